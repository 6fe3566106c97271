"""A bundle whose files are replaced, or whose store stops answering, while it is read."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from cags_common.bundle import BundleReader
from cags_common.bundle import store as store_module
from cags_common.errors import BundleError, DecodeError
from support.range_store import range_store
from support.small_bundles import small_bundle


def test_a_frame_that_was_damaged_is_read_anew_when_its_file_is_back(tmp_path: Path) -> None:
    url = small_bundle(tmp_path / "clip.cags")
    file = url / "gof_0000.bin"
    reader, intact = BundleReader.open(str(url)), file.read_bytes()
    reader.frame(0)  # its index is known when the file is replaced
    file.write_bytes(bytes(len(intact)))
    for _ in range(2):
        with pytest.raises(DecodeError, match="CRC-32"):
            reader.payload(0, 0, 0)
    file.write_bytes(intact)
    assert reader.payload(0, 0, 0)


def test_a_store_that_stops_answering_fails_one_read_late_and_the_others_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store_module, "ANSWER_S", 0.3)
    monkeypatch.setattr(store_module, "AGAIN_S", 0.05)
    small_bundle(tmp_path / "clip.cags")
    with range_store(tmp_path) as host:
        reader = BundleReader.open(f"{host.url}/clip.cags")
        host.speaks.clear()
        with pytest.raises(BundleError, match="does not answer; it is asked again until it does"):
            reader.frame(0)
        asked = host.requests
        for _ in range(200):  # were each to wait, this would take a minute
            with pytest.raises(BundleError, match="does not answer"):
                reader.frame(0)
        assert host.requests - asked <= 40, "the thread alone asks"
        assert sum(thread.name == "cags-store" for thread in threading.enumerate()) == 1
        host.speaks.set()
        deadline = time.monotonic() + 20
        while time.monotonic() < deadline:
            try:
                assert reader.payload(0, 0, 0)
                break
            except BundleError:
                time.sleep(0.05)
        else:
            pytest.fail("the store is not read again")
