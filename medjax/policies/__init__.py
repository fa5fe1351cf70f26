"""Dispatchers: rules, a planner, and trained policies from a file."""

from medjax.policies.policy import Choice, Policy
from medjax.policies.rules import BASELINES, forecast, greedy, none, paced, periodic, random

__all__ = [
    "BASELINES",
    "Choice",
    "Policy",
    "forecast",
    "greedy",
    "none",
    "paced",
    "periodic",
    "random",
]
