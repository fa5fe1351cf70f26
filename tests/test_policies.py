"""The simple dispatchers do what their names say, and never a masked action."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax


@pytest.fixture(scope="module")
def episodes(paper):
    """Actions, masks and needs of each baseline over four whole episodes."""
    env, params = paper

    def play(name):
        act = medjax.BASELINES[name](env)

        def episode(key):
            reset_key, key = jax.random.split(key)
            _, state = env.reset(reset_key, params)

            def step(state, key):
                act_key, step_key = jax.random.split(key)
                action, mask = act(act_key, state, params), env.action_mask(state, params)
                return env.step_env(step_key, state, action, params)[1], (action, mask, state)

            return jax.lax.scan(step, state, jax.random.split(key, 600))[1]

        keys = jax.random.split(jax.random.key(9), 4)
        return jax.tree.map(np.asarray, jax.jit(jax.vmap(episode))(keys))

    return {name: play(name) for name in medjax.BASELINES}


@pytest.mark.parametrize("name", list(medjax.BASELINES))
def test_only_allowed_actions(episodes, name):
    """Every action is int32 and allowed by the mask."""
    action, mask, _ = episodes[name]
    assert action.dtype == jnp.int32
    assert np.take_along_axis(mask, action[..., None], -1).all()


def test_none_sends_none(episodes):
    assert not episodes["none"][0].any()


def test_random_is_uniform_over_ramps(episodes):
    """All 15 are sent, from all ramps."""
    action, _, _ = episodes["random"]
    assert np.all((action > 0).sum(1) == 15)
    assert len(np.unique(action)) == 5


def test_periodic_spreads_the_fleet(episodes):
    """One every 600 / 15 decisions, ramp after ramp."""
    action, _, _ = episodes["periodic"]
    for row in action:
        when = np.flatnonzero(row)
        np.testing.assert_array_equal(when, np.arange(15) * 40)
        np.testing.assert_array_equal(row[when], 1 + np.arange(15) % 4)


def test_paced_sends_from_the_first_ramp(episodes):
    """One every 34 decisions until all 15 are sent."""
    action, _, _ = episodes["paced"]
    expected = np.zeros(600)
    expected[np.arange(15) * 34] = 1
    np.testing.assert_array_equal(action, np.broadcast_to(expected, action.shape))


def test_without_ramps_none_is_sent():
    """Where nothing can be sent, no rule asks for it."""
    env, params = medjax.make("paper", num_ramps=0)
    _, state = env.reset(jax.random.key(0), params)
    for build in medjax.BASELINES.values():
        assert build(env)(jax.random.key(1), state, params) == 0


def test_greedy_goes_where_the_need_is(episodes, paper):
    """Each MED is sent from the ramp with most low EVs without a slot, counted by hand."""
    _, params = paper
    action, _, state = episodes["greedy"]
    capacity = float(params.ev_capacity_j)
    episode, decision = np.nonzero(action)
    assert len(episode) >= 4
    for e, d in zip(episode, decision, strict=True):
        x = state.vehicles.x[e, d, 15:75]
        low = state.evs.energy_j[e, d] < 0.4 * capacity
        needy = state.vehicles.active[e, d, 15:75] & low & (state.evs.med[e, d] < 0)
        counts = [
            sum(n and r - 400 <= p <= r + 100 for p, n in zip(x, needy, strict=True))
            for r in (100, 1200, 2100, 3200)
        ]
        assert counts[action[e, d] - 1] == max(counts) >= 2
