"""Rate policies to compare with: the paper's four steps, one that looks at waiting alone, one that sends nothing."""
