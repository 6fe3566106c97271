"""What one client sees, holds, and shows wrongly."""
