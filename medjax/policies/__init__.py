"""Dispatchers: rules, and trained policies read from files."""

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
    "none",
    "paced",
    "periodic",
    "random",
    "rule",
    "slow",
]
