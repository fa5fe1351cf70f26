"""`python -m benchmarks.agents`: how agents act, from a policy's file (`policy.zip` of a run with `--agents`).

Over whole episodes and all decisions of MEDs in service, it reports the commanded speed by the distance to the nearest
requesting EV, ahead or behind. It also reports how often an agent accepts the EV that it would be granted, by the
energy that this EV lacks to reach its destination.
"""

import argparse
import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import lax

from benchmarks.command import a_path, a_seed, add_plot, benchmark_parser, run_command, whole_number
from medjax.charging.booking import ask
from medjax.env.agents.environment import AgentsEnv
from medjax.env.agents.view import requests
from medjax.env.forecast import lacking_j
from medjax.episodes.keys import episode_keys
from medjax.episodes.runner import EpisodeRunner, episode_steps
from medjax.errors import InputError
from medjax.numerics.devices import environment_mesh, on_devices
from medjax.policies.policy import Policy
from medjax.policies.saved import load_policy
from medjax.world.params import EnvParams
from medjax.world.state import IN_SERVICE, EnvState
from train.evaluation.tables import format_rows
from train.reporting.figures import new_figure, save

VIEW_M = 400.0
GAPS_M = np.linspace(-VIEW_M, VIEW_M, 17)  # edges of bins; the last bin is for no requesting EV
LACKS = np.array([0.0, 0.05, 0.1, 0.15, 0.2, 0.3])  # packs, edges; below the first: lacks nothing


class Seen(struct.PyTreeNode):
    """Sums over decisions of MEDs in service, by bin."""

    decisions: jax.Array  # (gaps,)
    told_m_per_s: jax.Array  # (gaps,)
    asked: jax.Array  # (lacks,) decisions with an EV that would be granted
    taken: jax.Array  # (lacks,)


def _into(bins: jax.Array, count: int, values: jax.Array) -> jax.Array:
    """Sums of values `(A,)` by bin, `(count,)`."""
    return jnp.sum(jnp.where(bins[:, None] == jnp.arange(count), values[:, None], 0.0), axis=0)


def look(env: AgentsEnv, state: EnvState, params: EnvParams, action: jax.Array) -> Seen:
    """Bins one decision of all agents with actions `(A,)`."""
    config = env.env.config
    parts = env.actions.unfold(action, env.actions.by_rule(state, params))
    serves = (state.meds.status == IN_SERVICE).astype(jnp.float32)
    asks = ask(state, config, params)[0].asks
    way = state.vehicles.x[config.ev_slots] - state.vehicles.x[config.med_slots, None]
    distance = jnp.where(asks & (jnp.abs(way) < VIEW_M), jnp.abs(way), jnp.inf)
    nearest = jnp.argmin(distance, axis=1)[:, None]
    somebody = jnp.isfinite(jnp.min(distance, axis=1))
    gap = jnp.take_along_axis(way, nearest, axis=1)[:, 0]
    gaps = len(GAPS_M)
    place = jnp.where(somebody, jnp.searchsorted(GAPS_M[1:-1], gap), gaps - 1)
    request = requests(state, config, params)
    lacks = lacking_j(state, config, params)[jnp.maximum(request, 0)] / params.ev_capacity_j
    lack = jnp.searchsorted(LACKS, lacks)
    asked = serves * (request >= 0)
    told = jnp.asarray(env.actions.speeds)[parts.speed]
    return Seen(
        decisions=_into(place, gaps, serves),
        told_m_per_s=_into(place, gaps, serves * told),
        asked=_into(lack, len(LACKS) + 1, asked),
        taken=_into(lack, len(LACKS) + 1, asked * (parts.accept > 0)),
    )


