"""The embedded scene: a lit, textured room with objects that move, bend, change colour, appear and disappear."""

from cags_encoder.scenes.procedural.scene import ProceduralScene, ProceduralSettings

__all__ = ["ProceduralScene", "ProceduralSettings"]
