"""An installation without extras has no torch: all but the research networks works there, and those say why not."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from cags_common.runtime.entry import COMMANDS

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
WITHOUT_TORCH = """
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "torch":
            raise ModuleNotFoundError("No module named 'torch'", name="torch")
sys.meta_path.insert(0, Absent())
"""
IMPORT_ALL = """
import importlib.util, pkgutil
BASE = "kernels common protocol gpu encoder shaper server client bench"
for package in (importlib.import_module(f"cags_{name}") for name in BASE.split()):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        origin = importlib.util.find_spec(module.name).origin
        if origin.endswith(".py") and not module.name.endswith("__main__"):
            try:
                importlib.import_module(module.name)
            except ModuleNotFoundError as error:
                assert error.name in {"wgpu", "distributed"}, (module.name, error)
assert "torch" not in sys.modules
"""


def run(program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", WITHOUT_TORCH + program, *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_only_the_extras_for_research_and_development_bring_torch() -> None:
    extras = PROJECT["optional-dependencies"]
    bringing = {name for name, needs in extras.items() if any(n.startswith(("torch", "cags-stream[")) for n in needs)}
    assert bringing == {"research", "runtimes", "jod", "dev"}
    assert not [need for need in PROJECT["dependencies"] if need.startswith("torch")]


def test_every_module_below_research_can_be_imported() -> None:
    done = run(IMPORT_ALL)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("command", ["cags-server", "cags-client", "cags-demo", "cags-train"])
def test_commands_explain_themselves(command: str) -> None:
    module = COMMANDS[command]
    done = run(f"from {module} import main; sys.exit(main())", "--help")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("command", "arguments"),
    [
        ("cags-client", ["--url", "ws://127.0.0.1:9/stream", "--restore", "srresnet"]),
        ("cags-client", ["--url", "ws://127.0.0.1:9/stream", "--restore", "cr-no-ref@openvino"]),
        ("cags-train", ["restore", "--scene", "procedural:size=300", "--out", "weights"]),
    ],
)
def test_a_network_names_the_extra_that_it_needs(command: str, arguments: list[str], tmp_path: Path) -> None:
    module = COMMANDS[command]
    done = run(f"import os; os.chdir({str(tmp_path)!r}); from {module} import main; sys.exit(main())", *arguments)
    assert done.returncode == 2
    assert "needs the package torch: pip install 'cags-stream[research]'" in done.stderr
    assert done.stderr.count("\n") == 1


def test_what_needs_no_torch_is_found_by_name() -> None:
    done = run("""
from cags_client.frame import align, restore
from cags_common.bundle.codecs import TILE_CODECS
from cags_encoder.codecs.registry import CLIP_CODECS
from cags_server.ratecontrol import RATE_POLICIES
for registry in (align.ALIGNERS, TILE_CODECS, CLIP_CODECS, RATE_POLICIES):
    print(*(registry.find(name).__name__ for name in registry.names()))
restore.check_name("reference")
assert "torch" not in sys.modules
""")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[3] == "UtilityPolicy BufferPolicy EvenPolicy NoTilesPolicy PaperPolicy"
