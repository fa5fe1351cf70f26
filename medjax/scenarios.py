"""`make`: builds an environment from a preset of `medjax.world.presets`."""

import dataclasses
import difflib
from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from medjax.charging.link import Coupling, couple
from medjax.env.charging_env import ChargingEnv
from medjax.env.observation import OBSERVATIONS
from medjax.env.reward import REWARDS, TERMS, RewardTerm, check_terms
from medjax.errors import MOST_SHOWN, InputError, shown
from medjax.traffic.following import CarFollowing
from medjax.traffic.idm import IDM_PLUS
from medjax.world.charging_params import CoilDesign, build_link
from medjax.world.checks import check_numbers
from medjax.world.kinds import EVS, GAS, KINDS
from medjax.world.numbers import as_numbers, read_number
from medjax.world.params import COILS, SIZES, EnvParams
from medjax.world.presets import PLACES, SCENARIOS, Recipe, change_numbers
from medjax.world.weights import PRICES

__all__ = ["SCENARIOS", "CoilDesign", "build_link", "make", "prepare"]

OPTIONS = (*PLACES, *SIZES, *COILS, "reward_weights")
# Arguments of `make` that hold numbers by name, and what reads such numbers from a file.
READ = {"road": "read_sumo_net", "demand": "read_detectors"}
KEYWORDS = (*READ, "reward", "observation", "following", "coupling")  # arguments other than numbers


def _check(is_good: bool, name: str, given: Any, allowed: str) -> None:
    if not is_good:
        raise InputError(f"{name} = {shown(given)}: allowed {allowed}")


def _unknown(kind: str, name: Any, allowed: Iterable[str]) -> InputError:
    known = list(allowed)
    close = difflib.get_close_matches(name[:MOST_SHOWN], known) if isinstance(name, str) else []
    if close:
        return InputError(f"unknown {kind} {shown(name)}: did you mean {', '.join(close)}?")
    listed = ", ".join(sorted(known)) if len(known) < 20 else "the names in docs/parameters.md"
    return InputError(f"unknown {kind} {shown(name)}: allowed {listed}")


def _named(kind: str, given: Any, known: Mapping[str, Any]) -> Any:
    """The value that medjax knows by this name, or what is given if it is no name."""
    if isinstance(given, str):
        if given not in known:
            raise _unknown(kind, given, known)
        return known[given]
    return given


def _plain(value: Any) -> Any:
    """Converts a checked number or array to JSON types."""
    if isinstance(value, Mapping):
        return {name: _plain(number) for name, number in value.items()}
    return np.asarray(as_numbers(value)).tolist()


def check_names(given: Iterable[Any], allowed: Iterable[str], others: Iterable[str] = ()) -> None:
    """Raises InputError for a name that is not allowed; `others` are further names to suggest."""
    known = list(allowed)
    for name in given:
        weight = isinstance(name, str) and name.startswith("reward_weights.")
        if name not in known and not weight:
            raise _unknown("option", name, [*known, *others])


def _sort(overrides: Mapping[str, Any]) -> tuple[dict[Any, Any], ...]:
    """Sorts overrides into sizes, numbers, coils and weights; checks coils only, the rest where it is used."""
    found: tuple[dict[Any, Any], ...] = ({}, {}, {}, {})
    sizes, numbers, coils, weights = found
    check_names(overrides, OPTIONS, KEYWORDS)
    for key, value in overrides.items():
        if key in SIZES:
            sizes[key] = value
        elif key in COILS:
            read_number(key, value, COILS[key])
            coils[key] = _plain(value)
        elif key in PLACES:
            numbers[key] = value
        elif key == "reward_weights":
            _check(isinstance(value, Mapping), key, value, "numbers by name of the term")
            weights |= value
        else:
            weights[key.removeprefix("reward_weights.")] = value
    return found


def _terms(reward: Any) -> Mapping[str, RewardTerm]:
    """The reward terms: a named set of medjax, or user functions."""
    terms = _named("reward", reward, REWARDS)
    allowed = f"{', '.join(REWARDS)}, or functions by name"
    _check(isinstance(terms, Mapping), "reward", reward, allowed)
    check_terms(terms)
    return terms


def _models(following: Any, coupling: Any) -> tuple[CarFollowing, Coupling]:
    """The car-following and coupling models; None selects IDM+ and the circuit."""
    following = IDM_PLUS if following is None else following
    coupling = couple if coupling is None else coupling
    methods = [getattr(following, name, None) for name in ("prepare", "acceleration")]
    is_model = not isinstance(following, type) and all(map(callable, methods))
    _check(is_model, "following", following, "a model, such as IDM()")
    _check(callable(coupling), "coupling", coupling, "a function")
    return following, coupling


def _profile(numbers: dict[Any, Any], sizes: dict[Any, Any]) -> np.ndarray | None:
    """Sets `num_periods` from a given profile; pops and returns it if all entries share one factor per period."""
    name = "profile" if "profile" in numbers else "demand.profile"
    profile = as_numbers(numbers.get(name))
    if profile is None or not profile.ndim:
        return None
    allowed = SIZES["num_periods"]
    if not allowed.low <= len(profile) <= allowed.high:
        raise InputError(f"{name} has {len(profile)} periods: allowed {allowed}")
    sizes.setdefault("num_periods", len(profile))
    if profile.ndim > 1:
        return None
    del numbers[name]
    return profile


