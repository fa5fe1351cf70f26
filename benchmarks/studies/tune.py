"""`python -m benchmarks.tune`: finds the best settings of the rules that have any.

The rules that PPO has to beat should be as good as they can be. `medjax.policies.paced` is played with every interval
and ramp, `medjax.policies.forecast` with every window and threshold. All play the same episodes, whose seed no
evaluation uses by default. `medjax.policies.budgeted` has too many numbers for a grid. It starts with the preset's own
numbers, or as `forecast`, and climbs the surface of its returns, on new episodes in every round. The last line compares
it with `forecast` on the episodes of the grids.

In a round, groups of variants play one episode each, in pairs that take opposite steps from a centre (antithetic
sampling, as in evolution strategies: Salimans et al. 2017, arXiv:1703.03864). Subtracting the group's mean return
removes the effect of the episode's demand, which is most of the variance. A quadratic in all numbers is fitted to the
rest by least squares (response surface method, Box and Wilson 1951), and the centre moves to its top.
"""

import argparse
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

import medjax
from benchmarks.command import add_number, episodes_parser, run_command, whole_number
from benchmarks.studies.base import estimate
from medjax.commandline import add_set_option, parse_overrides
from medjax.env.contract import Environment
from medjax.episodes.keys import episode_keys
from medjax.episodes.runner import EpisodeRunner, episode_steps
from medjax.episodes.scores import evaluate_policies
from medjax.numerics.devices import environment_mesh, on_devices
from medjax.numerics.rows import rows_that_fit
from medjax.policies.policy import Policy
from medjax.policies.rules import Budget, budgeted, forecast, paced, tuned_budget

RULES: dict[str, Callable[..., Policy]] = {
    "paced": paced,
    "forecast": forecast,
    "budgeted": budgeted,
}
GRID: dict[str, list[dict[str, Any]]] = {
    "paced": [
        {"ramp": ramp, "interval_s": interval}
        for ramp in (1, 2)
        for interval in (24, 28, 30, 32, 34, 36, 38, 40)
    ],
    "forecast": [
        {"window_s": window, "enough": enough}
        for window in (45, 60, 75)
        for enough in (4.0, 4.5, 5.0, 5.5, 6.0, 6.5)
    ],
}

CLIMB_SEED = 1_000_000  # of the first round's episodes; each later round adds 1
GROUP = 16  # variants that play one episode
LEAST_GROUPS = 8  # enough to fit the 54 terms of a quadratic in nine numbers
LEAST_CURVATURE = 4.0  # of the return per step squared; keeps steps short where the fit has no top
# The numbers that make `budgeted` act as `forecast`, and the spread of a round's variants.
AS_FORECAST = Budget(pack=0.0, coming=1.0, free=-1.0, ahead=0.0, time_left=0.0, ramp=(-5.0,) * 4)
SPREAD = Budget(pack=1.5, coming=0.15, free=0.15, ahead=4.0, time_left=1.0, ramp=(0.8,) * 4)


class Responses:
    """Plays variants of `budgeted`, each with its own numbers, `plays` at once (a multiple of GROUP)."""

    def __init__(self, env: Environment, params: Any, plays: int) -> None:
        policy = budgeted(env)
        self.params, self.weights_of = params, ravel_pytree(policy.weights)[1]
        runner, steps = EpisodeRunner(env, [policy]), episode_steps(env, params)

        def play(row: tuple[jax.Array, jax.Array], params: Any) -> jax.Array:
            numbers, key = row
            weights = [self.weights_of(numbers)]

            def decide(number: jax.Array, episodes: Any) -> Any:
                return runner.decide(episodes, number, weights, params)[0]

            start = runner.start(key[None], params)
            return jax.lax.fori_loop(0, steps, decide, start).scores["return"][0]

        row = jax.eval_shape(runner.start, episode_keys(0, 1), params)
        mesh, at_once = environment_mesh(plays), rows_that_fit(row)
        self._play = jax.jit(on_devices(mesh, jax.vmap(play, (0, None)), at_once))

    def of(self, numbers: np.ndarray, seed: int) -> np.ndarray:
        """Returns `(groups, GROUP)` of variants `(groups, GROUP, n)`, with one episode of the seed per group."""
        keys = jnp.repeat(episode_keys(seed, numbers.shape[0]), GROUP)
        rows = jnp.asarray(numbers, jnp.float32).reshape(len(keys), -1), keys
        return np.asarray(self._play(rows, self.params), np.float64).reshape(numbers.shape[:2])


def numbers_of(budget: Budget) -> np.ndarray:
    """The numbers of a budget, `(n,)` float64, in the order of its leaves."""
    return np.asarray(ravel_pytree(budget)[0], np.float64)


