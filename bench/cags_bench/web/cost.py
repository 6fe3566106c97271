"""Processor time of the viewer's worker per frame, in the browser: a clip in which every splat moves."""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cags_bench.jsonl import JsonObject, check
from cags_bench.web import hosts
from cags_bench.web.browser import BrowserError, chromium
from cags_common.geometry import F32, F64, Vec3
from cags_common.splats import Ids, Splats
from cags_encoder import EncodeSettings, encode
from cags_encoder.bundles.publish import publish
from cags_encoder.scenes import Focus

SPLATS, FRAMES = 60_000, 9
SHARES = (0.13, 0.37, 0.61, 0.89)
TOGETHER = len(SHARES)
"""Frames asked for at once: a single one is shorter than what the browser does around a question."""
WARM_PASSES, PASSES = 4, 20
MOST_MS = 4.0
WORKER_THREAD = "DedicatedWorker"
PATIENCE_S = 120

OPEN = """
const done = arguments[0], camera = { widthPx: 160, heightPx: 120, fxPx: 140, fyPx: 140, cxPx: 80, cyPx: 60 };
const worker = new Worker("/worker.js", { type: "module" }), waiting = new Map();
let asked = 0, spent = [];
window.frame = (request) => new Promise((resolve, reject) => {
  waiting.set(++asked, { resolve, reject });
  worker.postMessage({ ask: "frame", number: asked, request: { ...request, spent } }, spent);
});
worker.onerror = (event) => done({ error: event.message || "the worker does not start" });
worker.onmessage = ({ data }) => {
  if (data.tell === "frame") {
    waiting.get(data.number).resolve(data.update);
    spent = data.update.fresh ? [] : data.update.patches.map(({ words }) => words.buffer);
  }
  else if (data.tell === "failed") waiting.get(data.number).reject(new Error(data.message));
  else if (data.event.type === "error") done({ error: data.event.error.message });
  else if (data.event.type === "whole" && data.event.frame === LAST) done({});
  else if (data.event.type === "info") worker.postMessage({ ask: "control", state: PLAY });
};
const options = { intrinsics: camera, pose: { position: [0, 0, -9], rotation: [1, 0, 0, 0] } };
worker.postMessage({ ask: "connect", url: location.origin + "/", options });
""".replace("LAST", str(FRAMES - 1)).replace("PLAY", '{ action: "play", frame: 0, atUs: 0, keeps: true }')
"""The viewer's worker with a published folder, without the page: nothing is drawn beside it."""

ASK = """
const [requests, done] = arguments;
(async () => {
  const updates = [];
  for (const request of requests) {
    const { workMs, movedRows, full, patches } = await window.frame(request);
    const bytes = patches.reduce((sum, { words }) => sum + words.byteLength, 0);
    updates.push({ workMs, movedRows, full, bytes });
  }
  return { updates };
})().then(done, (error) => done({ error: String(error) }));
"""


class Swarm:
    """A cube of splats that drift and turn smoothly, every one in every frame."""

    name, fps, up = "swarm", 30.0, (0.0, 1.0, 0.0)

    def __init__(self, splats: int, frames: int) -> None:
        rng = np.random.default_rng(1)
        self._count, self._frames = splats, frames
        self._means: F64 = rng.uniform(-3, 3, (splats, 3))
        self._axes: F64 = rng.normal(size=(splats, 3))
        self._axes /= np.linalg.norm(self._axes, axis=1, keepdims=True)
        self._log_scales = rng.normal(-3.5, 0.4, (splats, 3)).astype(np.float32)
        self._sh0 = rng.normal(0, 0.7, (splats, 3)).astype(np.float32)

    @property
    def focus(self) -> Focus:
        """The cube's middle."""
        centre: Vec3 = (0.0, 0.0, 0.0)
        return Focus(centre, 3.0)

    def __len__(self) -> int:
        return self._frames

    def frame(self, index: int) -> Splats:
        """Every splat has moved by some centimetres and turned by some degrees since the frame before."""
        phase = 0.35 * index + self._means[:, ::-1]
        half = 0.5 * (0.3 + 0.06 * index)
        quats = np.concatenate([np.full((self._count, 1), np.cos(half)), np.sin(half) * self._axes], axis=1)
        none: F32 = np.zeros((self._count, 0, 3), np.float32)
        logits = np.full(self._count, 2.0, np.float32)
        means = (self._means + 0.2 * np.sin(phase)).astype(np.float32)
        return Splats(means, quats.astype(np.float32), self._log_scales, logits, self._sh0, none)

    def ids(self, index: int) -> Ids:
        """Rows keep their numbers."""
        return np.arange(self._count, dtype=np.int32)


def cost(folder: Path, page: Path) -> list[JsonObject]:
    """A line for media frames and one for pictures between them. ``folder`` is for what is made on the way.

    Raises :class:`CagsError` where a part is not here, and :class:`BrowserError` where the worker complains.
    """
    site = folder / "cost-site"
    encode(Swarm(SPLATS, FRAMES), EncodeSettings(frames=FRAMES, prune=0.0), str(folder / "cost"))
    publish(str(folder / "cost"), site, page)
    with (
        hosts.nginx(site, folder / "cost-nginx") as port,
        tempfile.TemporaryDirectory(dir=folder, ignore_cleanup_errors=True) as profile,
        chromium(Path(profile)) as browser,
    ):
        browser.set_script_timeout(PATIENCE_S)
        browser.get(f"http://localhost:{port}/manifest.json")  # of the same origin, and without the page's own worker
        answer(browser.execute_async_script(OPEN))
        worker = Worker(browser)
        worker.refined()
        return [worker.media(), worker.between()]


