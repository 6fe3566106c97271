"""Virtual-time simulation, experiments, reports and the demo."""
