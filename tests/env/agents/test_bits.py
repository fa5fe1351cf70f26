"""What is the same bit for bit: episodes of a dispatcher alone and among agents. Single steps: test_bits_of_a_step.py.

Compiled as usual, not quickly: programs that differ much round alike only then.
"""

import numpy as np
import pytest

import medjax
from medjax.episodes.scores import evaluate_policies
from medjax.policies.rules import BASELINES, greedy
from medjax.policies.team import Dispatched, rules_of
from tests.env.agents.conftest import TRIPS, refusing


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
