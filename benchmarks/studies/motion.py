"""`python -m benchmarks.motion`: what MEDs could gain by other rules of motion, before anything is learned.

A rule dispatches MEDs, and in service they follow a rule of motion. It is compared on the same episodes with the
default: keep the fleet's speed and lane, accept every request, drive to the end of the trip. Decisions are those of
`medjax.make_agents`.
"""

import argparse
import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import medjax
from benchmarks.command import episodes_parser, run_command
from medjax.charging.booking import ask
from medjax.commandline import add_set_option, parse_overrides
from medjax.env.agents.actions import Parts
from medjax.env.agents.environment import AgentsEnv
from medjax.env.agents.view import requests
from medjax.env.contract import StepResult
from medjax.env.depots import depot_places, who_is_sent
from medjax.env.dispatch import is_allowed
from medjax.env.forecast import expected_need, lacking_j
from medjax.env.observation import NEED_WINDOW_S
from medjax.env.wrapper import Wrapper
from medjax.episodes.scores import Scores, evaluate_policies
from medjax.errors import InputError
from medjax.policies.rules import BASELINES
from medjax.traffic.exits import next_exit
from medjax.world.params import EnvParams
from medjax.world.state import IN_SERVICE, NOT_BOOKED, EnvState
from train.evaluation.statistics import bootstrap_ci95
from train.evaluation.tables import format_rows, interval, short

Motion = Callable[[AgentsEnv, EnvState, EnvParams], Parts[jax.Array]]

SPEEDS = tuple(map(float, range(14, 26)))  # m/s
VIEW_M = 400.0  # farthest requesting EV that a MED reacts to
DISPATCHERS = {"paper": "budgeted", "corridor": "greedy"}  # best rule; one that sends at all
COLUMNS = ("return", "depleted_share", "ev_received_kwh", "ev_delay_h", "gas_delay_h")


def _usual(agents: AgentsEnv, state: EnvState, params: EnvParams) -> Parts[jax.Array]:
    """The fleet's default motion."""
    return agents.actions.by_rule(state, params)


def _at(speed: float, accept: int = 1) -> Motion:
    """All MEDs in service drive at this speed, m/s, and accept EVs, or none if `accept` is 0."""

    def move(agents: AgentsEnv, state: EnvState, params: EnvParams) -> Parts[jax.Array]:
        usual, serves = _usual(agents, state, params), state.meds.status == IN_SERVICE
        choice = jnp.where(serves, agents.actions.speeds.index(speed), usual.speed)
        return usual._replace(
            speed=choice.astype(jnp.int32), accept=jnp.full_like(usual.accept, accept)
        )

    return move


def _towards(per_s: float) -> Motion:
    """The fleet's speed plus `per_s`, 1/s, of the distance to the nearest requesting EV, negative behind."""

    def move(agents: AgentsEnv, state: EnvState, params: EnvParams) -> Parts[jax.Array]:
        config, usual = agents.env.config, _usual(agents, state, params)
        asks = ask(state, config, params)[0].asks
        way = state.vehicles.x[config.ev_slots] - state.vehicles.x[config.med_slots, None]
        distance = jnp.where(asks & (jnp.abs(way) < VIEW_M), jnp.abs(way), jnp.inf)
        nearest = jnp.argmin(distance, axis=1)[:, None]
        gap = jnp.take_along_axis(jnp.where(jnp.isfinite(distance), way, 0.0), nearest, axis=1)
        wanted = params.fleet.service_speed + per_s * gap
        choice = jnp.argmin(jnp.abs(jnp.asarray(agents.actions.speeds) - wanted), axis=1)
        serves = state.meds.status == IN_SERVICE
        return usual._replace(speed=jnp.where(serves, choice, usual.speed).astype(jnp.int32))

    return move


def _slow_until(evs: int, speed: float) -> Motion:
    """Each MED drives at this speed, m/s, until that many EVs have booked it."""

    def move(agents: AgentsEnv, state: EnvState, params: EnvParams) -> Parts[jax.Array]:
        usual = _usual(agents, state, params)
        booked = state.evs.med[:, None] == jnp.arange(agents.num_agents)
        waits = (jnp.sum(booked, axis=0) < evs) & (state.meds.status == IN_SERVICE)
        slow = agents.actions.speeds.index(speed)
        return usual._replace(speed=jnp.where(waits, slow, usual.speed).astype(jnp.int32))

    return move


