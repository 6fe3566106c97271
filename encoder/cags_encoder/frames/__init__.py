"""From source frames to differential frames: identities, what changed against the decoder's copy, tiles."""
