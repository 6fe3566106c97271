"""The folder tree is the architecture: small folders, no module that nothing imports, no setting out of reach."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from cags_bench.cli import SUBCOMMANDS as EXPERIMENTS
from support.command_flags import every_flag

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES = [ROOT / folder for folder in PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]]
KERNELS = ROOT / "kernels/src/cags_kernels"
MOST_MODULES = 14
LARGER = {
    "encoder/cags_encoder/formats": "a file a format",
    "bench/cags_bench/cost": "a file a stage that is measured",
    "tests/support": "a builder a file",
}
"""Folders with more modules than the others may have, and why."""
NOT_OF_A_COMMAND = {
    "cags_client.frame.align.base.AlignSettings": "of a call: the paper's parameters, of which --erosion sets one",
    "cags_common.correction.base.CorrectSettings": "of a call: parameters of the seam, which the correctors share",
}
"""Classes of settings that no command has flags for, and why."""
OF_SCENES = "cags_encoder.scenes."
"""Settings here are written in a scene's name (``procedural:size=2000``)."""


def modules(folder: Path) -> list[Path]:
    return [path for path in folder.glob("*.py") if path.stem not in {"__init__", "__main__", "conftest"}]


def sources() -> Iterator[tuple[str, Path]]:
    """Name and file of every module of the project."""
    for package in (*PACKAGES, KERNELS):
        for path in package.rglob("*.py"):
            parts = path.relative_to(package.parent).with_suffix("").parts
            yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


def test_no_folder_of_code_has_more_modules_than_one_can_look_over() -> None:
    folders = {path.parent for top in (*PACKAGES, ROOT / "tests") for path in top.rglob("*.py")}
    large = {str(folder.relative_to(ROOT)) for folder in folders if len(modules(folder)) > MOST_MODULES}
    assert large == set(LARGER), "one that is small again leaves the list"


def mentioned(tree: ast.AST) -> Iterator[str]:
    """Modules that one imports, or names in a text (those that a command loads when it is asked for them)."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def test_every_module_is_imported_by_another() -> None:
    known = {name for name, path in sources() if path.stem not in {"__init__", "__main__"}}
    started = {
        *PROJECT["project"]["scripts"].values(),
        *chain.from_iterable(group.values() for group in PROJECT["project"]["entry-points"].values()),
    }
    used = (
        {entry.partition(":")[0] for entry in started}
        | {"cags_web.build"}
        | {f"cags_bench.{name}.command" for name in EXPERIMENTS}
    )
    for name, path in sources():
        used |= set(mentioned(ast.parse(path.read_text(encoding="utf-8")))) - {name}
    assert known - used == set()


def settings() -> Iterator[tuple[str, str]]:
    """Class and name of every field that is a setting."""
    for name, path in sources():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ClassDef):
                continue
            for field in node.body:
                if isinstance(field, ast.AnnAssign) and isinstance(field.value, ast.Call):
                    made_by = field.value.func
                    if isinstance(made_by, ast.Name) and made_by.id == "setting" and isinstance(field.target, ast.Name):
                        yield f"{name}.{node.name}", field.target.id


def test_every_setting_has_a_flag() -> None:
    flags = every_flag()
    without = {
        f"{where}.{name}"
        for where, name in settings()
        if not where.startswith(OF_SCENES) and f"--{name.replace('_', '-')}" not in flags
    }
    assert {name.rpartition(".")[0] for name in without} == set(NOT_OF_A_COMMAND)
