"""``cags-bench reproduce``: the paper's tables and figures on this project's scenes and traces."""
