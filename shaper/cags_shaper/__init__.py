"""Network shaping: traces, a pure link, and a TCP proxy that runs through it."""
