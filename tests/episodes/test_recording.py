"""Recordings against evaluation, the tally's books and the kinematics of the road."""

import dataclasses

import numpy as np
import pytest

import medjax
from medjax.episodes.recording import Recording, record_episode
from medjax.episodes.scores import evaluate_policies
from medjax.policies.policy import Policy
from medjax.policies.rules import forecast
from medjax.world.kinds import by_class
from medjax.wrappers import Wrapper

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {"num_meds": 3, "num_evs": 12, "num_gas": 20, "mainline_per_h": 600.0}


@pytest.fixture(scope="module")
def world():
    return medjax.make("paper", episode_decisions=90, **SMALL)


@pytest.fixture(scope="module")
def recording(world) -> Recording:
    env, params = world
    return record_episode(env, params, forecast(env), seed=3, episode=1)


def test_is_the_episode_that_evaluation_plays(world, recording):
    env, params = world
    scores = evaluate_policies(env, params, {"rule": forecast(env)}, 2, seed=3)["rule"]
    assert recording.decisions.reward.sum() == pytest.approx(scores["return"][1], rel=1e-4)
    assert (recording.decisions.sent > 0).sum() == scores["meds_dispatched"][1]


def test_who_enters_is_who_the_tally_counts(recording):
    entered = by_class(recording.decisions.tally.entered.sum(axis=0))
    first = recording.frames.active[0]
    config = recording.config
    on_road = [first[config.med_slots].sum(), first[config.ev_slots].sum()]
    on_road.append(first.sum() - sum(on_road))
    ids = recording.vehicle_ids()
    assert len(np.unique(ids[ids >= 0])) == ids.max() + 1 == entered.sum() + sum(on_road)


def test_a_vehicle_moves_by_its_speed_and_keeps_its_number(recording):
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


def test_another_episode_of_the_same_policy_compiles_nothing(world):
    """The policy is traced for the first recording alone."""
    env, params = world
    traced = []

    def act(weights, key, obs, state, params):
        traced.append(1)
        return forecast(env).act(weights, key, obs, state, params)

    policy = Policy(act)
    first, again, other = (
        record_episode(env, params, policy, episode=episode) for episode in (0, 0, 1)
    )
    times = len(traced)
    assert times > 0
    np.testing.assert_array_equal(first.frames.x, again.frames.x)
    assert (first.frames.x != other.frames.x).any()
    record_episode(env, params, policy, seed=9)
    assert len(traced) == times


@dataclasses.dataclass(frozen=True)
class Scaled(Wrapper):
    """A wrapper of one's own that holds an array, which has no hash."""

    scale: object = None


def test_an_environment_that_has_no_hash_is_recorded(world):
    env, params = world
    own = Scaled(env, np.ones(3))
    recording = record_episode(own, params.replace(episode_decisions=2), forecast(own))
    assert len(recording.frames.x) == 9
