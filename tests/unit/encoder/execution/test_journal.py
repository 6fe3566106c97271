"""Records of finished frames are read back unchanged, and only by the run that they belong to."""

import fcntl
import shutil
from pathlib import Path
from typing import IO

import pytest

from cags_common.bundle import TilePayloads
from cags_common.errors import BundleError, OutputError
from cags_common.tiles.kinds import TileKind
from cags_encoder.execution import journal
from cags_encoder.execution.journal import FrameRecord, Journal

TILES = (
    TilePayloads(3, 0, ((0.1, 0.2, 0.3), (1.0, 2.0, 3.0)), (b"base", b"", b"layer")),
    TilePayloads(2, None, ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)), (b"b", b"xy", b"z")),
    TilePayloads(3, None, ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), (b"coarse", b"fine"), TileKind.MOTION, (7, 2), 16),
    TilePayloads(1, None, ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), (b"u", b"", b""), TileKind.UPDATE),
)
RECORD = FrameRecord(TILES, b"source")
NOTHING = FrameRecord((), b"")


def test_records_come_back(tmp_path: Path) -> None:
    with Journal(tmp_path, "key") as journal:
        journal.add(0, RECORD)
        journal.add(1, NOTHING)
        back, nothing = journal.frame(0), journal.frame(1)
    assert back is not None and nothing is not None
    assert [vars(tile) for tile in back.tiles] == [vars(tile) for tile in TILES]
    assert back.source == b"source"
    assert (nothing.tiles, nothing.source) == ((), b"")


@pytest.mark.parametrize("same", [True, False])
def test_another_key_or_other_codebooks_start_afresh(tmp_path: Path, same: bool) -> None:
    with Journal(tmp_path, "key") as journal:
        journal.codebooks(b"books")
        journal.add(0, RECORD)
        journal.write_note("order", [1])
    with Journal(tmp_path, "key" if same else "other") as journal:
        assert (journal.frame(0) is not None) == same
        assert journal.note("order") == ([1] if same else None)
        journal.add(0, RECORD)
        journal.codebooks(b"other books")
        assert journal.frame(0) is None


@pytest.mark.parametrize("cut", [0, 10, 200, -1])
def test_a_damaged_record_is_none(tmp_path: Path, cut: int) -> None:
    with Journal(tmp_path, "key") as journal:
        journal.add(0, RECORD)
        path = next(tmp_path.glob("*.npz"))
        path.write_bytes(path.read_bytes()[:cut])
        assert journal.frame(0) is None
        assert journal.frame(1) is None


def test_one_process_at_a_time(tmp_path: Path) -> None:
    with Journal(tmp_path, "key") as journal:
        journal.add(0, RECORD)
        with pytest.raises(BundleError, match="another process encodes this bundle"):
            Journal(tmp_path, "key")
    with Journal(tmp_path, "key") as journal:
        journal.discard()
    assert not tmp_path.exists()


def test_a_run_begins_while_another_deletes_its_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The lock was then that of a deleted file: the run ended in a traceback, or a third one could join it."""
    folder = tmp_path / "records"
    ending = Journal(folder, "key")
    lock = fcntl.flock

    def ends_first(file: IO[str], how: int) -> None:
        monkeypatch.setattr(fcntl, "flock", lock)
        ending.discard()
        lock(file, how)

    monkeypatch.setattr(fcntl, "flock", ends_first)
    with Journal(folder, "key") as journal:
        journal.add(0, RECORD)
        with pytest.raises(BundleError, match="another process encodes this bundle"):
            Journal(folder, "key")
        assert journal.frame(0) is not None


def test_a_folder_that_others_keep_deleting_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fcntl, "flock", lambda file, how: shutil.rmtree(tmp_path / "records"))
    with pytest.raises(BundleError, match="another process encodes this bundle"):
        Journal(tmp_path / "records", "key")


def test_a_journal_without_records_leaves_nothing(tmp_path: Path) -> None:
    with Journal(tmp_path / "journal", "key") as journal:
        journal.write_note("order", [1])
    assert not (tmp_path / "journal").exists()


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(BundleError, match="file/below: cannot be written"):
        Journal(tmp_path / "file" / "below", "key")


def test_a_full_disk_at_the_beginning_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, data: bytes) -> None:
        raise OutputError(f"{path}: cannot be written (No space left on device)")

    with monkeypatch.context() as patch, pytest.raises(OutputError, match="No space left"):
        patch.setattr(journal, "write_whole", full)
        Journal(tmp_path / "records", "key")
    assert not list(tmp_path.iterdir())
    with Journal(tmp_path / "records", "key") as unlocked:
        unlocked.add(0, RECORD)
