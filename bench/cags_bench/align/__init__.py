"""Time of a client's frame with references, and of the server's work for references."""