def watch(
    env: AgentsEnv, params: EnvParams, policy: Policy, episodes: int, seed: int
) -> tuple[Seen, float]:
    """Sums over whole episodes, and the mean return."""
    runner, steps = EpisodeRunner(env, [policy]), episode_steps(env, params)

    def play(keys: jax.Array, params: EnvParams) -> tuple[Seen, jax.Array]:
        """Plays some episodes; returns the sums and the return of each."""
        weights = (policy.weights,)

        def decide(carry: Any, number: jax.Array) -> tuple[Any, None]:
            """Plays one decision in every episode."""
            playing, sums = carry
            after, made = runner.decide(playing, number, weights, params)
            see = jax.vmap(functools.partial(look, env), (0, None, 0))
            seen = see(playing.state, params, made.action)
            return (after, jax.tree.map(jnp.add, sums, seen)), None

        rows, gaps, lacks = len(keys), len(GAPS_M), len(LACKS) + 1
        none = Seen(*(jnp.zeros((rows, size)) for size in (gaps, gaps, lacks, lacks)))
        start = runner.start(keys, params), none
        numbers = jnp.arange(steps, dtype=jnp.int32)
        (ended, sums), _ = lax.scan(decide, start, numbers)
        return sums, ended.scores["return"]

    keys = episode_keys(seed, episodes)
    shared = jax.jit(on_devices(environment_mesh(episodes), play))
    sums, returns = jax.device_get(shared(keys, params))
    return jax.tree.map(lambda leaf: leaf.sum(axis=0), sums), float(np.mean(returns))


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Prints one row per bin: the speeds that MEDs in service are told, and the EVs that they accept."""
    saved = load_policy(options.policy)
    if not saved.about.agents:
        raise InputError(f"policy {options.policy} is a dispatcher's: allowed one of agents")
    env, params = saved.make()
    seen, mean = watch(env, params, saved.policy(env), options.episodes, options.seed)
    told = seen.told_m_per_s / np.maximum(seen.decisions, 1.0)
    taken = seen.taken / np.maximum(seen.asked, 1.0)
    middles = 0.5 * (GAPS_M[1:] + GAPS_M[:-1])
    names = [*(f"{middle:+.0f} m" for middle in middles), "nobody asks"]
    edges = ["nothing", *(f"to {edge:g}" for edge in LACKS[1:]), f"over {LACKS[-1]:g}"]
    print(
        f"{saved.about.scenario}, {options.episodes} episodes, seed {options.seed}, return {mean:.1f}"
    )
    rows = [["nearest EV that asks", "decisions", "told m/s"]]
    rows += [
        [name, f"{count:.0f}", f"{speed:.1f}" if count else "-"]
        for name, count, speed in zip(names, seen.decisions, told, strict=True)
    ]
    print(format_rows(rows))
    rows = [["packs it lacks", "decisions", "taken"]]
    rows += [
        [name, f"{count:.0f}", f"{share:.2f}" if count else "-"]
        for name, count, share in zip(edges, seen.asked, taken, strict=True)
    ]
    print(format_rows(rows))
    return {
        "scenario": saved.about.scenario,
        "episodes": options.episodes,
        "seed": options.seed,
        "return_mean": mean,
        "speeds": list(env.actions.speeds),
        "gap_m": middles.tolist(),
        "decisions": seen.decisions.tolist(),
        "told_m_per_s": told.tolist(),
        "lacks_packs": edges,
        "asked": seen.asked.tolist(),
        "taken_share": taken.tolist(),
    }


def draw(path: Path, result: dict[str, Any]) -> None:
    """Draws both tables as a PNG."""
    figure = new_figure(10.0, 4.0)
    speed, taken = figure.subplots(1, 2)
    there = np.array(result["decisions"][:-1]) > 0
    gaps, told = np.array(result["gap_m"]), np.array(result["told_m_per_s"])
    speed.plot(gaps[there], told[:-1][there], "o-", color="#00796b", label="an EV asks")
    speed.axhline(told[-1], color="#e65100", linestyle="--", label="nobody asks")
    # The axis spans all speeds, so that small differences look small.
    speed.set(ylim=(min(result["speeds"]) - 1.0, max(result["speeds"]) + 1.0))
    speed.set(xlabel="way to the nearest EV that asks, m", ylabel="told speed, m/s")
    speed.legend(frameon=False)
    taken.bar(result["lacks_packs"], result["taken_share"], color="#00796b")
    taken.set(
        xlabel="packs that the EV lacks to its destination", ylabel="share taken", ylim=(0, 1)
    )
    save(figure, path)


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = benchmark_parser("agents", __doc__)
    parser.add_argument(
        "--policy", type=a_path, required=True, metavar="FILE.zip", help="trained policy of agents"
    )
    number = whole_number(least=2)
    parser.add_argument("--episodes", type=number, default=64, help="number of whole episodes")
    parser.add_argument("--seed", type=a_seed, default=0, help="seed of the episodes")
    add_plot(parser, "speed by gap and acceptance by need")
    run_command(parser, measure, arguments, draw)
