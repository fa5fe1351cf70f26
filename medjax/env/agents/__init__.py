"""Multi-agent environment: every MED is an agent. Action spaces, observations and the environment itself."""
