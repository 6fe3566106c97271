"""Sessions of ``cags-bench motion``: which are played, what is made of their pictures, and what must hold."""

from __future__ import annotations

from pathlib import Path

import pytest

from cags_bench.motion import sessions
from cags_bench.motion.sessions import Goal, Session, goal_checks, played, quality_of, sessions_of
from cags_bench.motion.settings import MotionSettings
from cags_common.errors import ConfigError


def test_sessions_of_scenes_that_are_not_at_hand_are_left_out(tmp_path: Path) -> None:
    assert [one.name for one in sessions_of(MotionSettings(shared=str(tmp_path)))] == ["the demo's link"]
    (tmp_path / "scenes" / "monkey").mkdir(parents=True)
    (tmp_path / "scenes" / "talking_head").mkdir()
    (tmp_path / "scenes" / "talking_head" / "params.npz").touch()
    names = [one.name for one in sessions_of(MotionSettings(shared=str(tmp_path)))]
    assert names == ["talking head, 4 Mbps", "monkey, lte-driving", "the demo's link"]


def test_pictures_of_the_first_second_do_not_count() -> None:
    figures = quality_of([10.0, 20.0, 40.0, 41.0, 44.0, 44.0, 41.5], [0, 29, 30, 31, 32, 34, 35])
    assert figures["mean_db"] == pytest.approx(42.1)
    assert figures["lowest_db"] == 40.0
    assert figures["steps_within_2_db"] == 0.5
    assert figures["steps_within_3_db"] == 1.0


@pytest.mark.parametrize(("values", "ok"), [((0.94, 0.96), True), ((0.93, 0.96), False)])
def test_a_share_is_judged_by_its_mean(values: tuple[float, ...], ok: bool) -> None:
    session = Session("one", "scene", "trace", (Goal("steps_within_2_db", 0.95),))
    (found,) = goal_checks(session, [{"steps_within_2_db": value} for value in values])
    assert found["ok"] is ok


def test_a_lowest_picture_is_judged_by_the_worst_play() -> None:
    session = Session("one", "scene", "trace", (Goal("lowest_db", 34.0),))
    (found,) = goal_checks(session, [{"lowest_db": 50.0}, {"lowest_db": 33.0}])
    assert (found["ok"], found["value"]) == (False, 33.0)


def test_an_unknown_part_is_refused() -> None:
    with pytest.raises(ConfigError, match="parts"):
        MotionSettings(parts="rates,speed")


def test_a_session_is_played_as_its_link_and_seed_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sessions, "FRAMES", 12)
    monkeypatch.setattr(sessions, "FPS", 4)
    monkeypatch.setattr(sessions, "WIDTH_PX", 80)
    monkeypatch.setattr(sessions, "HEIGHT_PX", 60)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    settings = MotionSettings(cache=str(tmp_path / "bundles"))
    scene = "procedural:size=600,frames=12"
    wide = Session("wide", scene, "generated:steady-10", ())
    thin = Session("thin", scene, "generated:steady-10", (), share=0.005)
    first, again, other, little = (played(*way) for way in (
        (wide, settings, 0), (wide, settings, 0), (wide, settings, 1), (thin, settings, 0)
    ))  # fmt: skip
    assert first == again
    assert first["mean_db"] != other["mean_db"]
    assert little["mean_db"] < first["mean_db"] - 1.0
