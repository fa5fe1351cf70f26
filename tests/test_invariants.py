"""Invariants in random play in random worlds, over five million vehicle updates."""

import dataclasses
import functools
import json
import re
import shlex

import jax
import numpy as np
import pytest
from hypothesis import given, note, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import medjax
from benchmarks.verification import cases, soak
from benchmarks.verification.anything_allowed import BOUND, VAST
from benchmarks.verification.cases import Case, run_case
from benchmarks.verification.decisions import Decision, check_decision
from benchmarks.verification.draws import random_units
from benchmarks.verification.invariants import INVARIANTS
from benchmarks.verification.random_worlds import (
    as_overrides,
    as_settings,
    draw_config,
    draw_params,
    validated,
    world_of,
)
from medjax.errors import InputError
from medjax.world.numbers import numbers_of
from medjax.world.params import GROUPS, EnvConfig

NUM_ENVS = 32
# Near the limits of what is allowed.
MOST = EnvConfig(
    **{"num_lanes": 6, "num_ramps": 8, "num_exits": 4, "num_depots": 3, "num_meds": 40},
    **{"num_evs": 40, "num_gas": 160, "tick_s": 0.05, "ticks_per_round": 20},
)
LEAST = EnvConfig(
    num_lanes=1, num_ramps=0, num_meds=1, num_evs=12, num_gas=12, tick_s=0.5, ticks_per_round=2
)

pytestmark = pytest.mark.usefixtures("quick_compiles")


@functools.cache
def case(config):
    """A case of these sizes, compiled once."""
    return Case(0, 0, num_envs=NUM_ENVS, config=config)


def played(case, updates):
    """(vehicle updates, violations) of play over at least so many updates."""
    total, found = 0, []
    for moved, violations in run_case(case, updates):
        total, found = total + moved, found + violations
    return total, found


@pytest.mark.parametrize(
    ("config", "updates"),
    [pytest.param(MOST, 4e6, marks=pytest.mark.thorough), (LEAST, 1e6)],
)
def test_five_million_updates_in_random_worlds(config, updates):
    """The soak's own play: a world of its own in each environment."""
    total, found = played(case(config), updates)
    assert total >= updates
    assert not found, "\n".join(map(str, found))


@pytest.mark.thorough
def test_what_is_played_is_worth_checking():
    """Vehicles enter, change lanes, leave, miss exits and run out, and MEDs are sent."""
    stats = case(MOST).play(0).state.stats
    happened = ("entered", "left", "lane_changes", "meds_dispatched", "missed_exits", "depleted")
    counts = {name: float(getattr(stats, name).sum()) for name in happened}
    assert min(counts.values()) > 20, counts


@pytest.mark.thorough
def test_nothing_is_violated_where_evs_charge(paper):
    """Random worlds hardly ever see an EV dock, so a rule sends MEDs in four episodes of the preset."""
    env, params = paper
    env = env.with_probe(lambda state: state)
    rule = medjax.BASELINES["greedy"](env)

    def decide(before, key):
        act_key, step_key = jax.random.split(key)
        action = rule(act_key, None, before, params).action
        obs, state, reward, _, _, info = env.step_env(step_key, before, action, params)
        decision = Decision(before, state, obs, reward, info)
        return state, check_decision(decision, env.config, params)

    def play(key):
        _, state = env.reset(key, params)
        return jax.lax.scan(decide, state, jax.random.split(key, 150))

    state, found = jax.jit(jax.vmap(play))(jax.random.split(jax.random.key(3), 4))
    totals = dict(zip(INVARIANTS, np.asarray(found).sum(axis=(0, 1)), strict=True))
    assert totals == dict.fromkeys(INVARIANTS, 0)
    assert state.stats.evs_served.sum() > 10


@pytest.mark.slow
def test_a_million_updates_of_the_largest_sizes():
    """All sizes at their limits, and as many gas vehicles as the limit of slots leaves."""
    sizes = {name: int(each.high) for name, each in numbers_of(EnvConfig).items() if "num_" in name}
    ticks = {"tick_s": 0.5, "ticks_per_round": 20}
    with pytest.raises(InputError, match="allowed at most") as refusal:
        EnvConfig(**sizes, **ticks)
    most = int(re.search("at most ([0-9]+)", str(refusal.value))[1])
    sizes["num_gas"] = most - sizes["num_meds"] - sizes["num_evs"]
    total, found = played(Case(0, 0, num_envs=8, config=EnvConfig(**sizes, **ticks)), 1e6)
    assert total >= 1e6
    assert not found, "\n".join(map(str, found))


