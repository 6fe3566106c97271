"""The comparison: ladders of the quantisers and points of the peers, scene by scene."""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np

from cags_bench.codec.bjontegaard import Curve, bd_psnr_db, bd_rate
from cags_bench.codec.peers import peers
from cags_bench.codec.views import Judge, views_around
from cags_bench.jsonl import check, summary
from cags_common.bundle import Manifest
from cags_common.codecs import TileCodec, tile_codec
from cags_common.lpips import Lpips
from cags_common.morton import morton_order, tile_ranges
from cags_common.raster import create
from cags_common.splats import Splats
from cags_common.tiles import KEY_TILE_SPLATS, position_bytes
from cags_encoder import EncodeSettings
from cags_encoder.measuring import cameras_around, measured
from cags_encoder.pipeline import near_plane
from cags_encoder.scenes import FrameSource, open_scene
from cags_encoder.svq_codec import SvqCodec

Line = dict[str, Any]
TRAIN_SPLATS = 65_536


def compare(scenes: Sequence[str], options: argparse.Namespace) -> Iterator[Line]:
    """Lines of every scene, then the summary."""
    lpips = Lpips(options.lpips) if options.lpips else None
    curves: dict[tuple[str, str], Curve] = {}
    tops: dict[str, tuple[float, float]] = {}
    times: list[Line] = []
    for spec in scenes:
        source = open_scene(spec)
        splats = source.frame(0)
        splats = splats.take(morton_order(splats.means))
        judge = Judge(splats, views_around(source, options.views, options.width), create("auto"), lpips)
        for name in options.quantisers:
            lines = [{"scene": spec, **line} for line in _ladder(source, splats, name, judge, options)]
            yield from lines
            curves[spec, name] = [(line["bytes"], line["psnr_db"]) for line in lines]
            if name == "layered":
                tops[spec] = lines[-1]["bytes_a_splat"], lines[-1]["psnr_db"]
                times.append(lines[-1])
        yield from _points(spec, splats, judge, options)
    yield summary("codec", _checks(curves, tops, times, options.quantisers), scenes=list(scenes), views=options.views)


def _ladder(
    source: FrameSource, splats: Splats, name: str, judge: Judge, options: argparse.Namespace
) -> Iterator[Line]:
    rows = np.sort(np.random.default_rng(0).permutation(len(splats))[:TRAIN_SPLATS])
    start = time.perf_counter()
    codec = SvqCodec.train(splats.take(rows), EncodeSettings(quantiser=name))
    train_s = time.perf_counter() - start
    rasteriser = create("auto")
    if rasteriser.name != "reference":
        focus = source.focus
        cameras = cameras_around(focus.centre, focus.radius, source.up, near_plane(focus))
        codec = measured(codec, splats, cameras, rasteriser, lambda at, end: None)
    tiles = _encode(codec, splats)
    sizes = np.array([[len(payload) for payload in payloads] for payloads in tiles]).sum(axis=0)
    positions = sum(position_bytes(payloads[0]) for payloads in tiles)
    books = codec.codebooks()
    manifest = Manifest("", 30.0, 1, (0,), (0,), 0, ((0, 0, 0), (0, 0, 0)), codec.lod_order, ())
    opener = tile_codec(manifest, books)
    encode_ms = _median_ms(partial(_encode, codec, splats), 1)
    for lod in np.unique(np.linspace(0, len(codec.lod_order), options.points).astype(int)):
        decode = partial(_decode, opener, tiles, int(lod))
        total = int(sizes[: lod + 1].sum())
        yield {
            "codec": name,
            "lod": int(lod),
            "splats": len(splats),
            "bytes": total + len(books),
            "bytes_a_splat": total / len(splats),
            "bytes_positions": positions,
            "bytes_base": int(sizes[0]) - positions,
            "bytes_layers": total - int(sizes[0]),
            "bytes_codebooks": len(books),
            **asdict(judge(decode())),
            "train_s": train_s,
            "encode_ms": encode_ms,
            "decode_ms": _median_ms(decode, options.repeats),
        }


def _points(spec: str, splats: Splats, judge: Judge, options: argparse.Namespace) -> Iterator[Line]:
    for peer in peers(splats):
        data = peer.encode(splats)
        yield {
            "scene": spec,
            "codec": peer.name,
            "splats": len(splats),
            "bytes": len(data),
            "bytes_a_splat": len(data) / len(splats),
            **asdict(judge(peer.decode(data))),
            "encode_ms": _median_ms(partial(peer.encode, splats), 1),
            "decode_ms": _median_ms(partial(peer.decode, data), options.repeats),
        }


def _encode(codec: SvqCodec, splats: Splats) -> list[tuple[bytes, ...]]:
    coded = codec.quantise(codec.prepare(splats))
    out = []
    for first, end in tile_ranges(len(splats), KEY_TILE_SPLATS):
        ids = np.arange(first, end, dtype=np.int32)
        out.append(codec.encode_tile(ids, coded.take(slice(first, end)), id_range=True).payloads)
    return out


def _decode(opener: TileCodec, tiles: list[tuple[bytes, ...]], lod: int) -> Splats:
    parts = []
    for payloads in tiles:
        state = opener.open_tile(payloads[0])
        for level in range(1, lod + 1):
            state.add_layer(level, payloads[level])
        parts.append(state.dequantise())
    return Splats.concatenate(parts)


def _median_ms(work: Callable[[], object], repeats: int) -> float:
    """Median of ``repeats`` runs after one that warms up."""
    work()
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        taken.append(1e3 * (time.perf_counter() - start))
    return statistics.median(taken)


def _checks(
    curves: dict[tuple[str, str], Curve], tops: dict[str, tuple[float, float]], times: list[Line], names: Sequence[str]
) -> list[Line]:
    out = []
    scenes = list(tops)
    if "paper-66" in names and scenes:
        gains = [bd_psnr_db(curves[scene, "layered"], curves[scene, "paper-66"]) for scene in scenes]
        rates = [bd_rate(curves[scene, "layered"], curves[scene, "paper-66"]) for scene in scenes]
        known, fewer = [g for g in gains if g is not None], [r for r in rates if r is not None]
        mean = statistics.fmean(known) if known else None
        out.append(check("bd_psnr_db_mean", ">= 4 dB over paper-66", mean, mean is not None and mean >= 4))
        out.append(
            check(
                "bd_psnr_db_worst", "never worse than paper-66", min(known, default=None), min(known, default=-1) >= 0
            )
        )
        rate = statistics.fmean(fewer) if fewer else None
        out.append(check("bd_rate_mean", "<= -0.35 against paper-66", rate, rate is not None and rate <= -0.35))
    for scene, (size, quality) in tops.items():
        good = size <= 11 and quality >= 43
        out.append(check(f"top_lod {scene}", ">= 43 dB at <= 11 bytes a splat (SH degree 0)", [size, quality], good))
    for line in times:
        scaled = line["decode_ms"] * 150_000 / line["splats"]
        out.append(check(f"decode_ms_150k {line['scene']}", "< 20 ms for 150,000 splats", scaled, scaled < 20))
    return out
