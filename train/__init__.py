"""Trains a dispatcher in one compiled program with the simulator, and evaluates it."""

import medjax  # noqa: F401 - for commands, sets XLA's log level before JAX is imported
