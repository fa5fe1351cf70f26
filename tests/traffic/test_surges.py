"""Surges of demand and the detectors that see them, against Poisson counts and a float64 version of the smoothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chisquare, kstest

import medjax
from medjax.env.forecast import expected_need
from medjax.errors import InputError
from medjax.traffic.arrivals import draw_surges, new_seed, redraw
from medjax.traffic.demand import surge_factors, surge_starts

pytestmark = pytest.mark.usefixtures("quick_compiles")
# A minute of a decision a second, and so few vehicles that nobody waits long.
WORLD = {"num_evs": 8, "num_gas": 60, "mainline_per_h": 400.0, "ramp_per_h": 400.0}
WORLD |= {"num_surges": 1, "has_detectors": 1, "surge_s": 20.0}
EPISODES = 150


@pytest.fixture(scope="module")
def episodes():
    """Plays episodes of a minute: counts `(number, 60, entries)` that entered, wait, and that detectors show."""
    env, params = medjax.make("paper", **WORLD)

    @jax.jit
    @jax.vmap
    def play(key, action, demand):
        world = params.replace(demand=demand)

        def decide(state, step_key):
            _, state, *_ = env.step_env(step_key, state, action, world)
            return state, (state.entered_here, state.queue, state.detected_per_s)

        return jax.lax.scan(decide, env.reset(key, world)[1], jax.random.split(key, 60))[1]

    def of(action=0, **numbers):
        keys = jax.random.split(jax.random.key(7), EPISODES)
        demand = params.demand.replace(**{k: jnp.float32(value) for k, value in numbers.items()})
        every = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (EPISODES, *leaf.shape)), demand)
        counts = play(keys, jnp.full(EPISODES, action), every)
        return [np.asarray(each, np.float64) for each in counts]

    return of


def test_a_surge_at_a_given_time_multiplies_one_ramp(episodes):
    """All ramps together get Poisson counts of the demand, and 4 - 1 times a ramp's more while the surge lasts."""
    entered, queue, _ = episodes(surge_from_s=15.0, surge_until_s=15.0, surge_factor=4.0)
    came = (entered + queue)[:, :, 4:].sum(axis=2)
    for begins, ends, ramps in ((0, 15, 4.0), (15, 35, 4.0 + 3.0), (35, 60, 4.0)):
        counts = came[:, ends - 1] - (came[:, begins - 1] if begins else 0.0)
        expected = 400.0 / 3600.0 * ramps * (ends - begins)
        assert counts.mean() == pytest.approx(expected, abs=4.0 * (expected / EPISODES) ** 0.5)
        assert counts.var() == pytest.approx(expected, rel=4.0 * (2.0 / EPISODES) ** 0.5)


def test_starts_and_ramps_are_drawn_evenly():
    """Starts are uniform between the two times (Kolmogorov and Smirnov), ramps uniform (chi square)."""
    env, params = medjax.make(
        "paper", **WORLD, surge_from_s=100.0, surge_until_s=500.0, surge_factor=2.0
    )
    times = jnp.arange(0.0, 600.0, 2.0)

    @jax.vmap
    def factors(key):
        drawn = draw_surges(new_seed(key), env.config)
        of = lambda time: surge_factors(drawn, env.config, params.demand, time)  # noqa: E731
        return jax.vmap(of)(times)

    seen = np.asarray(factors(jax.random.split(jax.random.key(0), 1000)))
    assert set(np.unique(seen)) == {1.0, 2.0}
    rises = seen == 2.0
    assert not rises[:, :, :4].any()
    np.testing.assert_allclose(rises.any(axis=2).sum(axis=1), 10, atol=1)  # 20 s in steps of 2 s
    begins = np.asarray(times)[rises.any(axis=2).argmax(axis=1)]
    assert kstest((begins - 1.0 - 100.0) / 400.0, "uniform").pvalue > 1e-3
    assert chisquare(rises.any(axis=1).sum(axis=0)[4:]).pvalue > 1e-3


def test_redrawn_surges_begin_later():
    """A surge that has begun stays; one that has not begins at a uniform time of what is left, at any ramp."""
    times = {"surge_from_s": 100.0, "surge_until_s": 500.0, "rounds_per_decision": 5}
    env, params = medjax.make("paper", **WORLD | times | {"num_surges": 2})
    state = jax.jit(env.reset)(jax.random.key(0), params)[1]
    begun, later = [0.2, 0.9], [0.7, 0.1]  # the first at 180 s, the other at 380 s
    # Decisions of 5 s: 300 s have been played, the last round from 299 s on.
    state = state.replace(surges=jnp.array([begun, later]), time=jnp.int32(60))
    keys = jax.random.split(jax.random.key(1), 1000)
    anew = jax.vmap(lambda key: redraw(key, state, env.config, params))(keys)
    assert (anew.surges[:, 0] == jnp.array(begun)).all()
    starts = jax.vmap(surge_starts, (0, None))(anew.surges, params.demand)[:, 1]
    assert kstest((np.asarray(starts) - 299.0) / 201.0, "uniform").pvalue > 1e-3
    assert kstest(np.asarray(anew.surges[:, 1, 1]), "uniform").pvalue > 1e-3


