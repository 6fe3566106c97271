"""One frame: rasterise, add what the reference says is lacking, hand on."""
