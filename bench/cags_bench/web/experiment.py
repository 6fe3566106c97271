"""A scene played from a published folder and from the server over the same links, and what was seen of it."""

from __future__ import annotations

import tempfile
import urllib.request
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from cags_bench.bundles import cached_bundle
from cags_bench.jsonl import JsonObject, check, provenance, summary
from cags_bench.web import hosts
from cags_bench.web.browser import chromium, programs
from cags_bench.web.settings import PUBLISHED, SERVER, SOURCES, WebBenchSettings
from cags_bench.web.watch import Picture, Watched, watch
from cags_common import raster
from cags_common.errors import ConfigError
from cags_common.raster.base import RenderOptions
from cags_encoder import EncodeSettings
from cags_encoder.bundles.publish import built_page, publish
from cags_encoder.scenes import FrameSource, open_scene

PAGE_FILES = ("", "page.css", "page.js", "icon.svg", "worker.js", "kernels.wasm", "draco_decoder.wasm")
MOST_PAGE_BYTES = 1_500_000
FIRST_LINK, FIRST_PICTURE_S = "generated:steady-10", 1.0
KEPT_PICTURES = 6
TIMEOUT_S = 20


def plays(settings: WebBenchSettings) -> Iterator[JsonObject]:
    """One line a link and source, then the summary. Raises :class:`CagsError` where a part is not here."""
    programs()
    page = built_page()
    if page is None:
        raise ConfigError("the viewer is not built; python -m cags_web.build")
    bundle = cached_bundle(settings.scene, settings.cache, EncodeSettings())
    truth = Truth(open_scene(settings.scene))
    lines: list[JsonObject] = []
    with tempfile.TemporaryDirectory(prefix="cags-web-") as work:
        folder = Path(work)
        publish(str(bundle), folder / "site", page)
        for link in settings.link_list:
            for source in settings.source_list:
                line = _play(settings, folder, bundle, truth, source=source, link=link)
                lines.append(line)
                yield {**line, **provenance()}
    yield from beside(lines)
    yield summary("web", _checks(lines), scene=settings.scene)


class Truth:
    """What a viewer would see of the scene itself."""

    def __init__(self, source: FrameSource) -> None:
        self._source = source
        self._rasteriser = raster.create("auto")

    def drawn(self, picture: Picture) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """[H, W, 3] 8 bits a channel, of the picture's frame from its camera."""
        scene = self._rasteriser.load(self._source.frame(picture.frame))
        rgb = scene.render(picture.camera, RenderOptions(displayed=True)).rgb
        return np.asarray(np.floor(np.clip(rgb, 0, 1) * 255 + 0.5), np.uint8)

    def psnr(self, picture: Picture) -> float:
        """PSNR over all pixels, dB."""
        away = self.drawn(picture).astype(np.float64) - picture.pixels
        return float(10 * np.log10(255**2 / max(float(np.mean(away**2)), 1e-9)))


def _host(source: str, folder: Path, bundle: Path) -> AbstractContextManager[int]:
    if source == PUBLISHED:
        return hosts.nginx(folder / "site", folder / "nginx")
    return hosts.server(bundle, folder / "server")


def _play(
    settings: WebBenchSettings, folder: Path, bundle: Path, truth: Truth, *, source: str, link: str
) -> JsonObject:
    with (
        _host(source, folder, bundle) as port,
        hosts.link(link, port, folder / "link") as shaped,
        tempfile.TemporaryDirectory(dir=folder) as profile,
        chromium(Path(profile), width=900, height=700, webgpu=True) as browser,
    ):
        size = f"{settings.width}x{settings.height}"
        page_bytes = sum(_fetched(port, name) for name in PAGE_FILES)
        play = watch(browser, f"http://localhost:{shaped}/#size={size}", settings.seconds, settings.patience)
    if settings.pictures:
        _keep(Path(settings.pictures) / f"{source}-{link.rpartition(':')[2]}.png", play.pictures, truth)
    return {"case": "play", "source": source, "link": link, "page_bytes": page_bytes, **figures(play, truth)}


