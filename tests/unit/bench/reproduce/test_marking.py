"""Names of scenes for people."""

import pytest

from cags_bench.reproduce.marking import title, titled


@pytest.mark.parametrize(
    ("spec", "name"),
    [
        ("procedural:size=30000,frames=45", "room of 30,000 splats"),
        ("procedural", "built-in room"),
        ("../shared/scenes/talking_head/params.npz:up=y", "talking head"),
        ("../shared/scenes/playbot/1_0", "playbot"),
        ("motion:../shared/scenes/guitar/guitar.compressed.ply", "guitar in motion"),
        ("motion:/a/b.ply:kind=bend,frames=4", "b in motion (bend)"),
        ("monkey", "monkey"),
        ("a/1/2", "a"),
    ],
)
def test_a_spec_has_a_name(spec: str, name: str) -> None:
    assert title(spec) == name


def test_specs_in_a_text_are_named_and_the_rest_stays() -> None:
    text = (
        "least -6.3 on motion:guitar.compressed.ply, 60 Mbps | procedural:size=500,frames=45 † | flicker [1/255], a / b"
    )
    assert titled(text) == "least -6.3 on guitar in motion, 60 Mbps | room of 500 splats † | flicker [1/255], a / b"
    assert titled(titled(text)) == titled(text)
