"""``cags-demo``: three real processes, one report."""
