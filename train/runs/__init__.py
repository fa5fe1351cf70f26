"""A run from its beginning to its end: directory, checkpoints, logs, processes."""
