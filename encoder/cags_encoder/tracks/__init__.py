"""Tracks: which splat of a frame is which of the frame before, and what changed visibly."""
