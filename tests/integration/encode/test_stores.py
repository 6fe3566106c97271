"""Bundles on other stores than a folder: the same files, readable from there; nothing left of a run that failed."""

import os
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from uuid import uuid4

import fsspec
import pytest

from cags_common.bundle import BundlePlayer, BundleReader
from cags_common.errors import BundleError, SceneError
from cags_encoder import EncodeSettings, encode
from cags_encoder.cli import main
from cags_encoder.execution.journal import Journal
from cags_encoder.pipeline import Resume
from support.bundle_bytes import files_of
from support.codec_scenes import cloud
from support.processes import free_port

FAST = EncodeSettings(train_splats=500, lod_order="paper")


def files_at(url: str) -> dict[str, bytes]:
    fs, path = fsspec.core.url_to_fs(url)
    return {name.removeprefix(path).strip("/"): fs.cat_file(name) for name in fs.find(path)}


def check_store(url: str, folder: Path) -> None:
    """A bundle at ``url`` is the one in ``folder``, is replaced by another, and a failed run leaves nothing."""
    frames = [cloud(200), cloud(200).take(slice(20, 200))]
    encode(frames, FAST, str(folder))
    encode(frames, FAST, url)
    assert files_at(url) == files_of(folder)
    with BundleReader.open(url) as reader:
        assert len(BundlePlayer(reader).frame(1).ids) == 180
    assert main(["--verify", url]) == 0
    encode(frames[:1], replace(FAST, seed=1), url)
    with BundleReader.open(url) as reader:
        assert reader.manifest.frames == 1
    before = files_at(url)
    with pytest.raises(SceneError, match="SH degree"):
        encode([cloud(20), cloud(20, 0, 1)], FAST, url)
    assert files_at(url) == before, "nothing was written yet"

    def stop(stage: str, done: int, total: int) -> None:
        if stage == "encode":
            raise SceneError("no more")

    with pytest.raises(SceneError, match="no more"):
        encode(frames, FAST, url, stop)
    assert files_at(url) == {}


def test_memory(tmp_path: Path) -> None:
    check_store(f"memory://{uuid4().hex}/clip", tmp_path / "clip")


def test_a_second_run_touches_nothing_of_the_first(tmp_path: Path) -> None:
    url, resume = f"memory://{uuid4().hex}/clip", Resume(tmp_path / "records", "key")
    encode([cloud(100)], FAST, url)
    before = files_at(url)
    with Journal(resume.folder, resume.key), pytest.raises(BundleError, match="another process"):
        encode([cloud(100, 1)], FAST, url, resume=resume)
    assert files_at(url) == before


def test_a_scheme_that_nobody_knows_is_named() -> None:
    with pytest.raises(BundleError, match="nowhere://a/b: cannot be opened"):
        encode([cloud(20)], FAST, "nowhere://a/b")


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """URL of an empty bucket in an S3 store of its own, a process."""
    for package in ("moto", "s3fs", "flask"):
        pytest.importorskip(package, reason="an S3 store for the test: pip install 'moto[server]' s3fs")
    endpoint = f"http://127.0.0.1:{free_port()}"
    for name, value in {
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": endpoint,
    }.items():
        monkeypatch.setenv(name, value)
    command = [sys.executable, "-m", "moto.server", "-p", endpoint.rpartition(":")[2]]
    quiet = subprocess.DEVNULL
    running = subprocess.Popen(command, stdout=quiet, stderr=quiet, env=os.environ)
    try:
        deadline = time.monotonic() + 60
        while not answers(f"{endpoint}/moto-api/"):
            assert running.poll() is None and time.monotonic() < deadline
            time.sleep(0.1)
        put = urllib.request.Request(f"{endpoint}/clips", method="PUT")
        urllib.request.urlopen(put, timeout=10).close()
        yield "s3://clips"
    finally:
        running.terminate()
        running.wait()


def answers(url: str) -> bool:
    try:
        urllib.request.urlopen(url, timeout=2).close()
    except urllib.error.HTTPError:
        return True
    except OSError:
        return False
    return True


@pytest.mark.slow
def test_s3(bucket: str, tmp_path: Path) -> None:
    check_store(f"{bucket}/clip", tmp_path / "clip")
