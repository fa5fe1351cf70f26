"""Whole episodes: their random keys, the player, recordings and scores."""
