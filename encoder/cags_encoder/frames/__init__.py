"""From source frames to differential frames: identities, changes relative to the decoder's copy, tiles."""
