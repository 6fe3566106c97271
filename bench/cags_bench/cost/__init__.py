"""``cags-bench cost``: what each step of accuracy costs in time and bytes, stage by stage."""
