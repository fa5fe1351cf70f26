"""Plugs at exits: charging times by quadrature, waits by a queue of events and by the formulas for M/M/c and M/D/c."""

import heapq
import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import medjax
from medjax.charging.plugs import charge_at_exits, plug_seconds, take_plugs
from medjax.errors import InputError
from tests.charging.scene import put

KWH = 3.6e6


@pytest.fixture(scope="module")
def paper():
    return medjax.make("paper", battery_scale=1.0)[1]


@pytest.mark.parametrize("bend", [0.0, 0.5, 0.8, 1.0])
@pytest.mark.parametrize("target", [0.0, 0.6, 0.8, 0.95])
def test_charging_times_are_the_integral_of_energy_by_power(paper, bend, target):
    """The midpoint rule in float64, from nine states of charge, of a power that falls linearly above the bend."""
    charging = paper.charging.replace(taper_soc=bend, plug_target_soc=target, plug_power_w=50e3)
    params, capacity = paper.replace(charging=charging), 30.0 * KWH
    start = np.linspace(0.0, 1.0, 9)
    got = plug_seconds(jnp.asarray(start * capacity, jnp.float32), params)
    for soc, seconds in zip(start, got, strict=True):
        width = max(target - soc, 0.0) / 200_000
        middles = soc + width * (np.arange(200_000) + 0.5)
        share = np.clip((1.0 - middles) / max(1.0 - bend, 1e-6), 1e-6, 1.0)
        assert float(seconds) == pytest.approx(np.sum(capacity * width / (50e3 * share)), rel=1e-4)


def by_events(num_plugs, arrivals):
    """Waits of one site's `(time, service)` in order of arrival; each EV takes the first plug that is free."""
    free = [0.0] * num_plugs
    waits = []
    for time, service in arrivals:
        start = max(time, heapq.heappop(free))
        heapq.heappush(free, start + service)
        waits.append(start - time)
    return waits


@given(seed=st.integers(0, 10_000), num_plugs=st.integers(1, 4), share=st.floats(0.05, 0.9))
def test_waits_are_those_of_a_queue_of_events(seed, num_plugs, share):
    """Three sites, six EVs that arrive again and again, several in one round at one site."""
    draw, rounds = np.random.default_rng(seed), 40
    free, lists = jnp.zeros((3, num_plugs)), [[] for _ in range(3)]
    got = [[] for _ in range(3)]
    serve = jax.jit(take_plugs)
    for number in range(rounds):
        arrives, site = draw.random(6) < share, draw.integers(0, 3, 6)
        service = draw.integers(0, 12, 6).astype(np.float32)
        free = jnp.maximum(free - 1.0, 0.0)
        free, waits = serve(free, jnp.asarray(site, jnp.int32), jnp.asarray(arrives), service)
        assert not np.asarray(waits)[~arrives].any()
        for ev in np.flatnonzero(arrives):
            lists[site[ev]].append((float(number), float(service[ev])))
            got[site[ev]].append(float(waits[ev]))
    for ours, arrivals in zip(got, lists, strict=True):
        assert ours == by_events(num_plugs, arrivals)


def erlang_c(servers, offered):
    """The chance that an arrival waits in M/M/c (Erlang 1917), with this load in servers."""
    terms = [offered**n / math.factorial(n) for n in range(servers)]
    last = offered**servers / math.factorial(servers) * servers / (servers - offered)
    return last / (sum(terms) + last)


@pytest.mark.parametrize("fixed", [False, True])
def test_mean_waits_at_steady_demand(fixed):
    """Three plugs, four fifths of the time at work: M/M/3 by Erlang's formula; M/D/3 by Cosmetatos's (1975).

    An EV arrives in a round with a small chance, charges for 100 rounds on average; 100 sites, 30,000 rounds.
    """
    sites, plugs, mean_s, load, warm, rounds = 100, 3, 100.0, 0.8, 5000, 30_000
    rate = load * plugs / mean_s

    def play(carry, key):
        free, waited, count = carry
        come_key, time_key = jax.random.split(key)
        arrives = jax.random.bernoulli(come_key, rate, (sites,))
        drawn = (
            jnp.full((sites,), mean_s)
            if fixed
            else mean_s * jax.random.exponential(time_key, (sites,))
        )
        free, waits = take_plugs(jnp.maximum(free - 1.0, 0.0), jnp.arange(sites), arrives, drawn)
        return (free, waited + waits.sum(), count + arrives.sum()), (waited, count)

    keys = jax.random.split(jax.random.key(1), rounds)
    start = jnp.zeros((sites, plugs)), jnp.float32(0.0), jnp.int32(0)
    (_, waited, count), (so_far, counted) = jax.jit(partial(jax.lax.scan, play))(start, keys)
    mean = float((waited - so_far[warm]) / (count - counted[warm]))
    expected = erlang_c(plugs, load * plugs) * mean_s / (plugs * (1.0 - load))
    if fixed:
        more = (1.0 - load) * (plugs - 1) * (math.sqrt(4.0 + 5.0 * plugs) - 2.0)
        expected *= 0.5 * (1.0 + more / (16.0 * load * plugs))
    # Arrivals at most one a round vary by 2.4 % less than Poisson's, so waits are shorter by about as much.
    assert mean == pytest.approx(expected * (1.0 - rate), rel=0.06)


