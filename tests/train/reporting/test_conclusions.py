"""Sentences on made numbers, where the right one is known."""

import numpy as np
import pytest

from train.reporting.conclusions import FEWEST, counts, difference, learning, lost, reached

PAIR = ("ppo", "forecast")
SPREAD = np.linspace(-1.0, 1.0, 16)  # mean 0


@pytest.mark.parametrize(
    ("shift", "words"),
    [
        (5.0, "higher with ppo than with forecast in the same 16 episodes, +5.000 ["),
        (-5.0, "lower with ppo than with forecast in the same 16 episodes, -5.000 ["),
        (0.1, "no difference between ppo and forecast can be seen with 16 episodes, +0.100 [-"),
    ],
)
def test_a_difference_needs_an_interval_without_zero(shift, words):
    assert difference("Return", PAIR, SPREAD + shift, 0).startswith(f"Return: {words}")


def test_few_episodes_and_equal_episodes_show_no_difference():
    few = difference("Return", PAIR, np.full(FEWEST - 1, 5.0), 0)
    assert few == f"Return: {FEWEST - 1} episodes are too few to tell ppo from forecast."
    lost = difference("Return", PAIR, np.append(np.ones(FEWEST), np.nan), 0)
    assert lost == f"Return: it is not finite in some of the {FEWEST + 1} episodes."
    assert "the same in each of the 3 episodes" in difference("Return", PAIR, np.zeros(3), 0)


def test_a_curve_is_told_by_the_means_of_its_parts():
    """Quarters, or halves of fewer updates, such as the 17 of a default run; never with an interval or a verdict."""
    rise = np.arange(100.0)
    settled = np.minimum(4.0 * rise, 100.0)
    for curve, first, third, last in (
        (rise, "12.00", "62.00", "87.00"),
        (-rise, "-12.00", "-62.00", "-87.00"),
        (0.0 * rise, "0.000", "0.000", "0.000"),
        (settled, "48.00", "100.0", "100.0"),
    ):
        quarters = f"{first} in the first quarter of the updates, {third} in the third and {last} in the last."
        assert learning(curve) == f"The mean return is {quarters}"
    for count, first, last in (
        (2 * FEWEST, "3.500", "11.50"),
        (17, "3.500", "12.50"),
        (4 * FEWEST - 1, "7.000", "23.00"),
    ):
        halves = f"{first} in the first half of the updates and {last} in the second."
        assert learning(rise[:count]) == f"The mean return is {halves}"
    assert "first quarter" in learning(rise[: 4 * FEWEST])
    assert "too few to tell a trend, 16 are needed" in learning(rise[: 2 * FEWEST - 1])
    assert "too few" in learning(rise[:0])


def test_an_episode_stands_beside_the_mean_of_all():
    said = counts("EVs that run out", 3.0, SPREAD + 5.0, 0)
    assert said.startswith("EVs that run out: 3 in this episode, 5.000 [4.")
    assert said.endswith("in the mean of 16.")


def test_evs_that_reach_their_exit_are_counted_by_the_hundred():
    shares = {"with ppo": 0.684, "with none": 0.316}
    said = reached(shares, dict.fromkeys(shares, 0.004))
    assert said == "Of 100 electric vehicles (EVs), 68 reach their exit with ppo, and 32 with none."


def test_evs_that_leave_to_charge_are_told_apart():
    """Only where there are some."""
    shares = {"with ppo": 0.684, "with paced": 0.5, "with none": 0.316}
    said = reached(shares, {"with ppo": 0.121, "with paced": 0.0, "with none": 0.6})
    assert said == (
        "Of 100 electric vehicles (EVs), 68 reach their exit and 12 leave to charge with ppo, 50 reach their exit with "
        "paced, and 32 reach their exit and 60 leave to charge with none."
    )


def test_lost_time_has_a_digit_only_if_it_is_short_and_no_minus_before_zero():
    said = lost({"with ppo": 45.52, "with paced": 9.33, "with none": -0.01}, "10 min")
    assert said.endswith(
        "together lose 46 min with ppo, 9.3 min with paced, and 0.0 min with none."
    )
    assert said.startswith("In an episode of 10 min, ")
