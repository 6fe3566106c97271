"""``cags-bench restore``: every restorer on the same views, over LoDs and pose errors: time and quality."""
