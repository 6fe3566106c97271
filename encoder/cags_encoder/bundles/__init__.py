"""Tools for finished bundles: describe, verify, export, plot, publish."""
