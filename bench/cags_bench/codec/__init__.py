"""Rate and distortion of the codec beside others."""
