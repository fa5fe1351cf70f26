"""`python -m benchmarks.agents`: what agents gain that choose their speed.

A rule dispatches, and all MEDs in service drive at one constant speed; the control is MEDs that drive at it but refuse
every EV. A trained policy of agents (`policy.zip` of a
run with `--agents`) plays the same episodes. The default is the rule alone, at the fleet's speed. Decisions are those
of `medjax.make_agents`.
"""

import argparse
from typing import Any

import jax
import jax.numpy as jnp

from benchmarks.command import a_number, a_path, add_number, episodes_parser, run_command
from benchmarks.studies.base import Column, describe, table_of
from medjax.agents import agents_of
from medjax.commandline import add_set_option, parse_overrides
from medjax.env.agents.environment import AgentsEnv
from medjax.episodes.scores import evaluate_policies
from medjax.errors import InputError
from medjax.policies.policy import Choice, Policy
from medjax.policies.rules import BASELINES
from medjax.policies.saved import load_policy
from medjax.policies.team import Dispatched, rules_of
from medjax.world.state import IN_SERVICE, MERGING, QUEUED

SPEEDS = (14.0, 18.0, 22.0, 25.0)  # m/s
DISPATCHERS = {"paper": "budgeted"}  # the best rule by preset; on others "greedy", which sends many
DEFAULT = "default"
COLUMNS = (
    Column("return", "return"),
    Column("depleted_share", "depleted share"),
    Column("ev_received_kwh", "ev received kwh"),
    Column("ev_delay_h", "ev delay h"),
    Column("gas_delay_h", "gas delay h"),
)


def at_speed(env: AgentsEnv, dispatcher: Policy, speed: float, accepts: bool = True) -> Policy:
    """The policy of all agents that drives at `speed`, m/s, in service, and accepts EVs or refuses all.

    Otherwise it does as the rule does. Most EVs book a MED before it is in service, so it refuses from the ramp on.

    Raises:
      InputError: agents of `env` cannot choose this speed.
    """
    if speed not in env.actions.speeds:
        allowed = " ".join(f"{each:g}" for each in env.actions.speeds)
        raise InputError(f"--speeds {speed:g}: allowed {allowed}")
    index = env.actions.speeds.index(speed)

    def act(weights: Any, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
        """See `Policy.act`."""
        status, parts = state.meds.status, env.actions.by_rule(state, params)
        serves = status == IN_SERVICE
        sent = serves | (status == QUEUED) | (status == MERGING)
        speeds = jnp.where(serves, index, parts.speed).astype(parts.speed.dtype)
        parts = parts._replace(speed=speeds, accept=jnp.full_like(parts.accept, accepts))
        action = jnp.where(sent, env.actions.fold(parts, sent), 0)
        return Choice(action, jax.nn.one_hot(action, env.num_actions, dtype=jnp.float32))

    return Dispatched(env, dispatcher).whole(Policy(act))


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Prints a row per policy: means, and the return minus the default's.

    Raises:
      InputError: the policy is of a dispatcher, or its agents cannot choose a speed.
    """
    overrides = parse_overrides(options.overrides)
    learned: dict[str, Policy] = {}
    if options.policy:
        saved = load_policy(options.policy)
        if not saved.about.agents:
            raise InputError(f"--policy {options.policy}: is a dispatcher's, allowed one of agents")
        scenario = options.scenario or saved.about.scenario
        env, params = saved.make(scenario, overrides)
        learned = {saved.about.name: saved.policy(env)}
    else:
        scenario = options.scenario or "paper"
        env, params = agents_of(scenario, **{"speeds": options.speeds, **overrides})
    rule = DISPATCHERS.get(scenario, "greedy")
    dispatcher = BASELINES[rule](env.env)
    policies = {DEFAULT: rules_of(env)[rule]}
    for accepts, name in ((True, "{:g} m/s"), (False, "{:g} m/s, refuses all")):
        for speed in options.speeds:
            policies[name.format(speed)] = at_speed(env, dispatcher, speed, accepts)
    episodes, seed = options.episodes, options.seed
    scores = evaluate_policies(env, params, policies | learned, episodes, seed)
    rows = [
        {"motion": name, **describe(score, COLUMNS, seed, scores[DEFAULT])}
        for name, score in scores.items()
    ]
    world = ", ".join([scenario, *options.overrides])
    print(f"{world}, {episodes} episodes, seed {seed}, sent by {rule}")
    print(table_of(rows, {"motion": "motion"}, COLUMNS, ("motion", DEFAULT)))
    played = {"episodes": episodes, "seed": seed, "dispatcher": rule}
    return {"scenario": scenario, "overrides": options.overrides, **played, "rows": rows}


def main(arguments: list[str] | None = None) -> None:
    parser = episodes_parser("agents", __doc__, episodes=256, seed=0)
    parser.set_defaults(scenario=None)  # that of the policy, else paper
    trained = "also play a trained policy of agents, in its world"
    parser.add_argument("--policy", type=a_path, metavar="FILE.zip", help=trained)
    speed = a_number("a speed from 1 to 100 m/s", lambda value: 1.0 <= value <= 100.0)
    add_number(parser, "--speeds", SPEEDS, "constant speeds, m/s", speed, nargs="+")
    add_set_option(parser, "set a parameter of the environment; repeatable")
    run_command(parser, measure, arguments)
