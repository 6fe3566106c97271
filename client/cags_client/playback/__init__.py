"""Playback in time: the player, its jobs, and when what is displayed."""