def number_of_units(config):
    """Units that a world of these sizes takes."""
    shapes = []
    draw_params(lambda shape: shapes.append(shape) or np.zeros(shape), config, None)
    return sum(int(np.prod(shape)) for shape in shapes)


def world_from(units, config, table):
    """The world that these units draw."""
    left = iter(units)
    take = lambda shape: np.array([next(left) for _ in range(int(np.prod(shape)))]).reshape(shape)  # noqa: E731
    return draw_params(take, config, table)


@pytest.mark.parametrize("config", [pytest.param(MOST, marks=pytest.mark.thorough), LEAST])
def test_any_valid_world_is_sound(config):
    """Hypothesis looks for a world in which 100 ticks of play in any environment violate an invariant."""
    ours = case(config)
    units = arrays(np.float32, number_of_units(config), elements=st.floats(0.0, 1.0, width=32))

    @settings(max_examples=10)
    @given(units, st.integers(0, 2**31 - 1))
    def sound(units, seed):
        world = world_from(units, config, ours.params.link.inductance)
        note(f"medjax.make('paper', **{as_overrides(config, world)}), key {seed}")
        batch = jax.tree.map(lambda x: np.broadcast_to(x, (ours.num_envs, *np.shape(x))), world)
        link = batch.link.replace(inductance=world.link.inductance)
        batch = validated(config, batch.replace(link=link), worlds=1)
        decisions = np.int32(100 / config.ticks_per_decision)
        played = jax.device_get(ours.program(batch, jax.random.key(seed), decisions))
        counts = dict(zip(INVARIANTS, played.violations.sum(0), strict=True))
        assert not any(counts.values()), counts

    sound()


def test_cases_reach_all_sizes():
    """A default soak plays every number of lanes and both ends of the other sizes."""
    configs = [draw_config(0, number) for number in range(soak.CASES)]
    assert {c.num_lanes for c in configs} == set(range(1, 7))
    assert {0, 8} <= {c.num_ramps for c in configs}
    assert {0, 8} <= {c.num_exits for c in configs}
    assert min(c.tick_s for c in configs) == 0.02
    assert max(c.tick_s for c in configs) == 0.5
    assert max(c.num_meds for c in configs) > 35
    for config in configs:
        medjax.world.params.validate_config(config)


def test_worlds_reach_the_ends():
    """Some have no demand or are saturated, all human or all autonomous, without a MED."""
    params = draw_params(random_units(np.random.default_rng(0), 256), MOST, None)
    demand, fleet = params.demand, params.fleet
    assert {0.0, 3000.0 * 6} <= set(demand.mainline_per_h.tolist())
    assert {0.0, 1.0} <= set(demand.human_share.tolist())
    assert {0, 40} <= set(fleet.size.tolist())


def test_worlds_are_drawn_from_all_that_is_allowed():
    """Each number that is free comes within a hundredth of its range of both ends, or of their logarithms."""
    config = dataclasses.replace(LEAST, num_ramps=1, num_exits=1, num_incidents=1)
    params = draw_params(random_units(np.random.default_rng(0), 2000), config, None)
    for group, numbers in GROUPS.items():
        for name in {*numbers} - {*BOUND.get(group, ())}:
            low, high = numbers[name].low, numbers[name].high
            values = np.asarray(getattr(getattr(params, group), name), np.float64)
            if name == "ramp_speed":  # which the acceleration lane bounds
                high = 50.0
            if np.isinf(high):
                assert np.isinf(values).any(), f"{group}.{name}"
                values = values[np.isfinite(values)]
                high = values.max()
                assert high >= 0.5 * VAST, f"{group}.{name}"
            if low > 0.0:
                low, high, values = np.log(low), np.log(high), np.log(values)
            near = 0.01 * (high - low)
            assert values.min() <= low + near, f"{group}.{name}"
            assert values.max() >= high - near, f"{group}.{name}"
    for values, low, high in (
        (params.battery_scale, 2e-3, 5e5),
        (params.road.length_m, 110.0, 190e3),
        (params.road.acceleration_lane_m, 11.0, 4900.0),
        (params.drivers.vehicle_length, 2.5, 49.0),
    ):
        assert values.min() <= low
        assert values.max() >= high


