"""When MEDs pay, and what a good dispatcher is worth there: a map over numbers of the world and prices."""
