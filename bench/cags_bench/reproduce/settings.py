"""Settings of the reproduction."""

from __future__ import annotations

from dataclasses import dataclass

from cags_bench.film.metrics import AUTO, chosen
from cags_common.settings import check_settings, setting


@dataclass(frozen=True)
class ReproduceSettings:
    """What is made, from what, and how large."""

    all: bool = setting(False, "make every table and figure")
    table: str = setting("", "make one table, by name")
    figure: str = setting("", "make one figure, by name")
    quick: bool = setting(False, "fewer frames, rates and levels: under 25 minutes on two cores")
    scenes: str = setting("procedural:size=30000", "scenes, separated by spaces")
    poses: str = setting("synthetic:walking", "head motion: a pose file or synthetic:NAME")
    walks: str = setting(
        "", "folder of recorded walks (SCENE_userNN.csv) for precision; empty: those beside the checkout, or none"
    )
    trace: str = setting(
        "", "fluctuating network trace; empty: the 5Gophers segment beside the checkout, or generated:5g-mmwave"
    )
    methods: str = setting("", "methods compared, separated by spaces, by name; empty: all. Ours is always there")
    links: str = setting("", "links compared over: the paper's Mbps and 'trace', by spaces; empty: the size's")
    kept: bool = setting(False, "tables sessions and rivals: compute no session, use those that earlier runs finished")
    frames: int = setting(0, "frames a session; 0: 300, or 45 when quick", low=0, high=100_000)
    width: int = setting(0, "client width in pixels; 0: 1600, or 640 when quick", low=0, high=8192)
    height: int = setting(0, "client height in pixels; 0: 1200, or 480 when quick", low=0, high=8192)
    device: str = setting("auto", "renderer: auto, oracle, cpu or gpu", choices=("auto", "oracle", "cpu", "gpu"))
    workers: int = setting(0, "sessions simulated at the same time; 0: as many as there are cores", low=0, high=256)
    lpips: str = setting("", "weights of LPIPS (.npz), to measure it too; empty: leave it out")
    video_metrics: str = setting(
        AUTO, "metrics of the whole film: vmaf, xpsnr, jod by commas; none; auto: the quick ones, vmaf and xpsnr"
    )
    out: str = setting("reproduction", "folder for index.html, and a .jsonl and .csv file a table")
    page: str = setting("", "Markdown page whose marked tables are renewed from the figures in --out; empty: none")
    cache: str = setting("", "folder of encoded bundles to reuse; empty: the user's cache folder")

    def __post_init__(self) -> None:
        check_settings(self)
        self.metrics  # noqa: B018 - refuse what does not parse

    @property
    def metrics(self) -> tuple[str, ...]:
        """Metrics of the film."""
        return chosen(self.video_metrics)
