"""A decoded reference: its picture and the camera that it was drawn from."""

from __future__ import annotations

from dataclasses import dataclass

from cags_common.geometry import F32, Camera


@dataclass(frozen=True, eq=False)
class ReferencePicture:
    """A decoded reference: what the server saw from ``camera`` at source frame ``frame``."""

    rgb: F32  # [h, w, 3] in [0, 1]
    camera: Camera
    frame: int
    seq: int = 0

    def __post_init__(self) -> None:
        if self.rgb.shape != (self.camera.height_px, self.camera.width_px, 3):
            raise ValueError(
                f"reference of shape {self.rgb.shape} under a camera of {self.camera.width_px}x{self.camera.height_px}"
            )
