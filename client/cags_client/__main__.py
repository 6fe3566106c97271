"""``python -m cags_client``."""

from cags_common.runtime.entry import client

raise SystemExit(client())
