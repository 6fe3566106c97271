"""Commands start, explain themselves, and fail in one line."""

import subprocess
import sys
from importlib.metadata import distribution

import pytest

from cags_common.runtime.entry import COMMANDS as MODULES

COMMANDS = sorted(e.name for e in distribution("cags-stream").entry_points if e.group == "console_scripts")


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


HELP_MODULES, START_MODULES = 320, 850
"""Modules at most: as many as load in 0.5 s and 1.5 s of processor time on an AMD EPYC (0.24 s and 1.1 s measured)."""

STARTS = {
    "cags-encode": ["/none", "out.cags"],
    "cags-server": ["--bundle", "/none"],
    "cags-client": ["--url", "ws://127.0.0.1:9/stream"],
    "cags-shaper": ["--listen", "127.0.0.1:0", "--to", "127.0.0.1:9", "--trace", "/none"],
    "cags-bench": ["stream", "--scene", "/none"],
    "cags-demo": ["/none", "--cache", "cache"],
    "cags-train": ["fov", "--poses", "/none", "--out", "weights.npz"],
    "cags-doctor": ["--threads", "-1"],
}
"""Work that ends at the first look at what it was given: everything that a start needs has been loaded by then."""


@pytest.mark.parametrize("command", COMMANDS)
def test_starting_loads_little_and_no_framework(command, tmp_path):
    counted = {}
    for kind, arguments in (("help", ["--help"]), ("start", STARTS[command])):
        code = (
            f"import sys; from {MODULES[command]} import main\ntry:\n    main({arguments!r})\n"
            "except SystemExit:\n    pass\n"
            "print('LOADED', len(sys.modules), bool({'torch', 'matplotlib', 'faiss'} & set(sys.modules)))"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
        )
        _, count, heavy = done.stdout.strip().splitlines()[-1].split()
        assert heavy == "False", f"{command} {kind}: a framework was loaded before there was work for it"
        counted[kind] = int(count)
    assert counted["help"] <= HELP_MODULES
    assert counted["start"] <= START_MODULES


@pytest.mark.parametrize("command", COMMANDS)
def test_an_unknown_flag_is_wrong_use(command):
    needed = {"cags-client": ["--url", "ws://127.0.0.1:1/stream"], "cags-encode": ["scene", "out"]}
    first = {"cags-bench": ["stream"], "cags-train": ["fov", "--poses", "walks", "--out", "w.npz"]}
    done = run(command, *first.get(command, []), *needed.get(command, []), "--no-such-flag")
    assert done.returncode == 2
    assert "no-such-flag" in done.stderr
    assert "Traceback" not in done.stderr
