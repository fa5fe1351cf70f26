"""Trains a dispatcher in one compiled program with the simulator, and evaluates it."""

import medjax  # noqa: F401 - from here on a command handles signals: `medjax.early`
