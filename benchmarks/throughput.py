"""`python -m benchmarks.throughput`: how many active vehicles medjax moves a second.

The complete default step is timed: dispatch, entries, booking, ticks, observation, reward, metrics and
auto-reset, under uniformly random actions. Only vehicles really on the road are counted.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import statistics
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

import medjax
from medjax.wrappers import BatchAutoReset


@dataclasses.dataclass(frozen=True)
class Measurement:
    """Figures of one number of environments; medians over repeats."""

    active_vehicle_updates_per_s: float
    env_steps_per_s: float
    mean_active_vehicles: float
    ticks_per_step: int
    compile_s: float
    num_envs: int
    repeats: int
    state_bytes_per_env: int
    backend: str = dataclasses.field(default_factory=jax.default_backend)
    device: str = dataclasses.field(default_factory=lambda: jax.devices()[0].device_kind)
    jax_version: str = jax.__version__


def measure(
    num_envs: int, *, steps: int = 50, repeats: int = 5, seed: int = 0, scenario: str = "paper"
) -> Measurement:
    """Times `steps` random decisions in `num_envs` environments, `repeats` times, after warm-up.

    Episodes are cut at random places in their first run, so that resets happen at their usual rate.
    """
    env, params = medjax.make(scenario)
    batch = BatchAutoReset(env, num_envs, stagger=int(params.episode_decisions))

    def play(key: jax.Array, state: Any) -> tuple[Any, tuple[jax.Array, jax.Array]]:
        def step(state: Any, key: jax.Array) -> tuple[Any, tuple[jax.Array, jax.Array]]:
            action_key, step_key = jax.random.split(key)
            actions = jax.random.randint(action_key, (num_envs,), 0, env.num_actions)
            obs, state, *_, info = batch.step(step_key, state, actions, params)
            # The sum keeps the observation from being optimised away.
            return state, (jnp.sum(info["tally"].vehicle_ticks), jnp.sum(obs))

        state, (active, seen) = jax.lax.scan(step, state, jax.random.split(key, steps))
        return state, (jnp.sum(active), jnp.sum(seen))

    keys = jax.random.split(jax.random.key(seed), repeats + 2)
    _, state = jax.jit(batch.reset)(keys[0], params)
    state_bytes = sum(leaf.nbytes for leaf in jax.tree.leaves(state)) // num_envs
    start = time.perf_counter()
    program = jax.jit(play, donate_argnums=1).lower(keys[1], state).compile()
    compile_s = time.perf_counter() - start
    state, _ = jax.block_until_ready(program(keys[1], state))

    walls, updates = [], []
    for key in keys[2:]:
        start = time.perf_counter()
        state, (active, _) = jax.block_until_ready(program(key, state))
        walls.append(time.perf_counter() - start)
        updates.append(float(active) / walls[-1])
    wall = statistics.median(walls)
    ticks = env.config.ticks_per_decision
    return Measurement(
        active_vehicle_updates_per_s=statistics.median(updates),
        env_steps_per_s=num_envs * steps / wall,
        mean_active_vehicles=float(active) / (num_envs * steps * ticks),
        ticks_per_step=ticks,
        compile_s=compile_s,
        num_envs=num_envs,
        repeats=repeats,
        state_bytes_per_env=state_bytes,
    )


def positive(text: str) -> int:
    """Parses a whole number above 0."""
    number = int(text)
    if number < 1:
        raise ValueError
    return number


def main(arguments: list[str] | None = None) -> None:
    """Prints one line a measurement and writes the last one, or all of a sweep, as JSON."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.throughput", description=__doc__)
    parser.add_argument("--num-envs", type=positive, default=[1024], nargs="+", metavar="N")
    parser.add_argument("--steps", type=positive, default=50, help="decisions in a repeat")
    parser.add_argument("--repeats", type=positive, default=5)
    parser.add_argument("--scenario", default="paper", choices=list(medjax.SCENARIOS))
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    results = []
    for num_envs in options.num_envs:
        result = measure(
            num_envs, steps=options.steps, repeats=options.repeats, scenario=options.scenario
        )
        results.append(dataclasses.asdict(result))
        print(
            f"{num_envs:6d} environments: {result.active_vehicle_updates_per_s / 1e6:6.2f} M active "
            f"vehicle updates/s, {result.env_steps_per_s:8.0f} decisions/s, "
            f"{result.mean_active_vehicles:.0f} vehicles a road, compiled in {result.compile_s:.1f} s"
        )
    if options.json:
        options.json.write_text(json.dumps(results[0] if len(results) == 1 else results, indent=2))


if __name__ == "__main__":
    main()
