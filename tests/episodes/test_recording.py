"""Recordings against evaluation, the tally's books and the kinematics of the road."""

import dataclasses

import numpy as np
import pytest

import medjax
from medjax.episodes.recording import record_episode
from medjax.episodes.scores import evaluate_policies
from medjax.policies.policy import Policy
from medjax.policies.rules import paced
from medjax.world.kinds import by_class
from medjax.wrappers import Wrapper
from tests.episodes.conftest import WORLD

pytestmark = pytest.mark.usefixtures("quick_compiles")


def test_is_the_episode_that_evaluation_plays(recording):
    env, params = medjax.make("paper", **WORLD)
    scores = evaluate_policies(env, params, {"rule": paced(env)}, 2, seed=3)["rule"]
    assert recording.decisions.reward.sum() == pytest.approx(scores["return"][1], rel=1e-4)
    assert (recording.decisions.sent > 0).sum() == scores["meds_dispatched"][1]


def test_entries_agree_with_the_tally(recording):
    entered = by_class(recording.decisions.stats.entered.sum(axis=0))
    first = recording.frames.active[0]
    config = recording.config
    on_road = [first[config.med_slots].sum(), first[config.ev_slots].sum()]
    on_road.append(first.sum() - sum(on_road))
    ids = recording.vehicle_ids()
    assert len(np.unique(ids[ids >= 0])) == ids.max() + 1 == entered.sum() + sum(on_road)


def test_a_vehicle_moves_by_its_speed_and_keeps_its_id(recording):
    frames, ids = recording.frames, recording.vehicle_ids()
    same = (ids[1:] == ids[:-1]) & (ids[1:] >= 0)
    moved = (frames.x[1:] - frames.x[:-1])[same]
    mean_speed = (0.5 * (frames.speed[1:] + frames.speed[:-1]))[same]
    tick = recording.config.tick_s
    # a stop within the tick is the only way off the trapezoid
    braking = frames.speed[1:][same] > 0.0
    np.testing.assert_allclose(moved[braking], tick * mean_speed[braking], atol=2e-3)
    assert recording.time_s[-1] == pytest.approx(90.0)
    for number in np.unique(ids[ids >= 0]):
        assert len(np.unique(np.nonzero(ids == number)[1])) == 1


@dataclasses.dataclass(frozen=True)
class Scaled(Wrapper):
    """A custom wrapper that holds an array, which has no hash."""

    scale: object = None


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("wrap", "decisions"),
    [(lambda env: env, 90), (lambda env: Scaled(env, np.ones(3)), 2)],
    ids=["with hash", "without hash"],
)
def test_another_episode_of_the_same_policy_is_not_compiled_again(wrap, decisions):
    """The policy is traced for the first recording alone, though an environment may have no hash."""
    env, params = medjax.make("paper", **WORLD | {"episode_decisions": decisions})
    own, traced = wrap(env), []

    def act(weights, key, obs, state, params):
        traced.append(1)
        return paced(own).act(weights, key, obs, state, params)

    policy = Policy(act)
    first = record_episode(own, params, policy)
    times = len(traced)
    assert times > 0
    assert len(first.frames.x) == 1 + 4 * decisions
    again, other = (record_episode(own, params, policy, episode=episode) for episode in (0, 1))
    np.testing.assert_array_equal(first.frames.x, again.frames.x)
    assert (first.frames.x != other.frames.x).any()
    record_episode(own, params, policy, seed=9)
    assert len(traced) == times
