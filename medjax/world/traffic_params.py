"""Parameters of road and drivers, each declared once with default, range, unit, description and source.

A default per vehicle kind is a tuple in the order of `medjax.world.kinds.KINDS`.
"""

from __future__ import annotations

import math

import jax
from flax import struct

from medjax.world.numbers import number

Scalar = jax.Array | float


class RoadParams(struct.PyTreeNode):
    """Geometry of the highway; positions are in metres from its left end."""

    length_m: Scalar = number(4000.0, 100, 200e3, "m", 'paper, "Experiment settings"')
    lane_width_m: Scalar = number(
        4.0, 2.75, 10, "m", "paper (lane width of highway-env); a lorry is 2.55 m wide"
    )
    ramp_x_m: jax.Array = number(
        (100.0, 1200.0, 2100.0, 3200.0),
        0,
        200e3,
        "m",
        "start of each acceleration lane, `(num_ramps,)`; paper",
        per="ramp",
    )
    acceleration_lane_m: Scalar = number(250.0, 10, 5000, "m", "chosen: usual for motorways")
    exit_x_m: jax.Array = number(
        (),
        0,
        200e3,
        "m",
        "end of each deceleration lane, where the off-ramp begins, `(num_exits,)`; paper: none",
        per="exit",
    )
    exit_lane_m: Scalar = number(
        250.0, 10, 5000, "m", "length of deceleration lanes; German guidelines (RAA): 250"
    )
    exit_notice_m: Scalar = number(
        1000.0,
        0,
        10e3,
        "m",
        "distance of the first sign before an exit, usual for motorways; vehicles that enter nearer do not take it",
    )
    slope: Scalar = number(
        0.0, -0.2, 0.2, "rad", "positive uphill, constant along the road; motorways stay below 0.06"
    )
    air_density: Scalar = number(1.2, 0.1, 10, "kg/m3", "reference: 20 C at sea level")


class DriverParams(struct.PyTreeNode):
    """Car-following and body parameters, each `(num_kinds,)`, and the response of EV drivers to low charge."""

    desired_speed: jax.Array = number(
        (22.0, 30.0, 30.0, 30.0, 23.6),
        1,
        100,
        "m/s",
        "mean of each kind; paper: about 110 km/h; a MED in service drives at `fleet.service_speed` instead; lorries: "
        "85 km/h, std 2.5 (Schakel, Knoop, van Arem 2012)",
        per="kind",
    )
    desired_speed_std: jax.Array = number(
        (0.0, 2.0, 1.0, 2.0, 0.7),
        0,
        20,
        "m/s",
        "standard deviation among drivers; chosen",
        per="kind",
    )
    time_headway: jax.Array = number(
        (1.5, 1.4, 1.2, 1.4, 2.0),
        0.1,
        10,
        "s",
        "Kesting, Treiber, Helbing 2007: 1.0-1.6; lorries: Treiber, Kesting 2013",
        per="kind",
    )
    min_gap: jax.Array = number(
        (3, 2, 2, 2, 4),
        0.1,
        20,
        "m",
        "at standstill, bumper to bumper; Treiber et al. 2000: 2",
        per="kind",
    )
    max_acceleration: jax.Array = number(
        (1, 1.4, 1.4, 1.4, 0.5),
        0.1,
        20,
        "m/s2",
        "Treiber, Kesting 2013, tab. 11.2: 1.0-1.5; lorries 0.4-0.7 (Schakel et al. 2012: 0.4)",
        per="kind",
    )
    comfortable_deceleration: jax.Array = number(
        (2.0, 2.0, 2.0, 2.0, 2.0), 0.1, 20, "m/s2", "source as for `max_acceleration`", per="kind"
    )
    acceleration_noise: jax.Array = number(
        (0.02, 0.10, 0.01, 0.10, 0.05), 0, 5, "m/s2", "standard deviation; chosen", per="kind"
    )
    lateral_wander: jax.Array = number(
        (0.02, 0.15, 0.02, 0.15, 0.1),
        0,
        2,
        "m",
        "standard deviation; chosen; drivers keep their lane to 0.1-0.3 m",
        per="kind",
    )
    vehicle_length: jax.Array = number(
        (12.0, 5.0, 5.0, 5.0, 16.5),
        2,
        50,
        "m",
        "cars: paper (highway-env); MED: a rigid truck; lorry: articulated (Directive 96/53/EC)",
        per="kind",
    )
    vehicle_width: jax.Array = number(
        (2.5, 1.8, 1.8, 1.8, 2.55),
        0.5,
        2.6,
        "m",
        "cars: chosen; a lorry's is the widest that is allowed in the EU (Directive 96/53/EC), 2.6 in the USA",
        per="kind",
    )
    eco_compliance: Scalar = number(
        0.0, 0, 1, "", "share of EV drivers who slow down to save charge; paper: none"
    )
    eco_speed: Scalar = number(
        22.0, 1, 100, "m/s", "lowest speed to save charge, no slower than a lorry; chosen"
    )
    eco_horizon_m: Scalar = number(
        30e3,
        0,
        math.inf,
        "m",
        "EVs bound for the road's end make their charge last at least this far; inf: no charge is enough for any EV",
    )
    eco_soc: Scalar = number(
        1.0, 0, 1, "", "drivers with more charge than this do not slow down to save it"
    )


