"""The passes that a frame needs and the effects that a link needs, decided in one place.

A pass (:class:`Effect`) is work that only some scenes or moments require. A plan is made for every frame, and passes
outside of it do not run. Leaving them out must not change the picture; tests check equality with all passes on, and a
visible fault when a needed pass is removed. The conditions:

==================  ====================================================================================================
view-colour         some held splat has a nonzero spherical-harmonics coefficient; evaluated up to the highest such
                    band
correction          a reference is available that carries, or allows computing, what the client lacks
restoration         a picture is available for a restorer of aligned pictures, and colours are still quantised (or
                    the restorer replaces the picture)
alignment           as restoration: such restorers need the picture in the client's view
occlusion           as alignment, and the cameras are at different positions; at one position nothing is occluded
erosion             as occlusion, and the restorer uses the aligned colours, which are filled where a pixel is
                    occluded
reference-render    as correction, and the reference is a picture: what the client lacks is the picture minus the
                    client's render from the reference camera
veto                as correction, and splats have changed since the reference was made, or, for a picture,
                    may have moved
fade                the reference belongs to another frame than the displayed one
depth               something is corrected or aligned, or the viewer shows the depth picture
==================  ====================================================================================================

The effects of a link are ``delay``, ``jitter``, ``loss``, ``queue`` (a limit), ``cap`` and ``rate`` (a trace), each if
the scenario names it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from cags_common.geometry import F32
from cags_common.splats import SH_REST_OF_DEGREE


class Pass(StrEnum):
    """Passes of a client's frame that run only when needed."""

    VIEW_COLOUR = "view-colour"
    DEPTH = "depth"
    ALIGNMENT = "alignment"
    OCCLUSION = "occlusion"
    EROSION = "erosion"
    FADE = "fade"
    REFERENCE_RENDER = "reference-render"
    VETO = "veto"
    CORRECTION = "correction"
    RESTORATION = "restoration"


class LinkEffect(StrEnum):
    """Effects of a simulated link on packets."""

    RATE = "rate"
    DELAY = "delay"
    JITTER = "jitter"
    LOSS = "loss"
    QUEUE = "queue"
    CAP = "cap"


STAGE_OF = {
    Pass.VIEW_COLOUR: "raster",
    Pass.DEPTH: "raster",
    Pass.ALIGNMENT: "align",
    Pass.OCCLUSION: "align",
    Pass.EROSION: "restore",
    Pass.REFERENCE_RENDER: "own",
    Pass.VETO: "correct",
    Pass.CORRECTION: "correct",
    Pass.RESTORATION: "restore",
}
"""The timed stage of a frame that contains each pass; ``fade`` has none."""

ALWAYS, NEEDED = "always", "needed"
POLICIES = (NEEDED, ALWAYS)
"""Policies: the needed passes, or, for comparison, all passes that can run."""


@dataclass(frozen=True, slots=True)
class Situation:
    """Conditions of one frame."""

    sh_degree: int
    """Highest band of spherical harmonics with a nonzero coefficient in any held splat."""
    scene_sh_degree: int
    """Highest band of spherical harmonics in the scene's format."""
    whole: bool
    """Everything displayed is at its highest level, and its quantisation error is below the reference's noise."""
    reference: bool
    """A reference is available that is not too old and not empty."""
    picture: bool
    """The reference is a picture of the scene."""
    same_place: bool
    """The reference's camera has the client's position, with any orientation."""
    certain: bool
    """The reference belongs to the displayed frame and holds at the client's view: it has its full weight."""
    corrects: bool
    """The client adds what it lacks."""
    stale: bool
    """Splats have changed since the reference was made in a way that it does not assume."""
    restorer: frozenset[Pass]
    """Inputs of the restorer of aligned pictures; none without such a restorer."""
    replaces: bool
    """The restorer replaces the picture instead of correcting it."""
    depth_shown: bool
    """The viewer shows the depth picture."""


@dataclass(frozen=True, slots=True)
class PassPlan:
    """The passes of one frame."""

    on: frozenset[Pass]
    sh_degree: int = 0

    def __contains__(self, effect: Pass) -> bool:
        return effect in self.on


def plan_frame(s: Situation, policy: str = NEEDED) -> PassPlan:
    """The passes needed in situation ``s``; with ``ALWAYS`` all passes that can run."""
    always = policy == ALWAYS
    on: set[Pass] = set()
    degree = s.scene_sh_degree if always else s.sh_degree
    if degree:
        on.add(Pass.VIEW_COLOUR)
    if s.reference and s.corrects:
        on |= _correcting(s, always=always)
    elif s.reference and s.picture and s.restorer and (always or s.replaces or not s.whole):
        on |= _restoring(s, always=always)
    if always or s.depth_shown or on & {Pass.ALIGNMENT, Pass.CORRECTION}:
        on.add(Pass.DEPTH)
    return PassPlan(frozenset(on), degree)


def _correcting(s: Situation, *, always: bool) -> set[Pass]:
    """Passes for a reference that carries what the client lacks."""
    on = {Pass.CORRECTION}
    if s.picture:
        on.add(Pass.REFERENCE_RENDER)
    if s.stale:
        on.add(Pass.VETO)
    if always or not s.certain:
        on.add(Pass.FADE)
    return on


def _restoring(s: Situation, *, always: bool) -> set[Pass]:
    """Passes for a picture and a restorer."""
    on = {Pass.RESTORATION, *(s.restorer - {Pass.EROSION})}
    if always or not s.same_place:
        on |= {Pass.OCCLUSION, *(s.restorer & {Pass.EROSION})}
    if always or not s.certain:
        on.add(Pass.FADE)
    return on


def held_sh_degree(sh_rest: F32) -> int:
    """The highest band with a nonzero coefficient in ``sh_rest`` [N, K, 3]."""
    bands = range(1, len(SH_REST_OF_DEGREE))
    own = {d: sh_rest[:, SH_REST_OF_DEGREE[d - 1] : SH_REST_OF_DEGREE[d]] for d in bands}
    return max((d for d, band in own.items() if band.any()), default=0)


def tally(records: Iterable[tuple[frozenset[Pass], Mapping[str, float]]]) -> dict[str, dict[str, Any]]:
    """Summarise frames (passes that ran, milliseconds by stage): each pass's share of frames and the time saved.

    ``saved_ms`` is the time that the pass's stage took less in frames without the pass than in frames with it, summed
    over the former. It is None if the pass always or never ran, or if no times were taken.
    """
    frames = list(records)
    return {effect.value: _tallied(effect, frames) for effect in Pass} if frames else {}


def _tallied(effect: Pass, frames: list[tuple[frozenset[Pass], Mapping[str, float]]]) -> dict[str, Any]:
    stage = STAGE_OF.get(effect)
    with_it = [ms.get(stage, 0.0) for on, ms in frames if effect in on] if stage else []
    without = [ms.get(stage, 0.0) for on, ms in frames if effect not in on] if stage else []
    saved = None
    if with_it and without and any(with_it):
        saved = max(sum(with_it) / len(with_it) * len(without) - sum(without), 0.0)
    return {"share": sum(effect in on for on, _ in frames) / len(frames), "saved_ms": saved}
