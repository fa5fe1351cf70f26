"""Dispatchers: rules, a planner, and trained policies from a file."""

from medjax.policies.rules import BASELINES

__all__ = ["BASELINES"]
