"""``cags-bench motion``: what moving scenes cost, with motion coded apart and without."""
