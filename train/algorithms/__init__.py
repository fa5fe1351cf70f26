"""Learning algorithms and their shared parts: networks, rollouts, advantages, normalisation."""
