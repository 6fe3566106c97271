"""Motion of splats, the encoder's side: trails over frames, fades, and chunks of all that."""
