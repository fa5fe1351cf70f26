"""`python -m benchmarks.ablation STUDY`: what a number of the world, or a weight of the reward, does."""
