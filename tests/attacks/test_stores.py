"""A bundle that is replaced, or whose store vanishes, while it is served: the others see nothing of it, who watches it
is told, and it is served again when it is back.
"""

from __future__ import annotations

import asyncio
import shutil
import urllib.request
from collections.abc import Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from support.range_store import range_store
from support.siege import MORE_MEMORY_MB, Keep, Viewer, encode_small, frames_go_on, keep, until, watching

pytestmark = [pytest.mark.faults, pytest.mark.timeout(240)]

CANNOT = "cannot read the scene at present"


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Other content under the same names."""
    return encode_small(tmp_path_factory.mktemp("other"), "procedural:size=900,frames=20,seed=5")


def _files(folder: Path) -> list[Path]:
    return [file for file in folder.rglob("*") if file.is_file()]


def overwritten(served: Path, other: Path) -> None:
    """Each file in place."""
    for file in _files(other):
        (served / file.relative_to(other)).write_bytes(file.read_bytes())


def renamed_over(served: Path, other: Path) -> None:
    """Each file by renaming a new one over it."""
    for file in _files(other):
        target = served / file.relative_to(other)
        new = target.with_name(f"{target.name}.new")
        shutil.copyfile(file, new)
        new.replace(target)


def swapped(served: Path, other: Path) -> None:
    """The folder as a whole."""
    shutil.rmtree(served)
    shutil.copytree(other, served)


def deleted(served: Path, other: Path) -> None:
    """Some of its files."""
    for file in _files(served):
        if file.suffix == ".bin":
            file.unlink()


def away(served: Path, other: Path) -> None:
    """As when a file system is taken away."""
    shutil.rmtree(served)


FAULTS: list[Callable[[Path, Path], None]] = [overwritten, renamed_over, swapped, deleted, away]


@asynccontextmanager
async def coming(url: str) -> Any:
    """One who comes, and comes again whenever it is sent away."""
    viewer = Viewer(url)
    task = asyncio.create_task(viewer.watch())
    try:
        yield viewer
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def _suffer(server: Keep, served: Path, bundle: Path, other: Path, fault: Callable[[Path, Path], None]) -> None:
    async with watching(f"{server.url}?scene=quiet", 2) as viewers:
        before_mb, lines = server.rss_mb, len(server.log_lines)
        fault(served, other)
        async with coming(f"{server.url}?scene=hurt") as hurt:
            await until(lambda: any(CANNOT in words for words in hurt.endings), f"it is not told: {hurt.endings}")
            await frames_go_on(viewers)
            async with coming(f"{server.url}?scene=quiet") as newcomer:
                await until(lambda: len(newcomer.arrivals) > 0, "nobody more can join")
            await asyncio.sleep(3.0)
            told = server.log_lines[lines:]
            assert len(told) <= 40, told
            assert "Traceback" not in server.log.read_text()
            assert any("cannot be" in line for line in told), told
            assert server.rss_mb - before_mb <= MORE_MEMORY_MB
            shutil.rmtree(served, ignore_errors=True)
            shutil.copytree(bundle, served)
            await until(lambda: len(hurt.arrivals) > 10, f"it is not served again: {hurt.endings[-3:]}")
        await frames_go_on(viewers)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_a_bundle_that_is_replaced_or_gone_hurts_no_other_and_is_served_again_when_it_is_back(
    bundle: Path, other: Path, tmp_path: Path, fault: Callable[[Path, Path], None]
) -> None:
    scenes = tmp_path / "scenes"
    for name in ("quiet", "hurt"):
        shutil.copytree(bundle, scenes / f"{name}.cags")
    with keep(scenes, tmp_path) as server:
        asyncio.run(_suffer(server, scenes / "hurt.cags", bundle, other, fault))
        assert server.stop() <= 5.0


def _answers(page: str) -> None:
    with urllib.request.urlopen(page, timeout=4) as answer:
        assert answer.read()


def test_a_store_that_stops_answering_stops_no_server_and_is_read_when_it_is_back(bundle: Path, tmp_path: Path) -> None:
    async def suffer(server: Keep) -> None:
        async with coming(server.url) as hurt:
            await until(lambda: any(CANNOT in words for words in hurt.endings), f"it is not told: {hurt.endings}")
            for path in ("healthz", "status.json"):
                await asyncio.to_thread(_answers, f"http://127.0.0.1:{server.port}/{path}")
            store.speaks.set()
            await until(lambda: len(hurt.arrivals) > 10, f"it is not served again: {hurt.endings[-3:]}")

    with range_store(bundle.parent) as store:
        served: Any = f"{store.url}/{bundle.name}"
        store.hushed = "gof_"
        store.speaks.clear()
        with keep(served, tmp_path) as server:
            asyncio.run(suffer(server))
            words = server.log.read_text()
            assert "does not answer" in words
            assert "Traceback" not in words
            assert len(words.splitlines()) <= 60, words
            assert server.stop() <= 8.0
