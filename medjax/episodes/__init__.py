"""Whole episodes: their random keys, the runner, recordings and scores."""
