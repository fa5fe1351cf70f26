"""What is the same bit for bit: steps of a dispatcher alone and among agents, and the two ways to say a step."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.env.agents.actions import Parts
from medjax.world.state import AT_DEPOT, IN_SERVICE

pytestmark = pytest.mark.usefixtures("quick_compiles")

TOLD = ("told_seconds", "told_speed_m", "refusing_seconds", "left_early")  # counts of agents alone


def test_the_dispatcher_is_a_special_case(trips):
    """Agents that enter when told and otherwise do as the rule does: the same highway as `ChargingEnv`, bit for bit."""
    single = trips.env.env
    alone = jax.jit(single.step_env)
    _, ours = trips.reset(1)
    _, theirs = jax.jit(single.reset)(jax.random.key(1), trips.params)
    for number in range(12):
        ramp = number % 3
        head = int(np.argmax(np.asarray(ours.meds.status) == AT_DEPOT))
        actions = jnp.zeros(4, jnp.int32).at[head].set(ramp)
        key = jax.random.key(number)
        _, ours, rewards, *_ = trips.step(key, ours, actions, trips.params)
        _, theirs, reward, *_ = alone(key, theirs, jnp.int32(ramp), trips.params)
        none = {name: jnp.zeros(()) for name in TOLD}
        road = ours.replace(tally=ours.tally.replace(**none))
        jax.tree.map(np.testing.assert_array_equal, road, theirs)
        np.testing.assert_array_equal(rewards, np.full(4, reward))
    assert (ours.meds.status != AT_DEPOT).any()


def test_parts_and_folded_are_the_same_step(trips, busy):
    """One decision by either."""
    rule = trips.by_rule(busy, trips.params)
    serves = busy.meds.status == IN_SERVICE
    parts = rule._replace(speed=jnp.where(serves, 1, rule.speed), accept=jnp.where(serves, 0, 1))
    folded = jnp.where(serves, trips.actions.fold(Parts(*parts), serves), 0)
    key = jax.random.key(9)
    _, one, *_ = jax.jit(trips.env.step_parts)(key, busy, parts, trips.params)
    _, other, *_ = trips.step(key, busy, folded, trips.params)
    jax.tree.map(np.testing.assert_array_equal, one, other)
