"""Converts user input (names, runs, files, functions) into a policy of an environment. Every command takes the same."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from medjax.commandline import as_path, read_object
from medjax.errors import InputError, shown, told
from medjax.policies.policy import Choice, Policy, sampled
from medjax.policies.pretrained import PRETRAINED, PRETRAINED_SAMPLED, pretrained
from medjax.policies.rules import BASELINES
from medjax.policies.saved import ExportedPolicy, load_policy
from medjax.policies.team import rules_of

FILE = ".zip"  # file extension of a policy
RUN = "run:"  # before the directory of a run
POLICY = "policy.zip"  # trained policy in the directory of a run
OTHERS = f"{RUN}DIR, module:function, or a file that ends in {FILE}"
ALLOWED = (
    f"a rule ({', '.join(BASELINES)}), {PRETRAINED} or {PRETRAINED_SAMPLED} (shipped with medjax), "
    f"{RUN}DIR (what train.ppo trained in DIR), module:function that builds a policy, or a file that ends in {FILE}"
)
"""What `check_policy` accepts, for the help of a command."""


def file_of(text: str) -> Path | None:
    """The file of a trained policy: that of `run:DIR`, or text itself if it ends in .zip; None for other policies.

    Raises:
      InputError: there is no such run or file.
    """
    if text.startswith(RUN):
        run = as_path("run", text.removeprefix(RUN))
        if not run.is_dir():
            raise InputError(f"run {run} is not a directory; allowed one that train.ppo wrote")
        if not (run / POLICY).is_file():
            remedy = f"python -m train.export --run-dir {run} writes it"
            raise InputError(f"run {run} holds no {POLICY}; {remedy}")
        return run / POLICY
    if not text.endswith(FILE):
        return None
    path = as_path("policy", text)
    if not path.is_file():
        raise InputError(f"policy {shown(text)} is not a file; allowed one that train.ppo wrote")
    return path


def check_policy(text: str, known: Iterable[str] = BASELINES) -> None:
    """Raises InputError if text names no policy for `as_policy`; needs no environment. `known` are the rules."""
    known = [*known, PRETRAINED, PRETRAINED_SAMPLED]
    if file_of(text) is not None or text in known:
        return
    if ":" not in text:
        raise _unknown(text, known)
    read_object("policy", text)


def _unknown(text: str, rules: Iterable[str]) -> InputError:
    """The error for an unknown policy name."""
    return InputError(f"unknown policy {shown(text)}: allowed {', '.join([*rules, OTHERS])}")


def as_policy(env: Any, given: Any) -> Policy:
    """Builds a policy for an environment.

    Args:
      env: a single environment.
      given: a `Policy`; an `ExportedPolicy` or the path of its file; the name of a rule; "pretrained" or
        "pretrained_sampled", for the environment's preset; `"run:DIR"`, for what train.ppo trained in DIR;
        `"module:name"` of a function that builds a policy from an environment; or a function
        `act(key, obs, state, params)` that returns an action, () int32, or a `Choice`.

    Raises:
      InputError: given is none of these, or does not fit the environment.
    """
    if isinstance(given, Policy):
        return given
    if isinstance(given, ExportedPolicy):
        return given.policy(env)
    if isinstance(given, str | Path):
        return _named(env, str(given))
    if callable(given):
        return _of_function(given, env.num_actions)
    raise InputError(f"policy is {shown(given)}, allowed: a policy, a rule's name, or a function")


def named_policy(env: Any, text: str) -> tuple[str, Policy]:
    """A policy by what names it, as in `as_policy`, and its own name: that in its file, or else text."""
    file = file_of(text)
    if file is None:
        return text, as_policy(env, text)
    trained = load_policy(file)
    return trained.about.name, trained.policy(env)


def _named(env: Any, text: str) -> Policy:
    """Policy by name: a rule, "pretrained" or "pretrained_sampled", a run, a file, or `module:name`."""
    rules = rules_of(env)
    if text in rules:
        return rules[text]
    if text == PRETRAINED:
        return pretrained(env)
    if text == PRETRAINED_SAMPLED:
        return sampled(pretrained(env))
    if (file := file_of(text)) is not None:
        return load_policy(file).policy(env)
    if ":" in text:
        build = read_object("policy", text)
        try:
            built = build(env)
        except Exception as error:  # user code may raise anything
            refusal = f"policy {shown(text)} failed to build: {told(error)}"
            raise InputError(refusal) from error
        return as_policy(env, built)
    raise _unknown(text, [*rules, PRETRAINED, PRETRAINED_SAMPLED])


def _of_function(act: Callable[..., Any], num_actions: int) -> Policy:
    """Wraps a function that returns actions or choices as a policy without weights."""

    def choose(weights: Any, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
        """Calls `act` and converts an action, () int32 or one per agent, to a `Choice`; InputError for another type."""
        chosen = act(key, obs, state, params)
        if isinstance(chosen, Choice):
            return chosen
        action = jnp.asarray(chosen)
        # A team returns one action per agent.
        if action.ndim > 1 or not jnp.issubdtype(action.dtype, jnp.integer):
            raise InputError(
                f"a policy returned {shown(chosen)}: allowed whole numbers, or a Choice"
            )
        action = action.astype(jnp.int32)
        return Choice(action, jax.nn.one_hot(action, num_actions, dtype=jnp.float32))

    return Policy(choose)
