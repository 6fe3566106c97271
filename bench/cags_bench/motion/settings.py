"""Settings of the motion benchmark."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cags_bench.outputs import check_suffix
from cags_common.errors import ConfigError
from cags_common.settings import check_settings, names_in, setting

PARTS = ("rates", "times", "sessions")

DISGUISE = "shuffle=1,quantise=sog"
"""Options that make a scene's frames like those from a capture's tool chain."""


@dataclass(frozen=True)
class MotionSettings:
    """What is measured."""

    shared: str = setting("../shared", "folder that contains scenes/; missing scenes are left out")
    scenes: str = setting("", "scenes, separated by ';'; empty: those of --shared and generated ones")
    parts: str = setting(",".join(PARTS), f"parts to run, of {', '.join(PARTS)}")
    frames: int = setting(49, "largest number of frames per scene", low=3, high=10_000)
    judged: int = setting(7, "number of frames to compare with the source, spread over the clip", low=1, high=1000)
    views: int = setting(3, "views of each judged frame", low=1, high=64)
    workers: int = setting(2, "encoder processes", low=1, high=64)
    whole: bool = setting(True, "also encode with changed splats sent whole, for comparison")
    film: str = setting("", "also play --film-scene with both codings in virtual time; file for a strip of it (.png)")
    film_scene: str = setting("fourd:splats=20000,births=2500", "scene of the film strip")
    film_trace: str = setting("generated:steady-10", "network trace of the film strip")
    seeds: int = setting(3, "plays of each session, each with another walk and part of the trace", low=1, high=100)
    cache: str = setting("", "folder of encoded bundles for film and sessions; empty: the user's cache folder")
    repetitions: int = setting(15, "timed evaluations of motion", low=1, high=1000)
    threads: int = setting(2, "threads that evaluate motion", low=1, high=64)

    def __post_init__(self) -> None:
        check_settings(self)
        self.part_list  # noqa: B018 - refuse what does not parse
        if self.film:
            check_suffix("film", self.film, (".png",))
        for name in ("film_scene", "film_trace"):
            value = getattr(self, name)
            if not self.film and value != getattr(MotionSettings, name):
                raise ConfigError(f"{name} = {value!r} is for a film strip; add --film FILE.png or leave it out")

    @property
    def part_list(self) -> list[str]:
        """Parts to run, from :data:`PARTS`."""
        return names_in(self.parts, "parts", PARTS)

    @property
    def scene_list(self) -> list[str]:
        """Specs of the scenes to measure."""
        if self.scenes:
            return self.scenes.split(";")
        folder = Path(self.shared) / "scenes"
        ordered = {
            "talking_head/params.npz": f"{folder}/talking_head/params.npz:up=y",
            "plant/plant.splat": f"motion:{folder}/plant/plant.splat",
        }
        known = [spec for name, spec in ordered.items() if (folder / name).exists()]
        known.append("procedural:size=30000")
        captures = [str(folder / name) for name in ("monkey", "wave") if (folder / name).exists()]
        return [*known, *(disguised(spec) for spec in known), *captures, "fourd:shuffle=1"]


def disguised(spec: str) -> str:
    """``spec`` with rows shuffled and attributes quantised as SOG does."""
    return f"{spec}{',' if ':' in spec.rpartition('/')[2] else ':'}{DISGUISE}"
