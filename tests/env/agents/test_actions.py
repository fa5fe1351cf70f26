"""Parts of an agent's action, the discrete action that they fold into, and masks."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest

from medjax.env.agents.actions import AgentActions, Parts, give_orders
from medjax.world.state import AT_DEPOT, IN_SERVICE, MERGING, QUEUED
from tests.charging.scene import put
from tests.env.agents.conftest import TRIPS

pytestmark = pytest.mark.usefixtures("quick_compiles")

PLACES = ("x", "destination")
SPACES = [
    AgentActions((14.0, 18.0, 22.0), (1, 2), num_ramps=4, exits=True),
    AgentActions((14.0, 22.0), (1,), num_ramps=2, exits=True, depots=2),
    AgentActions((22.0,), (0,), num_ramps=1, exits=False),
    AgentActions((10.0, 20.0), (1, 2, 3), num_ramps=0, exits=False),
]


@pytest.mark.parametrize("actions", SPACES)
def test_every_combination_is_one_action(actions):
    """Folding is one to one, and unfolding undoes it."""
    enter, *others = (range(space.n) for space in actions.parts)
    waits = [(ramp, 0, 0, 1, 0) for ramp in enter]
    serves = [(0, *each) for each in itertools.product(*others)]
    rows = np.array([*waits, *serves], np.int32)
    flags = np.arange(len(rows)) >= len(waits)
    folded = np.asarray(actions.fold(Parts(*map(jnp.asarray, rows.T)), jnp.asarray(flags)))
    np.testing.assert_array_equal(folded, np.arange(actions.num_actions))
    rule = Parts(*(jnp.full(len(rows), usual) for usual in (0, 0, 0, 1, 0)))
    back = actions.unfold(jnp.asarray(folded), rule)
    np.testing.assert_array_equal(np.stack(back, axis=1), rows)


@pytest.mark.thorough
@pytest.mark.parametrize("speed", [15.9, 20.0])
def test_action_0_keeps_the_fleet_s_speed_when_that_is_replaced(trips, busy, speed):
    fleet = trips.params.fleet.replace(service_speed=jnp.float32(speed))
    params = trips.params.replace(fleet=fleet)
    state, _ = give_orders(busy, trips.by_rule(busy, params), trips.actions, trips.config, params)
    serves = np.asarray(busy.meds.status == IN_SERVICE)
    assert serves.any()
    np.testing.assert_array_equal(state.meds.service_speed[serves], np.float32(speed))


@pytest.mark.thorough
def test_action_0_is_the_rule(trips, busy):
    """The fleet's speed and lane, every EV is taken, nobody leaves."""
    rule = trips.by_rule(busy, trips.params)
    fleet = trips.params.fleet
    assert trips.actions.speeds[int(rule.speed[0])] == float(fleet.service_speed)
    parts = trips.actions.unfold(jnp.zeros(4, jnp.int32), rule)
    np.testing.assert_array_equal(np.stack(parts), np.stack(rule))
    assert parts.accept.all()
    assert not parts.leave.any()


def test_masks_by_hand(trips, busy):
    """Each agent's masks follow from its status, bookings, lane and place."""
    masks = trips.masks(busy, trips.params)
    folded = np.asarray(trips.mask(busy, trips.params))
    status = np.asarray(busy.meds.status)
    depot = [med for med in range(4) if status[med] == AT_DEPOT]
    for med in range(4):
        may_enter = depot[:1] == [med] and float(busy.cooldown_s) <= 0.0
        assert list(masks.enter[med]) == [True, may_enter, may_enter]
        serves, comes = status[med] == IN_SERVICE, status[med] in (QUEUED, MERGING)
        booked = med in np.asarray(busy.evs.med)
        lanes = [
            (serves and not booked)
            or ((serves or comes) and lane == int(busy.meds.service_lane[med]))
            for lane in trips.actions.lanes
        ]
        assert list(masks.lane[med]) == lanes
        usual = [speed == float(trips.params.fleet.service_speed) for speed in trips.actions.speeds]
        assert list(masks.speed[med]) == [serves or (comes and each) for each in usual]
        assert list(masks.accept[med]) == [serves or comes] * 2
        x, destination = (np.asarray(getattr(busy.vehicles, name))[med] for name in PLACES)
        sooner = any(x + 400.0 < place < destination for place in TRIPS["exit_x_m"])
        assert list(masks.leave[med]) == [serves or comes, serves and sooner]
        sizes = len(trips.actions.speeds) * sum(lanes) * 2 * (1 + sooner) if serves else 2 * comes
        assert folded[med].sum() == 1 + 2 * may_enter + sizes
    assert folded[:, 0].all()
    assert folded.shape[1] == trips.env.num_actions


def test_a_med_leaves_early_once(trips, busy):
    """A MED that was ordered to leave cannot choose so again, nor can one too close to the last exit."""
    serves = np.asarray(busy.meds.status) == IN_SERVICE

    def may_leave(x, destination):
        """The state with all four MEDs there, and which may leave."""
        state = put(busy, vehicles={"x": (slice(4), x), "destination": (slice(4), destination)})
        return state, np.asarray(trips.masks(state, trips.params).leave[:, 1])

    first, last = TRIPS["exit_x_m"]
    state, may = may_leave(first - 500.0, 3000.0)
    np.testing.assert_array_equal(may, serves)
    rule = trips.by_rule(state, trips.params)
    told = rule._replace(leave=jnp.asarray(may, jnp.int32))
    after, _ = give_orders(state, told, trips.actions, trips.config, trips.params)
    assert (np.asarray(after.vehicles.destination)[:4][serves] == first).all()
    assert not trips.masks(after, trips.params).leave[:, 1].any()
    assert may_leave(first - 300.0, 3000.0)[1].any()  # too late for the first, not for the other
    assert not may_leave(first - 300.0, last)[1].any()  # where they leave anyway
    assert not may_leave(last - 300.0, 3000.0)[1].any()


def test_a_fresh_road_has_one_agent_with_a_choice(trips):
    """The first at the depot."""
    _, state = trips.reset()
    present = np.asarray(trips.env.present(state, trips.params))
    assert list(present) == [True, False, False, False]


@pytest.mark.parametrize("actions", SPACES)
def test_folded_logits_keep_parts_independent(actions):
    """The marginals of the folded action's probabilities are the parts' softmaxes."""
    rng = np.random.default_rng(0)
    sizes = [part.n for part in actions.parts]
    logits = [rng.normal(size=size) for size in sizes]
    assert actions.num_logits == sum(sizes)
    folded = np.asarray(actions.fold_logits(jnp.asarray(np.concatenate(logits))[None]))[0]
    np.testing.assert_allclose(folded[: sizes[0]], logits[0], rtol=1e-6)
    joint = np.exp(folded[sizes[0] :])
    expected = np.ones(())
    for part in logits[1:]:
        share = np.exp(part) / np.exp(part).sum()
        expected = np.multiply.outer(expected, share)
    np.testing.assert_allclose((joint / joint.sum()).reshape(expected.shape), expected, rtol=1e-5)
