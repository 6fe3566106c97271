"""``cags-demo``: runs server, shaper and client, and writes a report."""
