"""Files are there whole or not at all, and what is no file is not replaced by one."""

import os
import stat
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from cags_common.errors import OutputError
from cags_common.files import whole_file, writable_folder, write_whole


def test_nothing_is_seen_of_a_file_until_it_is_whole(tmp_path):
    path = tmp_path / "report.json"
    path.write_bytes(b"old")
    with whole_file(path) as writing:
        writing.write_bytes(b"ne")
        assert path.read_bytes() == b"old"
        writing.write_bytes(b"new")
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


def test_an_error_leaves_what_was_there_and_nothing_else(tmp_path):
    path = tmp_path / "report.json"
    path.write_bytes(b"old")
    with pytest.raises(ZeroDivisionError), whole_file(path) as writing:
        writing.write_bytes(b"half")
        raise ZeroDivisionError
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "real").mkdir()
    real, link = tmp_path / "real" / "report.json", tmp_path / "latest.json"
    real.write_bytes(b"old")
    link.symlink_to(real)
    write_whole(link, b"new")
    assert link.is_symlink()
    assert real.read_bytes() == b"new"


def test_a_pipe_is_written_to_and_stays_one(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read: list[bytes] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_bytes()))
    reader.start()
    write_whole(pipe, b"through")
    reader.join(10)
    assert read == [b"through"]
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert list(tmp_path.iterdir()) == [pipe]


@pytest.mark.skipif(not Path("/dev/fd").exists(), reason="needs /dev/fd")
def test_an_open_pipe_by_its_name_is_written_to():
    """As ``--json /dev/stdout`` and ``--json >(program)`` name it: a link to what is no path."""
    out, into = os.pipe()
    try:
        write_whole(Path(f"/dev/fd/{into}"), b"through")
        assert os.read(out, 100) == b"through"
    finally:
        os.close(out)
        os.close(into)


def test_a_device_is_not_replaced_though_its_folder_could_be_written(tmp_path):
    try:
        os.mknod(tmp_path / "full", 0o666 | stat.S_IFCHR, os.makedev(1, 7))
    except PermissionError:
        pytest.skip("only root makes devices")
    try:
        with pytest.raises(OutputError, match=r"full: cannot be written \(No space left"):
            write_whole(tmp_path / "full", b"report")
    except PermissionError:
        pytest.skip("devices are off in this folder")
    assert stat.S_ISCHR((tmp_path / "full").stat().st_mode)


@pytest.mark.parametrize("place", ["none/here", "folder"])
def test_a_place_that_cannot_be_written_is_named(tmp_path, place):
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match=r"cannot be written .*choose another place"):
        write_whole(tmp_path / place, b"report")
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def test_a_file_is_no_folder_to_write_in(tmp_path):
    (tmp_path / "report").touch()
    with pytest.raises(OutputError, match=r"report: cannot be written \(it is no folder\); choose another place"):
        writable_folder(tmp_path / "report")
    assert writable_folder(tmp_path / "new" / "deeper").is_dir()


def test_programs_that_check_the_same_folder_at_once_are_all_told_that_it_is_writable(tmp_path: Path) -> None:
    """One took the other's probe away: two encoders of one cache, and one said that the folder did not exist."""
    with ThreadPoolExecutor(8) as pool:
        assert len(list(pool.map(writable_folder, [tmp_path] * 400))) == 400
    assert list(tmp_path.iterdir()) == []
