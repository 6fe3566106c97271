"""Settings of the encoder."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import ClassVar

from cags_common.errors import ConfigError
from cags_common.settings import check_settings, setting

QUANTISERS = ("layered", "layered-fine", "paper-66", "paper-76")


@dataclass(frozen=True)
class EncodeSettings:
    """Settings of the encoding; field names are flags and TOML keys."""

    SECTION: ClassVar[str] = "encoder"

    fps: float | None = setting(
        None, "frame rate of the bundle, frames per second; the scene's own when not given", low=0.1, high=240
    )
    frames: int | None = setting(None, "largest number of frames to encode; all when not given", low=1)
    gof_frames: int = setting(
        300, "frames per group; clients join and seek at group starts, which send all splats again", low=1
    )
    codec: str = setting("svq", "codec of tiles: svq, or one of the baselines density and video")
    quantiser: str = setting(QUANTISERS[0], "configuration of the svq quantiser", choices=QUANTISERS)
    lod_order: str = setting(
        "measured",
        "order of the quality layers: measured (on renders of the first frame; needs the kernels), paper (scale, "
        "rotation, SH, opacity; positions whole in the base), or a file of lines 'attribute layer'; 'position 1', "
        "'position 2' and so on are the last bits of positions",
    )
    position_step: float | None = setting(
        None,
        "step of positions with all levels, in radii of a tile's smaller splats (lower quartile); default: the "
        "quantiser's (1/8), halved up to three times where renders of the first frame need it",
        low=1e-4,
        high=10,
    )
    position_bits: int | None = setting(
        None,
        "bits per axis of positions in a tile's cube, all of them in the base; replaces --position-step",
        low=4,
        high=22,
    )
    change_threshold: float = setting(
        0.01, "smallest visible error at which a splat is sent again, share of a pixel's colour", low=0, high=1
    )
    motion: str = setting(
        "tracks",
        "coding of motion: tracks (apart from looks; svq only), or none (splats that change are sent whole, as in the "
        "paper)",
        choices=("tracks", "none"),
    )
    motion_span: int = setting(
        16,
        "frames per chunk of motion; longer chunks take fewer bytes in all and arrive in larger pieces",
        low=2,
        high=64,
    )
    prune: float = setting(
        0.0,
        "share of the splats to remove, least visible first; the loss is measured and stored in the bundle",
        low=0,
        high=0.99,
    )
    prune_psnr_db: float | None = setting(
        None,
        "remove as many splats as this PSNR against all of them permits, dB; replaces --prune; 45 is hardly visible",
        low=20,
        high=80,
    )
    view: str = setting(
        "",
        "JSON file with the author's view: title, background, pose, target, radius, each optional; the page in the "
        "browser saves one",
    )
    train_splats: int = setting(65_536, "splats to train codebooks on, sampled from the whole clip", low=256)
    seed: int = setting(0, "seed of the random subset and of k-means", low=0)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.codec != "svq" and self.quantiser != QUANTISERS[0]:
            raise ConfigError(
                f"quantiser = {self.quantiser!r} is of the codec svq, and codec = {self.codec!r}: leave one of them out"
            )
        if self.prune and self.prune_psnr_db is not None:
            raise ConfigError(f"prune = {self.prune} and prune_psnr_db = {self.prune_psnr_db}: give one of them")

    @property
    def measures_positions(self) -> bool:
        """Whether the step of positions is chosen by measurement: neither these settings nor the paper give it."""
        return self.position_step is None and self.position_bits is None and not self.quantiser.startswith("paper")


@dataclass(frozen=True)
class CommandSettings(EncodeSettings):
    """Settings of the command's execution, which change no byte of the bundle."""

    workers: int | None = setting(None, "worker processes; one per core when not given", low=1, high=1024)
    scheduler: str | None = setting(
        None, "dask scheduler whose workers encode, tcp://HOST:PORT; this machine when not given"
    )
    resume: bool = setting(True, "continue a run of the same scene and settings that was interrupted")

    @property
    def encoding(self) -> EncodeSettings:
        """The settings that the bytes depend on."""
        names = {f.name for f in fields(EncodeSettings)}
        return EncodeSettings(**{name: value for name, value in asdict(self).items() if name in names})
