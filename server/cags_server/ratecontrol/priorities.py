"""Priorities of queued messages, the smaller the sooner; references go before, in the session's own order."""

from __future__ import annotations

BLOB_PRIORITY = 0
"""Decoders' tables without which nothing can be shown."""

BASE_PRIORITY, URGENT_PRIORITY, ENHANCEMENT_PRIORITY, HIDDEN_PRIORITY = 1, 2, 3, 4
"""Base layers, ends of frames, tables that detail needs; detail that is due, other detail, what is out of view."""

WEIGHTS_PRIORITY = ENHANCEMENT_PRIORITY
"""A restorer's weights: playing goes on without them, so that base layers go first."""
