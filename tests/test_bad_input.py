"""Bad input from Python ends in one clear line before anything compiles. `test_bad_commands.py` counts the inputs."""

import dataclasses
import math

import jax
import numpy as np
import pytest

import medjax
import train.runs.session  # noqa: F401 - its import takes seconds, which no refusal should be charged for
from medjax.scenarios import prepare
from medjax.world import checks as world
from medjax.world.params import SIZES
from tests import bad_values
from tests.documented import COILS, NUMBERS
from tests.refusals import not_refused
from train.algorithms.ppo.settings import PPOConfig
from train.option import example

pytestmark = pytest.mark.usefixtures("nothing_starts")

# The environment: by name, by size, and by leaf.


def overrides_of(name):
    return [
        (value, lambda value=value: medjax.make(**{name: value}))
        for value in bad_values.bad_values(NUMBERS[name])
    ]


@pytest.mark.parametrize("name", NUMBERS)
def test_bad_overrides(name):
    """Numbers, sizes, coils and weights as arguments of `make`."""
    short = name.rpartition(".")[2]
    # The length of a list of places sets the number of ramps or exits, whose check may come first.
    counted = {"ramp_x_m": "ramp", "exit_x_m": "exit"}
    assert not not_refused(overrides_of(name), counted.get(short, short))


def sizes_of(name):
    return [
        (v, lambda v=v: medjax.EnvConfig(**{name: v})) for v in bad_values.bad_values(NUMBERS[name])
    ]


@pytest.mark.parametrize("name", SIZES)
def test_bad_sizes(name):
    assert not not_refused(sizes_of(name), name)


def leaves_of(name):
    env, params, _ = prepare()
    group, _, leaf = name.rpartition(".")

    def changed(value):
        if not group:
            return params.replace(**{leaf: value})
        holder = getattr(params, group)
        if group == "reward_weights":
            return params.replace(reward_weights={**holder, leaf: value})
        return params.replace(**{group: holder.replace(**{leaf: value})})

    return [
        (v, lambda v=v: world.validate(env.config, changed(v)))
        for v in bad_values.bad_values(NUMBERS[name])
    ]


LEAVES = [name for name in NUMBERS if name not in COILS and name not in SIZES]


@pytest.mark.parametrize("name", LEAVES)
def test_bad_leaves(name):
    """Leaves of params, which `validate` checks."""
    assert not not_refused(leaves_of(name), name)


def structures():
    env, params, _ = prepare()
    wrong = (None, 3, "x", {}, [], params.road.length_m, params)

    def replaced(value, **changes):
        return value, lambda: world.validate(env.config, params.replace(**changes))

    calls = [
        replaced(value, **{group: value})
        for group in ("road", "drivers", "fleet", "link", "reward_weights")
        for value in (*wrong[:3], wrong[4], params)
    ]
    calls += [(v, lambda v=v: world.validate(env.config, v)) for v in wrong[:6]]
    calls += [(v, lambda v=v: world.validate(v, params)) for v in wrong]
    calls += [(v, lambda v=v: medjax.ChargingEnv(v)) for v in wrong]
    link = params.link
    one = np.float32(1)
    table = world.InductanceTable(np.zeros((2, 4, 4), np.float32), one, one, one, one, one)
    tables = [(value, value) for value in (None, 3, np.zeros((2, 4, 4)))]
    tables += [
        (value, table.replace(**{name: value}))
        for name in vars(table)
        for value in (None, "x", math.nan, np.zeros((2, 4)), np.full((2, 4, 4), np.nan))
    ]
    return calls + [replaced(v, link=link.replace(inductance=broken)) for v, broken in tables]


def test_bad_structures():
    assert not not_refused(structures())


def arguments():
    names = [v for v in bad_values.NO_NUMBERS if not isinstance(v, str)]
    names += ["", "papre", "PAPER", "paper ", "paper\n", "\ud800", "p" * 100_000, 3, 0.5]
    calls = [(v, lambda v=v: medjax.make(v)) for v in names]
    calls += [(v, lambda v=v: medjax.make(observation=v)) for v in names if not callable(v)]
    calls += [
        (v, lambda v=v: medjax.make(reward=v))
        for v in names
        if v is not None and not isinstance(v, dict)
    ]
    calls += [
        (v, lambda v=v: medjax.make(reward_weights=v)) for v in names if not isinstance(v, dict)
    ]
    calls += [(v, lambda v=v: medjax.make(reward={v: max})) for v in (None, 3, b"x", ())]
    calls += [(v, lambda v=v: medjax.make(reward={"mine": v})) for v in (None, 3, "x", [])]
    keys = (
        *("", " ", "cooldown", "cooldown_s ", "COOLDOWN_S", "mass_kg", "ev", "ev.", ".mass_kg"),
        *("ev.mass_kg.x", "link.inductance", "inductance", "road", "reward_weights."),
        *("reward_weights.x", "__class__", "params", "config", "\n", "\ud800", "n" * 100_000, "٣"),
        *("road.cooldown_s", "drivers.KINDS", "-rf", "fleet.size=3"),
    )
    calls += [(v, lambda v=v: medjax.make(**{v: 1.0})) for v in keys]
    return calls


