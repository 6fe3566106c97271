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
TESTED_ELSEWHERE = {
    "cags_server/http/gallery": "tests/integration/server/test_gallery.py",
    "cags_research/align": "tests/unit/client/frame/test_align.py",
    "cags_research/codecs/encoding": "tests/unit/research/codecs/test_codecs.py",
    "cags_research/restore/networks/runtimes": "tests/unit/research/restore/networks",
    "cags_research/training/pairs": "tests/unit/research/training",
    "cags_bench/predict": "tests/unit/bench/test_cli.py",
    "cags_bench/reproduce/experiments": "tests/unit/bench/reproduce/test_reproduce.py",
}
"""Folders without a mirror of their own, and where their tests are."""
OLD_NAMES = {
    *("own_view", "stand_in", "bending", "past", "carry", "expected", "veil", "parallax", "pair", "local", "merged"),
    *("gof_store", "opening", "joining", "arrivals", "actions", "waiting", "board", "dial", "sight", "lingering"),
    "staleness",
}
"""Names of modules that said less than those which took their place."""
KINDS = ("unit", "property", "stability", "integration")
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
    assert without == set()


def mirrors(folder: Path) -> bool:
    """Whether tests lie as ``folder`` (``cags_client/net``) does: in a folder of its name, or in ``test_net*.py``."""
    short = Path(folder.parts[0].removeprefix("cags_"), *folder.parts[1:])
    homes = [ROOT / "tests" / kind / short for kind in KINDS]
    beside = [] if len(folder.parts) == 1 else [test for h in homes for test in h.parent.glob(f"test_{h.name}*.py")]
    return bool(beside) or any(home.is_dir() and any(home.rglob("test_*.py")) for home in homes)


def test_tests_mirror_the_source() -> None:
    folders = {path.parent for _, path in sources() if path.stem not in {"__init__", "__main__"}}
    parents = [package.parent for package in (*PACKAGES, KERNELS)]
    named = {folder.relative_to(parent) for folder in folders for parent in parents if folder.is_relative_to(parent)}
    without = {str(folder) for folder in named if not mirrors(folder)}
    assert without - {"cags_web"} == set(TESTED_ELSEWHERE), "one that has a mirror leaves the list"
    assert [home for home in TESTED_ELSEWHERE.values() if not (ROOT / home).exists()] == []


def test_no_folder_of_unit_tests_is_of_nothing() -> None:
    packages = {package.name.removeprefix("cags_"): package for package in (*PACKAGES, KERNELS)}
    unit = ROOT / "tests/unit"
    folders = {path.parent.relative_to(unit) for path in unit.rglob("test_*.py")}
    assert {str(f) for f in folders if not packages[f.parts[0]].joinpath(*f.parts[1:]).is_dir()} == set()


def test_no_module_has_a_name_that_was_given_up() -> None:
    assert {name for name, _ in sources() if name.rpartition(".")[2] in OLD_NAMES} == set()


def test_no_two_classes_of_a_package_have_one_name() -> None:
    """Experiments, each of which is read by itself, excepted."""
    public: dict[tuple[str, str], list[str]] = {}
    for name, path in sources():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            alone = name.startswith(("cags_bench.", "cags_research."))
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_") and not alone:
                public.setdefault((name.partition(".")[0], node.name), []).append(name)
    assert {key: homes for key, homes in public.items() if len(homes) > 1} == {}
