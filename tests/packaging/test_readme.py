"""The README's commands are the ones that CI runs."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cags_encoder.formats import write_splats
from support.capture import three_balls

ROOT = Path(__file__).parents[2]


def test_ci_runs_the_readme_test_command():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    command = next(line for line in readme.splitlines() if line.endswith("pytest -q -n 2"))
    assert command in ci


def tour() -> list[str]:
    """The lines of the tour with one's own scene."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    block = readme.split("## Five minutes with your own scene")[1].split("```sh\n")[1].split("```")[0]
    return block.strip().splitlines()


def test_ci_runs_and_times_the_first_command():
    first = next(
        line for line in (ROOT / "README.md").read_text(encoding="utf-8").splitlines() if "pip install" in line
    )
    assert first.endswith("cags-demo")
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert f"\n{first}\ntook " in ci


@pytest.mark.slow
def test_the_tour_works_with_frames_of_one_s_own(tmp_path):
    """Each line as it stands, in a folder with numbered frames and an environment; servers run beside."""
    (tmp_path / "frames").mkdir()
    still = three_balls(600, 1000)
    for index in range(20):
        moved = replace(still, means=still.means + np.float32([0.01 * index, 0, 0]))
        write_splats(tmp_path / "frames" / f"{index:04d}.ply", moved)
    (tmp_path / ".venv").symlink_to(sys.prefix)
    beside = []
    try:
        for line in tour():
            command = line.split()
            assert (tmp_path / command[0]).exists(), line
            if command[0].endswith(("cags-server", "cags-shaper")):
                beside.append(subprocess.Popen([*command, "--json"], cwd=tmp_path, stdout=subprocess.PIPE, text=True))
                assert json.loads(beside[-1].stdout.readline())["ready"]
                continue
            done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=240, check=False)
            assert done.returncode == 0, f"{line}\n{done.stderr}"
    finally:
        for process in reversed(beside):
            process.terminate()
            process.communicate(timeout=20)
    summary = json.loads((tmp_path / "clip.jsonl").read_text(encoding="utf-8").splitlines()[-1])
    assert summary["frames"] > 0
    assert summary["psnr_restored_db"] > 20
    assert (tmp_path / "clip.mp4").stat().st_size > 1000


def test_the_development_install_is_the_documented_one():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "pip install -q -c constraints.txt ./kernels -e '.[dev]'" in readme


def test_pictures_that_the_readme_shows_exist():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for target in (part.split(")")[0] for part in readme.split("](")[1:]):
        if not target.startswith(("http", "#")):
            assert (ROOT / target).exists(), target
