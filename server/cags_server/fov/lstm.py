"""The paper's learnt margins (section 4.4): an LSTM over viewports and past margins.

For frame i the network sees the rotation q_i, its change, the position p_i, its change, and the margin of the frame
before. Where the viewer's true pose is known it runs on truth: true poses and the margins that the fast approximation
says were needed. From there it is rolled out over the frames whose pose is only predicted, feeding its own margins
back. Whenever a true pose arrives, the state is refreshed: the roll-out starts again from one true frame later.

Positions are taken relative to the first true pose, so that the model does not depend on where a scene's origin is.
"""

from __future__ import annotations

import json
from collections import OrderedDict
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from cags_common.errors import ConfigError, DecodeError
from cags_common.files import whole_file
from cags_common.geometry import F32, Intrinsics, Pose
from cags_common.npz import load_npz
from cags_server.fov.base import FovObservation
from cags_server.fov.truth import fast_margins

INPUTS = 16  # q (4), change of q (4), p (3), change of p (3), margins of the frame before (2)
MAX_HIDDEN = 256
MAX_WEIGHTS_BYTES = 4 << 20
MAX_PENDING = 64
"""Frames planned whose true pose has not arrived; older ones are given up."""

SHIPPED = Path(__file__).parent / "weights" / "lstm.npz"
_NAMES = ("w_input", "w_hidden", "bias", "w_out", "b_out", "mean", "scale")


@dataclass(frozen=True, eq=False)
class LstmWeights:
    """One LSTM layer and a linear read-out; gates in the order input, forget, cell, output (as PyTorch has them)."""

    w_input: F32  # [4 H, INPUTS]
    w_hidden: F32  # [4 H, H]
    bias: F32  # [4 H]
    w_out: F32  # [2, H]
    b_out: F32  # [2]
    mean: F32  # [INPUTS] subtracted from the inputs
    scale: F32  # [INPUTS] inputs are divided by it
    provenance: dict[str, Any]

    @property
    def hidden(self) -> int:
        """Size of the hidden state."""
        return int(self.w_hidden.shape[1])

    def save(self, path: Path) -> None:
        """Write an ``.npz`` of float32 arrays and a JSON text."""
        text = np.frombuffer(json.dumps(self.provenance, sort_keys=True).encode(), np.uint8)
        with whole_file(path) as writing, writing.open("wb") as file:
            np.savez(file, provenance=text, **{name: getattr(self, name) for name in _NAMES})

    @staticmethod
    @cache
    def shipped() -> LstmWeights:
        """The shipped weights, read once and shared by all viewers."""
        return LstmWeights.load()

    @staticmethod
    def load(path: Path = SHIPPED) -> LstmWeights:
        """Read what :meth:`save` wrote. Raises :class:`ConfigError` for anything else."""
        try:
            file = load_npz(path, MAX_WEIGHTS_BYTES)
            arrays = {name: file[name].astype(np.float32) for name in _NAMES}
            provenance = json.loads(file["provenance"].tobytes())
        except (OSError, DecodeError, ValueError, KeyError) as error:
            raise ConfigError(f"{path}: cannot be read as LSTM weights ({error})") from error
        hidden = arrays["w_hidden"].shape[-1]
        shapes = ((4 * hidden, INPUTS), (4 * hidden, hidden), (4 * hidden,), (2, hidden), (2,), (INPUTS,), (INPUTS,))
        for name, shape in zip(_NAMES, shapes, strict=True):
            if hidden > MAX_HIDDEN or arrays[name].shape != shape or not np.isfinite(arrays[name]).all():
                raise ConfigError(f"{path}: {name} has shape {arrays[name].shape}, expected {shape}, all finite")
        return LstmWeights(**arrays, provenance=provenance)


@dataclass(frozen=True, eq=False)
class LstmState:
    """State of the recursion after a frame."""

    hidden: F32  # [H]
    cell: F32  # [H]
    rotation: F32  # [4] of the frame
    position: F32  # [3] of the frame, relative to the first
    margins: F32  # [2] of the frame


def features(state: LstmState | None, rotation: F32, position: F32) -> F32:
    """[INPUTS] for a frame; ``rotation`` must be on the side of the one before (:func:`same_side`)."""
    if state is None:
        return np.concatenate([rotation, np.zeros(4), position, np.zeros(3), np.zeros(2)]).astype(np.float32)
    changes = rotation - state.rotation, position - state.position
    return np.concatenate([rotation, changes[0], position, changes[1], state.margins]).astype(np.float32)


def same_side(rotation: F32, reference: F32) -> F32:
    """The sign of a quaternion that lies nearest to ``reference``: +q and -q are one rotation."""
    return rotation if float(rotation @ reference) >= 0 else -rotation


class LstmFov:
    """Rolls the network out over the frames in flight. ``gain`` multiplies what it says."""

    def __init__(self, gain: float = 1.0, weights: LstmWeights | None = None) -> None:
        self._weights = weights or LstmWeights.shipped()
        self._gain = gain
        self._origin: F32 | None = None
        self._true: LstmState | None = None
        self._pending: OrderedDict[int, Pose] = OrderedDict()
        self._last_frame: int | None = None

    def scale(self, observation: FovObservation) -> tuple[float, float]:
        """See :class:`~cags_server.fov.base.FovPolicy`."""
        if self._last_frame is not None and observation.frame <= self._last_frame:
            self._pending.clear()  # a seek or a loop: what is in flight will not be shown
        self._last_frame = observation.frame
        self._pending[observation.frame] = observation.predicted.pose
        while len(self._pending) > MAX_PENDING:
            self._pending.popitem(last=False)
        state = self._true
        for pose in self._pending.values():
            state = self._step(state, pose)
        assert state is not None
        x, y = np.maximum(state.margins, 0.0) * self._gain
        return float(x), float(y)

    def truth(self, frame: int, predicted: Pose, actual: Pose, client: Intrinsics) -> None:
        """Refresh the state by a frame whose true pose has become known."""
        for old in [f for f in self._pending if f <= frame]:
            del self._pending[old]
        state = self._step(self._true, actual)
        needed = np.array(fast_margins(client, actual, predicted), np.float32)
        self._true = LstmState(state.hidden, state.cell, state.rotation, state.position, needed)

    def _step(self, state: LstmState | None, pose: Pose) -> LstmState:
        """One frame further; the returned margins are the network's."""
        rotation = np.array(pose.rotation, np.float32)
        position = np.array(pose.position, np.float32)
        if self._origin is None:
            self._origin = position
        position = position - self._origin
        if state is not None:
            rotation = same_side(rotation, state.rotation)
        w = self._weights
        hidden, cell = (state.hidden, state.cell) if state else (np.zeros(w.hidden, np.float32),) * 2
        row = (features(state, rotation, position) - w.mean) / w.scale
        gates = w.w_input @ np.clip(row, -8, 8) + w.w_hidden @ hidden + w.bias
        enter, forget, content, leave = np.split(gates, 4)
        cell = _sigmoid(forget) * cell + _sigmoid(enter) * np.tanh(content)
        hidden = _sigmoid(leave) * np.tanh(cell)
        return LstmState(hidden, cell, rotation, position, w.w_out @ hidden + w.b_out)


def _sigmoid(x: F32) -> F32:
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * x)), dtype=np.float32)
