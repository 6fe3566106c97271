"""The README's commands are the ones that CI runs."""

from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_ci_runs_the_readme_test_command():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    command = next(line for line in readme.splitlines() if line.endswith("pytest -q -n 2"))
    assert command in ci


def test_the_development_install_is_the_documented_one():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "pip install -q -c constraints.txt ./kernels -e '.[dev]'" in readme


def test_pictures_that_the_readme_shows_exist():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for target in (part.split(")")[0] for part in readme.split("](")[1:]):
        if not target.startswith(("http", "#")):
            assert (ROOT / target).exists(), target
