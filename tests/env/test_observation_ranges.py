"""Ranges of observations in docs/guide.md hold in whole episodes of random play."""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.env.observation import FlatObservation

pytestmark = pytest.mark.usefixtures("quick_compiles")

PAGE = (Path(__file__).parents[2] / "docs/guide.md").read_text(encoding="utf-8")
ROW = r"^\| ((?:flat|profile): [^|]+) \| (\S+) to (\S+) \| (\S+) to (\S+) \|$"
ROWS = re.findall(ROW, PAGE, re.MULTILINE)


def parts(flat, profile, env):
    """Values of each row of the table, from vectors `(n, size)` of both kinds."""
    config, layout = env.config, env.observation
    meds, evs, clock = FlatObservation().split(flat, config)
    places, speeds, sideways = (
        np.concatenate([meds[..., index], evs[..., index]], axis=1) for index in (1, 2, 3)
    )
    others = [np.delete(rows, [1, 2, 3], axis=2).reshape(len(rows), -1) for rows in (meds, evs)]
    nodes, ramps = layout.road_nodes, config.num_ramps
    sizes = [nodes * 8, nodes * 4, 2 * ramps, 2 * ramps, 2 * ramps]
    of_evs, of_meds, ways, there, coming, shares = np.split(profile, np.cumsum(sizes), axis=1)
    of_evs = of_evs.reshape(len(profile), nodes, 8)
    of_meds = of_meds.reshape(len(profile), nodes, 4)
    flats = [np.concatenate([*others, clock], axis=1), places, speeds, sideways]
    at_nodes = [of_evs[..., :6], of_evs[..., 6:], of_meds[..., 0], of_meds[..., 1:3]]
    return [*flats, *at_nodes, of_meds[..., 3], ways, there, coming, shares]


@pytest.mark.parametrize(
    ("name", "episodes"), [("paper", 3), pytest.param("corridor", 2, marks=pytest.mark.slow)]
)
def test_ranges_are_as_documented(name, episodes):
    """And the nodes hold as many EVs as the road."""
    env, params = medjax.make(name, observation="profile")

    def decide(state, key):
        draw, key = jax.random.split(key)
        mask = env.action_mask(state, params)
        action = jax.random.categorical(draw, jnp.where(mask, 0.0, -jnp.inf))
        profile, state, *_ = env.step_env(key, state, action, params)
        there = state.vehicles.active[env.config.ev_slots] & ~state.evs.is_depleted
        return state, (FlatObservation()(state, env.config, params), profile, there.sum())

    def play(key):
        start = env.reset(key, params)[1]
        keys = jax.random.split(key, int(params.episode_decisions))
        return jax.lax.scan(decide, start, keys)[1]

    seen = jax.jit(jax.vmap(play))(jax.random.split(jax.random.key(3), episodes))
    flat, profile, evs = (np.concatenate(np.asarray(each)) for each in seen)
    found = parts(flat, profile, env)
    assert len(ROWS) == len(found)
    for (what, *ends), values in zip(ROWS, found, strict=True):
        low, high = map(float, ends[:2] if name == "paper" else ends[2:])
        assert low <= values.min(), what
        assert values.max() <= high + 1e-6, what
    at_nodes = found[4].sum((1, 2)) + found[5][..., 0].sum(1)
    np.testing.assert_allclose(at_nodes, evs, atol=0.02 * evs.max())
