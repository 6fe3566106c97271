"""Settings of the encoder."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import ClassVar

from cags_common.errors import ConfigError
from cags_common.settings import check_settings, setting

QUANTISERS = ("layered", "layered-fine", "paper-66", "paper-76")


@dataclass(frozen=True)
class EncodeSettings:
    """How a scene is encoded; the names are the command's flags and the TOML file's keys."""

    SECTION: ClassVar[str] = "encoder"

    fps: float | None = setting(None, "frames a second; the scene's own when not given", low=0.1, high=240)
    frames: int | None = setting(None, "encode this many frames at most; all when not given", low=1)
    gof_frames: int = setting(
        300, "frames a group: clients join and seek at group starts, each of which sends all splats again", low=1
    )
    codec: str = setting("svq", "how tiles are coded; others than svq are baselines to compare with")
    quantiser: str = setting("layered", "configuration of svq", choices=QUANTISERS)
    lod_order: str = setting(
        "measured",
        "'measured' on renders of the first frame (needs the kernels, else as 'paper'), 'paper' (scale, rotation, SH, "
        "opacity), or a file of 'attribute layer' lines",
    )
    position_step: float | None = setting(
        None,
        "step of positions, in radii of a tile's smaller splats (lower quartile); 1/8 unless the quantiser has its own",
        low=1e-4,
        high=10,
    )
    position_bits: int | None = setting(
        None, "bits an axis of positions over each tile's own cube, instead of position_step", low=4, high=22
    )
    change_threshold: float = setting(
        0.01, "visible effect (0..1 of a pixel's colour) by which a splat must be wrong to be sent again", low=0, high=1
    )
    motion: str = setting(
        "tracks",
        "'tracks': splats keep their looks and motion is coded apart; 'none': splats that change are sent whole, as in "
        "the paper (codecs other than svq always do so)",
        choices=("tracks", "none"),
    )
    motion_span: int = setting(
        16,
        "frames that one chunk of motion covers: longer ones are smaller in all and arrive in larger pieces",
        low=2,
        high=64,
    )
    prune: float = setting(
        0.0,
        "share of the splats to leave out, those that contribute least to views from around the scene; what it costs "
        "is measured and kept in the bundle",
        low=0,
        high=0.99,
    )
    prune_psnr_db: float | None = setting(
        None,
        "leave out as many of those splats as pictures may lose and keep this PSNR to pictures of all, in place of a "
        "share; 45 is hardly seen",
        low=20,
        high=80,
    )
    view: str = setting(
        "",
        "JSON file with the author's view: title, background, pose, target, radius, each optional; the page in the "
        "browser saves one",
    )
    train_splats: int = setting(65_536, "splats that codebooks are trained on, drawn over the clip", low=256)
    seed: int = setting(0, "seed of the random subset and of k-means", low=0)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.prune and self.prune_psnr_db is not None:
            raise ConfigError(f"prune = {self.prune} and prune_psnr_db = {self.prune_psnr_db}: give one of them")


@dataclass(frozen=True)
class CommandSettings(EncodeSettings):
    """Those of the command: how it runs changes no byte of the bundle."""

    workers: int | None = setting(None, "processes that encode frames; one a core when not given", low=1, high=1024)
    scheduler: str | None = setting(None, "address of a dask scheduler, tcp://HOST:PORT, to run on its workers instead")
    resume: bool = setting(True, "go on where a killed run of the same scene and settings ended")

    @property
    def encoding(self) -> EncodeSettings:
        """What the bytes depend on."""
        names = {f.name for f in fields(EncodeSettings)}
        return EncodeSettings(**{name: value for name, value in asdict(self).items() if name in names})
