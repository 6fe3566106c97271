"""What the client keeps beside its splats: decoded references."""
