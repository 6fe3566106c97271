"""Between message and link: the send queue, credit, round trips, reassembly."""
