"""Tables and figures of the codec: levels of quantisation, layers, the ladder, and what a reference adds."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from statistics import mean, median
from typing import Any

from cags_bench.confidence import Interval, interval
from cags_bench.jsonl import JsonObject, check
from cags_bench.reproduce.plan import Context
from cags_bench.reproduce.section import Cell, Curve, Plot, Section
from cags_bench.reproduce.stills.measure import (
    DISTORTED,
    EXAMPLE,
    FORMATS,
    OURS,
    RECOLOURED,
    SUPER_RESOLVED,
    UPSAMPLED,
    WAYS,
    StillCase,
)
from cags_bench.reproduce.stills.published import published
from cags_common.bundle import BundleReader
from cags_common.bundle.player import BundlePlayer
from cags_common.splats import Splats

DECODINGS = 5
"""Timed decodings, codec by codec in turns, after one."""

COMPARED = "paper-66"
"""The quantiser that the paper compares with other formats."""


def still_cases(kind: str) -> Callable[[Context], list[StillCase]]:
    """A measurement on the first frame of every scene."""
    return lambda context: [_still(context, kind, scene) for scene in context.plan.scenes]


def layer_cases(context: Context) -> list[StillCase]:
    """Layers are measured on one scene."""
    return [_still(context, "layers", context.plan.scenes[0])]


def _still(context: Context, kind: str, scene: str) -> StillCase:
    plan = context.plan
    steps = 12 if plan.quick and kind == "ladder" else 0
    lpips = plan.lpips if kind == "svq" else ""
    return StillCase(kind, scene, plan.poses, plan.width, plan.height, steps, lpips)


def _measured(context: Context, kind: str, scene: str) -> list[JsonObject]:
    found: list[JsonObject] = context.result(_still(context, kind, scene))["result"]
    return found


def svq(context: Context) -> Section:
    """The highest level of each configuration beside other formats and published rows: quality, size, decoding time."""
    rows: list[list[Cell]] = []
    measured: dict[str, dict[str, JsonObject]] = {}
    for scene in context.plan.scenes:
        lines = {line["codec"]: line for line in _measured(context, "svq", scene)}
        context.tell(f"svq, decoding of {scene}")
        times = _decoding_ms(context, scene)
        measured[scene] = {name: line | {"decoding_ms": times[name]} for name, line in lines.items()}
        for name, line in measured[scene].items():
            title = name if name in FORMATS else f"SVQ {name}"
            quality = mean(line["psnr_db"]), line["ssim"], line["lpips"]
            size = line["bytes"] / 1e6, line["bytes"] / line["splats"]
            scalable = "no" if name in FORMATS else "yes"
            rows.append([title, scene, *quality, *size, line["decoding_ms"], scalable, "measured here"])
    for row in published():
        quality, levels = (row.psnr_db, row.ssim, row.lpips), "yes" if row.scalable else "no"
        rows.append([row.method, row.dataset, *quality, row.size_mb, None, row.decoding_s * 1e3, levels, row.source])
    return Section(
        name="svq",
        title="Scalable vector quantisation at its highest level",
        paper="Table 1 and the supplement's two tables. Rows that are 'measured here' compare with the unquantised "
        "splats, on this machine; the others are published rows, copied from the tables named, which compare with "
        "pictures of cameras on the authors' machine. Read the two side by side for sizes, and not for quality.",
        columns=(
            "method",
            "on",
            "PSNR [dB]",
            "SSIM",
            "LPIPS",
            "size [MB]",
            "bytes a splat",
            "decoding [ms]",
            "scalable",
            "source",
        ),
        rows=rows,
        notes=[
            "SPZ and SOG are written and read by this program, whole splats at one quality. "
            "SOG's own program searches its codebooks for longer: cags-bench codec --splat-transform measures it.",
            "CompGS, HAC, HAC++, GIFStream and QUEEN train from pictures of cameras, which no scene here has: "
            "only their published rows are shown.",
            "Codebooks are not counted: a clip has one set.",
            "Decoding is on this machine, the codecs in turns; published times are of a graphics card.",
        ],
        checks=[one for name in FORMATS for one in _against(name, list(measured.values()))],
    )


def _decoding_ms(context: Context, scene: str) -> dict[str, float]:
    """Median time of decoding every codec's first frame, in turns."""
    from cags_encoder.scenes import open_scene

    source = open_scene(scene).frame(0)
    works: dict[str, Callable[[], Any]] = {}
    readers = []
    for one in _still(context, "svq", scene).encodings:
        reader = BundleReader.open(str(context.runner.bundle(one)))
        readers.append(reader)
        works[one.settings.quantiser] = partial(_decoded, reader)
    for name, (write, read) in FORMATS.items():
        works[name] = partial(read, write(source))
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(DECODINGS + 1):
        for name, work in works.items():
            started = time.perf_counter()
            work()
            times[name].append((time.perf_counter() - started) * 1e3)
    for reader in readers:
        reader.close()
    return {name: median(found[1:]) for name, found in times.items()}


def _decoded(reader: BundleReader) -> Splats:
    return BundlePlayer(reader).frame(0).splats


