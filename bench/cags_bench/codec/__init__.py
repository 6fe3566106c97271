"""Rate and distortion of the codec compared with other formats."""
