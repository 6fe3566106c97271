"""Settings of the sampling of training pairs."""

from __future__ import annotations

from dataclasses import dataclass

from cags_common.errors import ConfigError
from cags_common.settings import check_settings, setting
from cags_encoder.settings import EncodeSettings


@dataclass(frozen=True)
class PairSettings:
    """Distribution of a restorer's training data; field names are flags and TOML keys."""

    quantisers: str = setting("layered", "quantiser configurations to divide views among, comma separated")
    views: int = setting(60, "views drawn in each scene", low=1, high=100_000)
    crops: int = setting(8, "crops kept of each view", low=1, high=1000)
    crop: int = setting(128, "side of a crop, client pixels", low=32, high=1024)
    crf_low: float = setting(16.0, "least H.264 crf of references", low=0, high=51)
    crf_high: float = setting(26.0, "largest H.264 crf of references", low=0, high=51)
    margin_high: float = setting(0.35, "largest margin of the reference's field of view", low=0, high=2)
    horizon_ms_high: int = setting(400, "largest prediction horizon in milliseconds", low=0, high=1000)
    plain_share: float = setting(0.0, "share of views whose reference has no client footprint", low=0, high=1)
    frames_before: int = setting(6, "largest number of references before this one in the video", low=0, high=100)
    top_share: float = setting(0.1, "share of views with all tiles around the top of the ladder", low=0, high=1)
    levels: str = setting(
        "", "shares of the ladder to render every view at (0 0.3 0.6 1), untinted; when empty, shares are random"
    )
    reference_width: int = setting(400, "reference width in pixels", low=16, high=4096)
    reference_height: int = setting(300, "reference height in pixels", low=16, high=4096)
    seed: int = setting(0, "seed of all random choices", low=0, high=2**31 - 1)

    def __post_init__(self) -> None:
        check_settings(self)
        for name in self.quantiser_list:
            EncodeSettings(quantiser=name)  # refuses unknown ones
        if any(not 0 <= level <= 1 for level in self.level_list):
            raise ConfigError(f"levels = {self.levels!r} are not all shares of the ladder; give numbers of 0 to 1")

    @property
    def quantiser_list(self) -> list[str]:
        """Names of quantiser configurations."""
        return [word.strip() for word in self.quantisers.split(",")]

    @property
    def level_list(self) -> list[float]:
        """Shares of the ladder at which every view is drawn. Raises :class:`ConfigError`."""
        try:
            return [float(word) for word in self.levels.split()]
        except ValueError as error:
            raise ConfigError(
                f"levels = {self.levels!r} are no numbers; give shares of 0 to 1, as '0 0.3 1'"
            ) from error
