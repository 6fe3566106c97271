"""Training of Scalable Vector Quantisation codebooks and assignment of codes (paper, section of that name)."""
