"""Overlaps of boxes: pairs placed by hand, and the fault that lanes alone did not show."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.verification.boxes import lanes_covered, overlapping, overlapping_vehicles
from medjax.world.kinds import GAS

CAR = {"length": 5.0, "width": 1.8}


def pair(x, lateral, there=(True, True), **sizes):
    """Whether a car with its front at 100 m in the middle of a lane overlaps another vehicle."""
    sizes = {name: np.array([own, sizes.get(name, own)]) for name, own in CAR.items()}
    x, lateral = np.array([100.0, x]), np.array([0.0, lateral])
    both = overlapping(x, lateral, **sizes, there=np.array(there))
    assert not np.asarray(both)[np.tril_indices(2)].any()  # each pair once
    return bool(both[0, 1])


@pytest.mark.parametrize(
    ("x", "lateral", "sizes", "overlap"),
    [
        (100.0, 0.0, {}, True),
        (104.8, 0.0, {}, True),  # 0.2 m of the bumpers
        (104.95, 0.0, {}, False),  # 0.05 m: a touch
        (105.5, 0.0, {}, False),
        (98.0, 1.6, {}, True),  # side by side, 0.2 m of the mirrors
        (98.0, -1.75, {}, False),
        (98.0, 4.0, {}, False),  # a lane apart
        (110.0, 2.0, {"length": 12.0, "width": 2.5}, True),  # a truck's rear end
        (113.0, 2.0, {"length": 12.0, "width": 2.5}, False),
    ],
)
def test_two_boxes(x, lateral, sizes, overlap):
    assert pair(x, lateral, **sizes) is overlap
    assert not pair(x, lateral, there=(True, False), **sizes)


@pytest.fixture(scope="module")
def road():
    """Two cars on an empty road, 20 m apart in lane 1, and its params."""
    env, params = medjax.make("paper", mainline_per_h=0.0, ramp_per_h=0.0)
    v = jax.jit(env.reset)(jax.random.key(0), params)[1].vehicles
    first = env.config.gas_slots.start
    cars = slice(first, first + 2)
    v = v.replace(
        active=jnp.zeros_like(v.active).at[cars].set(True),
        kind=v.kind.at[cars].set(GAS),
        x=v.x.at[cars].set(jnp.array([500.0, 520.0])),
        lane=v.lane.at[cars].set(1),
        lateral_offset=v.lateral_offset.at[cars].set(0.0),
    )
    return v, params, first


@pytest.mark.thorough
def test_a_car_covers_its_old_lane_while_it_changes(road):
    """Its `lane` is the new one from the change's first tick on; its body is still in the old one."""
    v, params, first = road
    assert not overlapping_vehicles(v, params).any()
    changes = v.replace(x=v.x.at[first].set(517.0), lane=v.lane.at[first].set(2))
    assert not overlapping_vehicles(changes, params).any()
    changes = changes.replace(lateral_offset=v.lateral_offset.at[first].set(-4.0))
    assert int(overlapping_vehicles(changes, params).sum()) == 1


@pytest.mark.parametrize(
    ("offset", "lanes"),
    [(0.0, (1, 1)), (1.09, (1, 1)), (1.12, (1, 2)), (-1.12, (0, 1)), (-4.0, (0, 0))],
)
def test_lanes_that_a_body_covers(road, offset, lanes):
    """A car of 1.8 m in lanes of 4 m is within its lane up to 1.1 m off its centre."""
    v, params, first = road
    covered = lanes_covered(
        v.replace(lateral_offset=v.lateral_offset.at[first].set(offset)), params
    )
    assert tuple(int(lane[first]) for lane in covered) == lanes


def played(preset, rule, num_envs, decisions, seed, **overrides):
    """Overlapping pairs, and vehicle updates, summed over whole plays under a rule."""
    env, params = medjax.make(preset, **overrides)
    policy = medjax.BASELINES[rule](env)

    def probe(state):
        return overlapping_vehicles(state.vehicles, params).sum(), state.vehicles.active.sum()

    probed = env.with_probe(probe)

    def one(key):
        reset_key, key = jax.random.split(key)

        def decide(state, key):
            act_key, step_key = jax.random.split(key)
            action = policy(act_key, None, state, params).action
            _, state, *_, info = probed.step(step_key, state, action, params)
            return state, jax.tree.map(jnp.sum, info["ticks"])

        keys = jax.random.split(key, decisions)
        return jax.lax.scan(decide, env.reset(reset_key, params)[1], keys)[1]

    sums = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(seed), num_envs))
    return (int(np.sum(each, dtype=np.int64)) for each in jax.device_get(sums))


CROWD = {"mainline_per_h": 7000.0, "ramp_per_h": 450.0, "num_gas": 500}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 12, 13, 14])
@pytest.mark.parametrize(
    ("world", "overrides"),
    [(("paper", "none", 16, 400), CROWD), (("corridor", "greedy", 8, 60), {})],
)
def test_no_bodies_overlap_where_they_once_did(world, overrides, seed):
    """Two worlds in which vehicles on a lane line drove through others; 25 million updates a seed."""
    pairs, updates = played(*world, seed, **overrides)
    assert updates > 8e6
    assert pairs == 0
