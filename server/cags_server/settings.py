"""Settings of the server."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import ClassVar

from cags_common.errors import ConfigError
from cags_common.settings import check_printable, check_settings, setting
from cags_common.transport.hosts import check_listening, is_loopback, named

CLIENT, PLAIN = "client", "plain"
"""Footprints of references (``reference_footprint``)."""


ORIGIN = re.compile(r"[a-z][a-z0-9+.-]*://[^/\s?#@]+/?|null")
"""What a browser may send as ``Origin``: scheme, host and port; ``null`` for pages from files."""

HOST = re.compile(r"[a-z0-9_-]+(\.[a-z0-9_-]+)*\.?")
"""A host name in lower case. Literal addresses need not be listed."""


def check_origins(text: str) -> None:
    """Raise :class:`ConfigError` where a part of a comma-separated list is no origin, which no page can have."""
    if text.strip() == "*":
        return
    for part in filter(None, map(str.strip, text.split(","))):
        if not ORIGIN.fullmatch(part):
            raise ConfigError(f"origins: {part!r} is no origin; give ones such as https://viewer.example, or * alone")


def check_hosts(text: str) -> None:
    """Raise :class:`ConfigError` where a part of a comma-separated list is no name that a request can ask for."""
    for name in named(text):
        if not HOST.fullmatch(name):
            raise ConfigError(
                f"hosts: {name!r} is no host name; give ones such as viewer.example, without scheme, port and path"
            )


def check_token(text: str) -> None:
    """Raise :class:`ConfigError` for a list of tokens of which one is empty, or that no client can show."""
    check_printable("token", text)
    if text and not all(part.strip() for part in text.split(",")):
        raise ConfigError("token has an empty part, which would let everybody in; separate tokens by one comma")


@dataclass(frozen=True)
class ServerSettings:
    """What a server does for each client."""

    SECTION: ClassVar[str] = "server"

    predictor: str = setting(
        "autoregressive", "predictor of the viewer's pose: autoregressive, linear, kalman or hold", research=True
    )
    fov: str = setting("lstm", "margins of the reference's field of view: lstm, quantile or fixed", research=True)
    fov_margin: float = setting(
        0.1, "margin of --fov fixed, as a share of the client's field of view", low=0.0, high=4.0, research=True
    )
    fov_quantile: float = setting(
        0.9, "share of prediction errors that --fov quantile covers", low=0.01, high=0.9999, research=True
    )
    fov_gain: float = setting(0.7, "factor on the margins of --fov lstm", low=0.0, high=10.0, research=True)
    abr: str = setting(
        "utility",
        "rate policy: utility sends the layers with the largest gain per byte first; others are paper, buffer, even "
        "and none",
        research=True,
    )
    lead_frames: int = setting(6, "frames between planning a frame and its display", low=1, high=60)
    poor_lead_frames: int = setting(
        4, "the same while the client's own picture is poor (below 28 dB), if that is fewer", low=1, high=60
    )
    references: str = setting(
        "auto",
        "content of references: difference to the client's splats, picture of the scene, auto (the better of the two) "
        "or none",
        choices=("auto", "difference", "picture", "none"),
    )
    reference_footprint: str = setting(
        CLIENT,
        "splat footprint of references: that of the client's picture (client) or of the reference's own pixels (plain)",
        choices=(CLIENT, PLAIN),
        research=True,
    )
    reference_every: int = setting(
        1, "media frames per reference; larger values save rendering time and reduce quality", low=1, high=30
    )
    reference_width: int = setting(400, "width of references, pixels (even for yuv420p)", low=16, high=4096)
    reference_height: int = setting(300, "height of references, pixels (even for yuv420p)", low=16, high=4096)
    reference_crf: float = setting(
        20.0, "best H.264 quality (CRF) of references, lower is better; the rate control may raise it", low=0.0, high=51
    )
    reference_chroma: str = setting(
        "yuv444p", "chroma format of references; a client may ask for yuv420p", choices=("yuv420p", "yuv444p")
    )
    reference_kbps: int | None = setting(
        None, "largest bit rate of references, kbps; unlimited when not given", low=10, high=1_000_000
    )
    reference_full_size: bool = setting(
        False, "references as large as the client's display (remote rendering)", research=True
    )
    reference_share: float = setting(
        0.2, "target share of the link for references; their quality adapts to it", low=0.01, high=1
    )
    reference_most: float = setting(
        0.4,
        "largest share of the link for references; excess references are skipped; 1 disables the limit",
        low=0.01,
        high=1,
    )
    tiles_ahead: int = setting(
        8, "frames by which tiles precede the references that assume them", low=1, high=30, research=True
    )
    reserve_s: float = setting(
        2.0,
        "longest time by which tiles precede their frame over a link with capacity to spare, seconds; 0: no more than "
        "--tiles-ahead",
        low=0.0,
        high=30.0,
    )
    opening_tiles: bool = setting(True, "send the base layers of the first frame before playback begins", research=True)
    rasteriser: str = setting(
        "auto", "rasteriser: auto (gpu if there is a graphics processor, else cpu), gpu, cpu or oracle (slow, exact)"
    )
    render_threads: int = setting(2, "threads per reference render", low=1, high=256)
    visible_px: float = setting(
        0.02, "smallest contribution of a visible splat, in reference pixels", low=0.0, high=1e6, research=True
    )
    queue_ms: float = setting(150.0, "largest queueing delay of data in flight, ms", low=0.0, high=10_000.0)
    reference_deadline_ms: float = setting(
        200.0,
        "time after its frame's display at which an unsent or half-sent reference is discarded, ms",
        low=0.0,
        high=10_000.0,
        research=True,
    )
    tile_deadline_ms: float = setting(
        1000.0,
        "time after its frame's display at which a half-sent tile is discarded, ms; unsent tiles are chosen anew",
        low=0.0,
        high=60_000.0,
        research=True,
    )

    def __post_init__(self) -> None:
        check_settings(self)
        if self.reference_chroma == "yuv420p" and (self.reference_width % 2 or self.reference_height % 2):
            raise ConfigError(f"reference size {self.reference_width}x{self.reference_height} must be even for yuv420p")
        if self.reference_share > self.reference_most:
            raise ConfigError(
                f"reference_share = {self.reference_share} is above reference_most = {self.reference_most}, beyond "
                "which references are skipped; lower --reference-share or raise --reference-most"
            )


@dataclass(frozen=True)
class ServeSettings(ServerSettings):
    """All settings of the command: bundle, address, limits, and what a server does for each client."""

    bundle: str = setting("", "bundle to serve (a folder or an fsspec URL), or a folder of bundles; required")
    host: str = setting("127.0.0.1", "address to listen on")
    port: int = setting(8765, "TCP port to listen on; 0 picks a free one", low=0, high=65_535)
    workers: int = setting(2, "number of references rendered in parallel", low=1, high=256)
    max_clients: int = setting(
        32,
        "largest number of clients; further ones are refused; auto (or 0) measures how many the renderer can serve",
        low=0,
        high=100_000,
        words={"auto": 0},
    )
    token: str = setting(
        "",
        "access token, or several separated by commas; when empty, anyone may watch",
    )
    tls_cert: str = setting("", "PEM file of the TLS certificate; enables HTTPS and WSS")
    tls_key: str = setting("", "PEM file of the certificate's private key")
    origins: str = setting(
        "", "web origins allowed to connect, comma separated, or *; the server's own origin is always allowed"
    )
    hosts: str = setting("", "host names of this server, comma separated; required behind a proxy on the same machine")
    accept_uploads: bool = setting(
        False,
        "encode files that visitors drop on the gallery, into the folder of bundles; needs --token unless on loopback",
    )
    upload_mb: float = setting(500.0, "largest upload, MB; an archive may unpack to four times it", low=0.1, high=1e5)
    upload_minutes: float = setting(60.0, "time limit for encoding an upload, minutes", low=0.1, high=1e4)
    max_pose_rate: float = setting(2000.0, "largest pose rate of a client, poses per second", low=1.0, high=1e6)
    max_message_rate: float = setting(
        1000.0, "largest message rate of a client, messages per second", low=1.0, high=1e6
    )
    max_queue_mb: float = setting(16.0, "largest send queue of one client, MB", low=0.1, high=4096.0)
    decoded_mb: float = setting(
        256.0, "memory for decoded tiles of each scene, which its viewers share, MB", low=1.0, high=1e6
    )
    idle_s: float = setting(15.0, "silence after which a client is disconnected, seconds", low=0.5, high=3600.0)
    slow_s: float = setting(10.0, "time limit for writing one packet to a client, seconds", low=0.5, high=3600.0)
    session_logs: str = setting("", "folder for session logs, one JSON-lines file per session; none when empty")
    event_traces: str = setting("", "folder for traces of all send events, one file per session; none when empty")
    log_format: str = setting("text", "format of the log on stderr", choices=("text", "json"))
    drain_s: float = setting(2.0, "time limit for closing sessions at shutdown, seconds", low=0.0, high=600.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_listening("host", self.host)
        check_origins(self.origins)
        check_hosts(self.hosts)
        check_token(self.token)
        if self.accept_uploads and not self.token and (self.hosts or not is_loopback(self.host)):
            raise ConfigError(
                f"accept_uploads: others reach {self.hosts or self.host}; give a --token that uploads need"
            )
        if not self.bundle:
            raise ConfigError("bundle is not given; name one with --bundle FOLDER_OR_URL")
