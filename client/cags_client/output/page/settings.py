"""Settings of the live page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from cags_common.settings import check_settings, setting


@dataclass(frozen=True)
class ViewSettings:
    """Where the page is served, and what its pictures cost."""

    SECTION: ClassVar[str] = "client"

    view_host: str = setting(
        "127.0.0.1", "address that the live page is served on; others than loopback are open to all"
    )
    view_port: int = setting(8080, "TCP port of the live page; 0 picks a free one", low=0, high=65535)
    view_allow_host: str = setting("", "further host names that the page may be opened under, separated by commas")
    view_token: str = setting("", "token that the page asks for before it shows anything")
    view_raw: bool = setting(
        True, "hand pictures to a page on this machine as they are: less work than coding them, 20 MB a second"
    )
    view_crf: float = setting(22.0, "H.264 quality of the page's pictures: 0 lossless, 51 worst", low=0, high=51)
    view_jpeg: int = setting(85, "JPEG quality for browsers without WebCodecs", low=1, high=100)
    shaper_control: str = setting("", "HOST:PORT of a shaper's control port, to change cap and delay from the page")

    def __post_init__(self) -> None:
        check_settings(self)
