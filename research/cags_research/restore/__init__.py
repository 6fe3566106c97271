"""Restorers of aligned pictures: the paper's networks and their variants, and the aligned reference alone."""
