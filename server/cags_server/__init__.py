"""The server: predicts viewpoints, renders references, adapts the rate, streams."""
