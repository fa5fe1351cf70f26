"""Dispatchers: rules, a planner, and trained policies from a file."""

from medjax.policies.planner import look_ahead
from medjax.policies.policy import Choice, Policy, every, rule
from medjax.policies.rules import (
    BASELINES,
    Budget,
    budgeted,
    forecast,
    greedy,
    none,
    paced,
    periodic,
    random,
    slow,
)

__all__ = [
    "BASELINES",
    "Budget",
    "Choice",
    "Policy",
    "budgeted",
    "every",
    "forecast",
    "greedy",
    "look_ahead",
    "none",
    "paced",
    "periodic",
    "random",
    "rule",
    "slow",
]
