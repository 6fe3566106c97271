"""The shell: HTTP and WebSocket on one port, admission, operator's pages, one task a client."""
