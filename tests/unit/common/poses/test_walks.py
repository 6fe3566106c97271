"""Recorded walks by person, and people held out."""

from __future__ import annotations

from pathlib import Path

import pytest

from cags_common.errors import ConfigError, TraceError
from cags_common.poses.walks import read_walks, split_people

ROWS = "time_s,px,py,pz,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n0.1,0,0,0.1,1,0,0,0\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("room_user01", "room_User-02", "hall_user_02", "room_user10"):
        (tmp_path / f"{name}.csv").write_text(ROWS)
    return tmp_path


def test_the_person_is_in_the_name(folder: Path) -> None:
    assert [(walk.name, walk.person) for walk in read_walks(folder)] == [
        ("hall_user_02", "02"),
        ("room_User-02", "02"),
        ("room_user01", "01"),
        ("room_user10", "10"),
    ]


def test_everybody_is_on_one_side(folder: Path) -> None:
    train, test = split_people(read_walks(folder), " 02, 10 ")
    assert {walk.person for walk in train} == {"01"}
    assert {walk.person for walk in test} == {"02", "10"}


@pytest.mark.parametrize(
    ("held_out", "complaint"), [("2", "have no walks"), ("", "leaves 4"), ("01,02,10", "leaves 0")]
)
def test_a_side_without_walks_is_refused(folder: Path, held_out: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        split_people(read_walks(folder), held_out)


def test_a_file_without_a_person_and_an_empty_folder_are_named(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(TraceError, match="no pose traces"):
        read_walks(tmp_path / "none")
    (folder / "someone.csv").write_text(ROWS)
    with pytest.raises(TraceError, match=r"someone\.csv: its name does not say who walks"):
        read_walks(folder)
