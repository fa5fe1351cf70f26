"""What the world is made of: its numbers (`params`), their ranges, and the state that a step carries."""
