"""Compares policies on the same episodes: scores, intervals, tables."""
