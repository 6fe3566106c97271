"""``cags-bench motion``: the cost of moving scenes with motion coded separately and without."""
