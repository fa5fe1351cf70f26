"""`python -m benchmarks.variance`: what makes up the spread of returns on `paper`, and what reduces it.

A demand is the initial traffic together with all later arrivals. Each demand is played with several streams of drivers'
noise. An analysis of variance with one random factor separates the two (Searle, Casella and McCulloch 1992, chapter 3).
The command reports:

- the share of the returns' variance that is due to demand;
- the correlation of two policies' returns over episodes, and over noise streams at one demand;
- relief: the return, with one depleted EV's penalty refunded for each EV that arrives without enough charge for its
  trip. Potential-based shaping by that need sums to the same over an episode (Ng, Harada and Russell 1999; arrivals
  taken out as in Mao et al. 2018, arXiv:1807.02264). Beside it stands the spread with the best weight by least squares.
"""

import argparse
import math
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import medjax
from benchmarks.command import a_seed, benchmark_parser, run_command, say, whole_number
from medjax.env.contract import Environment
from medjax.env.forecast import lacking_j
from medjax.env.reward import TERMS, Outcome
from medjax.episodes.keys import episode_keys
from medjax.episodes.runner import EpisodeRunner, episode_steps
from medjax.numerics.devices import environment_mesh, on_devices
from medjax.numerics.rows import CACHED_ROWS
from medjax.policies.policy import Policy
from medjax.policies.pretrained import PRETRAINED, pretrained
from medjax.policies.rules import BASELINES
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import EnvState
from train.evaluation.statistics import bootstrap_ci95
from train.evaluation.tables import format_rows, interval, short

PRESET = "paper"
COMPARED = "forecast"  # the policy that the others are correlated with
CAME = "came_needy"  # name of the reward term below
RULES = ("budgeted", COMPARED, "none")


