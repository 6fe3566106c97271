"""The embedded scene: a lit, textured room in which things move, bend, change colour, appear and vanish."""

from cags_encoder.scenes.procedural.scene import ProceduralScene, ProceduralSettings

__all__ = ["ProceduralScene", "ProceduralSettings"]