class MotionParams(struct.PyTreeNode):
    """Motion limits and noise that all vehicles share."""

    max_braking: Scalar = number(9.0, 1, 50, "m/s2", "limit of the tyres on a dry road")
    noise_time_s: Scalar = number(
        5.0, 0.1, 10e3, "s", "correlation time of acceleration noise and lateral wander; chosen"
    )
    lateral_rate: Scalar = number(
        2.0, 0.1, 4, "1/s", "steering rate; a small offset is corrected at half of it"
    )
    lateral_acceleration: Scalar = number(
        2.0, 0.1, 20, "m/s2", "highest lateral acceleration; comfortable steering"
    )
    lateral_speed: Scalar = number(
        1.5,
        0.1,
        10,
        "m/s",
        "highest lateral speed, a lane in 4 s; Toledo, Zohar 2007: 4.6 s on average",
    )
    lateral_slope: Scalar = number(
        0.2,
        0.01,
        1,
        "",
        "highest ratio of lateral to longitudinal speed, so that no vehicle slides; chosen",
    )


class LaneChangeParams(struct.PyTreeNode):
    """MOBIL (Kesting, Treiber, Helbing 2007)."""

    politeness: Scalar = number(0.2, 0, 1, "", "Kesting, Treiber, Helbing 2007: 0.2-0.5")
    threshold: Scalar = number(0.2, 0, 100, "m/s2", "Kesting, Treiber, Helbing 2007: 0.1-0.2")
    right_bias: Scalar = number(
        0.0, -100, 100, "m/s2", "incentive to change right; 0: symmetric rules, as in the USA"
    )
    safe_braking: Scalar = number(
        4.0,
        0.1,
        50,
        "m/s2",
        "hardest braking that a change imposes on the follower or the vehicle itself; Kesting, Treiber, Helbing 2007",
    )
    mandatory_bias: Scalar = number(
        10.0,
        0,
        1000,
        "m/s2",
        "incentive of a mandatory change; chosen: outweighs any other incentive, but never safety",
    )
    urgency_bias: Scalar = number(
        10.0,
        0,
        1000,
        "m/s2",
        "additional incentive for a lane change that must be made, such as a merge; chosen",
    )
    accepted_headway: Scalar = number(
        0.56, 0.1, 10, "s", "accepted by the most urgent change; Schakel, Knoop, van Arem 2012"
    )
    relaxation_s: Scalar = number(
        15.0, 0.1, 1e3, "s", "time in which a short headway recovers; Laval, Leclercq 2008: 10-20"
    )
    courtesy_braking: Scalar = number(
        2.0,
        0,
        20,
        "m/s2",
        "hardest braking to let others change, or to fall in for one's own change; Schakel et al. 2012: comfortable",
    )
    view_m: Scalar = number(
        360.0,
        1,
        10e3,
        "m",
        "a mandatory change becomes urgent this far before it must be done; courteous drivers look as far",
    )
    exit_view_m: Scalar = number(
        295.0,
        1,
        10e3,
        "m",
        "the same before a deceleration lane, per lane to cross; Schakel, Knoop, van Arem 2012: 295",
    )
    recovery_s: Scalar = number(
        6.0, 0, 1e3, "s", "time from a lane change to the next discretionary one; chosen"
    )