def test_make_builds_a_drawn_world():
    """What a report prints gives the same numbers, to the last bit."""
    world = world_of(case(MOST).params, 5)
    _, params = medjax.make("paper", **as_overrides(MOST, world))
    jax.tree.map(np.testing.assert_array_equal, *map(jax.tree.leaves, (world, params)))
    assert "demand.mainline_per_h=" in " ".join(as_settings(MOST, world))


def run(argv, capsys):
    """(exit code, what was printed) of the command."""
    with pytest.raises(SystemExit) as ended:
        soak.main(argv)
    return int(ended.value.code or 0), capsys.readouterr().out


@pytest.fixture
def reckless(monkeypatch):
    """A soak of worlds that are not allowed, in which vehicles brake far harder than tyres can."""

    def braking(units, config, table):
        params = draw_params(units, config, table)
        below = np.full_like(params.drivers.max_acceleration, -60.0)
        drivers = params.drivers.replace(max_acceleration=below, comfortable_deceleration=below)
        return params.replace(drivers=drivers)

    program = case(LEAST).program
    monkeypatch.setattr(cases, "draw_config", lambda seed, number: LEAST)
    monkeypatch.setattr(cases, "draw_params", braking)
    monkeypatch.setattr(cases, "validated", lambda config, params: params)
    monkeypatch.setattr(cases, "compiled", lambda config, *args: program)


@pytest.mark.thorough
def test_a_violation_is_shown_again_by_its_command(reckless, tmp_path, capsys):
    """Violations are found, counted and printed; the printed command plays up to the first and shows the vehicle."""
    path = tmp_path / "soak.json"
    argv = ["--updates=1", "--seed=3", "--cases=1", f"--num-envs={NUM_ENVS}", f"--json={path}"]
    code, out = run(argv, capsys)
    assert code == 1
    report = json.loads(path.read_text())
    assert report["violations"]["motion"] > 0
    assert report["violations"]["road"] == report["violations"]["bookings"] == 0
    assert f"{report['updates']:,} vehicle updates" in out
    for command in report["commands"][: soak.MOST_SHOWN]:
        assert command in out

    command = next(line for line in out.splitlines() if line.startswith("  python -m"))
    first = re.search(r"VIOLATED: (.*): seed 3, .* first in decision (\d+)", out)
    code, shown = run(shlex.split(command)[3:], capsys)
    assert code == 1
    assert first.group(0) in shown  # the same counts in the same decision
    assert re.search(r"tick \d: motion: speed jumps: \d", shown)
    assert "slot " in shown
    assert "--set 'demand.mainline_per_h=" in shown


def test_play_up_to_a_decision_repeats_bit_for_bit(reckless):
    """Play repeats, so that a violation can be shown again; another episode differs."""
    ours = Case(3, 0, NUM_ENVS)
    one, again, other = ours.play(0, 7), ours.play(0, 7), ours.play(1, 7)
    jax.tree.map(np.testing.assert_array_equal, one, again)
    assert not np.array_equal(one.state.vehicles.x, other.state.vehicles.x)
    whole = ours.play(0)
    row = next(row for row in range(NUM_ENVS) if 0 <= whole.first[row] < ours.decisions)
    assert ours.play(0, int(whole.first[row])).violations[row].sum() == 0
    assert ours.play(0, int(whole.first[row]) + 1).violations[row].sum() > 0


def test_counts_are_of_vehicles_on_the_road():
    """Against states between decisions, within which few vehicles come and go."""
    ours = case(LEAST)
    totals, on_road = [], []
    for decisions in range(6):
        played = ours.play(0, decisions)
        totals.append(int(played.updates.sum()))
        on_road.append(int(played.state.vehicles.active.sum()))
    means = (np.array(on_road[1:]) + np.array(on_road[:-1])) / 2
    np.testing.assert_allclose(np.diff(totals), LEAST.ticks_per_decision * means, rtol=0.05)
