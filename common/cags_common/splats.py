"""3D Gaussians as a structure of arrays.

Attribute names carry their activation: the drawn scale is ``exp(log_scales)``, the drawn opacity is
``sigmoid(logit_opacities)``, the base colour is ``0.5 + SH_C0 * sh0`` (Kerbl et al. 2023).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from itertools import accumulate, pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import DecodeError, SceneError
from cags_common.geometry import F32

SH_C0 = 0.28209479177387814
"""Value of the constant spherical harmonic."""

SH_REST_OF_DEGREE = (0, 3, 8, 15)
"""Number of view-dependent SH coefficients a colour channel, by degree."""

MAX_SPLATS = 20_000_000
"""Bound on what a file may claim, checked before anything is allocated (a splat of degree 3 takes 236 bytes)."""

MAX_COORDINATE = 1e30
"""Means lie below it: their products must stay finite in single precision, and bundles carry their bounds."""

MAX_COEFFICIENT = 1e15
"""Coefficients of colour and harmonics lie below it: squares of their differences must stay finite, too."""

_BOUNDS = {"means": MAX_COORDINATE, "sh0": MAX_COEFFICIENT, "sh_rest": MAX_COEFFICIENT}

_REPAIR = "repair the file, or leave such splats out by the scene's option repair=drop"

Ids: TypeAlias = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Splats:
    """N Gaussians. All arrays are C-contiguous float32 of N rows.

    Use :meth:`checked` on data from outside: it refuses wrong shapes and non-finite values by name and index.
    """

    means: F32  # [N, 3] world, metres
    quats: F32  # [N, 4] wxyz, unit, w >= 0: rotation of the Gaussian's axes into the world
    log_scales: F32  # [N, 3] natural logarithm of the standard deviations, metres
    logit_opacities: F32  # [N]
    sh0: F32  # [N, 3] RGB coefficient of the constant harmonic
    sh_rest: F32  # [N, K, 3] RGB coefficients of the others, K in (0, 3, 8, 15)

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """Spherical-harmonics degree, 0 to 3."""
        return SH_REST_OF_DEGREE.index(self.sh_rest.shape[1])

    def arrays(self) -> Iterator[tuple[str, F32]]:
        """Name and array of each attribute, in declaration order."""
        for field in fields(self):
            yield field.name, getattr(self, field.name)

    def take(self, rows: NDArray[Any] | slice) -> Splats:
        """The splats at ``rows`` (indices, a mask or a slice)."""
        if isinstance(rows, slice) or rows.dtype == bool:
            return Splats(*(np.ascontiguousarray(array[rows]) for _, array in self.arrays()))
        return Splats(*(array.take(rows, axis=0) for _, array in self.arrays()))  # three times as fast as by brackets

    def checked(self, source: str) -> Splats:
        """These splats as contiguous float32 with unit quaternions; ``source`` names them in errors.

        Raises :class:`SceneError` for wrong shapes, no splats at all, non-finite values (by attribute and index), means
        beyond :data:`MAX_COORDINATE`, coefficients beyond :data:`MAX_COEFFICIENT` and zero quaternions. Infinite
        opacity logits are legal in real files (opacity exactly 0 or 1): clamped to +-20.
        """
        out = {name: np.ascontiguousarray(array, dtype=np.float32) for name, array in self.arrays()}
        n = len(out["means"])
        if n == 0:
            raise SceneError(f"{source}: holds no splats; give a file with at least one")
        check_shapes(out, source)
        logits = out["logit_opacities"]
        out["logit_opacities"] = np.where(np.isinf(logits), np.sign(logits) * np.float32(20.0), logits)
        for name, array in out.items():
            bad = ~np.isfinite(array)
            if bad.any():
                raise SceneError(f"{source}: {_first(name, array, bad)} is not finite; {_REPAIR}")
        for name, bound in _BOUNDS.items():
            if beyond_bounds(name, out[name]).any():
                far = np.abs(out[name]) >= np.float32(bound)
                raise SceneError(f"{source}: {_first(name, out[name], far)} lies beyond {bound:g}; {_REPAIR}")
        out["quats"] = _canonical_quats(out["quats"], source)
        return Splats(**out)

    def span(self, first: int, end: int) -> Splats:
        """Splats ``first`` to ``end`` in the same memory."""
        return Splats(*(array[first:end] for _, array in self.arrays()))

    def written_to(self, target: Splats | None) -> Splats:
        """These values in the arrays of ``target``, which is returned; without one, these splats themselves.

        Raises :class:`DecodeError` where the SH degrees differ.
        """
        if target is None:
            return self
        if target.sh_degree != self.sh_degree:
            raise DecodeError(f"splats have SH degree {self.sh_degree}, their place {target.sh_degree}")
        for (_, array), (_, values) in zip(target.arrays(), self.arrays(), strict=True):
            array[:] = values
        return target

    @staticmethod
    def unwritten(count: int, sh_degree: int) -> Splats:
        """Arrays of ``count`` splats whose values are still to be written.

        They share one block of memory: the system hands out large blocks by large pages, and keeps them at hand. A
        page fault for every 4 KiB took as long as decoding.
        """
        shapes = [(3,), (4,), (3,), (), (3,), (SH_REST_OF_DEGREE[sh_degree], 3)]
        ends = list(accumulate((count * math.prod(shape) for shape in shapes), initial=0))
        block = np.empty(ends[-1], np.float32)
        parts = [block[first:end] for first, end in pairwise(ends)]
        return Splats(*(part.reshape(count, *shape) for part, shape in zip(parts, shapes, strict=True)))

    @staticmethod
    def concatenate(parts: list[Splats]) -> Splats:
        """All splats of ``parts`` in order; every part must have the same SH degree."""
        columns = zip(*([array for _, array in part.arrays()] for part in parts), strict=True)
        return Splats(*(np.concatenate(column) for column in columns))


def check_shapes(arrays: Mapping[str, F32], source: str) -> None:
    """Raise :class:`SceneError` naming ``source`` unless the attributes' ``arrays`` are of N rows, as many as means."""
    n = len(arrays["means"])
    shapes = {"means": (n, 3), "quats": (n, 4), "log_scales": (n, 3), "logit_opacities": (n,), "sh0": (n, 3)}
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise SceneError(f"{source}: {name} has shape {arrays[name].shape}, expected {shape}")
    rest = arrays["sh_rest"]
    if rest.ndim != 3 or rest.shape[0] != n or rest.shape[2] != 3 or rest.shape[1] not in SH_REST_OF_DEGREE:
        raise SceneError(f"{source}: sh_rest has shape {rest.shape}, expected ({n}, 0|3|8|15, 3)")


