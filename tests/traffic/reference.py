"""IDM, IDM+ and neighbours in float64 NumPy, and parameter sets of drivers (m, s, m/s)."""

import numpy as np

from medjax.traffic.neighbours import NOBODY


def parameters(v0_kmh, T, s0, a, b):
    return {
        "desired_speed": v0_kmh / 3.6,
        "time_headway": T,
        "min_gap": s0,
        "max_acceleration": a,
        "comfortable_deceleration": b,
    }


CAR = parameters(120.0, 1.5, 2.0, 1.4, 2.0)
HIGHWAY = parameters(120.0, 1.0, 2.0, 1.0, 1.5)
TRUCK = parameters(85.0, 2.0, 4.0, 0.7, 2.0)


def wanted_gap(p, v, vl):
    """s*, m."""
    braking = 2 * np.sqrt(p["max_acceleration"] * p["comfortable_deceleration"])
    return p["min_gap"] + np.maximum(0.0, v * p["time_headway"] + v * (v - vl) / braking)


def idm(p, s, v, vl):
    """The printed formula; gaps are taken as they are."""
    interaction = (wanted_gap(p, v, vl) / s) ** 2
    return p["max_acceleration"] * (1 - (v / p["desired_speed"]) ** 4 - interaction)


def idm_plus(p, s, v, vl):
    """Schakel, van Arem, Netten 2010, eq (3); the free branch brakes at b at most."""
    a = p["max_acceleration"]
    free = np.maximum(a * (1 - (v / p["desired_speed"]) ** 4), -p["comfortable_deceleration"])
    return np.minimum(free, a * (1 - (wanted_gap(p, v, vl) / s) ** 2))


def equilibrium_gap(p, v):
    """(s0 + v T) / sqrt(1 - (v/v0)^4), m."""
    free = 1 - (v / p["desired_speed"]) ** 4
    return (p["min_gap"] + v * p["time_headway"]) / np.sqrt(free)


def slopes(p, v):
    """(f_s, f_l, f_v): how IDM answers gap, leader's speed and own speed, at equilibrium."""
    s, a = equilibrium_gap(p, v), p["max_acceleration"]
    star = wanted_gap(p, v, v)
    root = 2 * np.sqrt(a * p["comfortable_deceleration"])
    f_s = 2 * a * star**2 / s**3
    f_l = 2 * a * (star / s**2) * v / root
    f_v = 4 * v**3 / p["desired_speed"] ** 4 + 2 * (star / s**2) * (p["time_headway"] + v / root)
    return f_s, f_l, -a * f_v


def gain(p, v, w):
    """|G(w)| of one car behind a leader whose speed swings at w rad/s."""
    f_s, f_l, f_v = slopes(p, v)
    return abs(f_s + 1j * w * f_l) / abs(f_s - w**2 - 1j * w * f_v)


def sampled_gain(p, v, w, dt):
    """|G(w)| of the same linear car, moved by ballistic steps of dt (z-transform of both)."""
    f_s, f_l, f_v = slopes(p, v)
    z = np.exp(1j * w * dt)
    speed = dt / (z - 1)  # of one unit of acceleration
    position = (dt * speed + dt**2 / 2) / (z - 1)
    leader = 1 / (1j * w)  # position of one unit of the leader's speed
    return abs(speed * (f_s * leader + f_l) / (1 + f_s * position - f_v * speed))


def brute_force(x, lane, target, other=None, active=None):
    """(ahead, behind) of each active vehicle in its target lane, by float64 positions; ties by slot.

    A vehicle is in its lane and, unless it is in none, in its other lane.
    """
    slots = np.arange(len(x))
    active = np.full(len(x), True) if active is None else active
    other = lane if other is None else other
    ahead, behind = np.full((2, len(x)), NOBODY)
    for there in np.unique(target):
        members = slots[active & ((lane == there) | (other == there))]
        members = members[np.lexsort((members, x[members]))]
        looks = np.flatnonzero(active & (target == there))
        first = np.searchsorted(x[members], x[looks], side="left")
        for me, count in zip(looks, first, strict=True):
            # Vehicles abreast to the last bit are ordered by slot.
            count = count + np.sum((x[members] == x[me]) & (members < me))
            after = count + (me in members)  # the vehicle itself is in between
            ahead[me] = members[after] if after < len(members) else NOBODY
            behind[me] = members[count - 1] if count else NOBODY
    return ahead, behind
