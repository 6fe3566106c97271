"""Times of the components, measured on this machine beside the paper's graphics card."""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median
from typing import Any

from cags_bench.reproduce.plan import Context
from cags_bench.reproduce.section import Cell, Section

REPETITIONS = 7
LINK_MBPS = 30.0
"""The link of the session that is timed, in the paper's terms: slow enough that there is something to restore."""

HORIZON_US = 200_000

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
    from cags_bench.cost.moments import capture

    plan = context.plan
    case = context.case(plan.scenes[0], "cags", LINK_MBPS)
    context.tell(f"components, {case.scene}")
    bundle = context.runner.bundle(case)
    bench = capture(bundle, plan.width, plan.height, context.runner.link(case, bundle), plan.poses)
    works = {**_server_works(bench), **_client_works(bench)}
    rows: list[list[Cell]] = []
    for name, work in works.items():
        times = _times_ms(work)
        rows.append([name, median(times), max(times) - min(times), PAPER_MS.get(name)])
    size = f"{plan.width}x{plan.height}, {len(bench.moment.source):,} splats"
    return Section(
        name="components",
        title="Time of the system's components",
        paper=f"Table 'performance of system components'. Here: two threads of this machine, {size}; there: 1600x1200.",
        columns=("component", "ms (median)", "range", "paper [ms]"),
        rows=rows,
    )


def _times_ms(work: Callable[[], Any]) -> list[float]:
    work()
    times = []
    for _ in range(REPETITIONS):
        started = time.perf_counter()
        work()
        times.append((time.perf_counter() - started) * 1e3)
    return times


def _server_works(bench: Any) -> dict[str, Callable[[], Any]]:
    from cags_bench.cost.looking import POSE_PERIOD_US
    from cags_common import raster
    from cags_common.poses import Focus, open_poses
    from cags_common.raster.base import Footprint, RenderOptions
    from cags_common.video.h264 import H264Encoder
    from cags_protocol.messages import PoseSample
    from cags_server.predict import create_predictor
    from cags_server.predict.history import PoseHistory

    walk = open_poses("synthetic:walking", Focus((0.0, 0.0, 0.0), 1.0, (0.0, 1.0, 0.0)), window_us=4_000_000)
    history = PoseHistory(PoseSample(t, walk.pose_at(t)) for t in range(0, 2_000_000, POSE_PERIOD_US))
    predictor = create_predictor("autoregressive")
    scene = raster.create("auto").load(bench.moment.source)
    camera = bench.moment.reference.camera
    options = RenderOptions(
        footprint=Footprint.of(bench.moment.camera.intrinsics, camera.intrinsics), contribution=True
    )
    picture = scene.render(camera, options).rgb
    encoder = H264Encoder(camera.width_px, camera.height_px, 30)
    return {
        "viewport prediction": lambda: predictor.predict(history, HORIZON_US),
        "render reference (400x300)": lambda: scene.render(camera, options),
        "encode reference (H.264)": lambda: encoder.encode(picture),
    }


def _client_works(bench: Any) -> dict[str, Callable[[], Any]]:
    from cags_client import align, restore
    from cags_common.bundle import BundleReader
    from cags_common.raster.base import RenderOptions
    from cags_common.svq import CodebookSet
    from cags_common.tile_kinds import TileKind
    from cags_common.tiles import decode_base

    moment = bench.moment
    reader = BundleReader.open(str(bench.bundle))
    books = CodebookSet.from_bytes(reader.codebooks())
    tiles = [entry.tile for entry in reader.frame(0).tiles if entry.kind is TileKind.LOOKS]
    bases = [reader.payload(0, tile, 0) for tile in tiles]
    decoder = _layer_decoder(reader, books, tiles, bases)
    scene, options = moment.seen.scene, RenderOptions()
    aligner, restorer = align.create("auto"), restore.create("affine")
    inputs = moment.seen.inputs(moment.reference, moment.seen.aligned(moment.reference, aligner))
    return {
        "decode base layers (Draco)": lambda: [decode_base(base, books) for base in bases],
        "decode layers (SVQ)": decoder,
        "render distorted + depth": lambda: scene.render(moment.camera, options),
        "PRPA": lambda: moment.seen.aligned(moment.reference, aligner).rgb,
        "colour restoration": lambda: restorer.restore(inputs),
    }


def _layer_decoder(reader: Any, books: Any, tiles: list[int], bases: list[bytes]) -> Callable[[], Any]:
    from cags_common.dequantise import Dequantiser
    from cags_common.tile_state import TileState
    from cags_common.tiles import decode_base

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