def _first(name: str, values: F32, bad: NDArray[np.bool_]) -> str:
    """The first value that is ``bad``, by its place: all that a splat has of an attribute may be 45 numbers."""
    at = tuple(np.argwhere(bad)[0])
    return f"{name}{''.join(f'[{index}]' for index in at)} = {values[at]:g}"


def beyond_bounds(column: str, values: F32) -> NDArray[np.bool_]:
    """Which rows of ``values`` [n, ...] of a ``column`` of splats have a magnitude that is too large; not those with
    NaN.
    """
    if column not in _BOUNDS:
        return np.zeros(len(values), np.bool_)
    largest: F32 = np.abs(values).reshape(len(values), -1).max(axis=1, initial=0.0)
    return largest >= np.float32(_BOUNDS[column])


def _canonical_quats(quats: F32, source: str) -> F32:
    wide = quats.astype(np.float64)
    norms = np.linalg.norm(wide, axis=1, keepdims=True)
    zero = norms[:, 0] < 1e-12
    if zero.any():
        raise SceneError(f"{source}: quats[{int(np.argmax(zero))}] is zero and has no direction; {_REPAIR}")
    sign = np.where(wide[:, :1] < 0, -1.0, 1.0)
    return np.ascontiguousarray(wide * (sign / norms), dtype=np.float32)
