"""An environment takes the same course, bit for bit, alone, in any batch and on any number of devices."""

import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.wrappers import BatchAutoReset, environment_mesh, on_devices
from tests.compiling import quickly


def digest(leaf):
    """() int32 that changes with any bit of any entry."""
    bits = leaf.astype(jnp.int32) if leaf.dtype == bool else leaf
    bits = jax.lax.bitcast_convert_type(bits, jnp.int32).ravel()
    return jnp.sum(bits * (2 * jnp.arange(bits.size, dtype=jnp.int32) + 1))


def course(env, decisions, key, state, params):
    """Digests of all that decisions under random actions return, `(decisions,)` by name."""
    policy = medjax.BASELINES["random"](env)

    def step(state, key):
        act_key, step_key = jax.random.split(key)
        action = policy(act_key, None, state, params).action
        obs, state, reward, terminated, truncated, info = env.step_env(
            step_key, state, action, params
        )
        results = (action, obs, state, reward, terminated, truncated, info)
        return state, jax.tree.map(digest, results)

    seen = jax.lax.scan(step, state, jax.random.split(key, decisions))[1]
    return {jax.tree_util.keystr(path): leaf for path, leaf in jax.tree.leaves_with_path(seen)}


def differing(one, other, rows):
    """What differs in the first rows of both, and the decision at which it begins to."""
    return {
        name: int(np.argwhere(values[:rows] != other[name][:rows])[:, 1].min())
        for name, values in one.items()
        if not np.array_equal(values[:rows], other[name][:rows])
    }


def differing_courses(sizes, decisions, scenario="paper", *, as_constants=False, **overrides):
    """By size, what differs between courses in such a batch and in the largest; size 0 is the program without vmap.

    XLA simplifies more where the world's numbers are constants of the program than where they are arguments.
    """
    env, params = medjax.make(scenario, **overrides)
    keys = jax.random.split(jax.random.key(5), max(sizes))
    with quickly():  # only where all courses begin
        _, states = jax.jit(jax.vmap(env.reset, (0, None)))(keys, params)
    play = functools.partial(course, env, decisions)

    def played(program, keys, states):
        if as_constants:
            return jax.device_get(jax.jit(lambda *rows: program(*rows, params))(keys, states))
        return jax.device_get(jax.jit(program)(keys, states, params))

    largest = played(jax.vmap(play, (0, 0, None)), keys, states)
    assert len(np.unique(largest["[1]"])) > 0.9 * largest["[1]"].size  # no two of them are alike
    found = {}
    for size in sorted(set(sizes) - {max(sizes)}):
        program = jax.vmap(play, (0, 0, None)) if size else play
        some = jax.tree.map(lambda leaf: leaf[:size] if size else leaf[0], (keys, states))  # noqa: B023
        got = played(program, *some)
        if not size:
            got = jax.tree.map(lambda leaf: leaf[None], got)
        found[size] = differing(got, largest, max(size, 1))
    return {size: names for size, names in found.items() if names}


def test_alone_and_in_a_batch():
    """Without vmap and among many, fully optimised: every number of every decision."""
    assert differing_courses([0, 128], decisions=60) == {}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sizes", "decisions", "options"),
    [
        ([0, 1, 2, 3, 16, 64, 128], 600, {"observation": "flat"}),
        ([0, 1, 2, 3, 16, 64, 128], 600, {"observation": "profile"}),
        ([0, 3], 120, {"scenario": "long"}),  # 2512 slots
        ([0, 2, 64], 300, {"as_constants": True}),
    ],
)
def test_whole_episodes_in_batches_of_all_sizes(sizes, decisions, options):
    """Also on a long road, and with the world's numbers as constants of the program."""
    assert differing_courses(sizes, decisions, **options) == {}


@pytest.mark.slow
def test_resets():
    """Alone and in batches."""
    env, params = medjax.make("paper")
    keys = jax.random.split(jax.random.key(6), 128)
    reset = jax.jit(jax.vmap(env.reset, (0, None)))
    largest = reset(keys, params)
    for size in (1, 3, 64):
        some = reset(keys[:size], params)
        jax.tree.map(lambda a, b: np.testing.assert_array_equal(a, b[: len(a)]), some, largest)
    alone = jax.jit(env.reset)(keys[0], params)
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a, b[0]), alone, largest)


@pytest.mark.slow
@pytest.mark.parametrize("num_devices", [1, 2])
def test_blocks_devices_and_resets(num_devices):
    """Episodes that restart by themselves, 192 at once against blocks, and blocks on two devices.

    The first 64 of 384 environments are those of 64.
    """
    env, params = medjax.make("paper", episode_decisions=30)
    batch = BatchAutoReset(env, stagger=30)

    def play(keys, params):
        keys = jax.vmap(lambda key: jax.random.split(key, 41), out_axes=1)(keys)
        _, state = batch.reset(keys[0], params)

        def step(state, keys):
            actions = jax.vmap(lambda key: jax.random.randint(key, (), 0, 5))(keys)
            results = batch.step(keys, state, actions, params)
            return results[1], jax.tree.map(jax.vmap(digest), results)

        seen = jax.lax.scan(step, state, keys[1:])[1]
        return {
            jax.tree_util.keystr(path): leaf.T for path, leaf in jax.tree.leaves_with_path(seen)
        }

    keys = jax.random.split(jax.random.key(2), 384)
    plain = jax.device_get(jax.jit(play)(keys[:64], params))
    shared = on_devices(environment_mesh(384, num_devices), play)
    assert differing(plain, jax.device_get(jax.jit(shared)(keys, params)), 64) == {}


@pytest.mark.parametrize("preset", ["paper", "corridor"])
def test_resets_beside_other_worlds(preset):
    """An environment starts as it does alone where those beside it have other demands and other roads."""
    env, params = medjax.make(preset)
    road, demand = params.road, params.demand
    busier = demand.replace(mainline_per_h=1.37 * demand.mainline_per_h)
    elsewhere = road.replace(
        ramp_x_m=road.ramp_x_m
        + jnp.resize(jnp.array([7.3, 91.0, -33.0, 210.0]), road.ramp_x_m.shape)
    )
    worlds = [params, params.replace(demand=busier), params.replace(road=elsewhere)]
    keys = jax.random.split(jax.random.key(0), len(worlds))
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *worlds)
    together = jax.jit(jax.vmap(env.reset))(keys, stacked)
    alone = jax.jit(env.reset)
    for number, world in enumerate(worlds):
        own = alone(keys[number], world)
        beside = jax.tree.map(lambda leaf: leaf[number], together)  # noqa: B023
        chex.assert_trees_all_equal(own, beside)
