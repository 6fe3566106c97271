"""``python -m cags_shaper``."""

from cags_common.runtime.entry import shaper

raise SystemExit(shaper())
