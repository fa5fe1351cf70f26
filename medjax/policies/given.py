"""Whatever somebody has to act with, as a policy of an environment."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from medjax.commandline import as_path, read_object
from medjax.errors import InputError, shown, told
from medjax.policies.policy import Choice, Policy
from medjax.policies.pretrained import PRETRAINED, pretrained
from medjax.policies.rules import BASELINES
from medjax.policies.saved import ExportedPolicy, load_policy
from medjax.policies.team import rules_of

FILE = ".zip"  # ends the name of a policy's file


def check_policy(text: str, known: Iterable[str] = BASELINES) -> None:
    """Refuses (InputError) a name of `as_policy` that nothing has, before there is an environment; rules are known."""
    known = [*known, PRETRAINED]
    if text.endswith(FILE):
        path = as_path("policy", text)
        if not path.is_file():
            raise InputError(f"policy {shown(text)}: is no file; allowed one that train.ppo wrote")
    elif ":" in text:
        read_object("policy", text)
    elif text not in known:
        raise _unknown(text, known)


def _unknown(text: str, rules: Iterable[str]) -> InputError:
    """Of a policy that there is not."""
    others = f"module:function, or a file that ends in {FILE}"
    return InputError(f"unknown policy {shown(text)}: allowed {', '.join([*rules, others])}")


def as_policy(env: Any, given: Any) -> Policy:
    """A policy of an environment.

    Args:
      env: a single environment.
      given: a `Policy`; one that was read from a file (`load_policy`), or the file's path; the name of a rule;
        "pretrained", which is `load_pretrained` of the environment's preset; `"module:name"` of what builds a policy
        of an environment, as those of `medjax.BASELINES` do; or a function `act(key, obs, state, params)` that gives
        an action, () int32, or a `Choice`.

    Raises:
      InputError: it is none of them, or does not fit the environment.
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


def _named(env: Any, text: str) -> Policy:
    """A rule, what builds one, or a file."""
    rules = rules_of(env)
    if text in rules:
        return rules[text]
    if text == PRETRAINED:
        return pretrained(env)
    if text.endswith(FILE):
        return load_policy(text).policy(env)
    if ":" in text:
        build = read_object("policy", text)
        try:
            built = build(env)
        except Exception as error:  # whatever somebody's function raises
            refusal = f"policy {shown(text)} of the environment: {told(error)}"
            raise InputError(refusal) from error
        return as_policy(env, built)
    raise _unknown(text, [*rules, PRETRAINED])


def _of_function(act: Callable[..., Any], num_actions: int) -> Policy:
    """A function that gives actions, as a policy; it has no weights."""

    def choose(weights: Any, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
        """Its choice, or its action as one."""
        chosen = act(key, obs, state, params)
        if isinstance(chosen, Choice):
            return chosen
        action = jnp.asarray(chosen)
        # Of a team, an action each.
        if action.ndim > 1 or not jnp.issubdtype(action.dtype, jnp.integer):
            raise InputError(
                f"a policy acts by {shown(chosen)}: allowed whole numbers, or a Choice"
            )
        action = action.astype(jnp.int32)
        return Choice(action, jax.nn.one_hot(action, num_actions, dtype=jnp.float32))

    return Policy(choose)
