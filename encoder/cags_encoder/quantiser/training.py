"""Trains codebooks on sampled splats, and assigns codes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np

from cags_common.coding.packing import U32
from cags_common.geometry import F32, F64
from cags_common.splats import Splats
from cags_common.tiles.attributes import split_attributes
from cags_common.tiles.contexts import ContextModel
from cags_common.tiles.svq import Codebook, CodebookSet
from cags_encoder.quantiser.canonical import canonical
from cags_encoder.quantiser.configs import QuantiserConfig
from cags_encoder.quantiser.layered import LayeredEncoder
from cags_encoder.quantiser.printed import PrintedEncoder


class AttributeEncoder(Protocol):
    """Assigns one attribute's codes."""

    @property
    def book(self) -> Codebook:
        """The codebook for decoders."""
        ...

    def encode(self, values: F32) -> U32:
        """Codes [n] of full length for raw values [n, dim]."""
        ...


class _Truncated:
    """An encoder whose codes end after their first ``layers`` layers."""

    def __init__(self, whole: AttributeEncoder, layers: int) -> None:
        self._whole, self._layers = whole, layers
        self.book = whole.book.truncated(layers)

    def encode(self, values: F32) -> U32:
        """Codes [n] of raw values [n, dim]."""
        return self._whole.book.prefix(self._whole.encode(values), self._layers)


class _Modelled:
    """An encoder whose codes of tiles are coded by context."""

    def __init__(self, whole: AttributeEncoder, models: tuple[ContextModel | None, ...]) -> None:
        self._whole, self.book = whole, replace(whole.book, models=models)

    def encode(self, values: F32) -> U32:
        """Codes [n] of raw values [n, dim]."""
        return self._whole.encode(values)


class Quantiser:
    """The codebooks of a clip, and the encoding with them."""

    def __init__(self, encoders: Mapping[str, AttributeEncoder], *, canonical_axes: bool) -> None:
        self._encoders, self.canonical_axes = dict(encoders), canonical_axes
        """Whether :meth:`prepare` sorts the axes of splats."""
        self.books = CodebookSet({name: encoder.book for name, encoder in encoders.items()})

    def prepare(self, splats: Splats) -> Splats:
        """The splats in the form that :meth:`encode` takes and a decoder returns; they are drawn identically."""
        return canonical(splats) if self.canonical_axes else splats

    def encode(self, prepared: Splats) -> dict[str, U32]:
        """Attribute -> codes [n] of full length."""
        values = split_attributes(prepared)
        return {name: encoder.encode(values[name]) for name, encoder in self._encoders.items()}

    def truncated(self, enhancement_layers: Mapping[str, int]) -> Quantiser:
        """The same quantiser with fewer enhancement layers: as many as are given by attribute, otherwise none."""
        encoders = {
            name: _Truncated(each, 1 + enhancement_layers.get(name, 0)) for name, each in self._encoders.items()
        }
        return Quantiser(encoders, canonical_axes=self.canonical_axes)

    def modelled(self, models: Mapping[str, tuple[ContextModel | None, ...]]) -> Quantiser:
        """The same quantiser with ``models`` of the first layers by attribute."""
        encoders = {name: _Modelled(each, models.get(name, ())) for name, each in self._encoders.items()}
        return Quantiser(encoders, canonical_axes=self.canonical_axes)

    def decode(self, codes: dict[str, U32]) -> dict[str, F32]:
        """Attribute -> values [n, dim], as decoded with every layer."""
        return {book.attribute: book.lookup(codes[book.attribute], len(book.layer_bits)) for book in self.books}


def train(samples: Splats, config: QuantiserConfig, seed: int, weights: F64 | None = None) -> Quantiser:
    """Train every attribute's codebook on ``samples`` (n >= 1). Deterministic for a seed.

    ``weights`` [n] > 0 are the samples' weights; codebooks as in the paper ignore them.
    """
    if config.as_printed:
        values = split_attributes(samples)
        printed = {
            a.attribute: PrintedEncoder(values[a.attribute], a, config, seed)
            for a in config.attributes
            if a.attribute in values
        }
        return Quantiser(printed, canonical_axes=False)
    values = split_attributes(canonical(samples))
    counts: F64 = np.ones(len(samples)) if weights is None else weights
    layered = {
        a.attribute: LayeredEncoder(values[a.attribute], counts, a, config)
        for a in config.attributes
        if a.attribute in values
    }
    return Quantiser(layered, canonical_axes=True)
