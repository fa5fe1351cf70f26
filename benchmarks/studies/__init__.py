"""Studies of how parameters of the world, rules and learners affect results."""
