"""The folder tree is the architecture: small folders, no module that nothing imports, no setting out of reach."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from cags_bench.cli import SUBCOMMANDS as EXPERIMENTS
from support.command_flags import every_flag
from support.imports import PACKAGES, ROOT, circles, entry_points, imports, mentioned, sources, tree

MOST_MODULES = 14
LARGER = {
    "encoder/cags_encoder/formats": "a file a format",
    "bench/cags_bench/cost": "a file a stage that is measured",
    "tests/support": "a builder a file",
}
"""Folders with more modules than the others may have, and why."""
OLD_NAMES = {
    *("own_view", "stand_in", "bending", "past", "carry", "expected", "veil", "parallax", "pair", "local", "merged"),
    *("gof_store", "opening", "joining", "arrivals", "actions", "waiting", "board", "dial", "sight", "lingering"),
    "staleness",
}
"""Names of modules that said less than those which took their place."""
OF_SCENES = "cags_encoder.scenes."
"""Settings here are written in a scene's name (``procedural:size=2000``)."""


def modules(folder: Path) -> list[Path]:
    return [path for path in folder.glob("*.py") if path.stem not in {"__init__", "__main__", "conftest"}]


def test_no_folder_of_code_has_more_modules_than_one_can_look_over() -> None:
    folders = {path.parent for top in (*PACKAGES, ROOT / "tests") for path in top.rglob("*.py")}
    large = {str(folder.relative_to(ROOT)) for folder in folders if len(modules(folder)) > MOST_MODULES}
    assert large == set(LARGER), "one that is small again leaves the list"


def test_every_module_is_imported_by_another() -> None:
    known = {name for name, path in sources().items() if path.stem not in {"__init__", "__main__"}}
    used = entry_points() | {"cags_web.build"} | {f"cags_bench.{name}.command" for name in EXPERIMENTS}
    for name, path in sources().items():
        used |= set(mentioned(path)) - {name}
    assert known - used == set()


def test_no_imports_go_in_a_circle() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}, "e": set()}) == [{"a", "b", "c"}]
    assert circles(imports()) == []


def settings() -> Iterator[tuple[str, str]]:
    """Class and name of every field that is a setting."""
    for name, path in sources().items():
        for node in ast.walk(tree(path)):
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
    assert without == set()


def test_no_module_has_a_name_that_was_given_up() -> None:
    assert {name for name in sources() if name.rpartition(".")[2] in OLD_NAMES} == set()


def test_no_two_classes_of_a_package_have_one_name() -> None:
    """Experiments, each of which is read by itself, excepted."""
    public: dict[tuple[str, str], list[str]] = {}
    for name, path in sources().items():
        for node in tree(path).body:
            alone = name.startswith(("cags_bench.", "cags_research."))
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_") and not alone:
                public.setdefault((name.partition(".")[0], node.name), []).append(name)
    assert {key: homes for key, homes in public.items() if len(homes) > 1} == {}
