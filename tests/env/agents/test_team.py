"""Dispatchers among agents: they act as they do alone, and learned agents may leave dispatching to them."""

import jax
import numpy as np
import pytest

from medjax.agents import agents_of
from medjax.env.agents.environment import ROAD
from medjax.episodes.recording import record_episode
from medjax.episodes.scores import evaluate_policies
from medjax.episodes.table import vehicle_table
from medjax.policies.rules import greedy, none
from medjax.policies.team import Dispatched, as_team
from medjax.world.state import AT_DEPOT, IN_SERVICE
from tests.env.agents.conftest import TRIPS, refusing

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.mark.thorough
def test_with_a_dispatcher_agents_only_move(trips, busy):
    """At the depot they have no choice, in service all; as a wrapper and as a policy it plays the same episodes."""
    env = Dispatched(trips.env, greedy(trips.env.env))
    mask, free = np.asarray(env.action_mask(busy, trips.params)), trips.mask(busy, trips.params)
    at_depot = np.asarray(busy.meds.status == AT_DEPOT)
    serves = np.asarray(busy.meds.status == IN_SERVICE)
    np.testing.assert_array_equal(mask[at_depot].sum(axis=1), 1)
    np.testing.assert_array_equal(mask[serves], np.asarray(free)[serves])
    policies = {
        "by rule": as_team(trips.env, greedy(trips.env.env)),
        "refuses": env.whole(refusing(env)),
    }
    scores = evaluate_policies(trips.env, trips.params, policies, 3, 1)
    assert (scores["refuses"]["meds_dispatched"] > 0).all()
    # In its first decision a MED that was sent takes every EV, since it has no other order yet.
    received = {name: score["ev_received_kwh"].mean() for name, score in scores.items()}
    assert received["refuses"] < 0.2 * received["by rule"]
    wrapped = evaluate_policies(env, trips.params, {"refuses": refusing(env)}, 3, 1)
    # Counts: quickly compiled, two programs may round what is divided differently. All metrics are in test_bits.py.
    for metric in (
        "lane_changes",
        "vehicle_ticks",
        "evs_served",
        "meds_dispatched",
        "missed_exits",
    ):
        values = scores["refuses"][metric]
        np.testing.assert_array_equal(wrapped["refuses"][metric], values, err_msg=metric)


def test_an_agent_cannot_send_itself_where_a_dispatcher_does(trips):
    """The choice counts as invalid, and info shows the mask of who has no choice."""
    env = Dispatched(trips.env, none(trips.env.env))
    _, state = jax.jit(env.reset)(jax.random.key(0), trips.params)
    enters = np.argmax(np.asarray(trips.mask(state, trips.params))[:, 1:], axis=1) + 1
    before = float(state.stats.invalid_actions)
    _, after, *_, info = jax.jit(env.step_env)(jax.random.key(1), state, enters, trips.params)
    assert float(after.stats.meds_dispatched) == float(state.stats.meds_dispatched)
    assert float(after.stats.invalid_actions) - before == len(enters)
    np.testing.assert_array_equal(info["action_mask"], env.action_mask(after, trips.params))
    assert not np.asarray(info["action_mask"])[:, 1 : 1 + trips.config.num_ramps].any()


@pytest.mark.parametrize("central", [False, True])
def test_a_central_critic_sees_the_agent_s_vector_and_then_the_road(trips, busy, central):
    """Without a central critic, the agent's vector alone."""
    env, params = agents_of("corridor", central=central, **TRIPS)
    own = trips.env.view.size(trips.config)
    seen = np.asarray(jax.jit(env.get_obs)(busy, params))
    np.testing.assert_allclose(seen[:, :own], trips.view(busy, trips.params), atol=1e-6)
    assert env.view.own_size(trips.config) == own
    road = np.asarray(trips.global_state(busy, trips.params))
    for row in seen:
        np.testing.assert_allclose(row[own:], road if central else [], atol=1e-6)


def test_the_outlook_is_what_rules_go_by(trips, busy):
    """An agent's vector holds the need at each ramp, the fleet and the time left, as the dispatcher's does."""
    profile = trips.global_state(busy, trips.params)
    view, config = trips.env.view, trips.config
    need, at_depot, time_left = view.outlook(trips.view(busy, trips.params), config)
    wanted, here, left = ROAD.outlook(profile, config)
    for mine, theirs in zip(need, wanted, strict=True):
        np.testing.assert_allclose(mine, np.broadcast_to(theirs, mine.shape), rtol=1e-6)
    np.testing.assert_allclose(at_depot, here)
    np.testing.assert_allclose(time_left, left)


@pytest.mark.thorough
def test_a_recording_shows_what_agents_do(trips):
    """Each agent's orders tick by tick, and the decisions of the one that might enter."""
    env = Dispatched(trips.env, greedy(trips.env.env))
    policies = {"refuses": env.whole(refusing(env))}
    recording = record_episode(trips.env, trips.params, policies["refuses"], name="refuses", seed=1)
    frames, made = recording.frames, recording.decisions
    slowest = trips.actions.speeds[0]
    at = recording.decision_frames
    # Orders are given at a decision, and seen from its first tick on.
    serves = (frames.med_status[at[:-1]] == IN_SERVICE) & (frames.med_status[at[1:]] == IN_SERVICE)
    assert serves.any()
    np.testing.assert_array_equal(frames.med_service_speed[at[1:]][serves], np.float32(slowest))
    assert not frames.med_accepts[at[1:]][serves].any()
    np.testing.assert_array_equal(made.sent > 0, made.stats.meds_dispatched > 0)
    np.testing.assert_array_equal(made.sent, np.where(made.sent > 0, made.action, 0))
    assert made.mask.shape == made.probabilities.shape == (60, 3)
    np.testing.assert_allclose(made.probabilities.sum(axis=1), 1.0)
    assert made.sent.any()
    table = vehicle_table(recording)
    of_meds = ~np.ma.getmaskarray(table["told_speed_m_per_s"])
    assert set(table["kind"][of_meds]) == {"med"}
    assert set(np.unique(table["told_speed_m_per_s"].compressed())) >= {np.float32(slowest)}
    assert not table["accepts"].compressed().all()
