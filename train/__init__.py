"""Learning a dispatcher in one compiled program with the simulator, and its evaluation."""
