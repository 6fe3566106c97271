"""Write the traces of this folder: ``python traces/generate.py [FOLDER]``. Two runs write the same bytes."""

from __future__ import annotations

import sys
from pathlib import Path

from cags_shaper.generate import MODELS, STEADY_MBPS, generate
from cags_shaper.trace import open_trace

MAHIMAHI = (*(f"steady-{rate}:duration_s=0.2" for rate in STEADY_MBPS), "lte-driving:duration_s=10")
"""Traces that are also shipped as mahimahi files: short ones, since such a file has a line for every 1,504 bytes."""


def write_all(folder: Path) -> None:
    """Write every trace below ``folder``."""
    (folder / "mahimahi").mkdir(parents=True, exist_ok=True)
    for spec in (*MODELS, *(f"steady-{rate}" for rate in STEADY_MBPS)):
        (folder / f"{spec}.csv").write_text(generate(spec).to_csv(), encoding="ascii")
    for spec in MAHIMAHI:
        name = spec.split(":", maxsplit=1)[0]
        (folder / "mahimahi" / f"{name}.mahi").write_text(
            open_trace(f"generated:{spec}").to_mahimahi(), encoding="ascii"
        )


if __name__ == "__main__":
    write_all(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
