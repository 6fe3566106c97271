"""How a run is carried out: where frames are worked on, what is finished, what is told."""
