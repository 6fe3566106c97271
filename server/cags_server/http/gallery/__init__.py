"""What a server with several scenes adds: their list, thumbnails, and scenes that visitors bring."""
