"""Settings of the experiment on references."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cags_bench.references.methods import METHODS
from cags_common.errors import ConfigError
from cags_common.settings import check_settings, names_in, setting

QUICK = {"frames": 45, "width": 480, "height": 360}


FULL = {"frames": 150, "width": 800, "height": 600}


WALKS = ("room_user05.csv", "truck_user03.csv", "playroom_user08.csv")
"""Recorded walks of ``--shared``. Each scene has its own; with ``--full`` every scene has all."""


@dataclass(frozen=True)
class ReferenceBenchSettings:
    """The plays, and the state to compare with."""

    shared: str = setting("../shared", "folder that contains scenes/, poses/ and lpips/; missing ones are left out")
    scenes: str = setting("", "scenes, separated by ';'; empty: those of --shared and a generated room")
    poses: str = setting("", "walks, separated by ';'; empty: recorded ones of --shared, else synthetic:walking")
    links: str = setting("10,30,60", "link rates in Mbps of the paper's scale (equal bits per splat)")
    methods: str = setting(",".join(METHODS), f"methods, of {', '.join(METHODS)}")
    full: bool = setting(
        False, f"{FULL['frames']} frames of {FULL['width']}x{FULL['height']}, every scene with every walk"
    )
    frames: int = setting(0, f"media frames to play; 0: {QUICK['frames']}, or the value of --full", low=0, high=100_000)
    width: int = setting(0, f"client width in pixels; 0: {QUICK['width']}, or the value of --full", low=0, high=8192)
    height: int = setting(0, f"client height in pixels; 0: {QUICK['height']}, or the value of --full", low=0, high=8192)
    baseline: str = setting("", "JSON lines of an earlier run to compare with; empty: none")
    before: str = setting(
        "", "Python of an earlier installation to compare with; it plays the same cases alternately; empty: none"
    )
    lpips: str = setting("", "weights of LPIPS (.npz); empty: those of --shared, if present")
    workers: int = setting(1, "sessions played in parallel; more than 1 makes times less reliable", low=1, high=256)
    cache: str = setting("", "folder of encoded bundles to reuse; empty: the user's cache folder")

    def __post_init__(self) -> None:
        check_settings(self)
        self.method_list, self.link_list  # noqa: B018 - refuse what does not parse
        if self.baseline and self.before:
            raise ConfigError("baseline and before are both given; give one of them")

    @property
    def method_list(self) -> list[str]:
        """Methods to compare, from :data:`METHODS`."""
        return names_in(self.methods, "methods", METHODS)

    @property
    def link_list(self) -> list[float]:
        """Rates in Mbps of the paper's scale."""
        try:
            rates = [float(word) for word in self.links.split(",")]
        except ValueError:
            raise ConfigError(f"links = {self.links!r} must be rates in Mbps, like 10,30,60") from None
        if not all(0 < rate <= 10_000 for rate in rates):
            raise ConfigError(f"links = {self.links!r}: rates must lie in (0, 10000] Mbps")
        return rates

    @property
    def size(self) -> tuple[int, int, int]:
        """Frames, width and height."""
        chosen = FULL if self.full else QUICK
        return self.frames or chosen["frames"], self.width or chosen["width"], self.height or chosen["height"]

    @property
    def scene_list(self) -> list[str]:
        """Specs of the scenes to play."""
        if self.scenes:
            return self.scenes.split(";")
        folder = Path(self.shared) / "scenes"
        known = {
            "talking_head/params.npz": "{}:up=y",
            "plant/plant.splat": "motion:{}",
            "monkey": "{}",
            "guitar/guitar.compressed.ply": "{}",
            "statues/angel.sog": "{}",
        }
        found = [form.format(folder / name) for name, form in known.items() if (folder / name).exists()]
        return ["procedural:size=30000", *found]

    @property
    def walk_list(self) -> list[str]:
        """Specs of the walks."""
        if self.poses:
            return self.poses.split(";")
        folder = Path(self.shared) / "poses" / "eyenavgs_nthu"
        return [str(folder / name) for name in WALKS if (folder / name).exists()] or ["synthetic:walking"]

    @property
    def lpips_file(self) -> str:
        """Weights file of LPIPS; empty if there is none."""
        default = Path(self.shared) / "lpips" / "lpips_alex.npz"
        return self.lpips or (str(default) if default.exists() else "")