def directions(rng: np.random.Generator, groups: int, size: int) -> np.ndarray:
    """Standard normal steps `(groups, GROUP, size)`; the second half of each group negates the first."""
    half = rng.standard_normal((groups, GROUP // 2, size))
    return np.concatenate([half, -half], axis=1)


def fit(steps: np.ndarray, returns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slopes `(n,)` and curvatures `(n, n)` of the returns, and the slopes' standard errors `(n,)`.

    Args:
        steps: `(groups, GROUP, n)`.
        returns: `(groups, GROUP)`.
    """
    groups, _, size = steps.shape
    one, other = np.triu_indices(size)
    terms = np.concatenate([steps, steps[..., one] * steps[..., other]], axis=2)
    terms = (terms - terms.mean(1, keepdims=True)).reshape(groups * GROUP, -1)
    own = (returns - returns.mean(1, keepdims=True)).ravel()
    found, *_ = np.linalg.lstsq(terms, own, rcond=None)
    rest = own - terms @ found
    variance = (rest @ rest) / (groups * (GROUP - 1) - terms.shape[1])
    errors = np.sqrt(variance * np.diag(np.linalg.inv(terms.T @ terms)))
    curvature = np.zeros((size, size))
    curvature[one, other] = found[size:]
    return found[:size], curvature + curvature.T, errors[:size]


def step_to_top(slope: np.ndarray, curvature: np.ndarray) -> np.ndarray:
    """The step `(n,)` to the top of the fitted surface, scaled down to at most 1 in each number."""
    bend, axes = np.linalg.eigh(curvature)
    along = (axes.T @ slope) / np.maximum(-bend, LEAST_CURVATURE)
    step = axes @ along
    return step / max(1.0, float(np.abs(step).max()))


def play_grid(env: Environment, params: Any, rule: str, options: argparse.Namespace) -> Any:
    """Plays every setting of a grid; prints a line for each, and the best one."""
    named = {", ".join(f"{k} {v:g}" for k, v in row.items()): row for row in GRID[rule]}
    policies = {name: RULES[rule](env, **row) for name, row in named.items()}
    scores = evaluate_policies(env, params, policies, options.episodes, options.seed, batch=32)
    rows = []
    for name, score in scores.items():
        mean, (low, high) = estimate(score["return"], options.seed).values()
        rows.append(named[name] | {"return_mean": mean, "return_ci95": [low, high]})
        print(f"{rule}: {name:<26} {mean:8.1f} [{low:.1f}, {high:.1f}]", flush=True)
    best = max(rows, key=lambda row: row["return_mean"])
    print(f"best {rule}: " + ", ".join(f"{name} {best[name]:g}" for name in GRID[rule][0]))
    return {"rows": rows, "best": best}


def climb(env: Environment, params: Any, options: argparse.Namespace) -> Any:
    """Tunes `budgeted`; prints its numbers after every round and the gain on `forecast`."""
    responses = Responses(env, params, GROUP * options.groups)
    own = tuned_budget(env)
    numbers = numbers_of(AS_FORECAST if own == Budget() else own)
    spread = numbers_of(SPREAD)
    rng, rounds = np.random.default_rng(options.seed), []
    for number in range(options.rounds):
        steps = directions(rng, options.groups, len(numbers))
        returns = responses.of(numbers + spread * steps, CLIMB_SEED + number)
        slope, curvature, error = fit(steps, returns)
        numbers = numbers + spread * step_to_top(slope, curvature)
        mean = float(returns.mean())
        found = {"numbers": numbers, "slope": slope, "slope_error": error}
        rounds.append({"return_mean": mean} | {name: each.tolist() for name, each in found.items()})
        print(f"budgeted: round {number + 1:2}, {mean:8.1f}, to {_shown(numbers)}", flush=True)
    best = budgeted(env, responses.weights_of(jnp.asarray(numbers, jnp.float32)))
    rules = {"budgeted": best, "forecast": forecast(env)}
    scores = evaluate_policies(env, params, rules, options.episodes, options.seed)
    ours, theirs = scores["budgeted"], scores["forecast"]
    gain, (low, high) = estimate(ours["return"] - theirs["return"], options.seed).values()
    means = {name: float(np.mean(ours[name])) for name in ("return", "meds_dispatched")}
    print(f"best budgeted: {_shown(numbers)}")
    print(
        f"it returns {means['return']:.1f}, sends {means['meds_dispatched']:.2f} MEDs, "
        f"gains on forecast {gain:.1f} [{low:.1f}, {high:.1f}]"
    )
    return {"rounds": rounds, "gain_mean": gain, "gain_ci95": [low, high], "means": means}


def _shown(numbers: np.ndarray) -> str:
    """The numbers of a `Budget` with their names, in the order of its leaves."""
    names = [*(name for name in Budget.__dataclass_fields__ if name != "ramp")]
    names += [f"ramp {number}" for number in range(1, len(numbers) - len(names) + 1)]
    return ", ".join(f"{name} {value:.2f}" for name, value in zip(names, numbers, strict=True))


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Tunes each rule and prints the results."""
    env, params = medjax.make(options.scenario, **parse_overrides(options.overrides))
    return {
        rule: play_grid(env, params, rule, options) if rule in GRID else climb(env, params, options)
        for rule in options.rules
    }


def main(arguments: list[str] | None = None) -> None:
    parser = episodes_parser("tune", __doc__, episodes=256, seed=31)
    parser.add_argument("--rules", nargs="+", default=list(RULES), choices=list(RULES))
    add_set_option(parser, "set a parameter of the environment; repeatable")
    add_number(parser, "--rounds", 10, "rounds of hill climbing")
    groups = f"episodes per round of hill climbing, each for {GROUP} rules"
    add_number(parser, "--groups", 96, groups, whole_number(LEAST_GROUPS))
    run_command(parser, measure, arguments)
