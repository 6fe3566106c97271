"""Which modules of the project a file imports, names in a text, or reaches through what it imports."""

from __future__ import annotations

import ast
import tomllib
from functools import cache
from itertools import chain
from pathlib import Path

from cags_common.runtime.entry import COMMANDS

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES = [ROOT / folder for folder in PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]]
KERNELS = ROOT / "kernels/src/cags_kernels"


@cache
def sources() -> dict[str, Path]:
    """File of every module of the project, packages included."""
    found = {}
    for package in (*PACKAGES, KERNELS):
        for path in sorted(package.rglob("*.py")):
            parts = path.relative_to(package.parent).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def mentioned(path: Path) -> frozenset[str]:
    """Modules that a file imports, or names in a text (those that a command loads when it is asked for them)."""
    found = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.add(node.value.partition(":")[0])
    return frozenset(found)


def home(module: str, name: str) -> str:
    """The module that defines ``name``, which ``module`` may only hand on."""
    if f"{module}.{name}" in sources():
        return f"{module}.{name}"
    if module in sources() and sources()[module].stem == "__init__":
        for node in ast.walk(tree(sources()[module])):
            if isinstance(node, ast.ImportFrom) and node.module and any(a.name == name for a in node.names):
                return home(node.module, name)
    return module


@cache
def used(path: Path) -> frozenset[str]:
    """Modules that define what a file imports, and those that it names in a text."""
    found = set(mentioned(path))
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {home(node.module, alias.name) for alias in node.names}
    return frozenset(found & sources().keys())


@cache
def entry_points() -> frozenset[str]:
    """Modules that are started as commands or found by name."""
    groups = (PROJECT["project"]["scripts"], *PROJECT["project"]["entry-points"].values())
    named = (entry.partition(":")[0] for entry in chain.from_iterable(group.values() for group in groups))
    return frozenset({*named, *COMMANDS.values()})


def reached(path: Path) -> set[str]:
    """Modules that a file imports, directly, through others or builders. Registries lead to all entry points."""
    from cags_bench.cli import SUBCOMMANDS

    found: set[str] = set()
    builders = [
        ROOT / "tests" / f"{name.replace('.', '/')}.py" for name in mentioned(path) if name.startswith("support.")
    ]
    files = [path, *(builder for builder in builders if builder.exists())]
    ahead = set().union(*(mentioned(file) for file in files)) & sources().keys()
    while ahead:
        name = ahead.pop()
        found.add(name)
        more = mentioned(sources()[name]) & sources().keys()
        if name == "cags_bench.cli":
            more |= {f"cags_bench.{part}.command" for part in SUBCOMMANDS}
        if name == "cags_common.registry":
            more |= entry_points()
        ahead |= more - found
    return found


def circles(graph: dict[str, set[str]]) -> list[set[str]]:
    """Sets of modules that import each other, directly or through others."""

    def beyond(start: str) -> set[str]:
        found: set[str] = set()
        ahead = set(graph[start])
        while ahead:
            found |= ahead
            ahead = set().union(*(graph.get(name, set()) for name in ahead)) - found
        return found

    reach = {name: beyond(name) for name in graph}
    round_trips = [frozenset(other for other in reach[name] if name in reach.get(other, ())) for name in graph]
    return [set(circle) for circle in {each for each in round_trips if each}]


def imports() -> dict[str, set[str]]:
    """Module to the modules that its import statements name, late ones and those for types alone included."""
    graph = {}
    for module, path in sources().items():
        named = set()
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.ImportFrom) and node.module:
                inner = {f"{node.module}.{alias.name}" for alias in node.names}
                named |= inner if inner <= sources().keys() else {node.module, *inner}
            elif isinstance(node, ast.Import):
                named |= {alias.name for alias in node.names}
        graph[module] = named & sources().keys() - {module}
    return graph