def _against(name: str, scenes: Sequence[dict[str, JsonObject]]) -> list[JsonObject]:
    """What the paper claims of SVQ beside another format: as good, smaller, decoded faster."""
    gains = [a - b for one in scenes for a, b in zip(one[COMPARED]["psnr_db"], one[name]["psnr_db"], strict=True)]
    better = interval(gains)
    sizes, times = (
        interval([one[COMPARED][key] / one[name][key] for one in scenes]) for key in ("bytes", "decoding_ms")
    )
    title = "SVQ 66 bit"

    def share(one: Interval) -> str:
        return f"{one.mean:.2f} [{one.low:.2f}, {one.high:.2f}]"

    return [
        check(f"{title} looks better than {name}", "> 0 dB", f"{better} dB over views", better.above(0.0)),
        check(f"{title} is smaller than {name}", "< 1 of its bytes", f"{share(sizes)} of its bytes", sizes.high < 1),
        check(f"{title} decodes faster than {name}", "< 1 of its time", f"{share(times)} of its time", times.high < 1),
    ]


def ladder(context: Context) -> Section:
    """Quality against size as LoDs are added in their order."""
    rows: list[list[Cell]] = []
    curves: dict[str, tuple[list[float], list[float]]] = {}
    for scene in context.plan.scenes:
        for line in _measured(context, "ladder", scene):
            label, quality = f"{scene}, {line['quantiser']}", mean(line["psnr_db"])
            rows.append([label, line["lod"], line["bytes_a_splat"], quality, line["ssim"]])
            x, y = curves.setdefault(label, ([], []))
            x.append(line["bytes_a_splat"])
            y.append(quality)
    return Section(
        name="ladder",
        title="Quality against size along the LoD ladder",
        paper="Supplement, figure of interleaved layers.",
        columns=("scene, configuration", "LoD", "bytes a splat", "PSNR [dB]", "SSIM"),
        rows=rows,
        plots=[Plot("LoD ladder", "bytes a splat", "PSNR [dB]", [Curve(label, *xy) for label, xy in curves.items()])],
    )


def layers(context: Context) -> Section:
    """Each attribute decoded with more layers while the others are whole."""
    scene = context.plan.scenes[0]
    rows: list[list[Cell]] = []
    curves: dict[str, tuple[list[float], list[float]]] = {}
    for line in _measured(context, "layers", scene):
        size, quality = line["bytes_a_splat"], mean(line["psnr_db"])
        rows.append([line["attribute"], line["layers"], size, quality])
        x, y = curves.setdefault(line["attribute"], ([], []))
        x.append(size)
        y.append(quality)
    return Section(
        name="layers",
        title="Quality against size of each attribute's layers",
        paper="Supplement, figure of layer quality: one attribute cut, the others whole.",
        columns=("attribute", "layers", "bytes a splat", "PSNR [dB]"),
        rows=rows,
        plots=[Plot(scene, "bytes a splat", "PSNR [dB]", [Curve(label, *xy) for label, xy in curves.items()])],
    )


def motivation(context: Context) -> Section:
    """Size against PSNR over the paper's five flat quantisers: reference alone, colours alone, and by example."""
    rows: list[list[Cell]] = []
    plots = []
    found: list[JsonObject] = []
    for scene in context.plan.scenes:
        lines = _measured(context, "motivation", scene)
        found += lines
        for line in lines:
            means = [mean(line["psnr_db"][way]) for way in WAYS]
            kept = ", ".join(line["lossless"]) or "none"
            rows.append([scene, line["config"], line["bytes_a_splat"], line["codebook_bytes"] / 1e3, kept, *means])
        x = [line["bytes_a_splat"] for line in lines]
        curves = [Curve(way, x, [mean(line["psnr_db"][way]) for line in lines]) for way in WAYS]
        plots.append(Plot(scene, "bytes a splat", "PSNR [dB]", curves))
    return Section(
        name="motivation",
        title="Super-resolution, colours alone, and correction by example",
        paper="Figure 'motivation', with its flat quantisers: k-means codebooks of 8, 10, 12, 14 and 16 bits for "
        "scale, 4, 7, 10, 13 and 16 for rotation and harmonics, 4 for opacity, coded by Draco. References of 400x300 "
        "are rendered for the exact pose, as there.",
        columns=("scene", "config", "bytes a splat", "codebooks [kB]", "lossless", *(f"{way} [dB]" for way in WAYS)),
        rows=rows,
        plots=plots,
        notes=[
            "'Lossless': attributes with no more distinct values than the codebook has entries. The paper's scenes "
            "have more splats, so its largest codebooks still lose something.",
            "The paper does not say how positions are quantised, nor whether harmonics share a codebook: here 14 bits "
            "an axis, and one codebook a band.",
            "The networks are trained here, on the levels of our ladder and not on these quantisers: the "
            "paper trains one for each setting. What correction by a picture reaches without one is 'ours'.",
        ],
        checks=[_above(found, *pair) for pair in ((OURS, UPSAMPLED), (OURS, DISTORTED), *_PAPER)],
    )


_PAPER = ((EXAMPLE, SUPER_RESOLVED), (EXAMPLE, RECOLOURED))
"""The paper's own claim, of networks alone."""


def _above(lines: Sequence[JsonObject], way: str, other: str) -> JsonObject:
    """Whether ``way`` is above ``other`` at every quantiser, over the views of all scenes."""
    gains = {number: _gain(lines, number, way, other) for number in sorted({line["config"] for line in lines})}
    worst = min(gains, key=lambda number: gains[number].low)
    sure = sum(one.above(0.0) for one in gains.values())
    value = f"least {gains[worst]} dB at config {worst}; sure at {sure} of {len(gains)}"
    return check(f"{way} above {other}, every flat quantiser", "> 0 dB", value, sure == len(gains))


def _gain(lines: Sequence[JsonObject], number: int, way: str, other: str) -> Interval:
    own = [line["psnr_db"] for line in lines if line["config"] == number]
    return interval([a - b for one in own for a, b in zip(one[way], one[other], strict=True)])
