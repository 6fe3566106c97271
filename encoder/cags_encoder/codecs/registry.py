"""Codecs by name, the encoder's side of :mod:`cags_common.bundle.codecs`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, Self

from numpy.typing import NDArray

from cags_common.geometry import F64
from cags_common.registry import Registry
from cags_common.splats import Ids, Splats
from cags_common.tiles.lod import LodLayer
from cags_encoder.settings import EncodeSettings


class CodedSplats(Protocol):
    """Quantised splats [n], in whatever form the codec keeps them."""

    def take(self, rows: NDArray[Any]) -> Self:
        """The splats at ``rows``."""
        ...


class ClipCodec(Protocol):
    """A codec trained for one clip. Picklable and without state between calls."""

    @property
    def lod_order(self) -> tuple[LodLayer, ...]:
        """What each LoD from 1 on adds; names of attributes are the codec's own."""
        ...

    @property
    def lod_gains_db(self) -> tuple[float, ...]:
        """PSNR gained by each LoD of :attr:`lod_order` on renders of the clip; empty when not measured."""
        ...

    def codebooks(self) -> bytes:
        """What a decoder needs to be sent once."""
        ...

    def prepare(self, splats: Splats) -> Splats:
        """The same splats [n], to be drawn the same, written down as :meth:`decode` gives them back."""
        ...

    def quantise(self, prepared: Splats) -> Any:
        """:class:`CodedSplats` of prepared splats [n]."""
        ...

    def decode(self, coded: Any) -> Splats:
        """What a decoder with every LoD shows [n], but for the rounding of positions."""
        ...

    def shown(self, coded: Any) -> Splats:
        """What a decoder with every LoD shows of one tile [n], positions rounded as in that tile: bit by bit."""
        ...

    def encode_tile(self, ids: Ids, coded: Any, *, id_range: bool) -> tuple[bytes, ...]:
        """A tile of splats [n] with ascending ``ids``, consecutive ones with ``id_range``: a payload for each LoD."""
        ...


def _svq(samples: Splats, settings: EncodeSettings, weights: F64 | None) -> ClipCodec:
    from cags_encoder.codecs.svq import SvqCodec

    return SvqCodec.train(samples, settings, weights)


CLIP_CODECS: Registry[Callable[[Splats, EncodeSettings, F64 | None], ClipCodec]] = Registry(
    "codec =", "cags.clip_codecs", {"svq": _svq}
)
"""Makers of codecs by name, from samples [n], settings and the samples' weights [n]."""


def train_codec(samples: Splats, settings: EncodeSettings, weights: F64 | None = None) -> ClipCodec:
    """The codec that the settings name, trained on ``samples`` [n], n >= 1. Raises :class:`ConfigError`.

    ``weights`` [n] > 0 say how much each sample counts, to codecs that can use it.
    """
    return CLIP_CODECS.find(settings.codec)(samples, settings, weights)
