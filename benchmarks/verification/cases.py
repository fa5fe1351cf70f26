"""Cases of the soak test: each plays and checks random worlds side by side in one compiled program."""

import dataclasses
import math
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

import medjax
from benchmarks.verification.decisions import Decision, check_decision
from benchmarks.verification.draws import random_units
from benchmarks.verification.invariants import (
    INVARIANTS,
    STANDS_M_PER_S,
    STANDS_S,
    check_instant,
    count,
    stands_open,
)
from benchmarks.verification.random_worlds import draw_config, draw_params, validated
from medjax.env.agents.actions import AgentActions, Parts, allowed_parts, give_orders
from medjax.env.charging_env import ChargingEnv
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import EnvState
from medjax.wrappers import environment_mesh, on_devices

NUM_ENVS = 256
EPISODE_S = 150.0
NEVER = 2**30
# Random orders to MEDs: the speeds, m/s, the chance that a MED gets orders, and the chance that these say to leave.
SPEEDS, COMMAND_CHANCE, LEAVE_CHANCE = (5.0, 14.0, 22.0, 30.0), 0.1, 0.05


class Played(struct.PyTreeNode):
    """An episode in each of B environments."""

    state: EnvState  # (B, ...) after the last decision
    updates: jax.Array  # (B,) int32, vehicles on the road, summed over ticks
    violations: jax.Array  # (B, len(INVARIANTS)) int32
    first: jax.Array  # (B,) int32, decision of the first violation; -1: at reset; NEVER: none
    stood_s: jax.Array  # (B, N) s, how long each vehicle has stood with open road ahead


def random_action(key: jax.Array, mask: jax.Array, wild: jax.Array) -> jax.Array:
    """Draws an action, () int32: an allowed one, or if `wild` any one, even masked or out of range."""
    any_key, allowed_key = jax.random.split(key)
    anything = jax.random.randint(any_key, (), -1, mask.shape[0] + 1)
    allowed = jax.random.randint(allowed_key, (), 0, mask.shape[0])
    return jnp.where(wild, anything, jnp.where(mask[allowed], allowed, 0))


def commanded(
    key: jax.Array, index: Any, state: EnvState, config: EnvConfig, params: EnvParams
) -> EnvState:
    """Gives some MEDs random orders in every other pair of environments. Returns the new state.

    MEDs get orders wherever they are. Masks remove the orders that are not allowed.
    """
    exits, depots, meds = config.num_exits > 0, config.num_depots, (config.num_meds,)
    lanes = tuple(range(config.num_lanes))
    actions = AgentActions(SPEEDS, lanes, config.num_ramps, exits, depots=depots)
    new_key, speed_key, lane_key, accept_key, leave_key = jax.random.split(
        jax.random.fold_in(key, 1), 5
    )
    rule = actions.by_rule(state, params)
    new = jax.random.uniform(new_key, meds) < COMMAND_CHANCE
    leaves = new & (jax.random.uniform(leave_key, meds) < LEAVE_CHANCE)
    depot = jax.random.randint(jax.random.fold_in(leave_key, 1), meds, 1, 1 + depots)
    orders = Parts(
        enter=rule.enter,
        speed=jax.random.randint(speed_key, meds, 0, len(SPEEDS)),
        lane=jax.random.randint(lane_key, meds, 0, config.num_lanes),
        accept=jax.random.randint(accept_key, meds, 0, 2),
        leave=jnp.where(leaves, depot, 0),
    )
    parts, _ = allowed_parts(orders, actions.masks(state, config, params), rule)
    after, _ = give_orders(state, parts, actions, config, params)
    ordered = {
        name: jnp.where(new, getattr(after.meds, name), getattr(state.meds, name))
        for name in ("service_speed", "service_lane", "accepts", "depot")
    }
    after = after.replace(meds=state.meds.replace(**ordered))
    return jax.tree.map(lambda new, old: jnp.where(index % 4 >= 2, new, old), after, state)


def environment_keys(key: jax.Array, index: Any) -> jax.Array:
    """Keys of an environment's reset and decisions in the episode of this key."""
    return jax.random.split(jax.random.fold_in(key, index))


