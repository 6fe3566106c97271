"""How well is the viewer predicted, and how wide must the reference be? ``cags-bench predict``."""
