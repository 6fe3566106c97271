"""Settings of the live page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from cags_common.settings import check_printable, check_settings, setting
from cags_common.transport.hosts import check_listening


@dataclass(frozen=True)
class ViewSettings:
    """Address of the live page and quality of its pictures."""

    SECTION: ClassVar[str] = "client"

    view_host: str = setting(
        "127.0.0.1", "address to serve the live page on; addresses other than loopback are open to everybody"
    )
    view_port: int = setting(8080, "TCP port of the live page; 0 picks a free one", low=0, high=65535)
    view_allow_host: str = setting("", "additional host names of the page, comma separated")
    view_token: str = setting("", "access token of the live page; none when empty")
    view_raw: bool = setting(
        True, "send uncoded pictures to a page on this machine: less work than coding, 20 MB per second"
    )
    view_crf: float = setting(
        22.0, "H.264 quality (CRF) of the live page's pictures: 0 lossless, 51 worst", low=0, high=51
    )
    view_jpeg: int = setting(85, "JPEG quality for browsers without WebCodecs, 1 to 100", low=1, high=100)
    shaper_control: str = setting(
        "", "HOST:PORT of a shaper's control port, for the page to change bandwidth cap and delay"
    )

    def __post_init__(self) -> None:
        check_settings(self)
        check_listening("view_host", self.view_host)
        check_printable("view_token", self.view_token)
