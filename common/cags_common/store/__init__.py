"""What of a scene has come, and what of it is shown: the client's store, of which the server keeps a mirror."""
