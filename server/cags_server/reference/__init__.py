"""References: what a client lacks of a frame, or a picture of it, made ahead for a predicted pose."""
