"""The scene as all clients share it: source frames, tiles and their owners."""
