"""One play in the browser, watched: what the page shows when, and pictures of it."""

from __future__ import annotations

import base64
import math
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import Camera, Intrinsics, Pose

KEEP_EVERY_MS = 500
POLL_S = 0.25

SEEK = "const { player } = window.cags; player.pause(); player.seek(Math.floor(player.info.frames / 2));"
SOUGHT = """
const { player } = window.cags;
return player.shown.frame === Math.floor(player.info.frames / 2) && !player.waiting;
"""

WATCH = """
window.watched = { shown: [], at: {} };
setInterval(() => {
  const { player, show } = window.cags ?? {};
  if (show?.renderer) window.watched.at.device ??= performance.now();
  if (!player || player.isWatched) return;
  player.isWatched = true;
  const { shown, at } = window.watched, since = (name) => (at[name] ??= performance.now());
  const [step, handle] = [player.step.bind(player), player.handle.bind(player)];
  let [pictures, kept] = [0, -Infinity];
  since("join");
  player.handle = (event) => { since(event.type); handle(event); };
  player.step = () => {  // between frames: the device holds what was shown last
    const now = performance.now();
    if (player.shown && !player.drawing && player.pictures !== pictures) {
      since("picture");
      pictures = player.pictures;
      const { frame, share, camera, update, times } = player.shown;
      const { missed, full, lodMean: lod } = update;
      const row = { frame, share, camera, atMs: now, missed, full, lod, gpuMs: times.gpuMs };
      shown.push(row);
      if (!share && now - kept >= EVERY) {
        kept = now;
        window.cags.show.renderer.pixels().then(({ rgba }) => {
          let text = "";
          for (const byte of rgba) text += String.fromCharCode(byte);
          row.pixels = btoa(text);
        });
      }
    }
    step();
  };
}, 2);
""".replace("EVERY", str(KEEP_EVERY_MS))

READ = """
const player = window.cags?.player, { at, shown } = window.watched;
return {
  at, shown, stalls: player?.stalls ?? 0, stalledMs: player?.stalledMs ?? 0, missed: player?.missed ?? 0,
  status: player?.status, words: document.getElementById("message")?.innerText,
};
"""


@dataclass(frozen=True, eq=False)
class Picture:
    """What the page showed: a media frame from a camera, [H, W, 3] 8 bits a channel."""

    frame: int
    camera: Camera
    pixels: NDArray[np.uint8]


@dataclass(frozen=True)
class Watched:
    """A play: when things came (milliseconds of the page), everything that was shown, and how long a jump to the middle
    took after it (nan: it did not arrive)."""

    at_ms: dict[str, float]
    shown: list[dict[str, Any]]
    stalls: int
    stalled_ms: float
    missed: int
    seek_s: float
    status: dict[str, Any]
    complaints: list[str]
    pictures: list[Picture] = field(default_factory=list)


def watch(browser: Any, url: str, seconds: float, patience_s: float) -> Watched:
    """Open ``url``, wait for its first picture for ``patience_s`` at most, watch it for ``seconds``, and jump.

    What fails in the browser is a complaint of the play, not an error.
    """
    from selenium.common.exceptions import WebDriverException

    told: list[str] = []
    try:
        browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": WATCH})
        browser.get(url)
        if _until(browser, "return window.watched.at.picture", patience_s):
            time.sleep(seconds)
        read = browser.execute_script(READ)
        told += [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
        seek_s = _seek(browser, patience_s) if read["shown"] else math.nan
    except WebDriverException as error:
        told.append((error.msg or type(error).__name__).strip().splitlines()[0])
        return Watched({}, [], 0, 0.0, 0, math.nan, {}, told)
    if not read["shown"]:
        told.append(f"no picture within {patience_s:g} s; the page says {' '.join((read['words'] or '').split())!r}")
    elif math.isnan(seek_s):
        told.append(f"no picture of the middle within {patience_s:g} s of a jump there")
    pictures = [_picture(row) for row in read["shown"] if "pixels" in row]
    shown = [{k: v for k, v in row.items() if k not in ("pixels", "camera")} for row in read["shown"]]
    status = read["status"] or {}
    return Watched(read["at"], shown, read["stalls"], read["stalledMs"], read["missed"], seek_s, status, told, pictures)


def _seek(browser: Any, patience_s: float) -> float:
    """Seconds from a jump to the middle of the clip to its picture; nan where it does not come."""
    begun = time.monotonic()
    browser.execute_script(SEEK)
    return time.monotonic() - begun if _until(browser, SOUGHT, patience_s) else math.nan


def _until(browser: Any, script: str, patience_s: float) -> bool:
    ends = time.monotonic() + patience_s
    while not browser.execute_script(script):
        if time.monotonic() > ends:
            return False
        time.sleep(POLL_S)
    return True


def _picture(row: dict[str, Any]) -> Picture:
    i, pose = row["camera"]["intrinsics"], row["camera"]["pose"]
    intrinsics = Intrinsics(i["widthPx"], i["heightPx"], i["fxPx"], i["fyPx"], i["cxPx"], i["cyPx"])
    camera = Camera(intrinsics, Pose(tuple(pose["position"]), tuple(pose["rotation"])), row["camera"]["near"])
    pixels = np.frombuffer(base64.b64decode(row["pixels"]), np.uint8).reshape(i["heightPx"], i["widthPx"], 4)
    return Picture(row["frame"], camera, pixels[..., :3])
