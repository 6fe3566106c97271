"""The two sans-IO sessions: states, blobs, trace."""
