"""Training runs from start to end: directory, checkpoints, logs, processes."""
