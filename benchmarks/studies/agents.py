"""`python -m benchmarks.agents`: what agents gain that choose their speed.

A rule dispatches, and all MEDs in service drive at one constant speed; the control is MEDs that drive at it but refuse
every EV. The learners of a run with `--agents`, or the policy of one (`policy.zip`), play the same episodes. The
default is the rule alone, at the fleet's speed. Decisions are those of `medjax.make_agents`.
"""

import argparse
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from benchmarks.command import a_number, a_path, add_number, episodes_parser, run_command
from benchmarks.studies.base import Column, add_run_dir, describe, settings, table_of
from medjax.agents import agents_of
from medjax.commandline import add_set_option, parse_overrides
from medjax.env.agents.environment import AgentsEnv
from medjax.episodes.scores import evaluate_policies
from medjax.errors import InputError, shown
from medjax.policies.policy import Choice, Policy
from medjax.policies.rules import BASELINES
from medjax.policies.saved import load_policy
from medjax.policies.team import Dispatched, rules_of
from medjax.world.state import IN_SERVICE, MERGING, QUEUED
from train.runs.policies import load_policies

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


def learners(options: argparse.Namespace) -> tuple[Any, Any, str, dict[str, Policy]]:
    """Agents' environment, its parameters, its preset, and the policies of `--run-dir` or `--policy` by name.

    Raises:
      InputError: there is no such run or policy, it is of a dispatcher, or it does not fit the environment.
    """
    if options.run_dir:
        config = settings(options)
        if config.agents == "none":
            what = f"--run-dir {options.run_dir}"
            raise InputError(f"{what}: is of a dispatcher, allowed one of agents")
        env, params, found = load_policies(options.run_dir, config)
        learned = {name: policy for name, policy in found.items() if name not in BASELINES}
        return env, params, config.scenario, learned
    overrides = parse_overrides(options.overrides)
    if options.policy:
        saved = load_policy(options.policy)
        if not saved.about.agents:
            raise InputError(f"--policy {options.policy}: is a dispatcher's, allowed one of agents")
        scenario = options.scenario or saved.about.scenario
        env, params = saved.make(scenario, overrides)
        return env, params, scenario, {saved.about.name: saved.policy(env)}
    scenario = options.scenario or "paper"
    return *agents_of(scenario, **{"speeds": options.speeds, **overrides}), scenario, {}


def check_baseline(baseline: str, names: Sequence[str]) -> None:
    """Refuses (InputError) a baseline that is none of the names."""
    if baseline not in names:
        raise InputError(f"--baseline {shown(baseline)}: allowed one of {', '.join(names)}")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Prints a row per policy: means, and the return minus that of the baseline.

    Raises:
      InputError: see `learners`; or agents cannot choose a speed, or nothing is called as the baseline.
    """
    episodes, seed, baseline = options.episodes, options.seed, options.baseline
    motions = {
        name.format(speed): (speed, accepts)
        for accepts, name in ((True, "{:g} m/s"), (False, "{:g} m/s, refuses all"))
        for speed in options.speeds
    }
    if options.run_dir and options.policy:
        given = f"--policy {options.policy} with --run-dir {options.run_dir}"
        raise InputError(f"{given}, allowed: one of the two")
    if not (options.run_dir or options.policy):  # before anything compiles
        check_baseline(baseline, (DEFAULT, *motions))
    env, params, scenario, learned = learners(options)
    check_baseline(baseline, (DEFAULT, *motions, *learned))
    rule = DISPATCHERS.get(scenario, "greedy")
    dispatcher = BASELINES[rule](env.env)
    constant = {name: at_speed(env, dispatcher, *motion) for name, motion in motions.items()}
    policies = {DEFAULT: rules_of(env)[rule], **constant, **learned}
    scores = evaluate_policies(env, params, policies, episodes, seed)
    rows = [
        {"motion": name, **describe(score, COLUMNS, seed, scores[baseline])}
        for name, score in scores.items()
    ]
    world = ", ".join([scenario, *options.overrides])
    print(f"{world}, {episodes} episodes, seed {seed}, sent by {rule}")
    print(table_of(rows, {"motion": "motion"}, COLUMNS, ("motion", baseline)))
    played = {"episodes": episodes, "seed": seed, "dispatcher": rule, "baseline": baseline}
    return {"scenario": scenario, "overrides": options.overrides, **played, "rows": rows}


def main(arguments: list[str] | None = None) -> None:
    parser = episodes_parser("agents", __doc__, episodes=256, seed=0)
    add_run_dir(
        parser, "also play the learners of a run of agents, and their policy before training"
    )
    trained = "also play a trained policy of agents, in its world"
    parser.add_argument("--policy", type=a_path, metavar="FILE.zip", help=trained)
    text = f"motion to compare the others with (default: {DEFAULT})"
    parser.add_argument("--baseline", default=DEFAULT, metavar="MOTION", help=text)
    speed = a_number("a speed from 1 to 100 m/s", lambda value: 1.0 <= value <= 100.0)
    add_number(parser, "--speeds", SPEEDS, "constant speeds, m/s", speed, nargs="+")
    add_set_option(parser, "set a parameter of the environment; repeatable")
    run_command(parser, measure, arguments)
