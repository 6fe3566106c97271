"""A generated clip as 4D models give them when they are sampled: every splat lives for a while and moves in a line."""

from cags_encoder.scenes.fourd.scene import FourdOptions, FourdScene

__all__ = ["FourdOptions", "FourdScene"]
