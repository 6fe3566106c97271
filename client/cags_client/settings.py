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
"""Render resolutions (:mod:`cags_client.playback.quality`)."""

OFF, ON = "off", "on"
INTERPOLATIONS = OFF, ON, AUTO
"""Whether pictures are drawn between media frames (:mod:`cags_client.playback.quality`)."""


@dataclass(frozen=True)
class ClientSettings:
    """The client's display, its picture quality, and its playback."""

    SECTION: ClassVar[str] = "client"

    width: int = setting(800, "picture width, pixels", low=1, high=8192)
    height: int = setting(600, "picture height, pixels", low=1, high=8192)
    fov: float = setting(60.0, "horizontal field of view, degrees", low=1, high=170)
    raster: str = setting(
        "auto", "rasteriser: auto (gpu if there is a graphics processor, else cpu), gpu, cpu or oracle (slow, exact)"
    )
    exactness: str = setting(
        "balanced",
        "accuracy of rendering: fast, balanced or exact (slowest)",
        choices=("fast", "balanced", "exact"),
    )
    resolution: str = setting(
        AUTO,
        "render resolution: full, half (half the width and height, enlarged for display) or auto (half while full is "
        "too slow)",
        choices=RESOLUTIONS,
    )
    restore: str = setting(
        "correct",
        "use of references: correct adds what they say is missing, none ignores them",
    )
    align: str = setting(
        "fast", "alignment of references for restorers: fast, reference, unaligned or rotation", research=True
    )
    erosion: bool = setting(
        True, "fill occluded pixels of the aligned picture from their clean neighbours", research=True
    )
    chroma: str = setting("yuv444p", "chroma format of references to request", choices=CHROMAS)
    effects: str = setting(
        NEEDED,
        "passes of a frame: only those that change its picture (needed) or always all of them",
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
        "largest group of frames to accept, splats; each takes about 1 kB of memory at SH degree 3, 0.25 kB at 0, of "
        "--max-memory-mb",
        low=1,
        high=MAX_SPLATS,
    )
    max_memory_mb: float = setting(
        0.0,
        "largest memory for displayed splats, MB; streams that need more are refused; auto (or 0): half of the "
        "machine's, 4096 at most",
        low=0.0,
        high=1e6,
        words={"auto": 0.0},
    )
    start_frame: int = setting(0, "first media frame to play", low=0)
    duration: float | None = setting(None, "playing time, seconds; the whole clip when not given", low=0.001)
    startup_ms: int = setting(
        1500,
        "longest time to hold the first frame while more of it arrives, milliseconds; 0 plays at once",
        low=0,
        high=10_000,
    )
    start_delay_ms: int = setting(250, "startup buffer before the first frame, milliseconds", low=0, high=10_000)
    join_timeout: float = setting(30.0, "time limit for the first frame's data, seconds", low=0.1, high=3600)
    reconnect_s: float = setting(
        10.0, "time to retry a dropped connection, seconds; 0 ends playback at once", low=0.0, high=86_400
    )
    pose_rate: float = setting(60.0, "rate of poses sent, per second", low=1, high=1000)
    interpolate: str = setting(
        AUTO,
        "draw motion between media frames, up to --display-rate: off, on or auto (on a live display, where full "
        "resolution leaves time for it)",
        choices=INTERPOLATIONS,
    )
    display_rate: float = setting(
        60.0, "refresh rate of the display for --interpolate, pictures per second", low=1, high=1000
    )
    drop_late: bool = setting(True, "skip frames that are more than one frame interval late")
    token: str = setting("", "access token of the server")
    ca: str = setting("", "PEM file of the certificate authority that signed the server; the system's when empty")

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def intrinsics(self) -> Intrinsics:
        """The display's pinhole: square pixels, centred."""
        focal = self.width / (2 * math.tan(math.radians(self.fov) / 2))
        return Intrinsics(self.width, self.height, focal, focal, self.width / 2, self.height / 2)


class LiveSettings:
    """Settings that a viewer may change during playback: plain attributes, set from any thread, read once per frame."""

    def __init__(self, settings: ClientSettings) -> None:
        self.restore = settings.restore
        self.exactness = settings.exactness
        self.resolution = settings.resolution
        self.depth_shown = False
        """Whether somebody looks at the depth picture; otherwise depth is drawn only if alignment needs it."""

    @property
    def wishes(self) -> tuple[str, ...]:
        """What the viewer has chosen, by which one picture of the same splats differs from another."""
        return self.restore, self.exactness, self.resolution
