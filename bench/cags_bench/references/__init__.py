"""Gain of references over whole sessions: differences, pictures, the paper's method, and none."""
