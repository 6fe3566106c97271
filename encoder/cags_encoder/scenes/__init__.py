"""Scenes that can be encoded, each opened by one spec string. See ``docs/scenes.md``."""

from cags_encoder.scenes.open import open_scene
from cags_encoder.scenes.source import Focus, FrameSource, focus_of, is_still

__all__ = ["Focus", "FrameSource", "focus_of", "is_still", "open_scene"]
