"""Trained policies that come with medjax, one per preset; docs/pretrained.md has their results."""

from pathlib import Path
from typing import Any

from medjax.errors import InputError, shown
from medjax.policies.policy import Policy
from medjax.policies.saved import ExportedPolicy, load_policy

PRETRAINED = "pretrained"  # as a policy name
PRETRAINED_SAMPLED = "pretrained_sampled"  # the same, each action drawn
FILES = Path(__file__).parent / "trained"


def load_pretrained(scenario: str = "paper") -> ExportedPolicy:
    """Loads the policy that was trained for a preset.

    Args:
      scenario: name of the preset.

    Raises:
      InputError: medjax has no policy for it.
    """
    there = {path.stem: path for path in sorted(FILES.glob("*.zip"))}
    if not isinstance(scenario, str) or scenario not in there:
        raise InputError(
            f"no policy was trained for {shown(scenario)}: allowed {', '.join(there)}, or your own file"
        )
    return load_policy(there[scenario])


def pretrained(env: Any) -> Policy:
    """The policy that was trained for an environment's preset.

    Raises:
      InputError: there is none, or it does not fit the environment's changes to the preset.
    """
    return load_pretrained(env.name).policy(env)
