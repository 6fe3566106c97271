"""Stages of the server's reference: kind, size, footprint, quality and colour sampling, alone and combined."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

from cags_bench.cost.engine import Outcome, Point, Stage
from cags_bench.cost.moments import Moment, Workbench, psnr
from cags_bench.cost.serving import DIFFERENCES, Referring
from cags_common.raster.base import Footprint
from cags_common.video.colour import Chroma
from cags_server.reference.coder import Coded
from cags_server.settings import CLIENT, PLAIN, ServerSettings

SHIPPED = ServerSettings()
SHIPPED_SIZE = SHIPPED.reference_width, SHIPPED.reference_height
SHIPPED_CHROMA = Chroma(SHIPPED.reference_chroma)
"""Defaults of the server."""

CHROMA_NAMES = {Chroma.HALF: "4:2:0", Chroma.FULL: "4:4:4"}

KINDS = ("none", "picture", "difference")
SIZES = sorted({(200, 150), (400, 300), (800, 600), SHIPPED_SIZE})
CRFS = sorted({34.0, 28.0, 24.0, 20.0, 16.0, SHIPPED.reference_crf}, reverse=True)
COMBINED_CRFS = sorted({28.0, 20.0, 16.0, SHIPPED.reference_crf}, reverse=True)


def reference_stages(bench: Workbench) -> list[Stage]:
    """Drawing and coding a reference, judged by the client's corrected picture."""
    return [
        _kind(bench.moment),
        _size(bench.moment),
        _footprint(bench.moment),
        _quality(bench.moment),
        _chroma(bench.moment),
        _whole_reference(bench.moment),
    ]


def _point(referring: Referring, label: str, *, default: bool, drawn_once: bool = False) -> Point:
    """Draw and code; only code if the setting does not affect drawing (``drawn_once``)."""
    views = referring.drawn() if drawn_once else None

    def run() -> Coded:
        return referring.made() if views is None else referring.coded(*views)

    def judge(coded: Coded) -> Outcome:
        shown = referring.corrected(referring.received(coded))
        return {"bytes": len(coded.access_unit), "corrected_psnr_db": psnr(shown, referring.moment.truth)}

    return Point(label, run, judge, default)


def _stage(name: str, knob: str, points: tuple[Point, ...]) -> Stage:
    return Stage(name, knob, "server", "corrected_psnr_db", points, costs=("bytes",))


def _changed(moment: Moment, **changes: Any) -> Referring:
    return Referring(moment, replace(DIFFERENCES, **changes))


def _kind(moment: Moment) -> Stage:
    """``auto`` takes the kind with the smaller error: differences in most cases."""
    points = tuple(_point(_changed(moment, references=k), k, default=k == DIFFERENCES.references) for k in KINDS)
    return _stage("reference kind", "references", points)


def _sized(moment: Moment, size: tuple[int, int], **changes: Any) -> Referring:
    return _changed(moment, reference_width=size[0], reference_height=size[1], **changes)


def _size(moment: Moment) -> Stage:
    points = tuple(_point(_sized(moment, s), f"{s[0]}x{s[1]}", default=s == SHIPPED_SIZE) for s in SIZES)
    return _stage("reference size", "width x height", points)


def _footprint(moment: Moment) -> Stage:
    kinds = {PLAIN: Footprint.classic(), CLIENT: None}
    points = tuple(
        _point(Referring(moment, footprint=footprint), name, default=name == SHIPPED.reference_footprint)
        for name, footprint in kinds.items()
    )
    return _stage("reference footprint", "footprint", points)


def _quality(moment: Moment) -> Stage:
    points = tuple(
        _point(
            _changed(moment, reference_crf=crf), f"crf {crf:g}", default=crf == SHIPPED.reference_crf, drawn_once=True
        )
        for crf in CRFS
    )
    return _stage("reference H.264 quality", "crf", points)


def _chroma(moment: Moment) -> Stage:
    crfs = sorted({24.0, SHIPPED.reference_crf}, reverse=True)
    choices = [(f"{CHROMA_NAMES[chroma]} crf {crf:g}", crf, chroma) for chroma in Chroma for crf in crfs]
    points = tuple(
        _point(
            _changed(moment, reference_crf=crf, reference_chroma=chroma.value),
            label,
            default=(crf, chroma) == (SHIPPED.reference_crf, SHIPPED_CHROMA),
            drawn_once=True,
        )
        for label, crf, chroma in choices
    )
    return _stage("reference colour sampling", "chroma", points)


def _whole_reference(moment: Moment) -> Stage:
    """Every combination of size and quality: large coarse pictures against small fine ones."""
    points = tuple(
        _point(
            _sized(moment, (w, h), reference_crf=crf),
            f"{w}x{h} / crf {crf:g}",
            default=((w, h), crf) == (SHIPPED_SIZE, SHIPPED.reference_crf),
        )
        for (w, h), crf in product(SIZES, COMBINED_CRFS)
    )
    return _stage("whole reference", "size / quality", points)
