"""What references bring: differences, pictures, the paper's way, and none, over whole sessions."""
