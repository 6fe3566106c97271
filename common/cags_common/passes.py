"""Which effects a frame and a link need, decided in one place from what is there.

An effect is work that only some scenes, moments or scenarios call for. A plan is made anew for every frame; what is not
in it is not done, and leaving it out must not change the picture (tests hold both: equality with everything on, and a
visible fault where a needed effect is taken away). The conditions:

==================  ====================================================================================================
view-colour         some splat that is held has a spherical-harmonics coefficient that is not 0; up to the highest such
                    band
correction          a reference is at hand that says what is lacking, or from which that can be told
restoration         a picture is at hand for a restorer of aligned pictures, and colours are still quantised (or the
                    restorer stands in the picture's place)
alignment           as restoration: such restorers look at the picture from the client's view
occlusion           as alignment, and the two cameras stand at different places: from one place nothing can be hidden
erosion             as occlusion, and the restorer looks at the aligned colours (which are filled where a pixel is
                    hidden)
reference-render    as correction, and the reference is a picture: what is lacking is the picture less the client's
                    render from the reference camera
veto                as correction, and splats have changed since the reference was made
fade                the reference is of another frame than the one on display
depth               something is corrected or aligned, or somebody looks at the depth picture
==================  ====================================================================================================

and of a link: ``delay``, ``jitter``, ``loss``, ``queue`` (a bound on it), ``cap`` and ``rate`` (a trace), each where
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
    """Work of a client's frame that is done only where it is needed."""

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
    """What a simulated link does to packets besides carrying them."""

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
"""The timed stage of a frame that an effect is a part of (or the whole); ``fade`` is in none of its own."""

ALWAYS, NEEDED = "always", "needed"
POLICIES = (NEEDED, ALWAYS)
"""How effects are decided: from what is there, or all of them whenever they can run (to compare with)."""


@dataclass(frozen=True, slots=True)
class Situation:
    """What is there for one frame."""

    sh_degree: int
    """Highest band of spherical harmonics with a coefficient that is not 0, of all splats held."""
    scene_sh_degree: int
    """The band up to which the scene has coefficients at all."""
    whole: bool
    """Everything shown is at its highest level: what is left of quantisation is under the reference's own noise."""
    reference: bool
    """A reference is at hand that is not too old and says something."""
    picture: bool
    """That reference is a picture of the scene."""
    same_place: bool
    """The reference's camera stands where the client's does (whichever way they look)."""
    same_frame: bool
    """The reference is of the frame on display."""
    corrects: bool
    """What is lacking is added."""
    stale: bool
    """Splats have changed since the reference was made, other than it assumes."""
    restorer: frozenset[Pass]
    """What the restorer of aligned pictures looks at; nothing where there is none."""
    replaces: bool
    """That restorer stands in the picture's place instead of correcting it."""
    depth_shown: bool
    """Somebody looks at the depth picture."""


@dataclass(frozen=True, slots=True)
class PassPlan:
    """The effects of one frame."""

    on: frozenset[Pass]
    sh_degree: int = 0

    def __contains__(self, effect: Pass) -> bool:
        return effect in self.on


def plan_frame(s: Situation, policy: str = NEEDED) -> PassPlan:
    """The effects that situation ``s`` calls for; with ``ALWAYS`` every one that can run at all."""
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
    """Effects around a reference that says what is lacking."""
    on = {Pass.CORRECTION}
    if s.picture:
        on.add(Pass.REFERENCE_RENDER)
    if s.stale:
        on.add(Pass.VETO)
    if always or not s.same_frame:
        on.add(Pass.FADE)
    return on


def _restoring(s: Situation, *, always: bool) -> set[Pass]:
    """Effects around a picture for a restorer."""
    on = {Pass.RESTORATION, *(s.restorer - {Pass.EROSION})}
    if always or not s.same_place:
        on |= {Pass.OCCLUSION, *(s.restorer & {Pass.EROSION})}
    if always or not s.same_frame:
        on.add(Pass.FADE)
    return on


def held_sh_degree(sh_rest: F32) -> int:
    """The highest band with a coefficient that is not 0 in ``sh_rest`` [N, K, 3]."""
    bands = range(1, len(SH_REST_OF_DEGREE))
    own = {d: sh_rest[:, SH_REST_OF_DEGREE[d - 1] : SH_REST_OF_DEGREE[d]] for d in bands}
    return max((d for d, band in own.items() if band.any()), default=0)


def tally(records: Iterable[tuple[frozenset[Pass], Mapping[str, float]]]) -> dict[str, dict[str, Any]]:
    """Over frames (effects that were on, milliseconds by stage): each effect's share of frames and the time saved.

    ``saved_ms`` is the sum over the frames without the effect of what its stage takes less there than in the frames
    with it. It is None where the effect never ran, was never left out, or no times were taken.
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
