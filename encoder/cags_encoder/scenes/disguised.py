"""A scene as a capture tool chain delivers it: rows shuffled in every frame, attributes coarsely quantised.

Used to test encoders on such input with a known ground truth.
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

    shuffle: int = setting(0, "1: rows in a new order in every frame, and identities withheld", low=0, high=1)
    quantise: str = setting(
        "none", "attributes quantised frame by frame as a format does", choices=("none", *QUANTISED)
    )

    def __post_init__(self) -> None:
        check_settings(self)


class DisguisedScene:
    """Frames of ``base``, shuffled and quantised."""

    def __init__(self, base: FrameSource, options: DisguiseOptions) -> None:
        self._base, self._options = base, options

    @property
    def name(self) -> str:
        """The scene's."""
        return self._base.name

    @property
    def fps(self) -> float:
        """The scene's."""
        return self._base.fps

    @property
    def up(self) -> Vec3:
        """The scene's."""
        return self._base.up

    @property
    def focus(self) -> Focus:
        """The scene's."""
        return self._base.focus

    def __len__(self) -> int:
        return len(self._base)

    def frame(self, index: int) -> Splats:
        """The scene's frame ``index``, disguised."""
        splats = self._base.frame(index)
        if self._options.quantise != "none":
            splats = QUANTISED[self._options.quantise](splats).checked(f"{self.name}, frame {index}")
        return splats.take(self.order(index, len(splats))) if self._options.shuffle else splats

    def ids(self, index: int) -> Ids | None:
        """The scene's; None if rows are shuffled."""
        return None if self._options.shuffle else self._base.ids(index)

    def order(self, index: int, count: int) -> Ids:
        """For each of ``count`` rows, its row in the scene's frame ``index``."""
        if not self._options.shuffle:
            return np.arange(count, dtype=np.int32)
        return np.random.default_rng([index, count]).permutation(count).astype(np.int32)
