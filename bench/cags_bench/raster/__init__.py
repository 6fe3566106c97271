"""``cags-bench raster``: speed and exactness of the rasteriser."""