def _as_slow(scenario: str, road: Mapping[str, Any]) -> dict[str, Any]:
    """A road's numbers; where a preset's EVs are slower than cars, as lorries are, they desire no more than there."""
    preset = SCENARIOS[scenario]
    own = np.asarray(preset.params(preset.config).drivers.desired_speed)
    speeds = as_numbers(road.get("desired_speed"))
    if speeds is None or speeds.shape != own.shape:
        return dict(road)
    slow = (own < own[GAS]) & [kind.slots == EVS for kind in KINDS]
    kept = np.where(slow, np.minimum(own, speeds), speeds)
    return {**road, "desired_speed": kept.tolist()}


def prepare(
    name: str = "paper",
    *,
    reward: str | Mapping[str, RewardTerm] | None = None,
    observation: Any = "flat",
    following: CarFollowing | None = None,
    coupling: Coupling | None = None,
    **overrides: Any,
) -> tuple[ChargingEnv, EnvParams, CoilDesign]:
    """Builds and checks everything that `make` does, except the coils' table; computes and compiles nothing.

    Returns:
      (env, params without the table, coils); numbers are NumPy arrays of float32 and int32.

    Raises:
      InputError: as in `make`.
    """
    if not isinstance(name, str) or name not in SCENARIOS:
        raise _unknown("scenario", name, SCENARIOS)
    terms = _terms(SCENARIOS[name].reward if reward is None else reward)
    own = f"{', '.join(OBSERVATIONS)}, or one of your own"
    _check(observation is not None, "observation", observation, own)
    seen = _named("observation", observation, OBSERVATIONS)
    for what, source in READ.items():
        if (read := overrides.pop(what, None)) is not None:
            _check(isinstance(read, Mapping), what, read, f"numbers by name, as of {source}")
            numbers_read = _as_slow(name, read) if what == "road" else read
            overrides = {**numbers_read, **overrides}
    sizes, numbers, coils, weights = _sort(overrides)
    for places, size in (("ramp_x_m", "num_ramps"), ("exit_x_m", "num_exits")):
        given: Any = numbers.get(places, numbers.get(f"road.{places}"))
        if isinstance(given, list | tuple) or getattr(given, "ndim", 0) == 1:
            sizes.setdefault(size, len(given))
    profile = _profile(numbers, sizes)
    config = dataclasses.replace(SCENARIOS[name].config, **sizes)
    if profile is not None:
        numbers["demand.profile"] = np.repeat(profile[:, None], 1 + config.num_ramps, axis=1)
    params = SCENARIOS[name].params(config, numbers)
    given = {term: price.default for term, price in PRICES.items()} | params.reward_weights
    known = {term: given.get(term, float(term not in TERMS)) for term in terms}
    for term in weights:
        if term not in known:
            raise _unknown("reward term", term, known)
    params = params.replace(reward_weights=known | weights)
    params = check_numbers(config, change_numbers(params, numbers))
    followed, coupled = _models(following, coupling)
    env = ChargingEnv(
        config, reward=terms, observation=seen, name=name, following=followed, coupling=coupled
    )
    plain = {key: _plain(value) for key, value in overrides.items()}
    env.recipe = Recipe(name, plain, reward, observation, following, coupling)
    return env, params, CoilDesign(**coils)


def make(
    name: str = "paper",
    *,
    reward: str | Mapping[str, RewardTerm] | None = None,
    observation: Any = "flat",
    following: CarFollowing | None = None,
    coupling: Coupling | None = None,
    **overrides: Any,
) -> tuple[ChargingEnv, EnvParams]:
    """Builds an environment from a preset, with numbers changed by name.

    Args:
      name: one of `SCENARIOS`.
      reward: name of a set of terms (`medjax.env.reward.REWARDS`: "paper", "money"), or functions by name; None takes
        that of the preset. A term without a weight in the preset gets weight 0 if it is one of `medjax.TERMS`, and 1
        if it is your own, unless it has the name of a price (`medjax.world.weights.PRICES`): then it gets that.
      observation: a name in `medjax.env.observation.OBSERVATIONS`, or your own (`ChargingEnv`).
      following: car-following model (`medjax.traffic.following.CarFollowing`); None takes IDM+.
      coupling: model of coil efficiency; None takes the circuit, `medjax.charging.link.COUPLINGS` has others.
      **overrides: sizes of `EnvConfig` (`num_evs=80`); numbers of `EnvParams` by name (`cooldown_s=30`), with the group
        if the name is not unique (`{"ev.mass_kg": 2000}`); coils (`med_coil_radius_m=0.4`); or
        `reward_weights={"dispatches": -1.0}`. `road` and `demand` hold several numbers by name, such as
        `medjax.read_sumo_net` and `medjax.read_detectors` return; what is given beside them takes precedence. EVs that
        are lorries in the preset stay as slow as there, whatever speed limit `road` has. The
        lengths of `ramp_x_m`, `exit_x_m` and `profile` set `num_ramps`, `num_exits` and `num_periods` unless these are
        given.

    Returns:
      (env, params); params are float32 and int32 arrays, ready for batching. `env.recipe` records the arguments.

    Raises:
      InputError: a scenario or name is unknown, or a value is not allowed.
    """
    own: dict[str, Any] = {"reward": reward, "observation": observation}
    own |= {"following": following, "coupling": coupling}
    env, params, coils = prepare(name, **own, **overrides)
    link = build_link(coils, params.link)
    table = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), link.inductance)
    params = params.replace(link=link.replace(inductance=table))
    params = jax.tree.map(jnp.asarray, params)
    if env.observation not in OBSERVATIONS.values():  # check a user's observation early
        jax.eval_shape(env.reset, jax.random.key(0), params)
    return env, params
