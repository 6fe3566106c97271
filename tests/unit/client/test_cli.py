"""What ``cags-client`` says of its flags before it asks any server."""

from __future__ import annotations

import pytest

from cags_client import cli

NOWHERE = ["--url", "ws://127.0.0.1:1/stream", "--reconnect-s", "0"]


@pytest.mark.parametrize(
    ("flag", "value", "words"),
    [
        ("--raster", "ray", "rasteriser 'ray' is unknown; known: auto"),
        ("--align", "left", "aligner 'left' is unknown; known: auto"),
        ("--restore", "magic", "restorer 'magic' is unknown; known: none"),
        ("--restore", "magic@torch", "restorer 'magic@torch' is unknown"),
        ("--poses", "synthetic:flying", "synthetic walk 'flying' is unknown; known:"),
        ("--poses", "no such file.csv", "no such file.csv"),
    ],
)
def test_what_is_misspelt_is_told_without_a_server(
    capsys: pytest.CaptureFixture[str], flag: str, value: str, words: str
) -> None:
    assert cli.main([*NOWHERE, flag, value]) in (1, 2)
    said = capsys.readouterr().err
    assert words in said
    assert "no server" not in said
    assert said.count("\n") == 1


@pytest.mark.parametrize("restore", ["auto", "lite", "lite@torch", "affine"])
def test_what_is_right_goes_on_to_the_server(capsys: pytest.CaptureFixture[str], restore: str) -> None:
    assert cli.main([*NOWHERE, "--restore", restore]) == 1
    assert "no server answers" in capsys.readouterr().err
