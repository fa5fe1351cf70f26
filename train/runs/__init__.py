"""One training run: its command line, directory, checkpoints, log, and what it leaves."""
