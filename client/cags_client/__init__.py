"""The client: decodes, rasterises, aligns, restores and presents (``docs/`` and ``client/README.md``)."""