def _only_who_needs_it(agents: AgentsEnv, state: EnvState, params: EnvParams) -> Parts[jax.Array]:
    """Refuses EVs that reach their destination without charging."""
    config, usual = agents.env.config, _usual(agents, state, params)
    request = requests(state, config, params)
    lacks = lacking_j(state, config, params)[jnp.maximum(request, 0)] > 0.0
    return usual._replace(accept=((request < 0) | lacks).astype(jnp.int32))


def _home_when_idle(agents: AgentsEnv, state: EnvState, params: EnvParams) -> Parts[jax.Array]:
    """A MED leaves at the next exit when no EV has booked it or asks nearby."""
    config, usual = agents.env.config, _usual(agents, state, params)
    asks = ask(state, config, params)[0].asks
    way = state.vehicles.x[config.ev_slots] - state.vehicles.x[config.med_slots, None]
    near = jnp.any(asks & (jnp.abs(way) < params.charging.reach_ahead_m), axis=1)
    booked = state.evs.med[:, None] == jnp.arange(agents.num_agents)
    idle = ~near & ~jnp.any(booked & (state.evs.med != NOT_BOOKED)[:, None], axis=0)
    idle &= state.meds.status == IN_SERVICE
    return usual._replace(leave=jnp.where(idle, 1 + state.meds.depot, 0))


Places = Callable[[AgentsEnv, EnvState, EnvParams], jax.Array]


def _going_to(worth: Places) -> Motion:
    """A MED leaves where its trip ends, but for the depot with the highest `worth` `(num_meds, num_depots)`."""

    def move(agents: AgentsEnv, state: EnvState, params: EnvParams) -> Parts[jax.Array]:
        config, usual = agents.env.config, _usual(agents, state, params)
        choice = 1 + jnp.argmax(worth(agents, state, params), axis=1).astype(jnp.int32)
        mask = agents.actions.masks(state, config, params).leave
        ends = state.vehicles.destination[config.med_slots]
        notice = state.vehicles.x[config.med_slots] + params.road.exit_notice_m
        leaves = is_allowed(choice, mask) & (next_exit(notice, params.road) == ends)
        return usual._replace(leave=jnp.where(leaves, choice, 0))

    return move


def _nearness(agents: AgentsEnv, state: EnvState, params: EnvParams) -> jax.Array:
    """Minus the distance from each MED's exit to each depot."""
    config = agents.env.config
    ends = state.vehicles.destination[config.med_slots, None]
    return -jnp.abs(ends - depot_places(config, params))


def _room(agents: AgentsEnv, state: EnvState, params: EnvParams) -> jax.Array:
    """Minus the number of other MEDs at each depot or on their way to it."""
    meds, config = state.meds, agents.env.config
    theirs = (meds.depot[:, None] == jnp.arange(config.num_depots)) & (
        jnp.arange(config.num_meds) < params.fleet.size
    )[:, None]
    return theirs - jnp.sum(theirs, axis=0)


def _need(agents: AgentsEnv, state: EnvState, params: EnvParams) -> jax.Array:
    """EVs in need at each depot's ramps, now and soon, less the free slots that they will find."""
    config = agents.env.config
    need = expected_need(state, config, params, NEED_WINDOW_S)
    of_ramps = need.there + need.coming - need.free
    serves = jnp.asarray(config.ramp_depots) == jnp.arange(config.num_depots)[:, None]
    total = jnp.sum(jnp.where(serves, of_ramps, 0.0), axis=1)
    return jnp.broadcast_to(total, (config.num_meds, config.num_depots))


def _other_lane(agents: AgentsEnv, state: EnvState, params: EnvParams) -> Parts[jax.Array]:
    """All MEDs in service take the leftmost lane that allows four slots."""
    usual = _usual(agents, state, params)
    return usual._replace(lane=jnp.where(state.meds.status == IN_SERVICE, 0, usual.lane))


