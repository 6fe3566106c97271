"""Every importer reads a real file of its format. Skipped if the shared data is missing."""

import gsply
import numpy as np
import pytest

from cags_encoder.formats import read_splats
from support.splat_files import shared_scene


@pytest.mark.parametrize(
    ("name", "format_name", "count", "degree"),
    [
        ("plant/plant.splat", "splat", 113_648, 0),
        ("guitar/guitar.compressed.ply", "compressed-ply", 90_854, 0),
        ("statues/angel.sog", "sog", 71_359, 0),
        ("playbot/1_0", "sog", 250_000, 2),
        ("monkey/monkey_0050.sog", "sog", 31_658, 0),
        ("wave/wave_0200.sog", "sog", 4_225, 0),
    ],
)
def test_reads(name: str, format_name: str, count: int, degree: int) -> None:
    splats, entry = read_splats(shared_scene(name))
    assert (entry.name, len(splats), splats.sh_degree) == (format_name, count, degree)
    assert np.abs(splats.means).max() < 20
    assert np.median(splats.log_scales) < -2


def test_guitar_agrees_with_gsply() -> None:
    path = shared_scene("guitar/guitar.compressed.ply")
    ours, theirs = read_splats(path)[0], gsply.plyread(str(path))
    np.testing.assert_allclose(ours.means, theirs.means, atol=1e-5)
    np.testing.assert_allclose(ours.log_scales, theirs.scales, atol=1e-5)
    np.testing.assert_allclose(ours.sh0, theirs.sh0, atol=1e-5)
    np.testing.assert_allclose(np.abs(np.sum(ours.quats * theirs.quats, axis=1)), 1, atol=1e-5)
