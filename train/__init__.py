"""Learning a dispatcher in one compiled program with the simulator, and its evaluation."""

import medjax  # noqa: F401 - from here on a command hears signals: `medjax.early`
