"""Settings of the rasteriser benchmark."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cags_common.errors import ConfigError
from cags_common.settings import check_settings, setting

SIDES_PX = 10, 8192
"""Smallest and largest side of an image."""


@dataclass(frozen=True)
class RasterSettings:
    """What is measured."""

    shared: str = setting("../shared", "folder that contains scenes/ and prototypes/; missing ones are left out")
    scenes: str = setting("", "scenes, separated by ';'; empty: three captures of --shared, or a procedural one")
    sizes: str = setting("400x300,800x600,1600x1200", "image sizes in pixels, WIDTHxHEIGHT, separated by commas")
    threads: str = setting("1,2", "numbers of threads, separated by commas")
    repetitions: int = setting(9, "timed frames per renderer and case", low=1, high=1000)
    warm_up: int = setting(2, "frames before the timed ones", low=0, high=100)
    reference: bool = setting(True, "render the float64 reference and report errors (takes seconds per view)")
    growth: bool = setting(True, "also time 50,000 to 800,000 splats")
    views: bool = setting(True, "time every scene, size and number of threads at each level")
    upkeep: bool = setting(True, "also time loads, updates and contributions")
    peers: bool = setting(True, "also time installed peers (Open3D takes seconds per frame)")

    table: bool = setting(
        False, "instead: client table, references per second and growth on this machine's graphics processor"
    )
    clients: str = setting("1,8,64", "numbers of clients for --table, separated by commas")
    servers: str = setting(
        "1,8",
        "numbers of server processes that share the device, separated by commas, for --table; the clients are divided "
        "among them",
    )
    growing: str = setting(
        "50000,150000,400000,1000000,2000000,4000000", "numbers of splats for --table, separated by commas"
    )

    def __post_init__(self) -> None:
        check_settings(self)
        self.size_list, self.thread_list, self.client_list, self.server_list, self.growth_list  # noqa: B018 - refuse what does not parse

    @property
    def size_list(self) -> list[tuple[int, int]]:
        """Image sizes, pixels."""
        try:
            pairs = [text.lower().split("x") for text in self.sizes.split(",")]
            found = [(int(width), int(height)) for width, height in pairs]
        except ValueError as error:
            raise ConfigError(f"sizes = {self.sizes!r} must be like 400x300,800x600") from error
        if not all(SIDES_PX[0] <= side <= SIDES_PX[1] for size in found for side in size):
            raise ConfigError(f"sizes = {self.sizes!r}: sides must lie in {SIDES_PX[0]} to {SIDES_PX[1]} pixels")
        return found

    @property
    def thread_list(self) -> list[int]:
        """Numbers of threads."""
        return _numbers("threads", self.threads)

    @property
    def client_list(self) -> list[int]:
        """Numbers of clients."""
        return _numbers("clients", self.clients)

    @property
    def server_list(self) -> list[int]:
        """Numbers of server processes."""
        return _numbers("servers", self.servers)

    @property
    def growth_list(self) -> list[int]:
        """Numbers of splats."""
        return _numbers("growing", self.growing)

    @property
    def scene_list(self) -> list[str]:
        """Specs of the scenes to draw."""
        if self.scenes:
            return self.scenes.split(";")
        folder = Path(self.shared) / "scenes"
        captures = ("plant/plant.splat", "statues/st-peter.sog", "playbot/1_0")
        found = [str(folder / name) for name in captures if (folder / name).exists()]
        return found or ["procedural:size=150000"]


def _numbers(name: str, text: str) -> list[int]:
    try:
        counts = [int(part) for part in text.split(",")]
    except ValueError as error:
        raise ConfigError(f"{name} = {text!r} must be like 1,2") from error
    if min(counts) < 1:
        raise ConfigError(f"{name} = {text!r} : every number must be at least 1")
    return counts


BACKENDS = ("cpu", "gpu")
