"""Codecs of clips: the registry, Scalable Vector Quantisation, and the linear LoD orders."""
