"""Drivers made by the package from named parameter sets, and what one of them decides among four others."""

import functools

import jax
import jax.numpy as jnp

from medjax.traffic.following import (
    Platooning,
    following_acceleration,
    gather_slots,
    leaders_and_followers,
    make_drivers,
)
from medjax.traffic.lane_change import LaneChangePhase, Situation, decide
from medjax.traffic.neighbours import NOBODY, Neighbours
from medjax.traffic.safety import BrakingLimits
from medjax.world.params import DriverParams

LENGTH = 5.0
CLEARING_S = 2.5  # until a changing vehicle is out of its lane
# The deciding vehicle; the leaders and followers that it has now and after a change to the right.
EGO, OLD_LEADER, NEW_LEADER, OLD_FOLLOWER, NEW_FOLLOWER = range(5)


def drivers(kinds):
    """One driver of each of `kinds`, parameter sets as in reference.py; cars of 5 m."""
    count = len(kinds)
    columns = {name: jnp.asarray([kind[name] for kind in kinds], jnp.float32) for name in kinds[0]}
    noise = ("desired_speed_std", "acceleration_noise", "lateral_wander")
    columns |= dict.fromkeys(noise, jnp.zeros(count))
    params = DriverParams(**columns, vehicle_length=jnp.full(count, LENGTH))
    return make_drivers(jnp.arange(count), params.desired_speed, params)


@functools.partial(jax.jit, static_argnames=("there", "model"))
def decided(their, x, speed, intent, params, there, model):
    """What the ego decides by `decide`: CHANGE_LANE, or the acceleration that it keeps to for the new leader.

    Args:
      their: drivers of the five; x: m, front bumpers; speed: m/s; `(5,)`.
      intent: of the five, for changes to the right.
      there: which of the five exist.
    """

    def of(*slots):
        slots += (NOBODY,) * (5 - len(slots))
        return jnp.asarray([slot if slot in there else NOBODY for slot in slots])

    # Only the ego asks; what the others see of each other is needed for their accelerations.
    leader = of(OLD_LEADER, NOBODY, NOBODY, EGO, NEW_LEADER)
    neighbours = Neighbours(leader, of(OLD_FOLLOWER), of(NEW_LEADER), of(NEW_FOLLOWER))
    leaders, followers = leaders_and_followers(their, x, speed, of(), model)
    follow = functools.partial(following_acceleration, platooning=Platooning(0.3, 2.0), model=model)
    following = follow(followers, gather_slots(leaders, leader), leader != NOBODY)
    situation = Situation(
        leaders=leaders,
        followers=followers,
        usual_headway=their.time_headway,
        neighbours=neighbours,
        clearing_s=jnp.full(5, CLEARING_S),
        following=following,
        acceleration=following,
    )
    phase, limits = LaneChangePhase(jnp.asarray(1), jnp.asarray(0), 1), BrakingLimits(9.0, 0.25)
    return decide(situation, intent, phase, follow, params, limits)[EGO]