def episode_program(config: EnvConfig, num_devices: int = 0) -> Any:
    """A program from `(params, key, decisions)` to `Played`: it plays and checks an episode's first `decisions`.

    Leaves of `params` are (B, ...), except the coils' table, which all environments share. `key` is the episode's.
    `decisions`, () int32, is traced. One program thus plays any number of decisions, bit for bit the same way.
    """
    env = ChargingEnv(config).with_probe(lambda state: state)

    def play(
        index: jax.Array, params: EnvParams, table: Any, key: jax.Array, decisions: jax.Array
    ) -> Played:
        """Plays one environment."""
        params = params.replace(link=params.link.replace(inductance=table))
        reset_key, key = environment_keys(key, index)
        _, state = env.reset(reset_key, params)
        found = count(check_instant(state, config, params))
        first = jnp.where(found.any(), -1, NEVER).astype(jnp.int32)

        def decide(decision: jax.Array, played: Played) -> Played:
            act_key, step_key = jax.random.split(jax.random.fold_in(key, decision))
            before = commanded(act_key, index, played.state, config, params)
            action = random_action(act_key, env.action_mask(before, params), index % 2 == 0)
            obs, state, reward, _, _, info = env.step_env(step_key, before, action, params)
            decided = Decision(before, state, obs, reward, info)
            stands = stands_open(before, config, params) & stands_open(state, config, params)
            # A vehicle in stop-and-go, for example one that lets another in, does not count as standing.
            distance = jnp.abs(state.vehicles.x - before.vehicles.x)
            stands &= distance <= STANDS_M_PER_S * config.decision_s
            stood_s = jnp.where(stands, played.stood_s + config.decision_s, 0.0)
            found = check_decision(decided, config, params)
            found += count({"standing": {"for too long": stood_s > STANDS_S}})
            return Played(
                state=state,
                updates=played.updates + info["step_stats"].vehicle_ticks.astype(jnp.int32),
                violations=played.violations + found,
                first=jnp.minimum(played.first, jnp.where(found.any(), decision, NEVER)),
                stood_s=stood_s,
            )

        still = jnp.zeros((config.num_vehicles,))
        start = Played(state, jnp.zeros((), jnp.int32), found, first, still)
        return jax.lax.fori_loop(0, decisions, decide, start)

    def play_rows(rows: tuple[Any, ...], same: tuple[Any, ...]) -> Played:
        return jax.vmap(partial(play, table=same[0], key=same[1], decisions=same[2]))(*rows)

    @jax.jit
    def program(params: EnvParams, key: jax.Array, decisions: jax.Array) -> Played:
        table, index = params.link.inductance, jnp.arange(jnp.shape(params.battery_scale)[0])
        rows = index, params.replace(link=params.link.replace(inductance=None))
        mesh = environment_mesh(index.shape[0], num_devices)
        return on_devices(mesh, play_rows)(rows, (table, key, decisions))

    return program


def compiled(config: EnvConfig, *args: Any) -> Any:
    """`episode_program` of these sizes, compiled for arguments of these shapes."""
    return episode_program(config).lower(*args).compile()


class Case:
    """Case `number` of a seed: sizes, the numbers of each environment, and the compiled program.

    With another `num_envs` the case plays other worlds. `config` replaces the drawn sizes.
    """

    def __init__(
        self, seed: int, number: int, num_envs: int = NUM_ENVS, config: EnvConfig | None = None
    ) -> None:
        self.seed, self.number, self.num_envs = seed, number, num_envs
        self.config = config or draw_config(seed, number)
        units = random_units(np.random.default_rng([seed, number]), num_envs)
        table = jax.device_get(medjax.make("paper")[1].link.inductance)
        self.params = validated(self.config, draw_params(units, self.config, table))
        self.decisions = math.ceil(EPISODE_S / self.config.decision_s)
        start = time.perf_counter()
        self.program = compiled(self.config, self.params, self.key(0), np.int32(0))
        self.compile_s = time.perf_counter() - start

    def key(self, episode: int) -> jax.Array:
        """Key of an episode."""
        of_case = jax.random.fold_in(jax.random.key(self.seed), self.number)
        return jax.random.fold_in(of_case, episode)

    def play(self, episode: int, decisions: int | None = None) -> Played:
        """Plays an episode, or only its first decisions, in every environment. Returns NumPy arrays."""
        count = np.int32(self.decisions if decisions is None else decisions)
        return jax.device_get(self.program(self.params, self.key(episode), count))

    def __str__(self) -> str:
        c = self.config
        ticks = f"{c.tick_s:g} s x {c.ticks_per_round} x {c.rounds_per_decision}"
        vehicles = f"{c.num_meds} MEDs, {c.num_evs} EVs, {c.num_gas} gas"
        return f"{c.num_lanes} lanes, {c.num_ramps} ramps, {ticks}, {vehicles}"


@dataclasses.dataclass(frozen=True)
class Violation:
    """The first violation in an environment of a case."""

    case: Case
    environment: int
    episode: int
    decision: int  # -1: at reset
    counts: dict[str, int]  # in the whole episode

    def command(self) -> str:
        """The command that reproduces it."""
        command = f"python -m benchmarks.soak --seed {self.case.seed} --case {self.case.number}"
        command += f" --environment {self.environment}"
        command += f" --episode {self.episode}" if self.episode else ""
        envs = self.case.num_envs
        return command + (f" --num-envs {envs}" if envs != NUM_ENVS else "")

    def __str__(self) -> str:
        where = f"decision {self.decision}" if self.decision >= 0 else "the reset"
        counts = ", ".join(f"{name} {count}" for name, count in self.counts.items())
        return (
            f"VIOLATED: {counts}: seed {self.case.seed}, case {self.case.number}, environment "
            f"{self.environment}, episode {self.episode}, first in {where}\n  {self.command()}"
        )


def violations_of(case: Case, episode: int, played: Played) -> list[Violation]:
    """The violations of an episode, at most one per environment."""
    found = []
    for row in np.flatnonzero(played.first < NEVER).tolist():
        of_all = zip(INVARIANTS, played.violations[row].tolist(), strict=True)
        counts = {name: count for name, count in of_all if count}
        found.append(Violation(case, row, episode, int(played.first[row]), counts))
    return found


def run_case(case: Case, updates: float) -> Iterator[tuple[int, list[Violation]]]:
    """Plays episodes of a case up to this many vehicle updates. Yields each episode's updates and violations."""
    done, episode = 0, 0
    while done < updates:
        played = case.play(episode)
        moved = int(played.updates.sum(dtype=np.int64))
        yield moved, violations_of(case, episode, played)
        # Without demand and MEDs, nobody moves. The floor of `num_envs` updates ends such a case.
        done, episode = done + max(moved, case.num_envs), episode + 1
