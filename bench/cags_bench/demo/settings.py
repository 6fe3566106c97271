"""Settings of ``cags-demo``."""

from __future__ import annotations

from dataclasses import dataclass

from cags_common.settings import check_settings, names_in, setting


@dataclass(frozen=True)
class DemoSettings:
    """Scene, link and sizes of the demo."""

    out: str = setting("cags-demo-report", "folder for the report; replaced when the demo succeeds")
    frames: int = setting(
        0,
        "media frames to play; 0: the scene once, up to 90 frames (a still one for 90); more than it has: it repeats",
        low=0,
        high=100_000,
    )
    trace: str = setting("generated:lte-driving", "network trace: a file or generated:NAME (see cags-shaper --help)")
    share: float = setting(
        0.12,
        "factor on the trace's bandwidth; the built-in scene is smaller than a capture",
        low=1e-3,
        high=10,
    )
    delay_ms: float = setting(20.0, "one-way propagation delay in milliseconds", low=0, high=10_000)
    poses: str = setting("synthetic:walking", "head motion: a pose file or synthetic:NAME (see cags-client --help)")
    width: int = setting(0, "client width in pixels; 0: 640, or 320 without the native kernels", low=0, high=8192)
    height: int = setting(0, "client height in pixels; 0: 480, or 240 without the native kernels", low=0, high=8192)
    threads: int = setting(0, "threads per render, in server and client; 0: all cores", low=0, high=256)
    view: bool = setting(False, "open the live page instead of writing a report; runs until interrupted")
    cache: str = setting("", "folder for encoded bundles; empty: cags-stream/bundles in the user's cache folder")

    def __post_init__(self) -> None:
        check_settings(self)


QUIET, BUSY = "quiet", "busy"
PARTS = (QUIET, BUSY)


@dataclass(frozen=True)
class DemoBenchSettings:
    """Number of plays, load on the machine, and the installation to compare with."""

    parts: str = setting(",".join(PARTS), "quiet: no additional load; busy: other processes occupy --busy-cores")
    runs: int = setting(5, "plays of each part", low=1, high=1000)
    busy_cores: int = setting(1, "number of cores that other processes occupy in the part busy", low=1, high=256)
    scene: str = setting("procedural", "scene of the demo: a file, a folder, motion:PATH or procedural[:size=N,...]")
    before: str = setting(
        "", "Python of an earlier installation to compare with; its demo is played alternately; empty: none"
    )
    cache: str = setting("", "folder for encoded bundles; empty: cags-stream/bundles in the user's cache folder")

    def __post_init__(self) -> None:
        check_settings(self)
        self.part_list  # noqa: B018 - refuse what does not parse

    @property
    def part_list(self) -> list[str]:
        """Parts to run, from :data:`PARTS`."""
        return names_in(self.parts, "parts", PARTS)
