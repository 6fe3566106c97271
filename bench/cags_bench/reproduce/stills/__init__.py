"""First frames coded in every way: ours, flat quantisers, other formats, and published rows."""
