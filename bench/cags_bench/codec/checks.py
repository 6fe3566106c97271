"""Targets of the codec and the measured values."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence
from typing import Any

from cags_bench.codec.bjontegaard import Curve, bd_psnr_db, bd_rate
from cags_bench.jsonl import check

Line = dict[str, Any]
DEFAULT, FINE, ANCHOR = "layered", "layered-fine", "paper-66"


def checks(lines: Sequence[Line]) -> list[Line]:
    """All targets that the measured ``lines`` allow to check."""
    clips = [line for line in lines if "clip" in line]
    lines = [line for line in lines if "codec" in line]
    ours = [line for line in lines if line["codec"] == DEFAULT]
    scenes = list(dict.fromkeys(line["scene"] for line in ours))
    tops = {scene: max((x for x in ours if x["scene"] == scene), key=lambda x: x["lod"]) for scene in scenes}
    return [
        *_rate_distortion(lines, scenes),
        *(_top(scene, tops[scene]) for scene in scenes if tops[scene]["sh_degree"] == 0),
        *(_time(scene, tops[scene]) for scene in scenes),
        *(_changed(scene, tops[scene]) for scene in scenes),
        *_beside(lines),
        *_workers(clips),
    ]


def _rate_distortion(lines: Sequence[Line], scenes: list[str]) -> Iterator[Line]:
    def curve(scene: str, codec: str) -> Curve:
        return [(x["bytes"], x["psnr_db"]) for x in lines if (x["scene"], x["codec"]) == (scene, codec)]

    pairs = [(curve(scene, DEFAULT), curve(scene, ANCHOR)) for scene in scenes if curve(scene, ANCHOR)]
    if not pairs:
        return
    gains = [gain for pair in pairs if (gain := bd_psnr_db(*pair)) is not None]
    rates = [rate for pair in pairs if (rate := bd_rate(*pair)) is not None]
    gain, rate = statistics.fmean(gains) if gains else None, statistics.fmean(rates) if rates else None
    enough = (gain is not None and gain >= 4) or (rate is not None and rate <= -0.35)
    target = f">= 4 dB over {ANCHOR} at equal bytes, or <= -0.35 of its bytes at equal PSNR, mean of the scenes"
    yield check("bd_psnr_db, bd_rate", target, [gain, rate], enough)
    yield check("bd_psnr_db_worst", f"never worse than {ANCHOR}", min(gains, default=None), min(gains, default=-1) >= 0)


def _top(scene: str, line: Line) -> Line:
    size, quality = line["bytes_a_splat"], line["psnr_db"]
    target = ">= 43 dB at <= 11 bytes a splat (SH degree 0)"
    return check(f"top_lod {scene}", target, [size, quality], size <= 11 and quality >= 43)


def _time(scene: str, line: Line) -> Line:
    scaled = line["decode_ms"] * 150_000 / line["splats"]
    return check(f"decode_ms_150k {scene}", "< 20 ms for 150,000 splats", scaled, scaled < 20)


def _changed(scene: str, line: Line) -> Line:
    scaled = line["changed_decode_ms"] * 4_000 / line["changed_splats"]
    return check(f"changed_decode_ms {scene}", "< 2 ms for 4,000 changed splats", scaled, scaled < 2)


def _beside(lines: Sequence[Line]) -> Iterator[Line]:
    """Size and decoding time compared with other formats and their own readers.

    For each, our smallest LoD of at least equal quality is used, or else our best.
    """
    for peer in lines:
        known = [taken for taken in peer.get("reader_ms", {}).values() if taken is not None]
        ladder = [x for x in lines if x["codec"] in (DEFAULT, FINE) and x["scene"] == peer["scene"]]
        if not known or not ladder:
            continue
        as_good = [x for x in ladder if x["psnr_db"] >= peer["psnr_db"]]
        line = min(as_good, key=lambda x: x["bytes"]) if as_good else max(ladder, key=lambda x: x["psnr_db"])
        at = f"{peer['codec']} {peer['scene']}"
        level = [line["psnr_db"], peer["psnr_db"]]
        faster, smaller = line["decode_ms"] <= min(known), line["bytes"] <= peer["bytes"]
        times, bytes_ = [line["decode_ms"], min(known), *level], [line["bytes"], peer["bytes"], *level]
        target = "at equal quality no slower than its fastest own reader [ms, ms, dB, dB]"
        yield check(f"decode_beside {at}", target, times, bool(as_good) and faster)
        yield check(
            f"bytes_beside {at}", "at equal quality no larger [bytes, bytes, dB, dB]", bytes_, bool(as_good) and smaller
        )


def _workers(clips: Sequence[Line]) -> Iterator[Line]:
    """Speed-up relative to the first line's number of workers, and equality of bytes."""
    for line in clips[1:]:
        first = clips[0]
        faster, wanted = first["total_s"] / line["total_s"], 0.75 * line["workers"] / first["workers"]
        at, same = f"{first['workers']} -> {line['workers']} workers", line["sha256"] == first["sha256"]
        yield check(f"encode_speed_up {at}", f">= {wanted:g}, three quarters of ideal", faster, faster >= wanted)
        yield check(f"encode_same_bytes {at}", "equal", same, same)