def needy(state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
    """EVs on the road without enough charge for their trip at cruising speed, `(E,)` bool."""
    on_road = state.vehicles.active[config.ev_slots]
    return on_road & (lacking_j(state, config, params) > 0.0)


def came_needy(outcome: Outcome) -> jax.Array:
    """A reward term: EVs that entered in this decision without enough charge for their trip."""
    slots = outcome.config.ev_slots
    before, after = outcome.before.vehicles, outcome.after.vehicles
    # A smaller position means that another EV has taken the slot.
    goes_on = before.active[slots] & (after.x[slots] >= before.x[slots])
    come = needy(outcome.after, outcome.config, outcome.params) & ~goes_on
    return jnp.sum(come, dtype=jnp.float32)


def make(**numbers: Any) -> tuple[Environment, Any]:
    """The preset with overrides, whose reward also counts EVs that enter in need."""
    weight: dict[str, Any] = {f"reward_weights.{CAME}": 1.0}
    return medjax.make(PRESET, reward={**TERMS, CAME: came_needy}, **weight, **numbers)


def play(
    env: Environment, params: Any, policies: Mapping[str, Policy], sizes: tuple[int, int], seed: int
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Returns and numbers of EVs that entered in need, `(demands, streams)` each, of all policies in the same episodes.

    Args:
        env, params: of `make`.
        policies: by name.
        sizes: number of demands, and of noise streams for each.
        seed: of demands and noise.
    """
    demands, streams = sizes
    runner, steps = EpisodeRunner(env, [*policies.values()]), episode_steps(env, params)
    own = episode_keys(seed, demands * streams)
    of_demand = jnp.repeat(own[::streams], streams)  # keys of the reset, which seeds all arrivals

    def whole(rows: Any, same: Any) -> tuple[jax.Array, jax.Array]:
        """Plays some episodes with all policies; results are `(rows, policies)`."""
        (of_demand, own), (weights, params) = rows, same
        begun = runner.start(of_demand, params)
        there = jax.vmap(needy, (0, None, None))(begun.state, env.config, params)
        split = jax.vmap(jax.random.split, (0, None))(own, 3)
        begun = begun.replace(streams=jnp.repeat(split, len(policies), axis=0))
        scores = runner.to_end(begun, weights, params, steps).scores
        came = scores[f"reward_{CAME}"]
        found = scores["return"] - came, came + jnp.sum(there, axis=1)
        return jax.tree.map(lambda each: each.reshape(-1, len(policies)), found)

    at_once = max(CACHED_ROWS // len(policies), 1)
    run = jax.jit(on_devices(environment_mesh(demands * streams), whole, at_once))
    weights = tuple(policy.weights for policy in policies.values())
    found = jax.device_get(run((of_demand, own), (weights, params)))
    returns, came = (np.asarray(each, np.float64).reshape(*sizes, -1) for each in found)
    return {name: (returns[..., index], came[..., index]) for index, name in enumerate(policies)}


def within(values: np.ndarray) -> np.ndarray:
    """Variance over streams within a demand, `(rows, demands, streams)` to `(rows,)`."""
    return np.asarray(np.mean(np.var(values, axis=2, ddof=1), axis=1))


def demands_share(values: np.ndarray) -> np.ndarray:
    """Share of the variance due to demand, `(rows, demands, streams)` to `(rows,)`; below 0 only by chance."""
    inside = within(values)
    between = np.var(np.mean(values, axis=2), axis=1, ddof=1) - inside / values.shape[2]
    return np.asarray(between / (between + inside))


def correlation(pairs: np.ndarray) -> np.ndarray:
    """Correlation of two policies' returns, `(rows, demands, streams, 2)` to `(rows,)`."""
    apart = pairs - pairs.mean(axis=(1, 2), keepdims=True)
    first, second = apart[..., 0], apart[..., 1]
    both, one, other = (
        np.sum(product, axis=(1, 2)) for product in (first * second, first**2, second**2)
    )
    return np.asarray(both / np.sqrt(one * other))


def correlation_within(pairs: np.ndarray) -> np.ndarray:
    """The same over streams within a demand."""
    return correlation(pairs - pairs.mean(axis=2, keepdims=True))


def estimate(
    statistic: Callable[[np.ndarray], np.ndarray], samples: np.ndarray, seed: int
) -> dict[str, Any]:
    """A statistic of samples `(demands, streams, ...)`, and its interval by resampling demands."""
    value = float(statistic(samples[None])[0])
    return {"value": value, "ci95": list(bootstrap_ci95(samples, seed, statistic=statistic))}


def describe(returns: np.ndarray, came: np.ndarray, weight: float, seed: int) -> dict[str, Any]:
    """The parts of a policy's spread of returns; `weight` is that of a depleted EV."""
    apart = came - came.mean()
    best = float(np.sum(apart * returns) / max(np.sum(apart**2), 1e-12))
    return {
        "return_mean": float(returns.mean()),
        "spread": float(returns.std()),
        "demands_share": estimate(demands_share, returns, seed),
        "spread_at_one_demand": float(np.sqrt(within(returns[None])[0])),
        "relief_spread": float(np.std(returns - weight * came)),
        "best_weight": best,
        "best_spread": float(np.std(returns - best * came)),
    }


def _shown(found: Mapping[str, Any]) -> str:
    return f"{short(found['value'])} {interval(found['ci95'])}"


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Prints the results of policies and of pairs."""
    env, params = make()
    policies = {PRETRAINED: pretrained(env)} | {name: BASELINES[name](env) for name in RULES}
    sizes, seed = (options.demands, options.streams), options.seed
    say(f"{len(policies)} policies, {math.prod(sizes):,} episodes each ...")
    played = play(env, params, policies, sizes, seed)
    weight = float(params.reward_weights["depleted"])
    rows = {name: describe(*each, weight, seed) for name, each in played.items()}
    print(f"{PRESET}, seed {seed}: {sizes[0]} demands x {sizes[1]} streams of drivers' noise")
    spreads = ("spread", "spread_at_one_demand", "relief_spread", "best_spread", "best_weight")
    headings = ["return", "spread", "at one demand", "of relief", "least", "at weight"]
    table = [["policy", *headings, "demand's share of variance, 95 % CI"]]
    for name, row in rows.items():
        numbers = [short(row[key]) for key in ("return_mean", *spreads)]
        table.append([name, *numbers, _shown(row["demands_share"])])
    print(format_rows(table))
    table = [["correlation with " + COMPARED, "same episode, 95 % CI", "at one demand, 95 % CI"]]
    for name in (name for name in policies if name != COMPARED):
        pairs = np.stack([played[name][0], played[COMPARED][0]], axis=-1)
        both = {"whole": correlation, "at_one_demand": correlation_within}
        found = {key: estimate(statistic, pairs, seed) for key, statistic in both.items()}
        rows[name]["correlation"] = found
        table.append([name, *map(_shown, found.values())])
    print(f"\n{format_rows(table)}")
    return {"scenario": PRESET, "demands": sizes[0], "streams": sizes[1], "policies": rows}


def main(arguments: list[str] | None = None) -> None:
    parser = benchmark_parser("variance", __doc__)
    several = whole_number(least=2, most=4096)
    parser.add_argument(
        "--demands", type=several, default=64, help="number of demands (default: %(default)s)"
    )
    of_each = "streams of driver noise per demand (default: %(default)s)"
    parser.add_argument("--streams", type=several, default=16, help=of_each)
    parser.add_argument("--seed", type=a_seed, default=0, help="seed of demands and noise")
    run_command(parser, measure, arguments)
