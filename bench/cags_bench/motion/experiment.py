"""The experiment behind ``cags-bench motion``."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from cags_bench.inputs import check_scenes, check_traces
from cags_bench.jsonl import JsonObject, check, provenance, summary
from cags_bench.motion.film import write_film
from cags_bench.motion.sessions import goal_checks, played, sessions_of
from cags_bench.motion.settings import DISGUISE, MotionSettings
from cags_bench.motion.uploads import frame_uploads
from cags_bench.outputs import check_output_file
from cags_common import raster
from cags_common.bundle import BundlePlayer, BundleReader
from cags_common.files import writable_folder
from cags_common.metrics import covered_mask, psnr
from cags_common.raster import RenderOptions
from cags_common.tiles.kinds import TileKind
from cags_encoder import EncodeSettings, encode
from cags_encoder.bundles.parts import byte_parts
from cags_encoder.execution.executors import open_workers
from cags_encoder.scenes import FrameSource, open_scene
from cags_encoder.views import cameras_around

WHOLE, TRACKS, SHORT = "none", "tracks", "none, levels that show"
WAYS = {
    WHOLE: EncodeSettings(motion="none", lod_order="paper"),
    TRACKS: EncodeSettings(),
    SHORT: EncodeSettings(motion="none"),
}
"""Whole splats with every level, as in the paper; motion apart; and whole splats with visible levels alone, for scenes
whose ladder ends early.
"""
TIMED_SPLATS = 60_000


def measure(settings: MotionSettings) -> Iterator[JsonObject]:
    """One line per scene and coding, one for the times, one per session, then the summary.

    Raises :class:`CagsError`; wrong inputs and outputs are refused before anything is measured.
    """
    _check(settings)
    lines, checks = [], list[JsonObject]()
    if "rates" in settings.part_list:
        for scene in settings.scene_list:
            for line in _rates(scene, settings):
                lines.append(line)
                yield line
    if "times" in settings.part_list:
        times = evaluation_times(settings)
        yield times
        checks.append(
            check("motion of 60,000 splats", "<= 4 ms, two threads", times["median_ms"], times["median_ms"] <= 4)
        )
    checks += _checks(lines)
    for session in sessions_of(settings) if "sessions" in settings.part_list else []:
        plays = []
        for seed in range(settings.seeds):
            plays.append(played(session, settings, seed))
            yield plays[-1]
        checks += goal_checks(session, plays)
    if settings.film:
        yield write_film(Path(settings.film), settings.film_scene, settings.film_trace, settings.cache)
    yield summary("motion", checks)


def _check(settings: MotionSettings) -> None:
    if settings.film:
        writable_folder(Path(settings.film).parent)
        check_output_file("film", settings.film)
        check_traces([settings.film_trace])
        check_scenes([settings.film_scene])
    if "rates" in settings.part_list:
        check_scenes(settings.scene_list)


def _rates(scene: str, settings: MotionSettings) -> Iterator[JsonObject]:
    """Lines of each way to code ``scene``."""
    whole = _encoded(scene, WHOLE, settings) if settings.whole else None
    if whole is not None:
        yield whole
    tracks = _encoded(scene, TRACKS, settings)
    yield tracks
    if whole is not None and tracks["levels"] < whole["levels"]:
        yield _encoded(scene, SHORT, settings)


def _encoded(scene: str, way: str, settings: MotionSettings) -> JsonObject:
    """Encode ``scene`` and measure bytes and quality."""
    source = open_scene(scene)
    with tempfile.TemporaryDirectory(prefix="cags-motion-") as folder, open_workers(settings.workers) as workers:
        url, started = str(Path(folder) / "clip.cags"), time.perf_counter()
        frames = min(settings.frames, len(source))
        encode(source, replace(WAYS[way], frames=frames), url, workers=workers)
        seconds = time.perf_counter() - started
        with BundleReader.open(url) as reader:
            return {
                "benchmark": "motion",
                "part": "rates",
                "scene": scene,
                "way": way,
                "seed": 0,
                "frames": frames,
                "levels": reader.manifest.lods,
                "groups": len(reader.manifest.gof_starts),
                "encode_s": round(seconds, 2),
                **frame_bytes(reader),
                **frame_uploads(reader),
                **_quality(reader, source, settings),
                **provenance(),
            }


def frame_bytes(reader: BundleReader) -> JsonObject:
    """Bytes of the key frames' looks, and bytes per later frame: base levels alone, and all levels."""
    manifest, key = reader.manifest, 0
    later = {kind: np.zeros(2) for kind in TileKind}
    removed = 0
    for index in range(manifest.frames):
        entry = reader.frame(index)
        removed += entry.removed_bytes if manifest.motion is None else 0
        for tile in entry.tiles:
            if entry.keyframe and tile.kind == TileKind.LOOKS:
                key += sum(tile.lod_bytes)
            else:
                later[tile.kind] += (tile.lod_bytes[0], sum(tile.lod_bytes))
    count = max(manifest.frames - len(manifest.gof_starts), 1)
    base, top = (float(sum(sizes[i] for sizes in later.values()) + removed) / count for i in (0, 1))
    return {
        "key_bytes": key,
        "base_bytes_a_frame": round(base),
        "top_bytes_a_frame": round(top),
        "with_key_bytes_a_frame": round((key + top * count) / manifest.frames),
        "by_part": {
            kind: {part: round(size / count) for part, size in parts.items()}
            for kind, parts in byte_parts(reader).items()
        },
        "by_kind": {kind.name.lower(): [round(float(size) / count) for size in later[kind]] for kind in TileKind},
    }


