"""Where every command begins: an interrupt while its modules are loaded ends it in one line, as later ones do.

A command's module is loaded when the command is called. This one loads nothing that Python does not have by then.
"""

import os
import sys

COMMANDS = {
    "cags-encode": "cags_encoder.cli",
    "cags-server": "cags_server.cli",
    "cags-client": "cags_client.cli",
    "cags-shaper": "cags_shaper.cli",
    "cags-train": "cags_research.training.cli",
    "cags-bench": "cags_bench.cli",
    "cags-demo": "cags_bench.demo.cli",
    "cags-doctor": "cags_bench.doctor.cli",
}
"""The module of each command, with its ``main(argv)``."""


def encode() -> int:
    """``cags-encode``."""
    return _command("cags-encode")


def server() -> int:
    """``cags-server``."""
    return _command("cags-server")


def client() -> int:
    """``cags-client``."""
    return _command("cags-client")


def shaper() -> int:
    """``cags-shaper``."""
    return _command("cags-shaper")


def train() -> int:
    """``cags-train``."""
    return _command("cags-train")


def bench() -> int:
    """``cags-bench``."""
    return _command("cags-bench")


def demo() -> int:
    """``cags-demo``."""
    return _command("cags-demo")


def doctor() -> int:
    """``cags-doctor``."""
    return _command("cags-doctor")


def _command(name: str) -> int:
    try:
        main = __import__(COMMANDS[name], fromlist=["main"]).main
    except KeyboardInterrupt:
        print(f"{name}: interrupted", file=sys.stderr, flush=True)
        os._exit(130)  # Python would end by the signal itself, where it has left code that was made on the way
    code: int = main()
    return code
