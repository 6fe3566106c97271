"""Commands start, explain themselves, and fail in one line."""

import subprocess
import sys
from importlib.metadata import distribution

import pytest

COMMANDS = sorted(e.name for e in distribution("cags-stream").entry_points if e.group == "console_scripts")
MODULES = {e.name: e.value.partition(":")[0] for e in distribution("cags-stream").entry_points}


def run(command: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    code = f"import sys; from {MODULES[command]} import main; sys.exit(main())"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=60, check=False
    )


def test_every_command_is_there():
    assert {"cags-encode", "cags-server", "cags-client", "cags-shaper", "cags-bench", "cags-demo"} <= set(COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_examples(command):
    done = run(command, "--help")
    assert done.returncode == 0, done.stderr
    assert "examples:" in done.stdout
    assert command in done.stdout


@pytest.mark.parametrize("command", COMMANDS)
def test_help_loads_nothing_heavy(command):
    code = (
        f"import sys; from {MODULES[command]} import main\ntry:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "print('HEAVY', sorted({'torch', 'av', 'cv2', 'faiss', 'matplotlib', 'scipy', 'numba'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.strip().endswith("HEAVY []"), done.stdout[-200:]


@pytest.mark.parametrize("command", COMMANDS)
def test_an_unknown_flag_is_wrong_use(command):
    needed = {"cags-client": ["--url", "ws://127.0.0.1:1/stream"], "cags-encode": ["scene", "out"]}
    first = {"cags-bench": ["stream"], "cags-train": ["fov", "--poses", "walks", "--out", "w.npz"]}
    done = run(command, *first.get(command, []), *needed.get(command, []), "--no-such-flag")
    assert done.returncode == 2
    assert "no-such-flag" in done.stderr
    assert "Traceback" not in done.stderr
