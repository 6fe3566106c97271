"""Time of the client's frame with what references say, and of the server's references."""
