"""Settings of the benchmark of a frame's stages."""

from __future__ import annotations

import re
from dataclasses import dataclass

from cags_common.errors import ConfigError
from cags_common.settings import check_settings, setting


@dataclass(frozen=True)
class AlignBenchSettings:
    """What is measured."""

    scene: str = setting(
        "procedural:size=150000", "scene: a file, a folder, motion:PATH, procedural[:..] or fourd[:..]"
    )
    poses: str = setting("synthetic:walking:seed=1", "head motion: a recorded walk's CSV file or synthetic:NAME")
    sizes: str = setting("1600x1200,800x600", "sizes of client pictures, comma-separated WIDTHxHEIGHT")
    lod: float = setting(0.3, "level of the client's tiles, as a share of all levels", low=0, high=1)
    error_deg: float = setting(2.0, "error of the reference's pose, degrees", low=0, high=90)
    error_cm: float = setting(5.0, "error of the reference's pose, centimetres", low=0, high=1000)
    margin: float = setting(0.1, "widening of the reference's field of view", low=0, high=2)
    crf: float = setting(20.0, "H.264 crf of references", low=0, high=51)
    fov: float = setting(60.0, "client's horizontal field of view in degrees", low=1, high=170)
    threads: int = setting(2, "threads of a client's frame, and of one reference", low=1, high=256)
    repetitions: int = setting(15, "timed repetitions, after two to warm up", low=1, high=1000)
    device: str = setting("cpu", "gpu: also time the frame on the graphics device", choices=("cpu", "gpu"))
    clients: str = setting(
        "1,8", "numbers of simultaneous clients in the server's part, comma separated; empty: skip the part"
    )
    frames: int = setting(16, "media frames played in the server's part", low=2, high=10_000)
    link_mbps: float = setting(
        30.0, "link of each client in the server's part, Mbps of the paper's scale", low=0.1, high=10_000
    )
    seed: int = setting(0, "seed of the directions of pose errors", low=0, high=2**31 - 1)
    cache: str = setting("", "folder of encoded bundles to reuse; empty: the user's cache folder")

    def __post_init__(self) -> None:
        check_settings(self)
        self.size_list, self.client_list  # noqa: B018 - refuse what does not parse

    @property
    def size_list(self) -> list[tuple[int, int]]:
        """(width, height) in pixels."""
        if re.fullmatch(r"[1-9]\d{1,3}x[1-9]\d{1,3}(,[1-9]\d{1,3}x[1-9]\d{1,3})*", self.sizes) is None:
            raise ConfigError(f"sizes = {self.sizes!r} must be like 1600x1200,800x600, with 10 to 9999 pixels per side")
        pairs = (word.split("x") for word in self.sizes.split(","))
        return [(int(width), int(height)) for width, height in pairs]

    @property
    def client_list(self) -> list[int]:
        """Numbers of simultaneous clients."""
        if not self.clients:
            return []
        if re.fullmatch(r"[1-9]\d{0,2}(,[1-9]\d{0,2})*", self.clients) is None:
            raise ConfigError(f"clients = {self.clients!r} must be numbers from 1 to 999, like 1,8")
        return [int(word) for word in self.clients.split(",")]
