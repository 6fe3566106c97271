"""Settings of the experiment on the page in a browser."""

from __future__ import annotations

from dataclasses import dataclass

from cags_common.settings import check_settings, names_in, setting
from cags_shaper.trace import open_trace

PUBLISHED, SERVER = "published", "server"
SOURCES = (PUBLISHED, SERVER)
LINKS = ("generated:steady-2", "generated:steady-8", "generated:steady-10", "generated:steady-20")
LTE = "generated:lte-driving"


@dataclass(frozen=True)
class WebBenchSettings:
    """Scene, sources and links of the experiment."""

    scene: str = setting("procedural:size=30000,frames=240,degree=1", "scene to encode and play")
    links: str = setting(";".join((*LINKS, LTE)), "traces of the link as cags-shaper reads them, separated by ';'")
    sources: str = setting(",".join(SOURCES), f"who hands the scene out, of {', '.join(SOURCES)}")
    cost: bool = setting(True, "also time the worker's frames of 60,000 moving splats")
    seconds: float = setting(12.0, "time to watch from the first picture on, seconds", low=1, high=3600)
    patience: float = setting(120.0, "time limit for the first picture, seconds", low=1, high=3600)
    width: int = setting(160, "picture width in pixels", low=16, high=4096)
    height: int = setting(120, "picture height in pixels", low=16, high=4096)
    pictures: str = setting("", "folder for some displayed pictures beside the truth; none when empty")
    cache: str = setting("", "folder of encoded bundles to reuse; empty: the user's cache folder")

    def __post_init__(self) -> None:
        check_settings(self)
        self.source_list  # noqa: B018 - refuse what does not parse
        for link in self.link_list:
            open_trace(link)

    @property
    def link_list(self) -> list[str]:
        """Traces."""
        return [link for link in self.links.split(";") if link]

    @property
    def source_list(self) -> list[str]:
        """Sources to play, of :data:`SOURCES`."""
        return names_in(self.sources, "sources", SOURCES)