DEPOTS = {"nearest depot": _nearness, "emptiest depot": _room, "depot in need": _need}
MOTIONS: dict[str, Motion] = {
    "default": _usual,
    **{f"{speed:g} m/s": _at(speed) for speed in (14.0, 16.0, 18.0, 20.0, 22.0, 24.0, 25.0)},
    # Isolate the effect of slow lorries, since drivers behind them save energy.
    **{f"{speed:g} m/s, refuses all": _at(speed, accept=0) for speed in (14.0, 18.0, 22.0)},
    "0.02/s x gap": _towards(0.02),
    "0.05/s x gap": _towards(0.05),
    "18 m/s until 1 EV": _slow_until(1, 18.0),
    "18 m/s until 2 EVs": _slow_until(2, 18.0),
    "only who needs it": _only_who_needs_it,
    "home when idle": _home_when_idle,
    **{f"to the {depot}": _going_to(worth) for depot, worth in DEPOTS.items()},
    "lane to the left": _other_lane,
}


@dataclasses.dataclass(frozen=True)
class Moved(Wrapper):
    """`env` with MEDs in service that move by a rule; the action is the dispatcher's."""

    agents: AgentsEnv
    motion: Motion

    def step_env(
        self, key: jax.Array, state: EnvState, action: jax.Array, params: EnvParams
    ) -> StepResult:
        """Plays one decision."""
        head = who_is_sent(action, state.meds, self.env.config)
        parts = self.motion(self.agents, state, params)
        parts = parts._replace(enter=jnp.where(head, action, 0).astype(jnp.int32))
        _, state, *rest = self.agents.step_parts(key, state, parts, params)
        return self.env.get_obs(state, params), state, *rest


def play(options: argparse.Namespace) -> dict[str, Scores]:
    """Scores of all rules of motion on the same episodes."""
    overrides = parse_overrides(options.overrides)
    if "speeds" in overrides:
        raise InputError(
            "--set speeds: allowed a number of the world; speeds are those of the motions"
        )
    named = medjax.make_agents(options.scenario, speeds=SPEEDS, **overrides)
    agents = named.env
    played: dict[str, Scores] = {}
    dispatcher = BASELINES[DISPATCHERS.get(options.scenario, "greedy")]
    wanted = {"default", *(options.motions or MOTIONS)}
    if not agents.actions.exits:
        wanted.discard("home when idle")
    if not agents.actions.exits or agents.actions.depots == 1:
        wanted -= {f"to the {depot}" for depot in DEPOTS}
    for name in MOTIONS:
        if name not in wanted:
            continue
        env = Moved(agents.env, agents, MOTIONS[name])
        policy = {name: dispatcher(env)}
        played |= evaluate_policies(env, named.params, policy, options.episodes, options.seed)
    return played


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Prints a row per rule of motion: means, and return minus the default's."""
    played = play(options)
    rows: list[dict[str, Any]] = []
    for name, score in played.items():
        gain = score["return"] - played["default"]["return"]
        low, high = bootstrap_ci95(gain, options.seed)
        means = {column: float(np.mean(score[column])) for column in COLUMNS}
        paid = {"gain": float(np.mean(gain)), "gain_ci95": [low, high]}
        rows.append({"motion": name, **means, **paid})
    world = ", ".join([options.scenario, *options.overrides])
    print(f"{world}, {options.episodes} episodes, seed {options.seed}")
    table = [["motion", *(name.replace("_", " ") for name in COLUMNS), "return minus default"]]
    for row in rows:
        cells = [short(row[column]) for column in COLUMNS]
        table.append([row["motion"], *cells, f"{short(row['gain'])} {interval(row['gain_ci95'])}"])
    print(format_rows(table))
    return {
        "scenario": options.scenario,
        "overrides": options.overrides,
        "episodes": options.episodes,
        "rows": rows,
    }


def main(arguments: list[str] | None = None) -> None:
    parser = episodes_parser("motion", __doc__, episodes=256, seed=0)
    shown = f"some of {', '.join(MOTIONS)} (default: all)"
    parser.add_argument("--motions", nargs="+", choices=list(MOTIONS), metavar="NAME", help=shown)
    add_set_option(parser, "set a parameter of the environment; repeatable")
    run_command(parser, measure, arguments)
