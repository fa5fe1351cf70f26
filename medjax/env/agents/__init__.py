"""Every MED an agent: what it may do, what it sees, and the environment of all of them."""
