"""Sequences for the field-of-view LSTM: true poses, predicted poses, and the margins that were needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cags_common import so3
from cags_common.geometry import F32, F64, Intrinsics, Pose
from cags_common.poses import PoseTrace
from cags_common.poses.room import Room
from cags_server.fov.truth import fast_margins, in_reference, margins_for, view_rays
from cags_server.predict.pooled import PooledWeights, windows
from cags_server.predict.tangent import STEP_US

CLIENT = Intrinsics.of_fov(1600, 1200, 1.48, 1.20)
"""The paper's client."""

RAY_GRID = (13, 9)

STILL_SHARE = 0.08
"""Sessions of somebody who stands still, to all others."""


@dataclass(frozen=True, eq=False)
class FovSequence:
    """One walk at 30 fps, seen by a server that plans ``lead`` frames ahead."""

    rotations: F32  # [N, 4] true, signs continuous
    positions: F32  # [N, 3] true
    predicted_rotations: F32  # [N, 4] of frame i, predicted ``lead`` frames before; on the side of the true one
    predicted_positions: F32  # [N, 3]
    exact: F32  # [N, 2] margins that were needed
    fast: F32  # [N, 2] margins by the four corners


def sequence_of(trace: PoseTrace, weights: PooledWeights, lead: int) -> FovSequence:
    """The sequence of a walk, predicted by ``weights``."""
    times = np.arange(0, trace.duration_us + 1, STEP_US)
    poses = trace.poses_at(times)
    rotations = _one_side(np.array([p.rotation for p in poses]))
    positions = np.array([p.position for p in poses])
    guessed_q, guessed_p = predicted_walk(rotations, positions, weights, lead)
    room, rays = Room.around(positions), view_rays(CLIENT, *RAY_GRID)
    exact, fast = np.zeros((len(poses), 2)), np.zeros((len(poses), 2))
    for i, actual in enumerate(poses):
        predicted = _pose(guessed_p[i], guessed_q[i])
        points = room.points(positions[i], actual.rotation_matrix, rays)
        exact[i] = margins_for(in_reference(points, actual, predicted), CLIENT)
        fast[i] = fast_margins(CLIENT, actual, predicted)
    aligned = np.where((guessed_q * rotations).sum(axis=1, keepdims=True) < 0, -guessed_q, guessed_q)
    return FovSequence(*(a.astype(np.float32) for a in (rotations, positions, aligned, guessed_p, exact, fast)))


def predicted_walk(rotations: F64, positions: F64, weights: PooledWeights, lead: int) -> tuple[F64, F64]:
    """Rotations [N, 4] and positions [N, 3] of each frame as predicted ``lead`` frames before (held at the start)."""
    order = weights.order_for(len(rotations) - 1)
    rows = windows(rotations, positions, order) @ weights.at(order, float(lead))
    guessed_q, guessed_p = rotations.copy(), positions.copy()
    guessed_q[lead:], guessed_p[lead:] = rotations[:-lead], positions[:-lead]
    origins = slice(order, len(rotations) - lead)
    moved = rows[: len(rows) - lead]
    guessed_q[order + lead :] = so3.multiply(rotations[origins], so3.exp(moved[:, :3]))
    guessed_p[order + lead :] = positions[origins] + so3.rotate(rotations[origins], moved[:, 3:])
    return guessed_q, guessed_p


def turned(sequence: FovSequence, by: F64) -> FovSequence:
    """The same walk in a world turned by the quaternion ``by`` [4]: the margins stay as they are."""

    def rotate(q: F32) -> F32:
        return so3.multiply(by, q.astype(np.float64)).astype(np.float32)

    def move(p: F32) -> F32:
        return so3.rotate(np.broadcast_to(by, (len(p), 4)), p.astype(np.float64)).astype(np.float32)

    return FovSequence(
        rotate(sequence.rotations),
        move(sequence.positions),
        rotate(sequence.predicted_rotations),
        move(sequence.predicted_positions),
        sequence.exact,
        sequence.fast,
    )


def chunks(sequences: Sequence[FovSequence], length: int, rng: np.random.Generator) -> list[FovSequence]:
    """Every walk cut into sessions of ``length`` frames from a random start, each in a world of its own heading.

    A few more are of somebody who stands still, which recorded walks hardly hold: they need no margin.
    """
    out = []
    for sequence in sequences:
        first = int(rng.integers(0, length))
        for start in range(first, len(sequence.rotations) - length + 1, length):
            part = FovSequence(*(getattr(sequence, name)[start : start + length] for name in _FIELDS))
            by = rng.standard_normal(4)
            out.append(_session(turned(part, by / np.linalg.norm(by))))
    out += [_still(out[int(i)]) for i in rng.integers(0, max(len(out), 1), round(len(out) * STILL_SHARE))]
    return out


_FIELDS = ("rotations", "positions", "predicted_rotations", "predicted_positions", "exact", "fast")


def _session(part: FovSequence) -> FovSequence:
    """As a policy sees it: positions from the first one, and the first quaternion with w >= 0."""
    sign = np.float32(-1.0 if part.rotations[0, 0] < 0 else 1.0)
    origin = part.positions[0]
    return FovSequence(
        part.rotations * sign,
        part.positions - origin,
        part.predicted_rotations * sign,
        part.predicted_positions - origin,
        part.exact,
        part.fast,
    )


def _still(session: FovSequence) -> FovSequence:
    """The first pose of a session, held."""
    q, p = (np.repeat(a[:1], len(a), axis=0) for a in (session.rotations, session.positions))
    nothing = np.zeros_like(session.exact)
    return FovSequence(q, p, q, p, nothing, nothing)


def _one_side(q: F64) -> F64:
    flips = np.where((q[1:] * q[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    return np.asarray(q * np.concatenate([[1.0], np.cumprod(flips)])[:, None])


def _pose(position: F64, rotation: F64) -> Pose:
    p, q = position.tolist(), rotation.tolist()
    return Pose((p[0], p[1], p[2]), (q[0], q[1], q[2], q[3]))