def test_bad_arguments():
    """Names, observations and rewards."""
    assert not not_refused(arguments())


TOGETHER = [
    ({"cooldown_s": 1.0, "fleet.cooldown_s": 1.0}, "cooldown_s"),
    *(({"length_m": 3000}, "ramp_x_m"), ({"length_m": 3449}, "ramp_x_m")),
    ({"acceleration_lane_m": 801}, "ramp_x_m"),
    ({"acceleration_lane_m": 22}, "acceleration_lane_m"),
    ({"ramp_speed": 60, "max_braking": 7}, "acceleration_lane_m"),
    *(({"ramp_x_m": [1200, 100, 2100, 3200]}, "ramp_x_m"), ({"ramp_x_m": [100] * 9}, "num_ramps")),
    ({"ramp_x_m": np.zeros(100)}, "num_ramps"),
    ({"ramp_x_m": [100, 1200], "num_ramps": 3}, "ramp_x_m"),
    ({"num_ramps": 3, "ramp_per_h": [1, 2, 3, 4]}, "ramp_per_h"),
    ({"desired_speed": [30, 30, 30]}, "desired_speed"),
    *(({"arrival_soc_low": 0.71}, "arrival_soc_low"), ({"request_soc": 0.81}, "request_soc")),
    *(({"size": 16}, "size"), ({"num_meds": 3, "size": 4}, "size")),
    ({"num_lanes": 3, "service_lane": 3}, "service_lane"),
    ({"num_evs": 4096, "num_gas": 4096, "num_lanes": 6}, "num_gas"),
]


@pytest.mark.parametrize(("overrides", "name"), TOGETHER)
def test_bad_combinations(overrides, name):
    """Each value is in its range, but they do not go together."""
    assert not not_refused([(overrides, lambda: medjax.make(**overrides))], name)


# The learner's settings.

FIELDS = {field.name: field for field in dataclasses.fields(PPOConfig)}


def settings_of(name):
    field = FIELDS[name]
    one = field.default[0] if isinstance(field.default, tuple) else example(field)
    bad = [v for v in bad_values.NO_NUMBERS if not isinstance(v, list | np.ndarray | jax.Array)]
    bad += [bad_values.DEEP, bad_values.HEAVY]
    if field.default is None and name != "overrides":  # None: the setting follows others
        bad = [v for v in bad if v is not None]
    if name == "overrides":
        bad = [v for v in bad if v is not None and v != {} and not isinstance(v, dict)]
        inner = [v for v in bad_values.NO_NUMBERS if not isinstance(v, bool | str | list | dict)]
        bad += [{"cooldown_s": v} for v in inner] + [
            {v: 1} for v in (None, 3, "", "name", "reward")
        ]
    elif isinstance(one, str):
        bad = [v for v in bad if not isinstance(v, str)] + [3, 0.5]
        bad += ["tahn", "", "\ud800"] if field.metadata["choices"] else []
    elif isinstance(one, bool):
        bad = [v for v in bad if not isinstance(v, bool)] + [0, 1, 0.0, np.bool_(True)]
    else:
        low, high = field.metadata["low"], field.metadata["high"]
        assert math.isfinite(low)
        assert math.isfinite(high)
        whole = isinstance(one, int)
        bad += [
            v for v in bad_values.outside(low, high, whole) if not isinstance(v, list | jax.Array)
        ]
        if whole:
            bad += [2.0, np.float32(low), "1"]
    if isinstance(field.default, tuple):
        bad = [[value] for value in bad] + [[], (), None, 3, "12", {1: 2}, [1] * 100_000]
    return [(v, lambda v=v: PPOConfig(**{name: v})) for v in bad]


@pytest.mark.parametrize("name", FIELDS)
def test_bad_settings(name):
    assert not not_refused(settings_of(name), "" if name == "overrides" else name)
