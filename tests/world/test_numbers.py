"""Every documented value is accepted, up to both ends of its range and in every numeric type."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from docs.parameters import PAGE, written
from medjax.env.reward import MONEY, TERMS
from medjax.scenarios import prepare
from medjax.world.checks import check_numbers
from medjax.world.params import (
    COILS,
    GROUPS,
    OTHERS,
    SIZES,
    EnvConfig,
    EnvParams,
)
from medjax.world.weights import PRICES, WEIGHT, WEIGHTS
from tests.documented import NUMBERS

ALL = {**TERMS, **MONEY}  # a reward that has all weights
# Other numbers that the end of a range requires; see "What must go together".
LONG = {"length_m": 200e3}
DAYS = {"episode_decisions": 10_000_000, "rounds_per_decision": 100}
BESIDE = {
    "road.length_m": {"num_ramps": 0},
    "road.ramp_x_m": LONG | {"num_ramps": 1, "acceleration_lane_m": 10, "ramp_speed": 1},
    "road.acceleration_lane_m": LONG | {"num_ramps": 1, "ramp_speed": 1},
    "demand.ramp_speed": {"max_braking": 9},
    "road.exit_x_m": LONG | {"num_exits": 1, "exit_lane_m": 10},
    "demand.exit_share": {"num_exits": 1},
    "demand.arrival_soc_low": {"arrival_soc_high": 1},
    "demand.arrival_soc_high": {"arrival_soc_low": 0},
    "demand.surge_from_s": {"surge_until_s": 1e9},
    "demand.surge_until_s": {"surge_from_s": 0},
    "charging.request_soc": {"target_soc": 1},
    "charging.target_soc": {"request_soc": 0},
    "fleet.size": {"num_meds": 64},
    "fleet.service_lane": {"num_lanes": 6},
    "num_evs": {"num_gas": 0},
    "num_depots": {"num_ramps": 8},
    "num_plugs": {"num_exits": 1},
    "incidents.incident_from_s": DAYS | {"num_incidents": 1, "incident_until_s": 1e9},
    "incidents.incident_until_s": {"num_incidents": 1, "incident_from_s": 0},
    "incidents.incident_from_x_m": LONG | {"num_incidents": 1, "incident_until_x_m": 200e3},
    "incidents.incident_until_x_m": LONG | {"num_incidents": 1, "incident_from_x_m": 0},
    "incidents.incident_lane": {"num_incidents": 1, "num_lanes": 6},
    "incidents.incident_s": {"num_incidents": 1},
    **{f"reward_weights.{term}": {"reward": "money"} for term in MONEY},
}


def reachable(row):
    """The range, less the lanes that a ramp needs before the road ends and an exit after it begins."""
    high = row.high - 10 if row.name in ("road.ramp_x_m", "road.exit_x_m") else row.high
    low = 10 if row.name == "road.exit_x_m" else row.low
    return low, high


def forms(value):
    """One number in every type that is accepted."""
    yield value
    if value == int(value) if math.isfinite(value) else False:
        yield int(value)
        yield np.int64(value)
        yield np.asarray(int(value))
    yield np.float64(value)
    yield np.asarray(value)


def accepted(name, value):
    env, params, coils = prepare(**{"reward": ALL, name: value, **BESIDE.get(name, {})})
    group, _, leaf = name.rpartition(".")
    holder = getattr(params, group) if group else params
    for owner in (env.config, coils, holder):
        if isinstance(owner, dict):
            return owner[leaf]
        if hasattr(owner, leaf):
            return getattr(owner, leaf)
    raise AssertionError(name)


@pytest.mark.parametrize("name", NUMBERS)
def test_ends_of_ranges(name):
    """Sizes must be integers: 4.0 is refused."""
    row = NUMBERS[name]
    for end in reachable(row):
        for value in forms(end):
            if name in SIZES and row.whole and np.asarray(value).dtype.kind == "f":
                continue
            got = np.asarray(accepted(name, value))
            assert got.size
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
    name = data.draw(st.sampled_from(sorted(NUMBERS)))
    value = data.draw(numbers(NUMBERS[name]))
    np.testing.assert_allclose(np.asarray(accepted(name, value)), value, rtol=1e-6, atol=1e-37)


INDEPENDENT = sorted(
    name for name in NUMBERS if name not in BESIDE and name not in SIZES and "_soc" not in name
)


@given(
    st.fixed_dictionaries(
        {name: numbers(NUMBERS[name]) for name in INDEPENDENT if "braking" not in name}
    )
)
@settings(max_examples=25)
def test_all_numbers_at_once(numbers):
    """And the result passes the checks again."""
    env, params, _ = prepare(reward=ALL, **numbers)
    again = check_numbers(env.config, params)
    assert again.episode_decisions == numbers["episode_decisions"]


def test_every_field_has_a_range():
    """The code and the documentation state the same range for every number."""
    _, params, coils = prepare(reward=ALL)
    assert set(SIZES) == {field.name for field in dataclasses.fields(EnvConfig)}
    assert set(COILS) == {field.name for field in dataclasses.fields(coils)}
    stated = {**SIZES, **OTHERS, **COILS}
    for field in dataclasses.fields(EnvParams):
        holder = getattr(params, field.name)
        if field.name == "reward_weights":
            stated |= {f"reward_weights.{term}": WEIGHT for term in WEIGHTS | PRICES}
        elif dataclasses.is_dataclass(holder):
            leaves = {leaf.name for leaf in dataclasses.fields(holder)} - {"inductance"}
            assert set(GROUPS[field.name]) == leaves
            stated |= {f"{field.name}.{leaf}": GROUPS[field.name][leaf] for leaf in leaves}
        else:
            assert field.name in OTHERS
    assert stated.keys() == NUMBERS.keys()
    for name, limits in stated.items():
        row = NUMBERS[name]
        assert (limits.low, limits.high, limits.whole) == (row.low, row.high, row.whole), name


def test_parameters_page_is_current():
    """`python -m docs.parameters` would not change it."""
    page = PAGE.read_text(encoding="utf-8")
    assert written(page) == page
    assert page.count("<!-- table: ") == 5
