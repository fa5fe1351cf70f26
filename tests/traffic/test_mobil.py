"""MOBIL: a worked example, safety, and followers judged by their own parameters."""

import jax.numpy as jnp
import numpy as np
import pytest

from medjax.traffic import idm_acceleration, mobil_incentive
from medjax.traffic.idm import IDM
from medjax.traffic.lane_change import CHANGE_LANE, LaneChangeIntent
from medjax.traffic.mobil import is_safe
from medjax.world.params import LaneChangeParams
from tests.traffic.cars import EGO, LENGTH, OLD_LEADER, decided, drivers
from tests.traffic.reference import CAR, TRUCK, idm

SHORTEST = 0.56  # s, headway accepted where a change is most urgent
# The example: front bumpers and speeds of ego, old leader, new leader, old follower, new follower.
X = [0.0, 30.0 + LENGTH, 80.0 + LENGTH, -LENGTH - 30.0, -LENGTH - 25.0]
SPEED = [25.0, 20.0, 25.0, 25.0, 25.0]


@pytest.fixture(scope="module")
def accelerations():
    """Of the example: before and after the change of the ego, the old and the new follower."""
    points = [(25.0, 30.0, 20.0), (25.0, 80.0, 25.0)]
    points += [(25.0, 30.0, 25.0), (25.0, 30.0 + LENGTH + 30.0, 20.0)]  # once the ego is gone
    points += [(25.0, 25.0 + LENGTH + 80.0, 25.0), (25.0, 25.0, 25.0)]  # before the ego comes
    return [float(idm_acceleration(*point, **CAR)) for point in points]


def test_accelerations_of_the_example(accelerations):
    """Each of the three before and after the change."""
    expected = [-8.23017, 0.61573, -1.47002, -1.00001, 0.77651, -2.53793]
    np.testing.assert_allclose(accelerations, expected, atol=6e-6)


@pytest.mark.parametrize(("politeness", "incentive"), [(0.0, 8.8459), (0.2, 8.2770), (1.0, 6.0015)])
def test_incentive_of_the_example(accelerations, politeness, incentive):
    """Before the threshold: selfish, usual and fully polite."""
    got = mobil_incentive(*accelerations, politeness=politeness)
    assert float(got) == pytest.approx(incentive, abs=6e-5)


@pytest.mark.parametrize(("safe_braking", "safe"), [(4.0, True), (2.0, False)])
def test_safety_of_the_example(accelerations, safe_braking, safe):
    """The new follower brakes at 2.54 m/s^2, which b_safe = 4 allows and 2 does not."""
    _, own, _, _, _, follower = accelerations
    limits = {"safe_braking": safe_braking, "min_gap_ahead": 2.0, "min_gap_behind": 2.0}
    assert bool(is_safe(own, follower, 80.0, 25.0, **limits)) is safe


@pytest.mark.parametrize(
    ("own", "follower", "ahead", "behind", "safe"),
    [
        (-3.99, -3.99, 2.0, 4.0, True),
        (-4.01, 0.0, 50.0, 50.0, False),  # it would have to brake too hard itself
        (0.0, -4.01, 50.0, 50.0, False),
        (0.0, 0.0, 1.99, 50.0, False),  # less than the ego's own standing gap
        (0.0, 0.0, 50.0, 3.99, False),  # less than the follower's, which is larger
        (0.0, 0.0, -1.0, 50.0, False),  # beside a vehicle
        (0.0, 0.0, np.inf, np.inf, True),
    ],
)
def test_safety_criterion(own, follower, ahead, behind, safe):
    """Every one of the four conditions can refuse alone."""
    got = is_safe(
        own, follower, ahead, behind, safe_braking=4.0, min_gap_ahead=2.0, min_gap_behind=4.0
    )
    assert bool(got) is safe


def lane_change(x, speed, kinds, *, there=(0, 1, 2, 3, 4), desire=0.0, stay=False, **params):
    """Whether the ego changes to the right among vehicles of the given kinds, who drive by IDM."""
    usual = {"politeness": 0.0, "threshold": 0.2, "right_bias": 0.0, "safe_braking": 4.0}
    usual |= {"mandatory_bias": 10.0, "urgency_bias": 10.0, "accepted_headway": SHORTEST}
    params = LaneChangeParams(**usual | params)
    x, speed = jnp.asarray(x, jnp.float32), jnp.asarray(speed, jnp.float32)
    intent = LaneChangeIntent(
        jnp.zeros(5).at[EGO].set(desire), jnp.full(5, stay), jnp.full(5, True)
    )
    return bool(decided(drivers(kinds), x, speed, intent, params, there, IDM()) == CHANGE_LANE)


