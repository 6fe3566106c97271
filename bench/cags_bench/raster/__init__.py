"""``cags-bench raster``: speed and accuracy of the rasteriser."""
