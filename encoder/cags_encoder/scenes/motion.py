"""Turns one capture into a dynamic scene with known identities.

One part of the scene moves rigidly, another bends, another changes colour, and another appears and disappears; the rest
is bit-identical in all frames. Positions, rotations and view-dependent colour move together, so a moved part looks as
if the light moved with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_common import so3
from cags_common.geometry import F32, F64, Vec3
from cags_common.settings import check_settings, setting
from cags_common.splats import SH_C0, Ids, Splats
from cags_encoder.scenes import rotations
from cags_encoder.scenes.harmonics import rotate_rest
from cags_encoder.scenes.source import DEFAULT_FPS, MAX_FRAMES, Focus, FrameSource

Rows: TypeAlias = NDArray[np.intp]
Columns: TypeAlias = dict[str, F32]
KINDS = ("rigid", "bend", "colour", "appear", "mix")

CLUSTERS = 24
"""Number of patches that appear and disappear, each at its own time."""


@dataclass(frozen=True)
class MotionOptions:
    """Kind, size and speed of the motion."""

    kind: str = setting("mix", "kind of change", choices=KINDS)
    frames: int = setting(60, "number of frames", low=1, high=MAX_FRAMES)
    fps: float = setting(DEFAULT_FPS, "frames per second", low=1.0, high=240.0)
    share: float = setting(0.15, "share of the splats that change", low=0.0, high=1.0)
    amount: float = setting(
        1.0, "size of the motion; 1 moves by about a fifth of the scene's radius", low=0.0, high=10.0
    )
    period_s: float = setting(2.0, "time of one swing, seconds", low=0.05, high=600.0)
    seed: int = setting(1, "seed of directions and times", low=0, high=2**31 - 1)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, eq=False)
class _Cast:
    """The capture, and which of its rows move how."""

    rest: Splats
    parts: dict[str, Rows]
    """Kind of motion -> rows; without parts that are empty."""
    axis: F64
    """[3] about which the "bend" part leans."""
    cluster: Rows
    """[n] patch of each row of the "appear" part."""
    phase: F64
    """[:data:`CLUSTERS`] time offset of each patch, 0..1."""


class MotionScene:
    """The first frame of ``base`` with added motion. Row numbers of the capture are the identities."""

    def __init__(self, base: FrameSource, options: MotionOptions) -> None:
        self._base, self._options = base, options
        self._name, self._up, self._focus = f"{base.name}-{options.kind}", base.up, base.focus

    @cached_property
    def _cast(self) -> _Cast:
        options, rest = self._options, self._base.frame(0)
        rng = np.random.default_rng(options.seed)
        kinds = KINDS[:-1] if options.kind == "mix" else (options.kind,)
        parts = _parts(self._base, rest, options.share, kinds, rng)
        parts = {kind: rows for kind, rows in parts.items() if len(rows)}
        axis = _horizontal(np.asarray(self._up), rng.uniform(0, 2 * np.pi))
        return _Cast(rest, parts, axis, *_patches(rest, parts.get("appear", np.zeros(0, np.intp)), rng))

    def __getstate__(self) -> dict[str, Any]:
        """Workers read the capture themselves: it may take hundreds of megabytes."""
        return {name: value for name, value in self.__dict__.items() if name != "_cast"}

    @property
    def name(self) -> str:
        """The capture's name and the kind of motion."""
        return self._name

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self._options.fps

    @property
    def up(self) -> Vec3:
        """Up direction of the capture."""
        return self._up

    @property
    def focus(self) -> Focus:
        """Focus of the capture."""
        return self._focus

    def __len__(self) -> int:
        return self._options.frames

    def frame(self, index: int) -> Splats:
        """The capture at frame ``index``: the rows of :meth:`ids`, in order."""
        alive = self.ids(index)
        moved = {name: array.copy() for name, array in self._cast.rest.arrays()}
        swing = 2 * np.pi * index / (self._options.fps * self._options.period_s)
        if "rigid" in self._cast.parts:
            self._move_rigidly(moved, self._cast.parts["rigid"], swing)
        if "bend" in self._cast.parts:
            self._bend(moved, self._cast.parts["bend"], swing)
        if "colour" in self._cast.parts:
            _recolour(moved, self._cast.parts["colour"], self._options.amount, swing)
        splats = Splats(**moved)
        return (splats if len(alive) == len(splats) else splats.take(alive)).checked(self._name)

    def ids(self, index: int) -> Ids:
        """The rows of the capture that exist in frame ``index``, ascending."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        alive = np.ones(len(self._cast.rest), bool)
        if "appear" in self._cast.parts:
            turn = index / (self._options.fps * self._options.period_s)
            hidden = (self._cast.phase + turn) % 1.0 < 0.5 * min(self._options.amount, 1.0)
            alive[self._cast.parts["appear"]] = ~hidden[self._cast.cluster]
            alive[0] |= not alive.any()  # a frame needs at least one splat
        return np.flatnonzero(alive).astype(np.int32)

    def _move_rigidly(self, moved: Columns, rows: Rows, swing: float) -> None:
        """Rotate back and forth about the up axis through the part's centre, and move up and down."""
        up = np.asarray(self._up)
        pivot = self._cast.rest.means[rows].astype(np.float64).mean(axis=0)
        turn = rotations.about(up, np.array(0.6 * self._options.amount * np.sin(swing)))
        lift = 0.2 * self._options.amount * self._focus.radius * 0.5 * (1.0 - np.cos(swing))
        _place(moved, rows, np.broadcast_to(turn, (len(rows), 4)), pivot, lift * up)

    def _bend(self, moved: Columns, rows: Rows, swing: float) -> None:
        """Lean about a horizontal axis, more with height, like a stalk in the wind."""
        means = self._cast.rest.means[rows].astype(np.float64)
        height = means @ np.asarray(self._up)
        foot = height.min()
        share = (height - foot) / (float(np.ptp(height)) or 1.0)
        turns = rotations.about(self._cast.axis, 0.5 * self._options.amount * np.square(share) * np.sin(swing))
        pivot = means.mean(axis=0)
        pivot = pivot + (foot - pivot @ np.asarray(self._up)) * np.asarray(self._up)
        _place(moved, rows, turns, pivot, np.zeros(3))


