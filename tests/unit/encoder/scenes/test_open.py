"""Spec strings."""

from pathlib import Path

import numpy as np
import pytest

from cags_common.errors import ConfigError, SceneError
from cags_common.splats import Splats
from cags_encoder.formats import write_splats
from cags_encoder.formats.ply import ply_bytes
from cags_encoder.scenes import open_scene
from cags_encoder.scenes.options import split_options
from support.splat_files import random_splats


@pytest.mark.parametrize(
    ("spec", "head", "options"),
    [
        ("procedural", "procedural", {}),
        ("procedural:size=500,seed=3", "procedural", {"size": "500", "seed": "3"}),
        ("a/b.ply:up=-y", "a/b.ply", {"up": "-y"}),
        ("motion:C:/x.ply:kind=mix", "motion:C:/x.ply", {"kind": "mix"}),
        ("a:b", "a:b", {}),
        ("", "", {}),
    ],
)
def test_splitting(spec: str, head: str, options: dict[str, str]) -> None:
    assert split_options(spec) == (head, options)


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("procedural:size=10", "scene 'procedural:size=10': size = 10 must lie in"),
        ("procedural:size=many", "size = 'many' must be of type int"),
        ("procedural:sise=600", "unknown option 'sise'; known: size, frames, seed, fps, degree, shuffle, quantise"),
        ("procedural:size=600,size=700", "'size' is given twice"),
        ("procedural:fps=nan", "fps = nan must be finite"),
        ("motion:", "names no capture"),
        ("", "scene '' has no name"),
    ],
)
def test_wrong_options(spec: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        open_scene(spec)
    assert words in str(caught.value)


def test_missing_paths_are_named() -> None:
    with pytest.raises(SceneError, match=r"no/where\.ply: no such file or folder"):
        open_scene("no/where.ply")
    with pytest.raises(SceneError, match=r"no/where\.ply: no such file or folder"):
        open_scene("motion:no/where.ply:kind=bend")


def test_options_reach_files_also_through_the_motion_tool(tmp_path: Path) -> None:
    write_splats(tmp_path / "a.ply", random_splats())
    scene = open_scene(f"{tmp_path}/a.ply:frames=7,fps=24,up=+z,focus=1/2/3/4")
    assert (len(scene), scene.fps, scene.up, scene.name) == (7, 24.0, (0, 0, 1), "a")
    assert (scene.focus.centre, scene.focus.radius) == ((1, 2, 3), 4)
    moved = open_scene(f"motion:{tmp_path}/a.ply:kind=bend,up=+z,focus=1/2/3/4,frames=9")
    assert (len(moved), moved.up, moved.focus, moved.name) == (9, (0, 0, 1), scene.focus, "a-bend")


@pytest.mark.parametrize(("said", "up"), [("z", (0, 0, 1)), ("+z", (0, 0, 1)), ("-z", (0, 0, -1)), ("x", (1, 0, 0))])
def test_an_axis_without_a_sign_is_the_positive_one(said: str, up: tuple[int, int, int], tmp_path: Path) -> None:
    write_splats(tmp_path / "a.ply", random_splats())
    assert open_scene(f"{tmp_path}:up={said}").up == up


@pytest.mark.parametrize("focus", ["1/2/3", "a/b/c/d", "1/2/3/0", "1/2/3/inf"])
def test_wrong_focus(focus: str, tmp_path: Path) -> None:
    write_splats(tmp_path / "a.ply", random_splats())
    with pytest.raises(ConfigError, match="focus"):
        open_scene(f"{tmp_path}/a.ply:focus={focus}")


def test_a_path_that_looks_like_options_wins(tmp_path: Path) -> None:
    write_splats(tmp_path / "x.ply", random_splats())
    odd = tmp_path / "a:b=1"
    odd.mkdir()
    (tmp_path / "x.ply").rename(odd / "x.ply")
    assert len(open_scene(str(odd))) == 60
    assert open_scene(f"motion:{odd}").name == "a:b=1-mix"
    assert open_scene(f"motion:{odd}:kind=bend,up=+z").up == (0, 0, 1)


def test_a_name_beyond_the_file_systems_limit_is_no_file() -> None:
    for spec in ("x" * 5000, f"motion:{'x' * 5000}", f"{'x' * 5000}:up=x"):
        with pytest.raises(SceneError, match="no such file or folder"):
            open_scene(spec)


def broken(path: Path) -> Path:
    """A PLY with a NaN in splat 7."""
    arrays = dict(random_splats().arrays())
    arrays["means"][7] = np.nan
    path.write_bytes(ply_bytes(Splats(**arrays)))
    return path


def test_the_repair_that_errors_name_works_through_the_motion_tool(tmp_path: Path) -> None:
    path = broken(tmp_path / "a.ply")
    with pytest.raises(SceneError, match="repair=drop"):
        open_scene(f"motion:{path}")
    count = len(open_scene(f"motion:{path}:repair=drop,kind=bend").frame(0))
    assert count == len(random_splats()) - 1
    write_splats(tmp_path / "b.ply", random_splats())
    assert len(open_scene(f"motion:{tmp_path}/b.ply:repair=drop").frame(0)) > 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("sise=3", "unknown option 'sise'; known: kind, frames, fps, share, amount, period_s, seed, up, focus, repair"),
        ("kind=fly", "kind"),
        ("repair=all", "repair"),
        ("shuffle=2", "shuffle"),
    ],
)
def test_options_are_checked_before_files_are_read(options: str, words: str, tmp_path: Path) -> None:
    path = broken(tmp_path / "a.ply")
    with pytest.raises(ConfigError, match=words):
        open_scene(f"motion:{path}:{options}")
