"""The program that the benchmarks time: random decisions in a batch of environments."""

import dataclasses
import math
import statistics
import time
from typing import Any

import jax
import jax.numpy as jnp

import medjax
from medjax.errors import InputError
from medjax.numerics import loops
from medjax.numerics.memory import check_memory, tree_bytes
from medjax.scenarios import prepare
from medjax.wrappers import BatchAutoReset, environment_mesh, on_devices

# Approximate number of vehicles on the road of SCALED presets, and the sizes of sweeps.
PRESET_VEHICLES = 140
SCALED = ("paper", "realistic")
ENVS = (64, 256, 1024, 4096, 8192)
VEHICLES = (64, PRESET_VEHICLES, 256, 512, 1024)
STATES_AT_ONCE = 2  # at least the old state and the new one


@dataclasses.dataclass(frozen=True)
class Measurement:
    """Figures for one number of environments; speeds are medians over repeats."""

    active_vehicle_updates_per_s: float
    env_steps_per_s: float
    mean_active_vehicles: float  # on one road, in the last repeat
    ticks_per_step: int
    compile_s: float
    num_envs: int
    num_devices: int
    repeats: int
    state_bytes_per_env: int
    work_bytes_per_env: int  # memory that a step needs besides the state
    backend: str = dataclasses.field(default_factory=jax.default_backend)
    device: str = dataclasses.field(default_factory=lambda: jax.devices()[0].device_kind)
    jax_version: str = jax.__version__


class Workload:
    """A compiled program of `steps` decisions in each of `num_envs` environments.

    The first episode of each environment ends at a random decision, so that resets come at their usual rate.

    Args:
      num_envs: number of environments.
      steps: decisions per call.
      seed: of all draws.
      scenario, overrides: as in `medjax.make`.
      num_devices: devices that share the environments; 0 uses all.
    """

    def __init__(
        self,
        num_envs: int,
        steps: int,
        seed: int = 0,
        scenario: str = "paper",
        num_devices: int = 0,
        **overrides: Any,
    ) -> None:
        self.env, self.params = medjax.make(scenario, **overrides)
        self.num_envs, self.steps = num_envs, steps
        self.mesh = environment_mesh(num_envs, num_devices)
        self.batch = BatchAutoReset(self.env, stagger=int(self.params.episode_decisions))
        self.key, reset_key = jax.random.split(jax.random.key(seed))
        self.reset = jax.jit(self._reset)
        state = jax.eval_shape(self.reset, reset_key)[1]
        check_memory(f"{num_envs} environments", STATES_AT_ONCE * tree_bytes(state))
        _, self.state = self.reset(reset_key)
        start = time.perf_counter()
        self.program = jax.jit(self._play, donate_argnums=1).lower(self.key, self.state).compile()
        self.compile_s = time.perf_counter() - start

    def _reset(self, key: jax.Array) -> tuple[Any, Any]:
        keys = jax.random.split(key, self.num_envs)
        return on_devices(self.mesh, self.batch.reset)(keys, self.params)

    def _play(self, key: jax.Array, state: Any) -> tuple[Any, tuple[jax.Array, jax.Array]]:
        keys = jax.random.split(key, self.num_envs)
        state, sums = on_devices(self.mesh, self._play_some)((keys, state), self.params)
        return state, jax.tree.map(jnp.sum, sums)

    def _play_some(
        self, rows: tuple[jax.Array, Any], params: Any
    ) -> tuple[Any, tuple[jax.Array, jax.Array]]:
        """Plays some environments; returns state, and `(rows,)` vehicles on the road and sums of all results."""
        keys, state = rows

        def step(state: Any, keys: jax.Array) -> tuple[Any, tuple[jax.Array, jax.Array]]:
            choose = jax.vmap(lambda key: jax.random.randint(key, (), 0, self.env.num_actions))
            actions = choose(keys[:, 1])
            obs, state, reward, *_, info = self.batch.step(keys[:, 0], state, actions, params)
            # Summing everything that a step returns keeps XLA from optimising any of it away.
            results = jax.tree.leaves((obs, reward, info["reward_terms"], info["metrics"]))
            sums = (leaf.reshape(keys.shape[0], -1).sum(1) for leaf in results)
            return state, (info["step_stats"].vehicle_ticks, sum(sums, jnp.zeros(())))

        split = jax.vmap(lambda key: jax.random.split(key, (self.steps, 2)), out_axes=1)
        state, sums = loops.scan(step, state, split(keys))
        return state, jax.tree.map(lambda values: jnp.sum(values, axis=0), sums)

    def play(self) -> tuple[float, float]:
        """Makes one call; returns its seconds, and the vehicles on the road summed over its ticks."""
        self.key, key = jax.random.split(self.key)
        start = time.perf_counter()
        self.state, (active, _) = jax.block_until_ready(self.program(key, self.state))
        return time.perf_counter() - start, float(active)


def measure(num_envs: int, *, steps: int = 50, repeats: int = 5, **options: Any) -> Measurement:
    """Times a `Workload` with these options `repeats` times after a warm-up."""
    return alternate([Workload(num_envs, steps, **options)], repeats)[0]


def alternate(works: list[Workload], repeats: int) -> list[Measurement]:
    """Times all workloads in turn after a warm-up, so that a temporary slowdown of the machine affects all alike."""
    for work in works:
        work.play()
    rounds = [[work.play() for work in works] for _ in range(repeats)]
    return [summarize(work, own) for work, *own in zip(works, *rounds, strict=True)]


def summarize(work: Workload, calls: list[tuple[float, float]]) -> Measurement:
    """Figures of the results of `Workload.play`."""
    num_envs, decisions = work.num_envs, work.num_envs * work.steps
    ticks = work.env.config.ticks_per_decision
    plan: Any = work.program.memory_analysis()
    return Measurement(
        active_vehicle_updates_per_s=statistics.median(active / wall for wall, active in calls),
        env_steps_per_s=decisions / statistics.median(wall for wall, _ in calls),
        mean_active_vehicles=calls[-1][1] / (decisions * ticks),
        ticks_per_step=ticks,
        compile_s=work.compile_s,
        num_envs=num_envs,
        num_devices=work.mesh.size,
        repeats=len(calls),
        state_bytes_per_env=sum(x.nbytes for x in jax.tree.leaves(work.state)) // num_envs,
        # XLA reports the memory of one device, which holds its share of the environments.
        work_bytes_per_env=int(plan.temp_size_in_bytes) * work.mesh.size // num_envs,
    )


def road_for(num_vehicles: int, scenario: str = "paper") -> dict[str, Any]:
    """Overrides that scale the road and all that depends on its length, so that it holds about num_vehicles.

    Raises:
      InputError: the preset is not in SCALED, such as one with exits.
    """
    if scenario not in SCALED:
        raise InputError(
            f"--scenario {scenario}: allowed {', '.join(SCALED)}, whose road can be longer or shorter"
        )
    env, params, _ = prepare(scenario)
    scale = num_vehicles / PRESET_VEHICLES
    return {
        "length_m": float(params.road.length_m) * scale,
        "ramp_x_m": [float(x) * scale for x in params.road.ramp_x_m],
        "battery_scale": float(params.battery_scale) / scale,
        "num_evs": math.ceil(env.config.num_evs * scale),
        "num_gas": math.ceil(env.config.num_gas * scale),
    }
