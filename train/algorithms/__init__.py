"""What learns: algorithms, and what they share (networks, rollouts, advantages, normalisation)."""
