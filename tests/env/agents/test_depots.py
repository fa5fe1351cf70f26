"""Agents of several depots: entering, leaving, and observations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.env.agents.actions import give_orders
from medjax.episodes.runner import Decision
from medjax.world.state import AT_DEPOT, IN_SERVICE, RETIRED
from tests.charging.scene import put
from tests.env.agents.conftest import TRIPS, World

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.fixture(scope="module")
def depots():
    """The road of TRIPS with a depot at either ramp."""
    return World(medjax.make_agents("corridor", **TRIPS, num_depots=2, return_speed=50.0))


def test_the_first_med_of_each_depot_may_enter_by_its_own_ramps(depots):
    """MEDs 0 and 2 stand at the first depot, 1 and 3 at the second."""
    _, state = depots.reset()
    mask = np.asarray(depots.mask(state, depots.params))
    assert mask[:, 0].all()
    assert mask[:, 1].tolist() == [True, False, False, False]
    assert mask[:, 2].tolist() == [False, True, False, False]
    assert not mask[:, 3:].any()


@pytest.mark.thorough
def test_of_two_meds_that_enter_at_once_one_does(depots):
    """That of the last ramp; the cooldown stops the other."""
    _, state = depots.reset()
    actions = jnp.array([1, 2, 0, 0])
    _, state, *_, info = depots.step(jax.random.key(0), state, actions, depots.params)
    assert (state.meds.status == AT_DEPOT).tolist() == [True, False, True, True]
    assert info["metrics"]["invalid_actions"] == 0.0


def test_a_recording_shows_the_agent_that_entered(depots):
    """Of several, the one of the last ramp; none enters by a ramp of another depot."""
    _, state = depots.reset()
    mask = depots.mask(state, depots.params)[None]
    one_hot = jnp.zeros(mask.shape)
    for actions, sent in zip(
        ([1, 2], [1, 0], [1, 1], [2, 2], [2, 0]), (2, 1, 1, 2, 0), strict=True
    ):
        actions += [0, 0]
        made = Decision(jnp.array([actions]), one_hot, mask, jnp.zeros(1), {}).of_dispatcher(3)
        after = depots.step(jax.random.key(0), state, jnp.array(actions), depots.params)[1]
        entered = after.meds.ramp[after.meds.status != AT_DEPOT]
        assert [int(ramp) + 1 for ramp in entered] == [sent] * (sent > 0)
        assert bool(made.mask[0, made.action[0]]) == (actions != [2, 0, 0, 0])
        if sent:
            assert made.action.tolist() == [sent]


def at(depots, state, x, destination, depot):
    """The state with all four in service at x, and their mask of `leave`."""
    four = slice(4)
    state = put(
        state,
        vehicles={"x": (four, x), "destination": (four, destination), "active": (four, True)},
        meds={"status": (four, IN_SERVICE), "depot": (four, depot)},
    )
    return state, depots.masks(state, depots.params).leave[0].tolist()


def test_which_depots_a_med_may_choose(depots):
    """Any by an exit that comes sooner; another one by its own exit, until it is too late."""
    _, state = depots.reset()
    first, last = TRIPS["exit_x_m"]
    assert depots.actions.parts.leave.n == 3
    assert at(depots, state, first - 500.0, last, 0)[1] == [True, True, True]
    assert at(depots, state, first - 500.0, first, 0)[1] == [True, False, True]
    assert at(depots, state, first - 500.0, first, 1)[1] == [True, True, False]
    assert at(depots, state, first - 300.0, first, 1)[1] == [True, False, False]
    assert at(depots, state, last - 300.0, last, 0)[1] == [True, False, False]
    assert at(depots, state, last - 300.0, 3000.0, 0)[1] == [True, False, True]  # by the road's end
    told, _ = at(depots, state, first - 500.0, first, 0)
    rule = depots.by_rule(told, depots.params)
    orders = rule._replace(leave=jnp.array([0, 1, 2, 2]))
    after, _ = give_orders(told, orders, depots.actions, depots.config, depots.params)
    assert after.meds.depot.tolist() == [0, 0, 1, 1]
    assert (after.vehicles.destination[:4] == first).all()


def test_a_med_sent_to_another_depot_enters_from_there(depots):
    """A MED of the first depot leaves early for the second, and is next in its queue once back."""
    params, actions = depots.params, depots.actions
    _, state = depots.reset(1)
    status, told = AT_DEPOT, False
    for number in range(60):
        mask = np.asarray(depots.mask(state, params))
        parts = depots.by_rule(state, params)._replace(leave=jnp.full(4, 2))
        to_second = np.asarray(actions.fold(parts, jnp.ones(4, bool)))[0]
        action = np.zeros(4, np.int32)
        if number == 0:
            action[0] = 1
        elif mask[0, to_second] and not told:
            told, action[0] = True, to_second
        _, state, *_ = depots.step(jax.random.key(number), state, jnp.asarray(action), params)
        before, status = status, int(state.meds.status[0])
        if before == RETIRED and status == AT_DEPOT:
            break
    assert told
    assert status == AT_DEPOT
    assert state.meds.depot.tolist() == [1, 1, 0, 1]
    mask = np.asarray(depots.mask(state, params))
    # MED 0 comes before MED 1, since it has the lower number; MED 2 is the first at the first depot.
    assert mask[:, 1].tolist() == [False, False, True, False]
    assert mask[:, 2].tolist() == [True, False, False, False]
    assert mask[:, 0].all()


def test_observations_of_depots(depots):
    """An agent sees its own depot and the share of the fleet at each; `outlook` still finds need and shares."""
    _, state = depots.reset()
    seen, view = np.asarray(depots.view(state, params := depots.params)), depots.env.view
    assert seen.shape == (4, view.size(depots.config))
    other = World(medjax.make_agents("corridor", **TRIPS))
    assert view.size(depots.config) - view.size(other.config) == 4
    moved = state.replace(meds=state.meds.replace(depot=jnp.array([1, 1, 0, 1])))
    changed = (np.asarray(depots.view(moved, params)) != seen).sum(axis=1)
    # The shares of both depots; the flags of its own; who is the first of either line now.
    assert changed.tolist() == [4, 3, 3, 2]
    need, at_depot, _ = view.outlook(jnp.asarray(seen), depots.config)
    assert need.there.shape == (4, 2)
    np.testing.assert_allclose(at_depot, 1.0)
