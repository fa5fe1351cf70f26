"""EV drivers who see the queues at exits: who they are, what they decide, and that they wait less."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import medjax
from medjax.charging.booking import init_new_evs
from medjax.env.trips import needs_charger
from medjax.errors import InputError
from medjax.traffic.arrivals import draw_traits
from medjax.traffic.entry import Newcomers
from tests.charging.scene import put
from tests.env.quiet_road import EXITS, SHORTER_S, energy_for, quiet_road, with_evs


@pytest.fixture(scope="module")
def road():
    return quiet_road()


LOW, REACH_ONE, REACH_TWO = (
    2,
    4,
    6,
)  # of eight EVs, those that reach no later exit, at most one, at most two


def test_who_stops_at_the_exit_ahead(road):
    """From 4500 m it is 16 2/3 s to the first exit, 183 1/3 s to the second, 350 s to the third."""
    env, params, state = road
    # Two of each: those who reach no later exit, the second, the third, and the charger beyond the road's end.
    energy = energy_for(np.repeat([5400.0, 5600.0, 10_600.0, 17_300.0], 2), params)
    first, second, third = (EXITS - 4500.0) / 30.0

    def stops(*free_in_s, **changed):
        """How many of the EVs stop, the lowest first."""
        now = with_evs(state, env.config, energy, free_in_s, **changed)
        flags = np.asarray(needs_charger(now, env.config, params))
        assert (flags == (np.arange(8) < flags.sum())).all()
        return flags.sum()

    queue = SHORTER_S
    assert stops(0.0, 0.0, 0.0) == stops(0.0, 0.0, 9e3) == LOW
    assert stops(0.0, second + queue - 1.0, 9e3) == LOW
    assert stops(0.0, second + queue + 1.0, 0.0) == REACH_ONE
    assert stops(0.0, second + queue + 1.0, third + queue - 1.0) == REACH_ONE
    assert stops(0.0, second + queue + 1.0, third + queue + 1.0) == REACH_TWO
    # Nobody waits for a plug that is free by the time; a minute's wait here makes a minute's difference.
    assert stops(first, second + queue + 1.0, third + queue + 1.0) == REACH_TWO
    assert stops(first + 60.0, second + queue + 59.0, third + queue + 59.0) == LOW
    assert stops(first + 60.0, second + queue + 61.0, third + queue + 59.0) == REACH_ONE
    # Who does not see, or whose own exit is within reach, goes on, and so does everybody off the signed stretch.
    assert stops(0.0, 9e3, 9e3, sees=False) == LOW
    assert stops(0.0, 9e3, 9e3, destination=10_000.0) == LOW
    assert stops(0.0, 9e3, 9e3, destination=15_000.0) == REACH_ONE
    assert stops(0.0, 9e3, 9e3, x=3900.0) == stops(0.0, 9e3, 9e3, x=4900.0) == 0
    booked = with_evs(state, env.config, energy, [0.0, 9e3, 9e3])
    booked = put(booked, evs={"med": (slice(None), 0)})
    assert not needs_charger(booked, env.config, params).any()


@given(seed=st.integers(0, 10_000))
def test_nobody_goes_on_who_would_not_without_an_app(road, seed):
    """Whoever has to stop stops, seeing or not; whoever goes on reaches the next exit with `stop_soc` left."""
    env, params, state = road
    draw = np.random.default_rng(seed)
    place = EXITS[draw.integers(0, 3, 8)] - draw.uniform(250.0, 1000.0, 8)
    energy = energy_for(draw.uniform(0.0, 18_000.0, 8), params)
    free = draw.exponential(600.0, 3) * draw.integers(0, 2, 3)
    now = with_evs(state, env.config, energy, free, x=place)
    blind = put(now, evs={"sees_queues": (slice(None), False)})
    seeing, unseeing = (np.asarray(needs_charger(s, env.config, params)) for s in (now, blind))
    assert (seeing >= unseeing).all()
    following = np.append(EXITS[1:], 15_000.0 + 20_000.0 / 3.0)[np.searchsorted(EXITS, place)]
    assert (energy[~seeing] >= energy_for(following - place, params)[~seeing] * (1 - 1e-5)).all()


def test_evs_that_avoid_a_queue_leave_and_charge(road):
    """Eight that reach the second exit, whose plugs are busy for an hour: seeing, they charge at the first one."""
    env, params, state = road
    step = jax.jit(env.step_env)
    x = 3900.0 - 70.0 * np.arange(8.0)
    energy = energy_for(7500.0, params)
    for sees, exit_m, minutes in ((True, 5000.0, 2), (False, 10_000.0, 5)):
        now = with_evs(state, env.config, energy, [0.0, 3600.0, 3600.0], sees=sees, x=x)
        for number in range(60 * minutes):
            now = step(jax.random.key(number), now, 0, params)[1]
        assert (now.vehicles.destination[env.config.ev_slots] == exit_m).all()
        assert float(now.stats.plug_stops) == float(now.stats.left.sum()) == 8.0
        assert float(now.stats.depleted) == float(now.stats.missed_exits) == 0.0
        # Two free plugs take four each, 8 min long: 12 min of mean wait; at the other exit nearly an hour more.
        waits_s = float(now.stats.plug_wait_s) / 8.0
        assert 650.0 < waits_s < 750.0 if sees else 3600.0 < waits_s + 300.0 < 4500.0


def test_the_share_of_drivers_who_see():
    """At reset and at entry, whatever else the driver is; nobody at 0, all at 1, the same ones and more at more."""
    env, params = medjax.make("corridor", num_evs=4000, num_plugs=1, eco_compliance=0.5)
    config, count = env.config, env.config.num_evs
    entry = config.by_slot(-1, jnp.arange(count, dtype=jnp.int32), -1)
    stream = jnp.arange(count, dtype=jnp.int32) % config.num_entries
    number = jnp.arange(count, dtype=jnp.int32) // config.num_entries
    seed = jnp.array([3, 5], jnp.uint32)

    @jax.jit
    def drivers(share):
        now = params.replace(charging=params.charging.replace(queue_seen_share=share))
        before = env.reset(jax.random.key(2), now)[1].evs
        newcomers = Newcomers(entry, draw_traits(seed, stream, number))
        return before, init_new_evs(before, newcomers, config, now)

    shares = (0.0, 0.3, 0.6, 1.0)
    for by_share in zip(*map(jax.device_get, map(drivers, shares)), strict=True):
        fewer = np.zeros(count, bool)
        for share, evs in zip(shares, by_share, strict=True):
            sees, error = evs.sees_queues, 4.0 * np.sqrt(share * (1.0 - share) / count)
            assert sees.mean() == pytest.approx(share, abs=error)
            assert sees[evs.complies].mean() == pytest.approx(share, abs=1.5 * error)
            low = evs.energy_j < np.median(evs.energy_j)
            assert sees[low].mean() == pytest.approx(share, abs=1.5 * error)
            assert (sees >= fewer).all()
            fewer = sees
            unlike = jax.tree.map(np.array_equal, evs, by_share[0].replace(sees_queues=sees))
            assert all(jax.tree.leaves(unlike))


def test_without_plugs_nobody_has_queues_to_see():
    """The state is that of a world without the setting, so older runs go on."""
    env, params = medjax.make("corridor", queue_seen_share=1.0)
    state = jax.eval_shape(env.reset, jax.random.key(0), params)[1]
    assert state.evs.sees_queues is None


@pytest.mark.parametrize("share", [-0.1, 1.1, float("nan")])
def test_no_other_share(share):
    with pytest.raises(
        InputError, match=f"^queue_seen_share = {share}: allowed a number from 0 to 1$"
    ):
        medjax.make("corridor", num_plugs=4, queue_seen_share=share)


@pytest.mark.slow
@pytest.mark.parametrize(("low", "most"), [(0.05, 1.0), (0.15, 0.7)])
def test_on_corridor_who_sees_waits_less(low, most):
    """An hour of rush on eight days without MEDs, four plugs at each exit, nobody seeing and all.

    In the preset (0.05) most who charge come with too little for a choice, and crowd the first exit.
    """
    env, params = medjax.make("corridor", num_plugs=4, arrival_soc_low=low)

    @jax.jit
    def play(key, share):
        now = params.replace(charging=params.charging.replace(queue_seen_share=share))
        keys, state = jax.random.split(key, 360), env.reset(key, now)[1]
        state, _ = jax.lax.scan(lambda s, k: (env.step_env(k, s, 0, now)[1], None), state, keys)
        return state.stats

    mean_min = []
    for share in (0.0, 1.0):
        days = [jax.device_get(play(jax.random.key(day), share)) for day in range(8)]
        names = ("depleted", "plug_stops", "plug_wait_s", "missed_exits")
        depleted, stops, wait_s, missed = (
            sum(getattr(day, name) for day in days) for name in names
        )
        assert depleted == 0.0
        mean_min.append(wait_s / stops / 60.0)
        print(f"{low}, {share}: {stops} stops, wait {mean_min[-1]:.2f} min, {missed} missed exits")
    assert mean_min[1] <= most * mean_min[0]
