"""Differential frames do not drift: after any number of deltas a decoder is as near to the source as after the first.

Each changed splat is sent whole and judged against what the decoder holds, so an error cannot add up; what is left is
the quantiser's own error and the change threshold, both independent of the frame's number.
"""

from pathlib import Path

import numpy as np
import pytest

from cags_common.bundle import BundleReader
from cags_common.bundle.player import BundlePlayer
from cags_common.splats import Splats
from cags_encoder import EncodeSettings, encode
from cags_encoder.scenes import Focus

SPLATS = 48


class Orbit:
    """A ring of splats that turns by an angle no float32 holds exactly, for ever."""

    name, fps, up = "orbit", 30.0, (0.0, 1.0, 0.0)
    focus = Focus((0.0, 0.0, 0.0), 1.0)

    def __init__(self, frames: int) -> None:
        self.frames = frames
        rng = np.random.default_rng(3)
        self.angles = rng.uniform(0, 2 * np.pi, SPLATS)
        self.radii = rng.uniform(0.5, 1.0, SPLATS)
        self.colours = rng.normal(size=(SPLATS, 3)).astype(np.float32)

    def __len__(self) -> int:
        return self.frames

    def frame(self, index: int) -> Splats:
        angle = self.angles + index / 7.0
        means = np.stack([self.radii * np.cos(angle), np.zeros(SPLATS), self.radii * np.sin(angle)], axis=1)
        half = angle / 2
        quats = np.stack([np.cos(half), np.zeros(SPLATS), np.sin(half), np.zeros(SPLATS)], axis=1)
        return Splats(
            means.astype(np.float32),
            quats.astype(np.float32),
            np.full((SPLATS, 3), -3.0, np.float32),
            np.full(SPLATS, 2.0, np.float32),
            self.colours,
            np.zeros((SPLATS, 0, 3), np.float32),
        ).checked("orbit")

    def ids(self, index: int) -> np.ndarray:
        return np.arange(SPLATS, dtype=np.int32)


def errors_over_time(folder: Path, frames: int, at: list[int]) -> dict[int, float]:
    """Largest position error [world units] of the decoded frames ``at``, one group of frames throughout."""
    source = Orbit(frames)
    encode(source, EncodeSettings(gof_frames=frames, train_splats=256), str(folder))
    reader = BundleReader.open(str(folder))
    assert len(reader.manifest.gof_starts) == 1
    player, found = BundlePlayer(reader), {}
    for index in at:
        decoded = player.frame(index).splats
        truth = source.frame(index)
        # identities are the encoder's own business: match each decoded splat to the nearest true one
        distances = np.linalg.norm(decoded.means[:, None].astype(np.float64) - truth.means[None], axis=2)
        assert len(decoded) == SPLATS
        found[index] = float(distances.min(axis=1).max())
    reader.close()
    return found


@pytest.mark.parametrize("frames", [200, pytest.param(10_000, marks=pytest.mark.slow)])
def test_the_last_frame_is_as_exact_as_the_first_delta(tmp_path, frames):
    found = errors_over_time(tmp_path / "orbit", frames, [1, 10, frames // 2, frames - 1])
    bound = EncodeSettings().change_threshold + 2.0 / 2**10
    assert all(error <= bound for error in found.values()), found
    assert found[frames - 1] <= 4 * max(found[1], 1e-4), "an error that grows with time is drift"
