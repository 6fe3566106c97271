"""Training Scalable Vector Quantisation codebooks and assigning codes (paper, section of that name)."""
