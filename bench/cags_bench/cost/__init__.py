"""``cags-bench cost``: time and bytes for each step of accuracy, stage by stage."""
