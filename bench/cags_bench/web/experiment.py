"""A scene played from a published folder and from the server over the same links, and what was seen of it."""

from __future__ import annotations

import http.client
import tempfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from cags_bench.bundles import cached_bundle
from cags_bench.jsonl import JsonObject, check, provenance, summary
from cags_bench.web import cost, hosts
from cags_bench.web.browser import chromium, programs
from cags_bench.web.settings import PUBLISHED, SERVER, SOURCES, WebBenchSettings
from cags_bench.web.watch import Picture, Watched, watch
from cags_client.output.files import write_png
from cags_common import raster
from cags_common.bundle import BundleReader
from cags_common.errors import ConfigError
from cags_common.files import writable_folder
from cags_common.raster.base import RenderOptions
from cags_encoder import EncodeSettings
from cags_encoder.bundles.publish import PAGE_SUFFIXES, built_page, publish
from cags_encoder.scenes import FrameSource, open_scene
from cags_shaper.trace import open_trace

MOST_PAGE_BYTES = 1_500_000
FIRST_LINK, FIRST_PICTURE_S = "generated:steady-10", 1.0
SLOWEST_LINK, FASTEST_LINK = "generated:steady-2", "generated:steady-20"
KEPT_PICTURES = 6
ENOUGH = 2.0
"""A link suffices if it never carries less than so many times what the lowest level needs."""

SHORTAGES = {PUBLISHED: ("stalls", "waits for data"), SERVER: ("frames_missed", "frames shown without their data")}
"""What must not happen on such links: a published folder's page waits for data, a server's shows frames without it."""

TIMEOUT_S = 20


def plays(settings: WebBenchSettings) -> Iterator[JsonObject]:
    """Lines of the host, of the worker's cost and of each link and source, then the summary.

    Raises :class:`CagsError` where a part is not here or pictures cannot be written.
    """
    if settings.pictures:
        writable_folder(Path(settings.pictures))
    programs()
    page = built_page()
    if page is None:
        raise ConfigError("the viewer is not built; python -m cags_web.build")
    bundle = cached_bundle(settings.scene, settings.cache, EncodeSettings())
    truth = Truth(open_scene(settings.scene))
    lines: list[JsonObject] = []
    with tempfile.TemporaryDirectory(prefix="cags-web-", ignore_cleanup_errors=True) as work:
        folder = Path(work)
        publish(str(bundle), folder / "site", page)
        for line in _lines(settings, folder, page, bundle, truth):
            lines.append(line)
            yield {**line, **provenance()}
    plays = [line for line in lines if line["case"] == "play"]
    yield from beside(plays)
    yield summary("web", checks(lines), scene=settings.scene)


def _lines(settings: WebBenchSettings, folder: Path, page: Path, bundle: Path, truth: Truth) -> Iterator[JsonObject]:
    if settings.cost:
        yield from cost.cost(folder, page)
    with hosts.nginx(folder / "site", folder / "nginx") as port:
        yield hosted(folder / "site", port)
    for link in settings.link_list:
        for source in settings.source_list:
            yield _play(settings, folder, bundle, truth, source=source, link=link)


def hosted(site: Path, port: int) -> JsonObject:
    """What a plain web host at ``port`` makes of the published folder ``site``: bytes of the page, ranges, caching."""
    tiles = sorted(path for path in site.glob("*.bin"))
    answers = [_get(port, path.name, Range="bytes=1-8") for path in tiles]
    ranged = [
        (status, body) == (206, path.read_bytes()[1:9]) for path, (status, _, body) in zip(tiles, answers, strict=True)
    ]
    named = [f"-{zlib.crc32(path.read_bytes()):08x}-" in path.name for path in tiles]
    page = [_get(port, name, **{"Accept-Encoding": "gzip"}) for name in page_files(site)]
    again = [
        _get(port, name, **{"Accept-Encoding": "gzip", "If-None-Match": headers.get("ETag", "")})
        for name, (_, headers, _) in zip(page_files(site), page, strict=True)
    ]
    return {
        "case": "host",
        "page_bytes": sum(len(body) for _, _, body in page),
        "tile_files": len(tiles),
        "tile_files_by_ranges": sum(ranged),
        "tile_files_named_by_content": sum(named),
        "page_files": len(page),
        "page_files_revalidated": sum(status == 304 for status, _, _ in again),
        "page_bytes_of_a_second_visit": sum(len(body) for _, _, body in again),
    }


