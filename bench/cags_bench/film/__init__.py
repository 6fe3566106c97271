"""Films of what a viewer saw: kept, measured, written for people."""
