"""Whole episodes: whose randomness they take, who plays them, and what is kept of them."""
