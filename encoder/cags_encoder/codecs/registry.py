"""Codecs by name: the encoder's side of :mod:`cags_common.bundle.codecs`."""

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
    """Quantised splats [n] in the codec's own form."""

    def take(self, rows: NDArray[Any]) -> Self:
        """The splats at ``rows``."""
        ...


class ClipCodec(Protocol):
    """A codec trained for one clip. Picklable and stateless between calls."""

    @property
    def lod_order(self) -> tuple[LodLayer, ...]:
        """Layer added by each LoD from 1 on; attribute names are the codec's own."""
        ...

    @property
    def lod_gains_db(self) -> tuple[float, ...]:
        """PSNR gained by each LoD of :attr:`lod_order` on renders of the clip; empty if not measured."""
        ...

    @property
    def base_psnr_db(self) -> float | None:
        """PSNR of LoD 0 in those renders; None if not measured."""
        ...

    def codebooks(self) -> bytes:
        """Data that a decoder needs once."""
        ...

    def prepare(self, splats: Splats) -> Splats:
        """The same splats [n], equal when drawn, in the form that :meth:`decode` returns."""
        ...

    def quantise(self, prepared: Splats) -> Any:
        """:class:`CodedSplats` of prepared splats [n]."""
        ...

    def decode(self, coded: Any) -> Splats:
        """The splats [n] of a decoder with every LoD, except for the rounding of positions."""
        ...

    def shown(self, coded: Any) -> Splats:
        """The splats [n] of one tile in a decoder with every LoD, with rounded positions: bit-identical."""
        ...

    def encode_tile(self, ids: Ids, coded: Any, *, id_range: bool) -> tuple[bytes, ...]:
        """Payloads of a tile, one per LoD, for splats [n] with ascending ``ids`` (consecutive if ``id_range``)."""
        ...


def _svq(samples: Splats, settings: EncodeSettings, weights: F64 | None) -> ClipCodec:
    from cags_encoder.codecs.svq import SvqCodec

    return SvqCodec.train(samples, settings, weights)


CLIP_CODECS: Registry[Callable[[Splats, EncodeSettings, F64 | None], ClipCodec]] = Registry(
    "codec =", "cags.clip_codecs", {"svq": _svq}
)
"""Codec factories by name; their arguments are samples [n], settings and the samples' weights [n]."""


def train_codec(samples: Splats, settings: EncodeSettings, weights: F64 | None = None) -> ClipCodec:
    """The codec named by the settings, trained on ``samples`` [n], n >= 1. Raises :class:`ConfigError`.

    ``weights`` [n] > 0 are the samples' weights, for codecs that use them.
    """
    return CLIP_CODECS.find(settings.codec)(samples, settings, weights)
