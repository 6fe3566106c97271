"""Sessions that share a bottleneck with other traffic, in virtual time, each over a model of TCP."""
