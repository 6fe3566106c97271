"""Motion of splats, the encoder's side: trails over frames, rigid blocks, fades, and chunks of all that."""
