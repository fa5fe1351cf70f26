"""Equal bit for bit: a dispatcher alone and among agents, and both forms of an action.

No quick compiles: different programs round alike only as XLA compiles by default.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.env.agents.actions import Parts
from medjax.episodes.scores import evaluate_policies
from medjax.policies.rules import BASELINES, greedy
from medjax.policies.team import Dispatched, rules_of
from medjax.world.state import AT_DEPOT, IN_SERVICE
from tests.env.agents.conftest import TRIPS, refusing

TOLD = ("told_seconds", "told_speed_m", "refusing_seconds", "left_early")  # counts of agents alone


@pytest.mark.thorough
def test_the_dispatcher_is_a_special_case(trips):
    """Agents that only enter when a dispatcher sends them play the same highway as `ChargingEnv`."""
    single = trips.env.env
    alone = jax.jit(single.step_env)
    _, ours = trips.reset(1)
    _, theirs = jax.jit(single.reset)(jax.random.key(1), trips.params)
    for number in range(12):
        ramp = number % 3
        head = int(np.argmax(np.asarray(ours.meds.status) == AT_DEPOT))
        actions = jnp.zeros(4, jnp.int32).at[head].set(ramp)
        key = jax.random.key(number)
        _, ours, *_, info = trips.step(key, ours, actions, trips.params)
        _, theirs, reward, *_ = alone(key, theirs, jnp.int32(ramp), trips.params)
        none = {name: jnp.zeros(()) for name in TOLD}
        road = ours.replace(stats=ours.stats.replace(**none))
        jax.tree.map(np.testing.assert_array_equal, road, theirs)
        np.testing.assert_array_equal(info["rewards"], np.full(4, reward))
    assert (ours.meds.status != AT_DEPOT).any()


@pytest.mark.thorough
def test_parts_and_folded_are_the_same_step(trips, busy):
    """One decision gives the same bits by parts and by folded actions."""
    rule = trips.actions.by_rule(busy, trips.params)
    serves = busy.meds.status == IN_SERVICE
    parts = rule._replace(speed=jnp.where(serves, 1, rule.speed), accept=jnp.where(serves, 0, 1))
    folded = jnp.where(serves, trips.actions.fold(Parts(*parts), serves), 0)
    key = jax.random.key(9)
    _, one, *_ = jax.jit(trips.env.step_parts)(key, busy, parts, trips.params)
    _, other, *_ = trips.step(key, busy, folded, trips.params)
    jax.tree.map(np.testing.assert_array_equal, one, other)


@pytest.mark.slow
def test_a_dispatcher_alone_and_among_agents_is_the_same(trips):
    """Every rule's episodes, number for number."""
    # The numbers of `trips`: the coils' table may be of a quickly compiled program, which rounds differently.
    env, _ = medjax.make("corridor", **TRIPS | {"num_meds": TRIPS["size"]})
    names = ("none", "random", "greedy", "budgeted")
    alone = evaluate_policies(
        env, trips.params, {name: BASELINES[name](env) for name in names}, 3, 1
    )
    team = {name: policy for name, policy in rules_of(trips.env).items() if name in names}
    together = evaluate_policies(trips.env, trips.params, team, 3, 1)
    for name in names:
        for metric, values in alone[name].items():
            np.testing.assert_array_equal(together[name][metric], values, err_msg=metric)
    assert together["greedy"]["meds_dispatched"].sum() > 0


@pytest.mark.slow
def test_a_dispatched_team_is_the_same_as_a_wrapper_and_as_a_policy(trips):
    """Every metric of three episodes: quickly compiled programs are compared by counts only, in test_team.py."""
    env = Dispatched(trips.env, greedy(trips.env.env))
    policy = refusing(env)
    scores = evaluate_policies(trips.env, trips.params, {"refuses": env.whole(policy)}, 3, 1)
    wrapped = evaluate_policies(env, trips.params, {"refuses": policy}, 3, 1)
    for metric, values in scores["refuses"].items():
        np.testing.assert_array_equal(wrapped["refuses"][metric], values, err_msg=metric)
