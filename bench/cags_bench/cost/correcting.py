"""Stages of correction in the client: methods of using references, and the whole frame over combinations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

from cags_bench.cost.engine import Outcome, Point, Stage
from cags_bench.cost.moments import Moment, Workbench, psnr
from cags_bench.cost.serving import DIFFERENCES, Referring
from cags_client.frame import align, restore
from cags_client.frame.restore import CORRECT, NONE, RestoreInput
from cags_client.settings import AUTO, FULL, HALF, ClientSettings
from cags_client.store.references import Received
from cags_common import correction
from cags_common.correction import Reference
from cags_common.geometry import F32
from cags_common.raster.base import Exactness, RenderOptions
from cags_common.raster.halving import enlarged, halved
from cags_protocol.wire.messages import ReferenceKind
from cags_server.settings import ServerSettings

RESTORERS = ("reference", "srresnet")
"""Restorers of aligned pictures, for comparison."""

SHIPPED = ClientSettings()
"""Defaults of the client."""


def correcting_stages(bench: Workbench) -> list[Stage]:
    """Methods of using a reference, and the client's whole frame over combinations of settings."""
    return [_methods(bench.moment), _whole_frame(bench.moment)]


def _received(moment: Moment, kind: str) -> tuple[Referring, Received | None]:
    """A reference as received by the client; None if the server finds nothing to say."""
    referring = Referring(moment, ServerSettings(references=kind))
    return referring, referring.received(referring.made())


def _judge(moment: Moment) -> Callable[[F32], Outcome]:
    return lambda rgb: {"corrected_psnr_db": psnr(rgb, moment.truth)}


def _methods(moment: Moment) -> Stage:
    """After drawing: no correction, a difference, a picture (with its own render), and restorers."""
    view, judge = moment.view(), _judge(moment)
    points = [Point(NONE, lambda: view.rgb, judge, default=SHIPPED.restore == NONE)]
    for kind in (ReferenceKind.DIFFERENCE.value, ReferenceKind.PICTURE.value):
        referring, reference = _received(moment, kind)

        def correct(referring: Referring = referring, reference: Received | None = reference) -> F32:
            return referring.corrected(reference, view)

        default = SHIPPED.restore == CORRECT and kind == DIFFERENCES.references
        points.append(Point(f"{CORRECT}, {kind}", correct, judge, default))
    picture = None if reference is None else reference.picture
    aligner, depth = align.create(SHIPPED.align), view.depth
    assert depth is not None
    for name in RESTORERS:
        restorer = restore.create(name)

        def restored(restorer: restore.Restorer = restorer) -> F32:
            if picture is None:
                return view.rgb
            aligned = aligner.align(picture, depth, moment.camera, colours=True)
            return restorer.restore(RestoreInput(view.rgb, aligned, moment.expected_db))

        points.append(Point(name, restored, judge, default=SHIPPED.restore == name))
    return Stage("correction", "method", "client", "corrected_psnr_db", tuple(points))


def _whole_frame(moment: Moment) -> Stage:
    """Draw and correct with every combination of exactness, resolution and correction; judged by the picture shown."""
    _, received = _received(moment, DIFFERENCES.references)
    reference = None if received is None else received.reference()
    points = tuple(
        _combination(moment, reference, exactness, resolution, method)
        for exactness, resolution, method in product(Exactness, (HALF, FULL), (NONE, CORRECT))
    )
    knob = "exactness / resolution / correction"
    return Stage("client frame", knob, "client", "corrected_psnr_db", points)


def _combination(
    moment: Moment, reference: Reference | None, exactness: Exactness, resolution: str, method: str
) -> Point:
    """The reference is None where there is nothing to correct."""
    corrector = correction.create("auto", SHIPPED.threads)
    half = resolution == HALF
    camera = halved(moment.camera) if half else moment.camera
    options = RenderOptions(exactness=exactness, threads=SHIPPED.threads)
    if half:
        options = replace(options, footprint=options.footprint.at_half_resolution())

    def run() -> F32:
        view = moment.held.render(camera, options)
        shown = view.rgb if method == NONE or reference is None else corrector.correct(view, camera, reference).rgb
        return enlarged(shown, moment.camera, SHIPPED.threads) if half else shown

    defaults = SHIPPED.exactness, FULL if SHIPPED.resolution == AUTO else SHIPPED.resolution, SHIPPED.restore
    label = f"{exactness.value} / {resolution} / {method}"
    return Point(label, run, _judge(moment), default=(exactness.value, resolution, method) == defaults)
