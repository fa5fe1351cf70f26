"""What a number of the world, a rule or a learner comes to."""