def figures(play: Watched, truth: Truth) -> JsonObject:
    """What a play comes to: seconds from the page's start, and from when it asked for the scene to its data."""
    at = play.at_ms
    quality = [truth.psnr(picture) for picture in play.pictures]
    lods = [row["lod"] for row in play.shown if row["lod"] is not None]
    status = play.status
    return {
        "asked_s": at.get("join", np.nan) / 1e3,
        "data_s": (at.get("whole", np.nan) - at.get("join", np.nan)) / 1e3,
        "first_picture_s": at.get("picture", np.nan) / 1e3,
        "drawing_ms": float(np.median([row["gpuMs"] for row in play.shown])) if play.shown else np.nan,
        "pictures": len(play.shown),
        "frames_displayed": len({(row["frame"], row["share"]) for row in play.shown}),
        "frames_missed": play.missed,
        "stalls": play.stalls,
        "stalled_ms": play.stalled_ms,
        "psnr_db": float(np.mean(quality)) if quality else np.nan,
        "psnr_worst_db": min(quality, default=np.nan),
        "lod_first": lods[0] if lods else np.nan,
        "lod_last": lods[-1] if lods else np.nan,
        "bytes_tiles": status.get("bytesTiles", 0),
        "bytes_reference": status.get("bytesReference", 0),
        "bytes_other": status.get("bytesOther", 0),
        "complaints": play.complaints,
    }


COMPARED = ("first_picture_s", "data_s", "stalls", "stalled_ms", "frames_displayed", "psnr_db", "bytes")


def beside(lines: list[JsonObject]) -> list[JsonObject]:
    """One line a link that both sources were played over: the published folder's figures and the server's, in pairs."""
    by_link: dict[str, dict[str, JsonObject]] = {}
    for line in lines:
        total = sum(line[name] for name in ("bytes_tiles", "bytes_reference", "bytes_other"))
        by_link.setdefault(line["link"], {})[line["source"]] = {**line, "bytes": total}
    return [
        {"case": "beside", "link": link}
        | {name: {source: of[source][name] for source in SOURCES} for name in COMPARED}
        | {"psnr_gain_of_server_db": of[SERVER]["psnr_db"] - of[PUBLISHED]["psnr_db"]}
        for link, of in by_link.items()
        if of.keys() >= set(SOURCES)
    ]


def _fetched(port: int, name: str) -> int:
    """Bytes of one file of the page as a browser gets it, compressed where the host does that."""
    request = urllib.request.Request(f"http://127.0.0.1:{port}/{name}", headers={"Accept-Encoding": "gzip"})
    with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:  # noqa: S310 - of this machine
        return len(answer.read())


def _keep(path: Path, pictures: list[Picture], truth: Truth) -> None:
    """Some pictures, each above its truth."""
    if not pictures:
        return
    step = max(1, len(pictures) // KEPT_PICTURES)
    columns = [np.vstack([one.pixels, truth.drawn(one)]) for one in pictures[::step]]
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.hstack(columns)[..., ::-1])


def _checks(lines: list[JsonObject]) -> list[JsonObject]:
    largest = max(line["page_bytes"] for line in lines)
    checks = [check("page, compressed", f"<= {MOST_PAGE_BYTES} bytes", largest, largest <= MOST_PAGE_BYTES)]
    shown = [line["pictures"] > 0 and not line["complaints"] for line in lines]
    checks.append(check("plays that show pictures and complain of nothing", f"{len(lines)}", sum(shown), all(shown)))
    for line in lines:
        if line["source"] == PUBLISHED:
            name = f"frames shown without their data, {line['link']}"
            checks.append(check(name, "0", line["frames_missed"], line["frames_missed"] == 0))
        if line["link"] == FIRST_LINK:
            name = f"data of the first picture after it was asked for, at 10 Mbps, {line['source']}"
            checks.append(check(name, f"<= {FIRST_PICTURE_S} s", line["data_s"], line["data_s"] <= FIRST_PICTURE_S))
    return checks
