"""Reference images on the wire: H.264 and the colour conversion around it."""
