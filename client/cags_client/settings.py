"""Settings of the client: flags and TOML keys of ``cags-client``, and of the simulator's client."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from cags_common.geometry import Intrinsics
from cags_common.passes import NEEDED, POLICIES
from cags_common.settings import check_settings, setting
from cags_common.splats import MAX_SPLATS
from cags_protocol.wire.messages import CHROMAS

FULL, HALF, AUTO = RESOLUTIONS = "full", "half", "auto"
"""Pixels that a frame is worked out at (:mod:`cags_client.playback.quality`)."""

OFF, ON = "off", "on"
INTERPOLATIONS = OFF, ON, AUTO
"""Whether pictures are drawn between media frames (:mod:`cags_client.playback.quality`)."""


@dataclass(frozen=True)
class ClientSettings:
    """How the client looks at the scene, what it does to a picture, and how it plays."""

    SECTION: ClassVar[str] = "client"

    width: int = setting(800, "picture width in pixels", low=1, high=8192)
    height: int = setting(600, "picture height in pixels", low=1, high=8192)
    fov: float = setting(60.0, "horizontal field of view in degrees", low=1, high=170)
    raster: str = setting("auto", "rasteriser: auto (gpu where there is one, else cpu), reference, cpu or gpu")
    exactness: str = setting(
        "balanced",
        "accuracy of rendering",
        choices=("fast", "balanced", "exact"),
    )
    resolution: str = setting(
        AUTO,
        "render resolution: full, half the width and height (upsampled for display), or auto: half while full is too "
        "slow",
        choices=RESOLUTIONS,
    )
    restore: str = setting(
        "correct",
        "use of references: correct adds the difference that they carry, none ignores them",
    )
    align: str = setting(
        "fast", "aligner of pictures for restorers: fast, reference, unaligned or rotation", research=True
    )
    erosion: bool = setting(
        True, "fill occluded pixels of the aligned picture from their clean neighbours", research=True
    )
    chroma: str = setting("yuv444p", "chroma format of references to ask for", choices=CHROMAS)
    effects: str = setting(
        NEEDED,
        "work of a frame: what the scene and the moment need, or always everything",
        choices=POLICIES,
        research=True,
    )
    threads: int = setting(2, "threads for rendering and for decoding tiles", low=1, high=256)
    reference_age: int = setting(
        10,
        "largest age of a reference, in media frames; it fades out over the second half",
        low=0,
        high=1000,
    )
    max_splats: int = setting(
        4_000_000,
        "largest group of frames to accept, in splats; one takes about 1 kB of memory at SH degree 3",
        low=1,
        high=MAX_SPLATS,
    )
    max_memory_mb: float = setting(
        2048.0,
        "largest memory for the splats on display, MB; streams that need more are refused",
        low=1.0,
        high=1e6,
    )
    start_frame: int = setting(0, "first media frame to play", low=0)
    duration: float | None = setting(None, "seconds to play; the whole clip if not given", low=0.001)
    startup_ms: int = setting(
        1500,
        "longest hold of the first frame while more of it arrives, in milliseconds; 0 plays at once",
        low=0,
        high=10_000,
    )
    start_delay_ms: int = setting(250, "startup buffer before the first frame, in milliseconds", low=0, high=10_000)
    join_timeout: float = setting(30.0, "seconds to wait for the first frame's data", low=0.1, high=3600)
    reconnect_s: float = setting(
        10.0, "seconds to retry a dropped connection; 0 ends playback at once", low=0.0, high=86_400
    )
    pose_rate: float = setting(60.0, "poses sent per second", low=1, high=1000)
    interpolate: str = setting(
        AUTO,
        "interpolation of motion between media frames up to --display-rate: off, on, or auto: on a live display, where "
        "full resolution leaves time for it",
        choices=INTERPOLATIONS,
    )
    display_rate: float = setting(
        60.0, "refresh rate of the display in pictures per second, for --interpolate", low=1, high=1000
    )
    drop_late: bool = setting(True, "skip frames that are late by more than one frame interval")
    token: str = setting("", "access token of the server")
    ca: str = setting("", "PEM file of the certificate authority; the system's authorities when empty")

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def intrinsics(self) -> Intrinsics:
        """The display's pinhole: square pixels, centred."""
        focal = self.width / (2 * math.tan(math.radians(self.fov) / 2))
        return Intrinsics(self.width, self.height, focal, focal, self.width / 2, self.height / 2)


class LiveSettings:
    """What a viewer may change while playing. Read once a frame; plain attributes, set from any thread."""

    def __init__(self, settings: ClientSettings) -> None:
        self.restore = settings.restore
        self.exactness = settings.exactness
        self.resolution = settings.resolution
        self.depth_shown = False
        """Whether somebody looks at the depth picture; else it is drawn only where alignment needs it."""