def page_files(site: Path) -> list[str]:
    """Files of the page in a folder, as a browser asks for them."""
    names = sorted(path.name for path in site.iterdir() if path.suffix in PAGE_SUFFIXES)
    return ["" if name == "index.html" else name for name in names if not name.startswith("gallery.")]


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
        tempfile.TemporaryDirectory(dir=folder, ignore_cleanup_errors=True) as profile,
        chromium(Path(profile), width=900, height=700, webgpu=True) as browser,
    ):
        size = f"{settings.width}x{settings.height}"
        page = [_get(port, name, **{"Accept-Encoding": "gzip"}) for name in page_files(folder / "site")]
        play = watch(browser, f"http://localhost:{shaped}/#size={size}", settings.seconds, settings.patience)
    if settings.pictures:
        _keep(Path(settings.pictures) / f"{source}-{link.rpartition(':')[2]}.png", play.pictures, truth)
    page_bytes = sum(len(body) for _, _, body in page)
    rates = {"needed_mbps": needed_mbps(bundle), "least_mbps": least_mbps(link, settings.seconds)}
    return {"case": "play", "source": source, "link": link, "page_bytes": page_bytes, **rates, **figures(play, truth)}


def needed_mbps(bundle: Path) -> float:
    """Rate below which ``bundle`` cannot play without waiting: the most that the lowest level takes in any second.

    The first frame is not part of it, because playing begins after it.
    """
    with BundleReader.open(str(bundle)) as reader:
        count, second = reader.manifest.frames, round(reader.manifest.fps)
        frames = map(reader.frame, range(1, count))
        sizes = [frame.removed_bytes + sum(tile.lod_bytes[0] for tile in frame.tiles) for frame in frames]
    windows = range(max(len(sizes) - second, 0) + 1)
    return max(sum(sizes[first : first + second]) for first in windows) * 8 / 1e6


def least_mbps(link: str, seconds: float) -> float:
    """The least rate of any whole second of the first ``seconds`` of a trace."""
    trace = open_trace(link)
    starts = range(max(int(seconds), 1))
    return min(trace.mean_bps(start * 1_000_000, (start + 1) * 1_000_000) for start in starts) / 1e6


def figures(play: Watched, truth: Truth) -> JsonObject:
    """What a play comes to: seconds from the page's start to when it asked for the scene and to its first picture, and
    from that question to the first frame's data, to the device with its shaders, and to the picture."""
    at = play.at_ms
    quality = [truth.psnr(picture) for picture in play.pictures]
    lods = [row["lod"] for row in play.shown if row["lod"] is not None]
    status = play.status
    asked, whole, device, picture = (at.get(name, np.nan) / 1e3 for name in ("join", "whole", "device", "picture"))
    return {
        "asked_s": asked,
        "data_s": whole - asked,
        "device_s": device - asked,
        "picture_s": picture - asked,
        "first_picture_s": picture,
        "drawing_ms": float(np.median([row["gpuMs"] for row in play.shown])) if play.shown else np.nan,
        "pictures": len(play.shown),
        "frames_displayed": len({(row["frame"], row["share"]) for row in play.shown}),
        "frames_missed": play.missed,
        "stalls": play.stalls,
        "stalled_ms": play.stalled_ms,
        "seek_s": play.seek_s,
        "psnr_db": float(np.mean(quality)) if quality else np.nan,
        "psnr_worst_db": min(quality, default=np.nan),
        "lod_first": lods[0] if lods else np.nan,
        "full_share": float(np.mean([row["full"] for row in play.shown])) if play.shown else np.nan,
        "lod_last": lods[-1] if lods else np.nan,
        "bytes_tiles": status.get("bytesTiles", 0),
        "bytes_reference": status.get("bytesReference", 0),
        "bytes_other": status.get("bytesOther", 0),
        "complaints": play.complaints,
    }


