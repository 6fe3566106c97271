"""Settings of ``cags-bench scale``."""

from __future__ import annotations

from dataclasses import dataclass

from cags_bench.outputs import PLOTS, check_suffix
from cags_common.errors import ConfigError
from cags_common.settings import check_settings, setting


@dataclass(frozen=True)
class ScaleSettings:
    """Scenes, servers and viewers."""

    sizes: str = setting("10000,30000", "sizes of the built-in scenes to play, in splats, comma separated")
    scene: str = setting("", "a scene or bundle to play instead")
    viewers: int = setting(4, "viewers at one server", low=1, high=256)
    mbps: float = setting(5.0, "link of each viewer, Mbps", low=0.1, high=1000.0)
    clip_frames: int = setting(45, "media frames that each viewer watches", low=2, high=100_000)
    rounds: int = setting(2, "repetitions of each case, interleaved", low=1, high=100)
    crowd: int = setting(
        20,
        "number of viewers of the crowd case, at 5 frames a second and 3 Mbps on two cores; 0 skips it",
        low=0,
        high=1000,
    )
    job_ms: float | None = setting(
        None, "processor time of one reference for the model of servers, ms; measured if not given", low=0.1
    )
    servers: int = setting(8, "largest number of servers", low=1, high=256)
    workers: int = setting(2, "references that one server renders in parallel", low=1, high=256)
    stay_s: float = setting(20.0, "mean length of a session, seconds", low=0.1, high=1e5)
    seconds: float = setting(30.0, "virtual length of a run of the model, seconds", low=1.0, high=3600.0)
    seed: int = setting(1, "seed of walks, arrivals and departures", low=0)
    plot: str = setting("", "picture file for the curve (.png, .svg or .pdf); empty: none")
    table: str = setting("", "Markdown file for the sizing table; empty: none")
    cache: str = setting("", "folder of encoded bundles to reuse; empty: the user's cache folder")

    def __post_init__(self) -> None:
        check_settings(self)
        for size in self.sizes.split(","):
            if not size.isdecimal() or int(size) < 1:
                raise ConfigError(
                    f"sizes = {self.sizes!r}: {size!r} is not a number of splats; give for example 10000,30000"
                )
        if self.plot:
            check_suffix("plot", self.plot, PLOTS)
        if self.table and self.job_ms is not None:
            raise ConfigError(
                f"table = {self.table!r} needs a measured server, and with job_ms = {self.job_ms:g} none is; "
                "leave out --table or --job-ms"
            )
