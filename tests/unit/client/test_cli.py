"""What ``cags-client`` says of its flags before it asks any server."""

from __future__ import annotations

import itertools
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cags_web
from cags_client import cli
from cags_client.output.truth import BundleTruth
from cags_client.settings import ClientSettings
from cags_common.bundle import BundleReader, Manifest
from cags_common.bundle.view import AuthorView
from cags_common.errors import ConfigError
from cags_common.geometry import Pose
from cags_common.poses import Focus, open_poses
from cags_encoder import EncodeSettings, encode
from cags_encoder.scenes import open_scene

NOWHERE = ["--url", "ws://127.0.0.1:1/stream", "--reconnect-s", "0"]


@pytest.mark.parametrize(
    ("flag", "value", "words"),
    [
        ("--raster", "ray", "rasteriser 'ray' is unknown; known: auto"),
        ("--align", "left", "aligner 'left' is unknown; known: fast, oracle"),
        ("--restore", "magic", "restorer 'magic' is unknown; known: correct, none"),
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


@pytest.mark.parametrize("flag", ["--record", "--json", "--truth", "--stages", "--poses", "--config"])
def test_an_empty_name_is_refused_where_it_would_do_nothing(capsys: pytest.CaptureFixture[str], flag: str) -> None:
    with pytest.raises(SystemExit, match="2"):
        cli.main([*NOWHERE, flag, ""])
    said = capsys.readouterr().err
    assert said.startswith(f"cags-client: argument {flag}")
    assert "is empty; give a name, or leave it out" in said


def test_a_step_of_pictures_without_their_folder_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([*NOWHERE, "--stages-every", "5"]) == 2
    assert "--stages-every is an option of --stages; add --stages DIR or leave it out" in capsys.readouterr().err
    assert cli.main([*NOWHERE, "--stages", "pictures", "--stages-every", "5"]) == 1
    assert "no server answers" in capsys.readouterr().err


def test_a_start_beyond_the_end_is_told_with_what_there_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    info = Manifest("t", 30.0, 15, (0,), (1,), 0, ((0, 0, 0), (1, 1, 1)), (), ())
    monkeypatch.setattr("cags_client.net.endpoints.fetch_info", lambda *_: info)
    assert cli.main([*NOWHERE, "--start-frame", "15"]) == 2
    assert capsys.readouterr().err.endswith("start_frame = 15 is outside 0 to 14, the clip's frames\n")


@pytest.mark.parametrize(("first", "second"), [("--record", "--json"), ("--json", "--stages"), ("--save", "--stages")])
def test_two_outputs_of_one_name_are_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, first: str, second: str
) -> None:
    """The report replaced the film of the same play."""
    name = "clip.mp4" if "--json" in (first, second) else "pictures"
    (tmp_path / "link").symlink_to(tmp_path)
    assert cli.main([*NOWHERE, first, str(tmp_path / name), second, str(tmp_path / "link" / name)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f" and {second} both name {tmp_path / 'link' / name}; give each a name of its own" in line


@pytest.mark.parametrize(("seconds", "frames"), [(0.001, 1), (0.01, 1), (0.3, 9), (0.34, 10), (60.0, 25), (None, 25)])
def test_frames_of_a_play_are_counted_as_the_player_does(seconds: float | None, frames: int) -> None:
    """``--duration 0.01`` shows one frame, and said that it was one of none."""
    info = Manifest("t", 30.0, 30, (0,), (1,), 0, ((0, 0, 0), (1, 1, 1)), (), ())
    assert cli._frames(ClientSettings(duration=seconds, start_frame=5), info) == frames


@pytest.mark.parametrize("restore", ["correct", "none", "reference", "srresnet@torch"])
def test_what_is_right_goes_on_to_the_server(capsys: pytest.CaptureFixture[str], restore: str) -> None:
    assert cli.main([*NOWHERE, "--restore", restore]) == 1
    assert "no server answers" in capsys.readouterr().err


@pytest.mark.parametrize("watched", [True, False])
def test_why_no_graphics_processor_draws_is_one_line_to_who_looks(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, watched: bool
) -> None:
    monkeypatch.setenv("CAGS_GPU_ADAPTER", "no such adapter")
    monkeypatch.setattr("cags_common.runtime.terminal.watched", lambda *, headless: watched)
    assert cli.main(NOWHERE) == 1
    first, *others = capsys.readouterr().err.splitlines()
    assert first.startswith("cags-client: not drawing on a graphics processor: ") == watched
    assert len(others) == (1 if watched else 0)
    assert "no server answers" in [first, *others][-1]


def test_without_a_built_page_view_says_how_to_build_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cags_web, "page_folder", lambda: None)
    assert cli.main(["--url", "ws://127.0.0.1:9/stream", "--view"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(f"build it: {cags_web.HOW_TO_BUILD}")


def test_a_truth_of_another_length_is_told_before_the_play(tmp_path: Path) -> None:
    scene = open_scene("procedural:size=500,frames=2")
    encode(
        scene, EncodeSettings(frames=2, quantiser="paper-66", train_splats=500, lod_order="paper"), str(tmp_path / "b")
    )
    truth = BundleTruth(str(tmp_path / "b"), ClientSettings())
    info = BundleReader.open(str(tmp_path / "b")).manifest
    truth.check(info)
    longer = replace(info, frames=3)
    with pytest.raises(ConfigError, match=r"has 2 frames and the stream 3: another scene"):
        truth.check(longer)


def test_scores_until_an_interrupt_are_kept() -> None:
    """Scoring takes longer than the play; what is known of it is reported all the same."""

    class Spool:
        def __len__(self) -> int:
            return 3

        def scores(self, truth: object) -> Iterator[tuple[int, dict[str, float], None]]:
            for frame in range(3):
                yield frame, {"psnr_restored_db": 30.0 + frame}, None

    records: list[dict[str, Any]] = [{"frame": frame} for frame in range(3)]
    outputs = cli._Outputs("ws://a/stream", None, None, None, "truth", None, 30, view=False, headless=True)
    assert cli._score(records, Spool(), None, outputs, [signal.SIGINT]) == 1  # type: ignore[arg-type]
    assert records == [{"frame": 0, "psnr_restored_db": 30.0}, {"frame": 1}, {"frame": 2}]


def test_a_walk_begins_at_the_authors_view_where_none_is_named() -> None:
    info = Manifest("t", 30.0, 30, (0,), (1,), 0, ((0, 0, 0), (1, 1, 1)), (), ())
    pose = Pose.looking_at((3.0, 1.0, -2.0), (0.0, 0.0, 0.0))
    authored = replace(info, view=AuthorView(pose=pose))
    walk = cli._walk(None, ClientSettings(), authored)
    assert walk.pose_at(0).position == pytest.approx(pose.position)
    assert walk.pose_at(0).rotation == pytest.approx(pose.rotation)
    usual = open_poses(cli.DEFAULT_WALK, Focus(info.focus_centre, info.focus_radius, info.up))
    ours, others = (np.linalg.norm(np.diff(each.positions[:50], axis=0), axis=1) for each in (walk, usual))
    np.testing.assert_allclose(ours, others, err_msg="and goes on as it would have")
    named = cli._walk("synthetic:still", ClientSettings(), authored)
    assert named.pose_at(0).position != pytest.approx(pose.position)


@pytest.mark.parametrize(("width", "height"), [(800, 600), (400, 800), (1600, 500)])
def test_without_poses_and_view_a_walk_begins_with_all_of_an_object_in_view(width: int, height: int) -> None:
    """Ears stand out of the ball in which four fifths of the splats lie."""
    low, high = (-1.33, -0.95, -0.78), (1.35, 0.98, 0.84)
    info = Manifest("t", 30.0, 30, (0,), (1,), 0, (low, high), (), (), focus_centre=(0.0, 0.1, 0.2), focus_radius=1.04)
    settings = ClientSettings(width=width, height=height)
    walk = cli._walk(None, settings, info)
    corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
    pose, pinhole = walk.pose_at(0), settings.intrinsics
    x, y, z = ((corners - pose.position) @ pose.rotation_matrix).T
    assert (z > 0).all()
    assert (np.abs(x / z) <= pinhole.width_px / (2 * pinhole.fx_px) + 1e-9).all()
    assert (np.abs(y / z) <= pinhole.height_px / (2 * pinhole.fy_px) + 1e-9).all()
    away = np.linalg.norm(walk.positions - np.asarray(info.focus_centre), axis=1)
    assert away.min() > 0.7 * away[0], "it walks around the object, and not into it"