COMPARED = (
    "first_picture_s",
    "data_s",
    "stalls",
    "stalled_ms",
    "frames_displayed",
    "seek_s",
    "full_share",
    "psnr_db",
    "bytes",
)


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


def _get(port: int, name: str, **headers: str) -> tuple[int, Mapping[str, str], bytes]:
    """Status, headers and body, as sent, of a file of this machine's host."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=TIMEOUT_S)
    try:
        connection.request("GET", f"/{name}", headers=headers)
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()
    finally:
        connection.close()


def _keep(path: Path, pictures: list[Picture], truth: Truth) -> None:
    """Some pictures, each above its truth."""
    if not pictures:
        return
    step = max(1, len(pictures) // KEPT_PICTURES)
    columns = [np.vstack([one.pixels, truth.drawn(one)]) for one in pictures[::step]]
    write_png(path, np.hstack(columns))


def checks(lines: Sequence[JsonObject]) -> list[JsonObject]:
    """What the viewer must show, of the lines that were measured."""
    of = {case: [line for line in lines if line["case"] == case] for case in ("cost", "host", "play")}
    return [
        *(cost.checks(of["cost"]) if of["cost"] else []),
        *(found for line in of["host"] for found in _host_checks(line)),
        *_page_checks(of["play"]),
        *(found for line in of["play"] for found in _play_checks(line)),
        *_link_checks(of["play"]),
    ]


def _host_checks(line: JsonObject) -> Iterator[JsonObject]:
    for name in ("tile_files_by_ranges", "tile_files_named_by_content"):
        of = line["tile_files"]
        yield check(name.replace("_", " "), f"{of}", line[name], line[name] == of)
    of, again = line["page_files"], line["page_files_revalidated"]
    yield check("files of the page that a second visit need not fetch", f"{of}", again, again == of)


def _page_checks(plays: Sequence[JsonObject]) -> Iterator[JsonObject]:
    largest = max(line["page_bytes"] for line in plays)
    yield check("page, compressed", f"<= {MOST_PAGE_BYTES} bytes", largest, largest <= MOST_PAGE_BYTES)


def _play_checks(line: JsonObject) -> Iterator[JsonObject]:
    name = f"{line['source']}, {line['link']}"
    shown = line["frames_displayed"]
    yield check(f"plays: frames displayed, {name}", "> 1", shown, shown > 1)
    yield check(f"jumps to the middle, {name}", "a picture", line["seek_s"], line["seek_s"] == line["seek_s"])
    yield check(f"complaints, {name}", "0", len(line["complaints"]), not line["complaints"])
    if line["least_mbps"] >= ENOUGH * line["needed_mbps"]:
        key, what = SHORTAGES[line["source"]]
        yield check(f"{what} on a link that suffices, {name}", "0", line[key], line[key] == 0)
    if line["link"] == FIRST_LINK:
        for of, what in (
            ("data_s", "data of the first picture"),
            ("picture_s", "first picture, on a software adapter"),
        ):
            target = f"<= {FIRST_PICTURE_S} s after the page"
            yield check(f"{what}, {name}", target, line[of], line[of] <= FIRST_PICTURE_S)


def _link_checks(plays: Sequence[JsonObject]) -> Iterator[JsonObject]:
    """More of what a faster link shows is at its highest level, motion included."""
    for source in SOURCES:
        full = {line["link"]: line["full_share"] for line in plays if line["source"] == source}
        if full.keys() >= {SLOWEST_LINK, FASTEST_LINK}:
            low, high = full[SLOWEST_LINK], full[FASTEST_LINK]
            name = f"{source} adapts: share of pictures at full detail at 2 and at 20 Mbps"
            yield check(name, "rises or is level", [low, high], high >= low)
