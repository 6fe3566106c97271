"""Execution of an encoder run: workers, records of finished frames, progress."""
