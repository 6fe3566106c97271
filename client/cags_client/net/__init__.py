"""Connections: addresses of servers, writing that never waits, and when to try again."""
