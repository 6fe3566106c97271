"""``cags-doctor``: what this machine can do, what is missing, and which settings suit it."""