@pytest.mark.parametrize("until_s", [0.0, 60.0])
def test_before_the_first_round_no_surge_has_begun(until_s):
    """Not even one that is given for the start; so all are those of the new seed."""
    env, params = medjax.make("paper", **WORLD, surge_from_s=0.0, surge_until_s=until_s)
    state = jax.jit(env.reset)(jax.random.key(0), params)[1]
    anew = redraw(jax.random.key(1), state, env.config, params)
    drawn = draw_surges(anew.arrivals, env.config)
    np.testing.assert_array_equal(anew.surges[:, 1], drawn[:, 1])
    np.testing.assert_array_equal(
        surge_starts(anew.surges, params.demand), surge_starts(drawn, params.demand)
    )
    assert (anew.surges[:, 1] != state.surges[:, 1]).all()
    after = redraw(jax.random.key(1), state.replace(time=jnp.int32(1)), env.config, params)
    begun = surge_starts(state.surges, params.demand) <= 0.0
    np.testing.assert_array_equal(after.surges[begun], state.surges[begun])


def test_surges_of_one_ramp_multiply():
    """Two surges at once: the only ramp has the product of their factors, and after them its demand again."""
    given = {"ramp_x_m": [500.0], "num_surges": 2, "surge_from_s": 0.0, "surge_until_s": 0.0}
    env, params = medjax.make("paper", **WORLD | given, surge_factor=3.0)
    drawn = draw_surges(new_seed(jax.random.key(1)), env.config)
    of = [surge_factors(drawn, env.config, params.demand, time)[-1] for time in (0.0, 19.9, 20.0)]
    assert of == [9.0, 9.0, 1.0]


def test_who_arrives_does_not_depend_on_dispatchers(episodes):
    """Arrivals, entered or in the queue, are the same whether MEDs are sent or not."""
    entered, queue, _ = episodes()
    others, waits, _ = episodes(action=2)
    np.testing.assert_array_equal(entered + queue, others + waits)
    assert (entered != others).any()  # a MED enters before the vehicles behind it


def test_detectors_smooth_what_enters(episodes):
    """Each shows the exponentially weighted counts of its entry, as float64 has them, beginning with the demand."""
    entered, _, shown = episodes(detector_s=30.0)
    expected, before = np.array([100.0] * 4 + [400.0] * 4) / 3600.0, 0.0
    for second in range(60):
        expected = np.exp(-1.0 / 30.0) * expected + (1.0 - np.exp(-1.0 / 30.0)) * (
            entered[:, second] - before
        )
        before = entered[:, second]
        np.testing.assert_allclose(shown[:, second], expected, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("observation", ["flat", "profile"])
def test_a_dispatcher_with_detectors_does_not_know_the_demand(observation):
    """From the same state it sees and forecasts the same, whatever the demand's true rates are; without them not."""
    for has_detectors in (0, 1):
        given = WORLD | {"has_detectors": has_detectors}
        env, params = medjax.make("paper", observation=observation, **given)
        _, state = env.reset(jax.random.key(3), params)
        busier = params.replace(demand=params.demand.replace(mainline_per_h=jnp.float32(4000.0)))
        same = np.array_equal(env.get_obs(state, params), env.get_obs(state, busier))
        needs = [expected_need(state, env.config, each, 60.0).coming for each in (params, busier)]
        knows = has_detectors == 0
        assert np.array_equal(*needs) != knows
        assert same != (knows and observation == "profile")


def test_observations_show_the_detectors():
    """One number an entry, in thousand vehicles an hour, before the road's nodes of the profile."""
    shown = np.linspace(0.1, 0.8, 8, dtype=np.float32)
    for observation, at in (("profile", 0), ("flat", -12)):
        env, params = medjax.make("paper", observation=observation, **WORLD)
        plain, _ = medjax.make("paper", observation=observation, **WORLD | {"has_detectors": 0})
        assert env.observation_space().shape[0] == plain.observation_space().shape[0] + 8
        _, state = env.reset(jax.random.key(3), params)
        seen = env.get_obs(state.replace(detected_per_s=jnp.asarray(shown)), params)
        np.testing.assert_allclose(seen[at : at + 8 or None], 3.6 * shown, rtol=1e-6)


def test_the_profile_shows_the_detectors_after_the_depots():
    """On an empty road, while the fleet is at its two depots."""
    env, params = medjax.make("paper", observation="profile", **WORLD, num_depots=2)
    shapes = jax.eval_shape(env.reset, jax.random.key(0), params)[1]
    state = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
    shown = np.linspace(1.1, 1.8, 8, dtype=np.float32)
    seen = jax.jit(env.get_obs)(state.replace(detected_per_s=jnp.asarray(shown)), params)
    assert seen[:2].sum() == pytest.approx(1.0)
    np.testing.assert_allclose(seen[2:10], 3.6 * shown, rtol=1e-6)


def test_surges_that_cannot_be_are_refused():
    """A surge without a ramp, one that begins last before it begins first, and one after the end."""
    with pytest.raises(InputError, match="num_surges = 1: allowed 0 with num_ramps = 0"):
        medjax.make("paper", num_ramps=0, num_surges=1)
    with pytest.raises(InputError, match="surge_from_s = 9: allowed at most surge_until_s = 5"):
        medjax.make("paper", num_surges=1, surge_from_s=9.0, surge_until_s=5.0)
    after = {"surge_from_s": 700.0, "surge_until_s": 800.0}
    with pytest.raises(InputError, match="surge_from_s = 700: allowed at most the episode's end"):
        medjax.make("paper", num_surges=1, **after)
    medjax.make("paper", **after)  # no surge, no matter
