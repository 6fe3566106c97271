"""Times of the components, measured on this machine beside the paper's graphics card."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from typing import Any

import numpy as np

from cags_bench.align.settings import AlignBenchSettings
from cags_bench.align.views import KNEE, View, fresh, view_of
from cags_bench.reproduce.plan import Context
from cags_bench.reproduce.section import Cell, Section
from cags_bench.seeing import see
from cags_client.frame import align, restore
from cags_client.frame.align import ReferencePicture
from cags_client.frame.restore import RestoreInput, expected_psnr_db
from cags_common import correction
from cags_common.bundle import BundleReader
from cags_common.correction import compand
from cags_common.poses import Focus, open_poses
from cags_common.raster.base import RenderOptions
from cags_common.tiles.dequantise import Dequantiser
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.payloads import decode_base
from cags_common.tiles.state import TileState
from cags_common.tiles.svq import CodebookSet
from cags_common.video.h264 import H264Encoder
from cags_protocol.wire.messages import PoseSample
from cags_server.predict import create_predictor
from cags_server.predict.history import PoseHistory

REPETITIONS = 7

HORIZON_US = 200_000
POSE_PERIOD_US = 16_667

PAPER_MS = {
    "viewport prediction": 1.0,
    "render reference (400x300)": 1.7,
    "decode base layers (Draco)": 9.0,
    "decode layers (SVQ)": 2.58,
    "render distorted + depth": 9.32,
    "PRPA": 2.11,
    "colour restoration": 6.5,
}
"""Milliseconds of the paper's component table (RTX 3080, 1600x1200)."""


def components(context: Context) -> Section:
    """One row a component."""
    plan = context.plan
    case = context.case(plan.scenes[0], "cags")
    context.tell(f"components, {case.scene}")
    rows: list[list[Cell]] = []
    with BundleReader.open(str(context.runner.bundle(case.encoding))) as reader:
        view = view_of(reader, AlignBenchSettings(poses=plan.poses), (plan.width, plan.height))
        for name, work in {**_server_works(view), **_client_works(view, reader)}.items():
            times = _times_ms(work)
            rows.append([name, median(times), max(times) - min(times), PAPER_MS.get(name)])
    size = f"{plan.width}x{plan.height}, {len(view.splats):,} splats"
    return Section(
        name="components",
        title="Time of the system's components",
        paper=f"Table 'performance of system components'. Here: two threads of this machine, {size}; there: 1600x1200.",
        columns=("component", "ms (median)", "range", "paper [ms]"),
        rows=rows,
        notes=[
            "PRPA and the network are the published way's; the default client corrects instead: "
            "it samples what is lacking by depth, and adds it."
        ],
    )


def _times_ms(work: Callable[[], Any]) -> list[float]:
    work()
    times = []
    for _ in range(REPETITIONS):
        started = time.perf_counter()
        work()
        times.append((time.perf_counter() - started) * 1e3)
    return times


def _server_works(view: View) -> dict[str, Callable[[], Any]]:
    walk = open_poses("synthetic:walking", Focus((0.0, 0.0, 0.0), 1.0, (0.0, 1.0, 0.0)), window_us=4_000_000)
    history = PoseHistory(PoseSample(t, walk.pose_at(t)) for t in range(0, 2_000_000, POSE_PERIOD_US))
    predictor = create_predictor("autoregressive")
    camera = view.picture.camera
    truth_options = replace(view.own_options, contribution=True)
    truth, own = view.truth.render(camera, truth_options).rgb.clip(0, 1), view.own().clip(0, 1)
    pictures, differences = (H264Encoder(camera.width_px, camera.height_px, 30) for _ in range(2))
    return {
        "viewport prediction": lambda: predictor.predict(history, HORIZON_US),
        "render reference (400x300)": lambda: view.truth.render(camera, truth_options),
        "render the client's splats (400x300)": view.own,
        "encode a picture (H.264)": lambda: pictures.encode(truth),
        "encode a difference (H.264)": lambda: differences.encode(compand(truth - own, KNEE).astype(np.float32)),
    }


def _client_works(view: View, reader: BundleReader) -> dict[str, Callable[[], Any]]:
    books = CodebookSet.from_bytes(reader.codebooks())
    tiles = [entry.tile for entry in reader.frame(0).tiles if entry.kind is TileKind.LOOKS]
    bases = [reader.payload(0, tile, 0) for tile in tiles]
    seen = see(view.held, view.camera)
    picture = ReferencePicture(view.picture.coded, view.picture.camera, 0)
    aligner, network, corrector = align.create("fast"), restore.create("srresnet"), correction.create("auto")
    expected_db = expected_psnr_db(AlignBenchSettings().lod * (reader.manifest.lods - 1), reader.manifest)
    inputs = RestoreInput(seen.distorted, seen.aligned(picture, aligner, colours=True), expected_db)
    return {
        "decode base layers (Draco)": lambda: [decode_base(base, books) for base in bases],
        "decode layers (SVQ)": _layer_decoder(reader, books, tiles, bases),
        "render distorted + depth": lambda: view.held.render(view.camera, RenderOptions()),
        "correct by a new difference": lambda: seen.corrected(fresh(view.difference), corrector),
        "correct by a new picture": lambda: seen.corrected(fresh(view.picture), corrector),
        "PRPA": lambda: seen.aligned(picture, aligner, colours=True).rgb,
        "colour restoration": lambda: network.restore(inputs),
    }


def _layer_decoder(reader: BundleReader, books: CodebookSet, tiles: list[int], bases: list[bytes]) -> Callable[[], Any]:
    decoded = [decode_base(base, books) for base in bases]
    order, dequantiser = reader.manifest.lod_order, Dequantiser(books)
    layers = [[reader.payload(0, tile, lod) for lod in range(1, len(order) + 1)] for tile in tiles]

    def work() -> list[Any]:
        out = []
        for base, payloads in zip(decoded, layers, strict=True):
            state = TileState(base, dequantiser, order)
            for lod, payload in enumerate(payloads, start=1):
                state.add_layer(lod, payload)
            out.append(state.dequantise())
        return out

    return work
