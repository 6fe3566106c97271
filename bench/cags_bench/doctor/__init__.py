"""``cags-doctor``: capabilities of this machine, missing parts, and recommended settings."""