class Worker:
    """The viewer's worker in a browser, asked for frames and timed."""

    def __init__(self, browser: Any) -> None:
        self._browser = browser
        self._clock = ThreadClock(browser.service.process.pid)

    def refined(self) -> None:
        """Wait until nothing more is fetched or decoded beside what is timed."""
        ends = time.monotonic() + PATIENCE_S
        while not self._ask([{"frame": 0}])[0]["full"]:
            if time.monotonic() > ends:
                raise BrowserError(f"the clip did not come whole within {PATIENCE_S} s")
            time.sleep(0.2)

    def media(self) -> JsonObject:
        """Media frames in order, several passes; the jump back before each is not timed."""
        rounds = []
        for _ in range(WARM_PASSES + PASSES):
            self._ask([{"frame": 0}])
            rounds += [
                self._timed([{"frame": frame} for frame in range(first, first + TOGETHER)])
                for first in range(1, FRAMES, TOGETHER)
            ]
        return figures("media", rounds[WARM_PASSES * ((FRAMES - 1) // TOGETHER) :])

    def between(self) -> JsonObject:
        """Pictures between two media frames."""
        rounds = [
            self._timed([{"frame": FRAMES - 1 - TOGETHER, "share": share + i / 1000} for share in SHARES])
            for i in range(WARM_PASSES + 2 * PASSES)
            if self._ask([{"frame": FRAMES - 1 - TOGETHER}])
        ]
        return figures("between", rounds[WARM_PASSES:])

    def _ask(self, requests: Sequence[JsonObject]) -> list[JsonObject]:
        updates: list[JsonObject] = answer(self._browser.execute_async_script(ASK, list(requests)))["updates"]
        return updates

    def _timed(self, requests: Sequence[JsonObject]) -> Round:
        begun = self._clock.ns()
        updates = self._ask(requests)
        cpu_ms = (self._clock.ns() - begun) / 1e6 / len(updates)
        return Round(
            cpu_ms,
            float(np.mean([update["workMs"] for update in updates])),
            min(update["movedRows"] for update in updates),
            max(update["bytes"] for update in updates),
        )


class ThreadClock:
    """Processor time of the one worker thread among the descendants of a process (Linux)."""

    def __init__(self, pid: int) -> None:
        tasks = [task for child in _descendants(pid) for task in Path(f"/proc/{child}/task").iterdir()]
        found = [task for task in tasks if _read(task / "comm").startswith(WORKER_THREAD)]
        if len(found) != 1:
            raise BrowserError(f"{len(found)} worker threads in the browser; one is to be timed")
        self._stat = found[0] / "schedstat"

    def ns(self) -> int:
        """Nanoseconds on a processor so far."""
        return int(_read(self._stat).split()[0])


def _descendants(pid: int) -> list[int]:
    parents = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # processes that end meanwhile
            stat = (folder / "stat").read_text()
            parents[int(folder.name)] = int(stat.rpartition(")")[2].split()[1])
    found = [pid]
    for one in found:
        found += [child for child, parent in parents.items() if parent == one]
    return found[1:]


def _read(path: Path) -> str:
    return path.read_text(encoding="utf-8").strip()


@dataclass(frozen=True)
class Round:
    """Means over frames that were asked for together, and the least rows and most bytes of one of them."""

    cpu_ms: float
    work_ms: float
    rows: int
    bytes: int


def figures(frames: str, rounds: Sequence[Round]) -> JsonObject:
    """The line of frames of one kind: medians and tenths over the rounds."""
    cpu = [one.cpu_ms for one in rounds]
    return {
        "case": "cost",
        "frames": frames,
        "moved_rows": min(one.rows for one in rounds),
        "upload_bytes_a_frame": max(one.bytes for one in rounds),
        "cpu_ms": float(np.median(cpu)),
        "cpu_p10_ms": float(np.quantile(cpu, 0.1)),
        "cpu_p90_ms": float(np.quantile(cpu, 0.9)),
        "work_ms": float(np.median([one.work_ms for one in rounds])),
        "repetitions": len(rounds),
        "frames_together": TOGETHER,
    }


def checks(lines: Sequence[JsonObject]) -> list[JsonObject]:
    """One check a line, and one that all splats moved."""
    moved = min(line["moved_rows"] for line in lines)
    out = [check("splats that move in every frame of the cost's clip", f"{SPLATS}", moved, moved == SPLATS)]
    for line in lines:
        name = f"processor time of the worker, {line['frames']} frames of {SPLATS:,} moving splats"
        out.append(check(name, f"<= {MOST_MS} ms", line["cpu_ms"], line["cpu_ms"] <= MOST_MS))
    return out


def answer(told: JsonObject) -> JsonObject:
    """What a script of the browser told. Raises :class:`BrowserError` with its error."""
    if "error" in told:
        raise BrowserError(f"the viewer's worker says: {told['error']}")
    return told
