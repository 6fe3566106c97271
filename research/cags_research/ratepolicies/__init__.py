"""Rate policies to compare with: the paper's four steps, one level a frame, waiting alone, and nothing at all."""
