"""LoD orders: the paper's, and those read from files."""

from __future__ import annotations

from pathlib import Path

import pytest

from cags_common.errors import ConfigError
from cags_common.tiles.lod import LodLayer
from cags_encoder.codecs.lod_order import order_of, paper_order
from support.small_store import books

LAYERS = [LodLayer("opacity", 1), LodLayer("sh0", 1)]


def written(folder: Path, text: str) -> str:
    path = folder / "order.txt"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_the_papers_order_has_every_layer_once_and_colours_before_opacity() -> None:
    assert paper_order(books()) == tuple(reversed(LAYERS))
    assert order_of("measured", books()) == order_of("paper", books()) == paper_order(books())


def test_a_file_says_an_order_line_by_line(tmp_path: Path) -> None:
    text = "# first what is see-through\nopacity 1\n\nsh0 1  # then the colours\n"
    assert list(order_of(written(tmp_path, text), books())) == LAYERS


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("opacity\n", r"order.txt:1: 'opacity' must be 'attribute layer'"),
        ("sh0 1\nopacity one\n", r"order.txt:2: 'opacity one' must be 'attribute layer'"),
        ("sh0 1\n", "order.txt: "),
        ("sh0 1\nopacity 1\nopacity 2\n", "order.txt: "),
        ("sh0 1\nopacity 1\nscale 1\n", "order.txt: "),
    ],
)
def test_a_file_that_says_another_thing_is_refused_with_the_line(tmp_path: Path, text: str, what: str) -> None:
    with pytest.raises(ConfigError, match=what):
        order_of(written(tmp_path, text), books())


def test_a_name_that_is_no_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is not 'measured' or 'paper' and cannot be read as a file"):
        order_of(str(tmp_path / "none.txt"), books())
