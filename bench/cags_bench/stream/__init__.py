"""``cags-bench stream``: plays one scene over one trace in virtual time."""
