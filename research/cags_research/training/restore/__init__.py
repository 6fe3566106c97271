"""Training of restoration networks: ``cags-train restore``."""
