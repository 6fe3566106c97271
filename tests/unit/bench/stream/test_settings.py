"""Settings of ``cags-bench stream``: those of the programs, unless told otherwise."""

from __future__ import annotations

import argparse
from dataclasses import fields, replace
from pathlib import Path

import pytest

from cags_bench.demo.run import client_arguments
from cags_bench.demo.settings import DemoSettings
from cags_bench.stream.play import Play
from cags_bench.stream.settings import FIELDS, StreamSettings, add_arguments, changed, load
from cags_client.settings import ClientSettings
from cags_common.errors import CagsError, ConfigError
from cags_common.settings import add_flags, load_settings
from cags_server.settings import ServerSettings, ServeSettings


def parsed(*words: str) -> StreamSettings:
    parser = argparse.ArgumentParser(exit_on_error=False)
    add_arguments(parser)
    return load(parser.parse_args(words))


def test_the_defaults_are_those_of_server_and_client() -> None:
    shipped = ServeSettings(bundle="clip.cags")
    found = parsed()
    assert all(getattr(found.server, f.name) == getattr(shipped, f.name) for f in fields(ServerSettings))
    assert found.client == ClientSettings()


def test_the_defaults_are_those_of_the_demo_s_client_but_for_the_size_of_its_picture(tmp_path: Path) -> None:
    parser = argparse.ArgumentParser()
    add_flags(parser, ClientSettings)
    words = client_arguments("clip.cags", 1, replace(DemoSettings(), width=640, height=480, threads=2), tmp_path)
    known, _ = parser.parse_known_args(words)
    demo = load_settings(ClientSettings, known)
    assert replace(demo, width=800, height=600) == parsed().client


def test_flags_reach_the_side_that_they_belong_to() -> None:
    found = parsed("--fov-policy", "fixed", "--fov", "70", "--abr", "paper", "--tiles-ahead", "1", "--restore", "none")
    assert (found.server.fov, found.server.abr, found.server.tiles_ahead) == ("fixed", "paper", 1)
    assert (found.client.fov, found.client.restore) == (70.0, "none")


def test_a_file_of_the_programs_is_read_table_by_table(tmp_path: Path) -> None:
    file = tmp_path / "all.toml"
    file.write_text('scene = "frames/"\n[server]\nfov = "fixed"\nport = 1\n[client]\nfov = 90\nrestore = "none"\n')
    found = parsed("--config", str(file), "--restore", "correct")
    assert found.scene == "frames/"
    assert (found.server.fov, found.client.fov, found.client.restore) == ("fixed", 90, "correct")


def test_a_file_that_leaves_open_whose_fov_it_means_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "all.toml"
    file.write_text("fov = 90\n")
    with pytest.raises(ConfigError, match=r"'fov' is a setting of server and client; put it under"):
        parsed("--config", str(file))


@pytest.mark.parametrize(
    ("name", "text", "found"),
    [
        ("abr", "paper", lambda s: s.server.abr == "paper"),
        ("tiles-ahead", "1", lambda s: s.server.tiles_ahead == 1),
        ("fov_policy", "fixed", lambda s: s.server.fov == "fixed"),
        ("fov", "75", lambda s: s.client.fov == 75.0),
        ("erosion", "false", lambda s: s.client.erosion is False),
        ("reference_kbps", "500", lambda s: s.server.reference_kbps == 500),
        ("estimator", "oracle", lambda s: s.estimator == "oracle"),
        ("trace", "generated:step", lambda s: s.trace == "generated:step"),
    ],
)
def test_any_setting_can_be_changed_by_name(name: str, text: str, found) -> None:
    assert found(changed(StreamSettings(), name, text))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("speed", "1", "'speed' is not a setting of a play; known: abr, align"),
        ("compare", "a", "'compare' is not a setting of a play; known: abr, align"),
        ("record", "film.mp4", "'record' is not a setting of a play; known: abr, align"),
        ("estimator", "psychic", "estimator = 'psychic' must be one of measured, oracle"),
        ("tiles_ahead", "many", "tiles_ahead = 'many' must be of type int"),
        ("tiles_ahead", "99", r"tiles_ahead = 99 must lie in \[1, 30\]"),
        ("erosion", "1", "erosion = '1' must be true or false"),
    ],
)
def test_what_cannot_be_changed_is_refused_in_a_line(name: str, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        changed(StreamSettings(), name, text)


def test_every_name_is_a_setting_of_one_side() -> None:
    assert {"abr", "predictor", "fov", "fov_policy", "restore", "references", "trace", "scene"} <= set(FIELDS)
    assert not {"token", "drop_late", "interpolate", "duration"} & set(FIELDS)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("abr", "greedy", "abr = 'greedy' is unknown; known: utility"),
        ("predictor", "oracle", "predictor = 'oracle' is unknown; known: hold"),
        ("fov_policy", "huge", "fov = 'huge' is unknown; known: fixed"),
        ("restore", "magic", "restorer 'magic' is unknown; known: correct, none"),
        ("align", "magic", "'magic' is unknown"),
        ("raster", "foo", "rasteriser 'foo' is unknown"),
        ("rasteriser", "foo", "rasteriser 'foo' is unknown"),
        ("poses", "nope", "nope: cannot be read"),
        ("lpips", "nope.npz", "nope.npz: is not an LPIPS weights file"),
        ("trace", "nope", "nope: cannot be read"),
    ],
)
def test_unknown_names_are_refused_before_anything_is_encoded(name: str, value: str, message: str) -> None:
    with pytest.raises(CagsError, match=message):
        Play(changed(StreamSettings(scene="/nowhere"), name, value)).check()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"strip": 3}, "strip = 3 needs a folder; give --out FOLDER"),
        ({"record": "film.avi"}, r"record = 'film\.avi' must end in \.mp4"),
        ({"record_truth": True}, "record_truth = True needs a film"),
        ({"seeds": 0}, r"seeds = 0 must lie in \[1, 1000\]"),
        ({"video_metrics": "psnr"}, "video_metrics: 'psnr' is unknown"),
    ],
)
def test_settings_that_do_not_go_together_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        StreamSettings(**changes)


@pytest.mark.parametrize(
    ("changes", "plays"),
    [({}, 1), ({"seeds": 4}, 4), ({"compare": "abr=paper,utility"}, 3), ({"compare": "a=b", "seeds": 1}, 1)],
)
def test_a_comparison_has_three_seeds_unless_told_otherwise(changes: dict, plays: int) -> None:
    assert list(StreamSettings(**changes).seed_list) == list(range(plays))
