"""What the page sends of several files is an archive whose frames the server takes in order."""

from __future__ import annotations

import zipfile
from pathlib import Path

from cags_server.http.gallery.archives import unpacked
from support.node import run_tests


def test_the_pages_archive_is_read(tmp_path: Path) -> None:
    run_tests("zip", tmp_path)
    with zipfile.ZipFile(tmp_path / "page.zip") as held:
        assert held.testzip() is None
        assert held.namelist() == ["träume 2.ply", "träume 10.ply", "träume 1.ply"]
    folder = unpacked(tmp_path / "page.zip", tmp_path / "out", 20_000)
    assert [path.read_bytes() for path in sorted(folder.iterdir())] == [bytes([n]) * n * 1000 for n in (1, 2, 10)]
