"""Learning a dispatcher: PPO compiled together with the simulator, and its evaluation."""
