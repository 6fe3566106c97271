"""Every command begins at :mod:`cags_common.runtime.entry`, and an interrupt from the first moment on is one line."""

import signal
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

from cags_common.runtime import entry

ROOT = Path(__file__).parents[4]


def test_every_script_has_its_entry(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[str] = []
    monkeypatch.setattr(entry, "_command", called.append)
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    for target in scripts.values():
        module, name = target.split(":")
        getattr(import_module(module), name)()
    assert called == list(scripts) == list(entry.COMMANDS)


@pytest.mark.parametrize("module", entry.COMMANDS.values())
def test_every_command_has_a_main(module: str) -> None:
    assert callable(import_module(module).main)


def test_an_interrupt_while_modules_are_loaded_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "cags_client").mkdir()
    (tmp_path / "cags_client" / "__init__.py").write_text("import signal; signal.raise_signal(signal.SIGINT)")
    text = f"""import signal, sys
sys.path.insert(0, {str(tmp_path)!r})
signal.signal(signal.SIGINT, signal.default_int_handler)
from cags_common.runtime.entry import client
sys.exit(client())"""
    ended = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stderr) == (128 + signal.SIGINT, "cags-client: interrupted\n")


def test_the_entry_loads_nothing_else() -> None:
    """What it loads, nothing guards."""
    text = "import sys; had = set(sys.modules); import cags_common.runtime.entry; print(*sorted({*sys.modules} - had))"
    ended = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=60, check=True)
    assert ended.stdout.split() == ["cags_common", "cags_common.runtime", "cags_common.runtime.entry"]
