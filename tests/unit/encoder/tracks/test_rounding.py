"""Sources that round attributes to codebooks are known by their values."""

from __future__ import annotations

import numpy as np
import pytest

from cags_encoder.formats.sog_writer import quantised_as_sog
from cags_encoder.tracks.rounding import codebooks, step_at
from support.codec_scenes import cloud, with_changes

RNG = np.random.default_rng(0)


def test_codebooks_of_a_sog_file_are_found_and_nothing_else() -> None:
    exact = cloud(4000, 1, 2)
    assert codebooks(exact) == {}
    rounded = quantised_as_sog(exact)
    found = codebooks(rounded)
    assert set(found) == {"log_scales", "sh0", "sh_rest"}
    for name, book in found.items():
        assert np.array_equal(book, np.unique(getattr(rounded, name)))


@pytest.mark.parametrize("colours", [1, 3, 60])
def test_a_palette_is_no_codebook(colours: int) -> None:
    """Its colours differ on purpose."""
    palette = RNG.normal(size=(colours, 3)).astype(np.float32)
    splats = cloud(4000)
    assert "sh0" not in codebooks(with_changes(splats, sh0=palette[RNG.integers(colours, size=4000)]))


def test_a_few_splats_tell_nothing() -> None:
    assert codebooks(quantised_as_sog(cloud(60))) == {}


def test_the_step_is_that_to_the_farther_neighbour() -> None:
    book = np.array([0, 1, 1.5, 4], np.float32)
    assert step_at(book, book[[[0, 1], [2, 3]]]).tolist() == [[1, 1], [2.5, 2.5]]
