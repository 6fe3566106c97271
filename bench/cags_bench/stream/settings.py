"""Settings of a session in virtual time."""

from __future__ import annotations

from dataclasses import dataclass

from cags_common.settings import check_settings, setting


@dataclass(frozen=True)
class StreamSettings:
    """The experiment; what it leaves out keeps the defaults of server and client."""

    scene: str = setting("procedural", "scene: a file, a folder, motion:PATH or procedural[:size=N,...]")
    trace: str = setting("generated:lte-driving", "network trace: a file or generated:NAME")
    poses: str = setting("synthetic:walking", "head motion: a pose file or synthetic:NAME")
    frames: int = setting(60, "media frames to encode and play", low=1, high=1_000_000)
    width: int = setting(800, "client width in pixels", low=1, high=8192)
    height: int = setting(600, "client height in pixels", low=1, high=8192)
    fov: float = setting(60.0, "client's horizontal field of view in degrees", low=1, high=170)
    restore: str = setting("correct", "what is done with references: correct, none, or a restorer to compare with")
    references: str = setting("auto", "what references say", choices=("auto", "difference", "picture", "none"))
    reference_footprint: str = setting("client", "how references are drawn", choices=("client", "plain"))
    erosion: bool = setting(True, "for restorers of aligned pictures: fill what is occluded from beside it")
    predictor: str = setting("autoregressive", "pose predictor")
    fov_policy: str = setting("fixed", "policy of the reference's field of view")
    abr: str = setting("paper", "rate policy")
    estimator: str = setting("measured", "bandwidth estimator", choices=("measured", "oracle"))
    delay_ms: float = setting(20.0, "one-way propagation delay in milliseconds", low=0, high=10_000)
    queue_bytes: int | None = setting(None, "bound of the link's queue in bytes; unbounded when not given", low=1504)
    quantiser: str = setting("", "quantiser configuration; empty: the encoder's default")
    cache: str = setting("", "folder of encoded bundles to reuse; empty: the user's cache folder")
    out: str = setting("", "folder for frames.jsonl, timeline.png and strip.png; empty: none")

    def __post_init__(self) -> None:
        check_settings(self)
