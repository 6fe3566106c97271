"""Fields of view that the program is compared with."""
