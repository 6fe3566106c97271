"""Tiles: what their payloads hold, and how they become splats again."""
