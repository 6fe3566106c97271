"""``cags-train``: fits what the other commands ship. One module a subcommand, loaded when it is chosen."""

from __future__ import annotations

import argparse
from argparse import RawDescriptionHelpFormatter
from collections.abc import Sequence
from importlib import import_module

from cags_common.cli import command_parser, run_command
from cags_common.errors import ConfigError

EXAMPLES = """\
  cags-train predictor --poses poses/ --held-out 09,10,11,12 --out autoregressive.npz
  cags-train fov --poses poses/ --held-out 09,10,11,12 --out lstm.npz --seed 1
  cags-train restore --scene a.ply --held-out c.sog --steps 12000 --out srresnet/
  cags-train score --scene c.sog srresnet/srresnet.npz srresnet reference
"""

SUBCOMMANDS = {
    "predictor": ("cags_research.training.predictor", "fit the autoregressive viewport predictor"),
    "fov": ("cags_research.training.fov_command", "train the LSTM that chooses the reference's field of view"),
    "restore": ("cags_research.training.restore.command", "train the networks that restore colours"),
    "score": ("cags_research.training.restore.score", "score restorers on whole pictures of held-out scenes"),
}
"""Name -> module with ``add_arguments(parser)``, ``run(arguments) -> exit code`` and ``EXAMPLES``; and its help."""


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    return run_command("cags-train", _train, argv)


def _train(argv: Sequence[str]) -> int:
    parser = command_parser("cags-train", "Fit the learnt parts of the program.", EXAMPLES)
    chosen = next((word for word in argv if word in SUBCOMMANDS), None)
    subparsers = parser.add_subparsers(dest="part", required=True, metavar="PART")
    for name, (module, summary) in SUBCOMMANDS.items():
        subparser = subparsers.add_parser(name, help=summary, description=summary, allow_abbrev=False)
        if name == chosen:  # the flags of the others are not needed, nor is what they import
            part = import_module(module)
            subparser.formatter_class = RawDescriptionHelpFormatter
            subparser.epilog = "examples:\n" + part.EXAMPLES
            part.add_arguments(subparser)
    arguments: argparse.Namespace = parser.parse_args(argv)
    try:
        code: int = import_module(SUBCOMMANDS[arguments.part][0]).run(arguments)
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise ConfigError(
            f"training {arguments.part!r} needs the package torch: pip install 'cags-stream[research]'"
        ) from error
    return code
