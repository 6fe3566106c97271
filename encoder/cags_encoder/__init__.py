"""Offline encoder: scenes to bundles. ``encode`` is the library call, ``cags-encode`` the command."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cags_encoder.cache import content_key
    from cags_encoder.pipeline import encode
    from cags_encoder.settings import EncodeSettings

__all__ = ["EncodeSettings", "content_key", "encode"]

_HOMES = {"EncodeSettings": "settings", "content_key": "cache", "encode": "pipeline"}


def __getattr__(name: str) -> Any:
    """Load what is asked for: the encoder brings faiss and scipy, which ``--help`` need not wait for."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