def _place(moved: Columns, rows: Rows, turns: F64, pivot: F64, shift: F64) -> None:
    """Rotate ``rows`` by ``turns`` [M, 4] about ``pivot`` [3] and shift them, in place."""
    matrices = so3.matrices(turns)
    offsets = moved["means"][rows].astype(np.float64) - pivot
    moved["means"][rows] = (np.einsum("nij,nj->ni", matrices, offsets) + pivot + shift).astype(np.float32)
    moved["quats"][rows] = rotations.turned(moved["quats"][rows], turns)
    moved["sh_rest"][rows] = rotate_rest(moved["sh_rest"][rows], matrices)


def _recolour(moved: Columns, rows: Rows, amount: float, swing: float) -> None:
    """Rotate hues about the grey axis, lighten and darken, in place."""
    angle = 1.5 * min(amount, 2.0) * np.sin(swing)
    grey = np.full(3, 1 / np.sqrt(3.0))
    turn = so3.matrices(rotations.about(grey, np.array(angle)))
    gain = 1.0 + 0.15 * min(amount, 2.0) * np.sin(2 * swing)
    rgb = 0.5 + SH_C0 * moved["sh0"][rows].astype(np.float64)
    moved["sh0"][rows] = ((gain * rgb @ turn.T - 0.5) / SH_C0).astype(np.float32)
    moved["sh_rest"][rows] = (gain * moved["sh_rest"][rows].astype(np.float64) @ turn.T).astype(np.float32)


def _parts(
    base: FrameSource, rest: Splats, share: float, kinds: tuple[str, ...], rng: np.random.Generator
) -> dict[str, Rows]:
    """Disjoint parts of equal size for each kind of motion, each a compact region in the scene's bulk."""
    size = int(share * len(rest)) // len(kinds)
    offsets, up = rest.means.astype(np.float64) - base.focus.centre, np.asarray(base.up)
    free = np.ones(len(rest), bool)
    parts: dict[str, Rows] = {}
    for kind in kinds:
        candidates = np.flatnonzero(free)
        if kind == "bend":  # the highest parts sway
            order = np.argsort(-(offsets[candidates] @ up), kind="stable")
        else:
            near = candidates[np.linalg.norm(offsets[candidates], axis=1) <= base.focus.radius]
            seed = offsets[rng.choice(near if len(near) else candidates)] if len(candidates) else np.zeros(3)
            order = np.argsort(np.linalg.norm(offsets[candidates] - seed, axis=1), kind="stable")
        parts[kind] = np.sort(candidates[order[:size]])
        free[parts[kind]] = False
    return parts


def _patches(rest: Splats, rows: Rows, rng: np.random.Generator) -> tuple[Rows, F64]:
    """Patch of each of ``rows`` (the nearest of some random splats), and each patch's time offset in 0..1."""
    phases = rng.uniform(0, 1, CLUSTERS)
    if not len(rows):
        return rows, phases
    means = rest.means[rows].astype(np.float64)
    centres = means[rng.integers(0, len(rows), CLUSTERS)]
    distance = np.stack([np.sum(np.square(means - centre), axis=1) for centre in centres], axis=1)
    return np.argmin(distance, axis=1), phases


def _horizontal(up: F64, angle: float) -> F64:
    """A unit direction perpendicular to ``up``."""
    side = np.cross(up, (1.0, 0.0, 0.0) if abs(up[0]) < 0.9 else (0.0, 1.0, 0.0))
    side = side / np.linalg.norm(side)
    direction: F64 = np.cos(angle) * side + np.sin(angle) * np.cross(up, side)
    return direction
