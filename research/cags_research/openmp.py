"""How OpenMP's threads wait: torch's stay busy after each of its loops, on cores that others need.

GNU's runtime lets them spin 300,000 times, measured as 4 to 9 ms of a core after every network that ran, and twice the
processor time within it where cores are shared. Two thousand are longer than the gaps between a network's layers.
"""

from __future__ import annotations

import os

SPINS = "2000"
"""Some 50 microseconds."""


def yield_cores() -> None:
    """Before torch is first imported: its threads go to sleep soon after their work. What the user has set stays."""
    if not os.environ.keys() & {"GOMP_SPINCOUNT", "OMP_WAIT_POLICY"}:
        os.environ["GOMP_SPINCOUNT"] = SPINS
