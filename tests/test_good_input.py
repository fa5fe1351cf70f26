"""What the documentation allows is accepted, to the ends of every range and in every form that a number has."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from medjax.scenarios import prepare
from medjax.world import ranges
from medjax.world.params import EnvConfig, EnvParams, check_numbers
from tests import fuzz
from train.algorithms.ppo.settings import PPOConfig
from train.runs.arguments import parse_request

ROWS = {row.name: row for row in [*fuzz.ROWS, *fuzz.COILS]}
FIELDS = {field.name: field for field in dataclasses.fields(PPOConfig)}

# What a number at the end of its range needs of others; see "What must go together".
LONG = {"length_m": 200e3}
BESIDE = {
    "road.length_m": {"num_ramps": 0},
    "road.ramp_x_m": LONG | {"num_ramps": 1, "acceleration_lane_m": 10, "ramp_speed": 1},
    "road.acceleration_lane_m": LONG | {"num_ramps": 1, "ramp_speed": 1},
    "demand.ramp_speed": {"max_braking": 9},
    "demand.arrival_soc_low": {"arrival_soc_high": 1},
    "demand.arrival_soc_high": {"arrival_soc_low": 0},
    "charging.request_soc": {"target_soc": 1},
    "charging.target_soc": {"request_soc": 0},
    "fleet.size": {"num_meds": 64},
    "fleet.service_lane": {"num_lanes": 6},
    "num_evs": {"num_gas": 0},
}


def reachable(row):
    """The range, but that a ramp needs its acceleration lane before the road ends."""
    high = row.high - 10 if row.name == "road.ramp_x_m" else row.high
    return row.low, high


def forms(value):
    """One number as all that it may be given as."""
    yield value
    if value == int(value) if math.isfinite(value) else False:
        yield int(value)
        yield np.int64(value)
        yield np.asarray(int(value))
    yield np.float64(value)
    yield np.asarray(value)


def accepted(name, value):
    env, params, coils = prepare(**{name: value}, **BESIDE.get(name, {}))
    group, _, leaf = name.rpartition(".")
    holder = getattr(params, group) if group else params
    for owner in (env.config, coils, holder):
        if isinstance(owner, dict):
            return owner[leaf]
        if hasattr(owner, leaf):
            return getattr(owner, leaf)
    raise AssertionError(name)


@pytest.mark.parametrize("name", ROWS)
def test_ends_of_ranges(name):
    """Both ends, in every form; a size is a whole number, and 4.0 is none."""
    row = ROWS[name]
    for end in reachable(row):
        for value in forms(end):
            if name in ranges.SIZES and row.whole and np.asarray(value).dtype.kind == "f":
                continue
            got = np.asarray(accepted(name, value))
            np.testing.assert_allclose(got, end, rtol=1e-7)
            if got.ndim:
                accepted(name, [value] * got.size)
                accepted(name, np.full(got.shape, value, np.float32))


def test_a_number_on_the_device():
    for value in (jnp.float32(30), jnp.int32(30), jnp.bfloat16(30)):
        assert accepted("fleet.cooldown_s", value) == 30
    assert accepted("fleet.size", jnp.int32(3)) == 3
    np.testing.assert_array_equal(accepted("demand.ramp_per_h", jnp.arange(4.0)), range(4))


def numbers(row):
    low, high = reachable(row)
    if row.whole:
        return st.integers(int(low), int(high))
    if math.isinf(high):
        return st.floats(low, 1e30) | st.just(math.inf)
    return st.floats(low, high) | st.floats(low, min(high, low + 1))


@given(st.data())
@settings(max_examples=150)
def test_any_number_of_its_range(data):
    name = data.draw(st.sampled_from(sorted(ROWS)))
    value = data.draw(numbers(ROWS[name]))
    np.testing.assert_allclose(np.asarray(accepted(name, value)), value, rtol=1e-6, atol=1e-37)


INDEPENDENT = sorted(
    name for name in ROWS if name not in BESIDE and name not in ranges.SIZES and "_soc" not in name
)


@given(
    st.fixed_dictionaries(
        {name: numbers(ROWS[name]) for name in INDEPENDENT if "braking" not in name}
    )
)
@settings(max_examples=25)
def test_all_numbers_at_once(numbers):
    """And what comes out is accepted as it is."""
    env, params, _ = prepare(**numbers)
    again = check_numbers(env.config, params)
    assert again.episode_decisions == numbers["episode_decisions"]


def test_every_field_has_a_range():
    """In the code and in the documentation: of every number that there is, and the same."""
    _, params, coils = prepare()
    assert set(ranges.SIZES) == {field.name for field in dataclasses.fields(EnvConfig)}
    assert set(ranges.COILS) == {field.name for field in dataclasses.fields(coils)}
    stated = {**ranges.SIZES, **ranges.OTHERS, **ranges.COILS}
    for field in dataclasses.fields(EnvParams):
        holder = getattr(params, field.name)
        if field.name == "reward_weights":
            stated |= {f"reward_weights.{term}": ranges.WEIGHT for term in holder}
        elif dataclasses.is_dataclass(holder):
            leaves = {leaf.name for leaf in dataclasses.fields(holder)} - {"inductance"}
            assert set(ranges.GROUPS[field.name]) == leaves
            stated |= {f"{field.name}.{leaf}": ranges.GROUPS[field.name][leaf] for leaf in leaves}
        else:
            assert field.name in ranges.OTHERS
    assert stated.keys() == ROWS.keys()
    for name, limits in stated.items():
        assert (limits.low, limits.high, limits.whole) == (*ends(name), ROWS[name].whole), name


def ends(name):
    return ROWS[name].low, ROWS[name].high


# The learner's settings.

BESIDE_SETTING = {
    "num_minibatches": {"num_envs": 2**20},
    "total_timesteps": {"num_envs": 2**20},
    "num_envs": {"num_minibatches": 1},
    "num_seeds": {},
}


def good_settings(field):
    one = field.default[0] if isinstance(field.default, tuple) else field.default
    if isinstance(one, bool):
        return [True, False]
    if field.metadata["choices"]:
        return field.metadata["choices"]
    if not isinstance(one, int | float):
        return []
    return [field.metadata["low"], field.metadata["high"], one]


@pytest.mark.parametrize("name", FIELDS)
def test_settings(name):
    """In Python and on the command line, to the ends of the range."""
    field = FIELDS[name]
    beside = BESIDE_SETTING.get(name, {})
    flag = "--" + name.replace("_", "-")
    others = [f"--{other.replace('_', '-')}={value}" for other, value in beside.items()]
    for value in good_settings(field):
        given = (value, value) if isinstance(field.default, tuple) else value
        config = PPOConfig(**{name: given}, **beside)
        assert getattr(config, name) == given
        if isinstance(value, bool):
            argv = [flag if value else flag.replace("--", "--no-", 1)]
        elif isinstance(given, tuple):
            argv = [flag, *map(str, given)]
        else:
            argv = [f"{flag}={value}"]
        assert parse_request(PPOConfig, [*argv, *others]).config == config
        if isinstance(value, int | float) and not isinstance(value, bool) and given is value:
            same = np.asarray(value)[()]
            assert PPOConfig(**{name: same}, **beside) == config


def test_paths_of_any_usual_name():
    for name in (
        "runs/a",
        "../x",
        "/tmp/x y",
        "-rf",
        "con",
        "é€",
        "🚚",
        "a" * 255,
        "./~",
        "x.",
        "...",
        "a/../b",
        "run/",
    ):
        assert str(parse_request(PPOConfig, [f"--run-dir={name}"]).run_dir) == name.rstrip(
            "/"
        ).removeprefix("./")
