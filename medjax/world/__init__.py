"""The simulated world: its parameters, their allowed ranges, and the state that a step carries."""
