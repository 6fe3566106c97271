"""``cags-bench stream``: one scene over one trace, in virtual time."""