def _quality(reader: BundleReader, source: FrameSource, settings: MotionSettings) -> JsonObject:
    """PSNR over covered pixels against the source: base levels alone, and all levels."""
    cameras = cameras_around(source.focus, source.up, settings.views)
    rasteriser, frames = raster.create("auto"), reader.manifest.frames
    judged = sorted({round(at) for at in np.linspace(min(1, frames - 1), frames - 1, settings.judged)})
    out: JsonObject = {}
    for name, lod in (("base", 0), ("top", None)):
        player, found = BundlePlayer(reader, lod), []
        for index in judged:
            scenes = [rasteriser.load(s) for s in (source.frame(index), player.frame(index).splats)]
            for camera in cameras:
                true, shown = (scene.render(camera, RenderOptions()) for scene in scenes)
                found.append(psnr(shown.rgb, true.rgb, covered_mask(true.alpha)))
        out |= {f"{name}_psnr_db": round(float(np.mean(found)), 2), f"{name}_worst_db": round(min(found), 2)}
    return out


def evaluation_times(settings: MotionSettings) -> JsonObject:
    """Time to move :data:`TIMED_SPLATS` splats, as a client does for every frame."""
    from cags_bench.motion.moving import moving_buffer

    buffer = moving_buffer(TIMED_SPLATS, settings.threads)
    taken = []
    for repetition in range(settings.repetitions + 2):
        started = time.perf_counter()
        moved = buffer.move(0.5 + repetition)
        taken.append((time.perf_counter() - started) * 1e3)
        assert len(moved) == TIMED_SPLATS
    timed = sorted(taken[2:])
    return {
        "benchmark": "motion",
        "part": "evaluation",
        "splats": TIMED_SPLATS,
        "threads": settings.threads,
        "warm_up": 2,
        "repetitions": settings.repetitions,
        "median_ms": round(median(timed), 3),
        "spread_ms": round(timed[-1] - timed[0], 3),
        **provenance(),
    }


@dataclass(frozen=True)
class _Pair:
    """Results of one scene with whole splats and with motion apart."""

    scene: str
    whole: JsonObject
    tracks: JsonObject

    @property
    def fewer(self) -> float:
        """How many times fewer bytes per frame separate motion takes, with all levels."""
        return float(self.whole["top_bytes_a_frame"]) / max(float(self.tracks["top_bytes_a_frame"]), 1.0)

    @property
    def lost_db(self) -> float:
        """PSNR lost by separate motion compared with whole splats."""
        return float(self.whole["top_psnr_db"]) - float(self.tracks["top_psnr_db"])


def _checks(lines: list[JsonObject]) -> list[JsonObject]:
    by = {(line["scene"], line["way"]): line for line in lines}
    pairs = [_Pair(s, by[s, WHOLE], by[s, TRACKS]) for s, way in by if way == TRACKS and (s, WHOLE) in by]
    out: list[JsonObject] = []
    for pair in pairs:
        out += _pair_checks(pair)
        if (pair.scene, SHORT) in by:
            fewer = round(_Pair(pair.scene, by[pair.scene, SHORT], pair.tracks).fewer, 2)
            name = f"{pair.scene}: times fewer bytes than whole splats of the levels that show"
            out.append(check(name, "> 1", fewer, fewer > 1))
    for (scene, way), line in by.items():
        out += _upload_checks(scene, line) if way == TRACKS else []
        ordered = by.get((scene.replace(f",{DISGUISE}", "").replace(f":{DISGUISE}", ""), TRACKS))
        if way == TRACKS and scene.endswith(DISGUISE) and ordered is not None:
            more = line["top_bytes_a_frame"] / max(ordered["top_bytes_a_frame"], 1) - 1
            out.append(check(f"{scene}: more than ordered", "<= 0.25", round(more, 3), more <= 0.25))
        if way == TRACKS and scene.startswith("fourd"):
            top, base = line["with_key_bytes_a_frame"], line["base_bytes_a_frame"]
            out.append(check(f"{scene}: bytes a frame with the key frame", "<= 150,000", top, top <= 150_000))
            out.append(check(f"{scene}: base bytes a frame", "<= 60,000", base, base <= 60_000))
    return out


def _upload_checks(scene: str, line: JsonObject) -> list[JsonObject]:
    """Every row that differs is reported to the renderer, and few that do not."""
    unreported = line["rows_that_differ_and_are_not_told_of"]
    reported = line["rows_moved_a_frame"] + line["rows_changed_a_frame"]
    share = round(reported / max(line["rows_that_differ_a_frame"], 1), 2)
    return [
        check(f"{scene}: rows that differ and are not reported", "0", unreported, unreported == 0),
        check(f"{scene}: rows reported / rows that differ", "<= 2", share, share <= 2),
    ]


def _pair_checks(pair: _Pair) -> list[JsonObject]:
    least: dict[str, Any] = {"talking_head": 8.0, "procedural": 5.0, "monkey": 1.25, "wave": 1.25}
    wanted = next((times for name, times in least.items() if name in pair.scene and DISGUISE not in pair.scene), None)
    out = []
    if wanted is not None:
        fewer = round(pair.fewer, 2)
        out.append(check(f"{pair.scene}: times fewer bytes", f">= {wanted:g}", fewer, fewer >= wanted))
        lost = round(pair.lost_db, 2)
        out.append(check(f"{pair.scene}: dB less at the top", "<= 0.1", lost, lost <= 0.1))
    if "talking_head" in pair.scene and DISGUISE not in pair.scene:
        top = pair.tracks["top_bytes_a_frame"]
        out.append(check(f"{pair.scene}: bytes a frame at the top", "<= 20,000", top, top <= 20_000))
    return out
