"""A scene as it comes from a capture's tool chain: rows shuffled in every frame, attributes coarsely quantised.

Tests use it to check encoders on such input against a known ground truth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cags_common.geometry import Vec3
from cags_common.settings import check_settings, setting
from cags_common.splats import Ids, Splats
from cags_encoder.formats.sog_writer import quantised_as_sog
from cags_encoder.formats.spz import quantised_as_spz
from cags_encoder.scenes.source import Focus, FrameSource

QUANTISED = {"sog": quantised_as_sog, "spz": quantised_as_spz}


@dataclass(frozen=True)
class DisguiseOptions:
    """Changes to the frames of a scene; the defaults change nothing."""

    shuffle: int = setting(0, "1: shuffle the rows of every frame and hide their identities", low=0, high=1)
    quantise: str = setting(
        "none", "quantise the attributes of every frame as this file format does", choices=("none", *QUANTISED)
    )

    def __post_init__(self) -> None:
        check_settings(self)


class DisguisedScene:
    """Frames of ``base``, shuffled and quantised."""

    def __init__(self, base: FrameSource, options: DisguiseOptions) -> None:
        self._base, self._options = base, options

    @property
    def name(self) -> str:
        """Name of the scene."""
        return self._base.name

    @property
    def fps(self) -> float:
        """Frame rate of the scene."""
        return self._base.fps

    @property
    def up(self) -> Vec3:
        """Up direction of the scene."""
        return self._base.up

    @property
    def focus(self) -> Focus:
        """Focus of the scene."""
        return self._base.focus

    def __len__(self) -> int:
        return len(self._base)

    def frame(self, index: int) -> Splats:
        """Frame ``index`` of the scene, shuffled and quantised."""
        splats = self._base.frame(index)
        if self._options.quantise != "none":
            splats = QUANTISED[self._options.quantise](splats).checked(f"{self.name}, frame {index}")
        return splats.take(self.order(index, len(splats))) if self._options.shuffle else splats

    def ids(self, index: int) -> Ids | None:
        """Identities of the scene; None if rows are shuffled."""
        return None if self._options.shuffle else self._base.ids(index)

    def order(self, index: int, count: int) -> Ids:
        """For each of ``count`` rows, its index in the scene's frame ``index``."""
        if not self._options.shuffle:
            return np.arange(count, dtype=np.int32)
        return np.random.default_rng([index, count]).permutation(count).astype(np.int32)
