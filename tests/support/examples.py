"""How many examples a property is tried with: few in the usual run, ``CAGS_EXAMPLES`` times as many at night."""

from __future__ import annotations

import os


def examples(usual: int) -> int:
    """``usual``, or so many times as many as the environment's ``CAGS_EXAMPLES`` says."""
    return usual * int(os.environ.get("CAGS_EXAMPLES", "1"))
