"""The viewer in a real browser, measured: a published folder behind a plain web host beside the server's stream."""