@pytest.mark.parametrize(
    ("politeness", "threshold", "changes"),
    [(0.0, 8.84, True), (0.0, 8.85, False), (1.0, 6.00, True), (1.0, 6.003, False)],
)
def test_the_threshold_decides(politeness, threshold, changes):
    """The example's incentive, selfish 8.8459 and polite 6.0015, lies between two thresholds."""
    got = lane_change(X, SPEED, [CAR] * 5, politeness=politeness, threshold=threshold)
    assert got is changes


def smallest_taken(gaps, kinds, desire):
    """The first of ascending gaps behind that the ego takes; all drive at 20 m/s but its slow leader."""
    speed = [20.0, 15.0, 20.0, 20.0, 20.0]

    def taken(gap):
        return lane_change([0.0, 25.0, 185.0, -60.0, -LENGTH - gap], speed, kinds, desire=desire)

    # Bisected: the accelerations grow with the gap.
    low, high = 0, len(gaps) - 1
    assert not taken(gaps[low])
    assert taken(gaps[high])
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if taken(gaps[middle]) else (middle, high)
    return gaps[high]


@pytest.mark.parametrize("follower", [CAR, TRUCK])
@pytest.mark.parametrize("ego", [CAR, TRUCK])
def test_new_follower_is_judged_by_its_own_parameters(ego, follower):
    """The smallest gap behind that is taken is the one where that follower brakes at 4 m/s^2."""
    gaps = np.arange(4.5, 40.0, 0.25)
    braking = idm(follower, gaps, 20.0, 20.0)
    taken = smallest_taken(gaps, [ego, CAR, CAR, CAR, follower], 0.0)
    assert taken == gaps[np.argmax(braking >= -4.0)]


def test_judged_parameters_differ():
    """The two followers of the test above need different gaps."""
    assert idm(CAR, 13.0, 20.0, 20.0) < -4.0 < idm(CAR, 20.0, 20.0, 20.0)
    assert abs(idm(TRUCK, 20.0, 20.0, 20.0) - idm(CAR, 20.0, 20.0, 20.0)) > 0.1


@pytest.mark.parametrize("desire", [0.1, 0.25, 0.5, 0.75, 1.0])
def test_an_urgent_change_takes_a_shorter_gap(desire):
    """LMRS, eqs (8)-(10): the headway accepted behind falls from 1.5 s to 0.56, the braking asked grows to 4 m/s^2."""
    gaps = np.arange(1.0, 60.0, 0.125)
    headway = 1.5 + (SHORTEST - 1.5) * desire
    braking = idm(CAR | {"time_headway": headway}, gaps, 20.0, 20.0)
    assert braking[0] < -4.0  # it is not the standing gap that decides
    taken = smallest_taken(gaps, [CAR] * 5, desire)
    assert taken == gaps[np.argmax(braking >= -4.0 * desire)]


@pytest.mark.parametrize(
    ("desire", "stay", "changes"),
    [(1.0, False, True), (1.0, True, True), (-1.0, False, False), (0.0, True, False)],
)
def test_mandatory_changes_go_first(desire, stay, changes):
    """A vehicle that must go left or stay does not go right for its own gain."""
    assert lane_change(X, SPEED, [CAR] * 5, desire=desire, stay=stay) is changes


def test_a_mandatory_change_waives_no_safety():
    """It outweighs a loss, but not a follower that would brake at more than 4 m/s^2."""
    worse = [0.0, 500.0, 40.0, -60.0, -60.0]  # a short gap ahead in the target lane
    speed = [20.0] * 5
    assert not lane_change(worse, speed, [CAR] * 5)
    assert lane_change(worse, speed, [CAR] * 5, desire=1.0)
    hurried = CAR | {"time_headway": SHORTEST}
    for gap, safe in ((6.0, False), (7.0, True)):
        assert (idm(hurried, gap, 20.0, 20.0) >= -4.0) == safe
        close = [0.0, 500.0, 40.0, -60.0, -LENGTH - gap]
        assert lane_change(close, speed, [CAR] * 5, desire=1.0) is safe


def test_an_empty_lane_is_safe():
    """With nobody in the target lane, a slow leader is enough to leave."""
    assert lane_change(X, SPEED, [CAR] * 5, there=(EGO, OLD_LEADER))
    assert not lane_change(X, SPEED, [CAR] * 5, there=(EGO,))
