"""A generated clip like those sampled from 4D models: every splat lives for a while and moves along a line."""

from cags_encoder.scenes.fourd.scene import FourdOptions, FourdScene

__all__ = ["FourdOptions", "FourdScene"]
