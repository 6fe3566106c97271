"""Looking into finished bundles: describe, verify, export, plot."""