@pytest.fixture(scope="module")
def road():
    """Ten kilometres with two exits, two plugs at each, no demand."""
    size = {"num_evs": 4, "num_gas": 0, "length_m": 10_000, "exit_x_m": [3000, 6000]}
    size |= {"exit_share": 0.0, "battery_scale": 1.0, "mainline_per_h": 0, "ramp_per_h": 0}
    env, params = medjax.make("paper", **size, num_plugs=2, reward="money")
    return env, params, env.reset(jax.random.key(0), params)[1]


def test_evs_that_leave_for_a_charger_take_its_plugs(road):
    """Three at the second exit, the last of which waits for the first; one at the first exit; none that only leaves."""
    env, params, state = road
    config = env.config
    kwh = np.array([3.0, 12.0, 6.0, 9.0])
    exits = np.array([6000.0, 6000.0, 6000.0, 3000.0])
    vehicles = {"destination": (config.ev_slots, exits), "active": (config.ev_slots, False)}
    evs = {"energy_j": (slice(None), kwh * KWH), "stops": (slice(None), True)}
    now = put(state, vehicles=vehicles, evs=evs)
    after, stats = charge_at_exits(now, now.plugs_free_in_s, config, params)
    seconds = (24.0 - kwh) * KWH / 150e3  # to 0.8 of 30 kWh
    assert float(stats.plug_stops) == 4.0
    assert float(stats.plug_wait_s) == pytest.approx(seconds[1], rel=1e-6)
    assert float(stats.plug_charging_s) == pytest.approx(seconds.sum(), rel=1e-6)
    assert float(stats.plug_energy_j) == pytest.approx((24.0 * 4 - kwh.sum()) * KWH, rel=1e-6)
    expected = [[0.0, seconds[3]], sorted([seconds[0], seconds[1] + seconds[2]])]
    np.testing.assert_allclose(np.sort(after.plugs_free_in_s), expected, rtol=1e-6)
    assert not after.evs.stops.any()
    again, more = charge_at_exits(after, after.plugs_free_in_s, config, params)
    assert float(more.plug_stops) == 0.0
    left_s = np.maximum(np.array(expected) - config.round_s, 0.0)
    np.testing.assert_allclose(np.sort(again.plugs_free_in_s), left_s, rtol=1e-6)


def test_who_missed_the_last_exit_takes_no_plug(road):
    """It leaves at the road's end, on its way to a charger all the same."""
    env, params, state = road
    config = env.config
    vehicles = {"x": 10_000.5, "destination": 10_000.0, "active": False}
    gone = put(
        state,
        vehicles={name: (config.ev_slots, value) for name, value in vehicles.items()},
        evs={"stops": (slice(None), True)},
    )
    after, stats = charge_at_exits(gone, gone.plugs_free_in_s, config, params)
    assert float(stats.plug_stops) == 0.0
    assert not np.asarray(after.plugs_free_in_s).any()


def test_waits_and_energy_have_their_price(road):
    """From the road to the books: four EVs leave for two plugs, and the reward has hours and kWh, no flat price."""
    env, params, state = road
    config = env.config
    vehicles = {"x": 2200.0 - 60.0 * np.arange(4.0), "destination": 10_000.0, "speed": 30.0}
    vehicles |= {"lateral_offset": 0.0, "lane": config.num_lanes - 1, "active": True}
    state = put(
        state,
        vehicles={name: (config.ev_slots, value) for name, value in vehicles.items()},
        evs={"energy_j": (slice(None), 2.0 * KWH)},
    )
    step, total = jax.jit(env.step_env), {}
    for number in range(60):
        _, state, _, _, _, info = step(jax.random.key(number), state, 0, params)
        total = {name: total.get(name, 0.0) + float(x) for name, x in info["reward_terms"].items()}
    metrics = {name: float(value) for name, value in info["metrics"].items()}
    assert metrics["plug_stops"] == metrics["charging_stops"] == 4.0
    # Each takes nearly 22 kWh at 150 kW, and the last two wait for most of that.
    assert metrics["plug_kwh"] == pytest.approx(4.0 * 22.4, abs=2.0)
    assert metrics["plug_charging_h"] == pytest.approx(metrics["plug_kwh"] / 150.0, rel=1e-5)
    assert 0.2 < metrics["plug_wait_h"] < 2.0 * 22.4 / 150.0
    hours = metrics["plug_wait_h"] + metrics["plug_charging_h"]
    assert total["plug_h"] == pytest.approx(-20.0 * hours, rel=1e-5)
    assert total["plug_kwh"] == pytest.approx(-0.315 * metrics["plug_kwh"], rel=1e-5)
    assert total["charging_stops"] == 0.0


def test_plugs_need_exits():
    with pytest.raises(InputError, match="num_plugs = 2: allowed 0 with num_exits = 0"):
        medjax.make("paper", num_plugs=2)
