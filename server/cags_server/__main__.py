"""``python -m cags_server``."""

from cags_common.runtime.entry import server

raise SystemExit(server())
