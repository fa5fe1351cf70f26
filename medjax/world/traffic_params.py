"""Parameters of road, demand and drivers, each declared once with default, range, unit, description and source.

A default per vehicle kind is a tuple in the order of `medjax.world.kinds.KINDS`.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from flax import struct

from medjax.world.numbers import number

Scalar = jax.Array | float


class RoadParams(struct.PyTreeNode):
    """Geometry of the highway; positions are in metres from its left end."""

    length_m: Scalar = number(4000.0, 100, 200e3, "m", 'paper, "Experiment settings"')
    lane_width_m: Scalar = number(
        4.0, 2.75, 10, "m", "paper (highway-env's lane); a lorry is 2.55 m wide"
    )
    ramp_x_m: jax.Array = number(
        (100.0, 1200.0, 2100.0, 3200.0),
        0,
        200e3,
        "m",
        "where each acceleration lane starts, `(num_ramps,)`; paper",
        per="ramp",
    )
    acceleration_lane_m: Scalar = number(250.0, 10, 5000, "m", "chosen; usual for motorways")
    exit_x_m: jax.Array = number(
        (),
        0,
        200e3,
        "m",
        "where each deceleration lane ends, and its off-ramp begins, `(num_exits,)`; paper: none",
        per="exit",
    )
    exit_lane_m: Scalar = number(
        250.0, 10, 5000, "m", "deceleration lanes; German guidelines (RAA): 250"
    )
    exit_notice_m: Scalar = number(
        1000.0,
        0,
        10e3,
        "m",
        "the first sign before an exit; usual for motorways; who enters nearer to it does not take it",
    )
    slope: Scalar = number(
        0.0, -0.2, 0.2, "rad", "positive uphill, the same all along; motorways stay below 0.06"
    )
    air_density: Scalar = number(1.2, 0.1, 10, "kg/m3", "reference; 20 C at sea level")


class DemandParams(struct.PyTreeNode):
    """Traffic demand at the entries, and its mix of vehicles."""

    mainline_per_h: Scalar = number(
        2600.0, 0, 100e3, "1/h", "all lanes; chosen: 650 an hour and lane, free flow with platoons"
    )
    ramp_per_h: jax.Array = number(
        (250.0,) * 4, 0, 100e3, "1/h", "at each ramp, `(num_ramps,)`; chosen", per="ramp"
    )
    profile: jax.Array = number(
        ((1.0,) * 5,),
        0,
        100,
        "",
        "factor of `mainline_per_h` and of each `ramp_per_h` over the day, `(num_periods, 1 + num_ramps)`, one row a "
        "period; the last one stays; paper: always 1",
        per="period",
    )
    period_s: Scalar = number(3600.0, 1, 1e6, "s", "how long each period is")
    start_s: Scalar = number(0.0, 0, 1e9, "s", "where in the profile an episode starts")
    exit_share: jax.Array = number(
        (), 0, 1, "", "of those who pass an exit, who leave there, `(num_exits,)`", per="exit"
    )
    ev_share: Scalar = number(
        0.12, 0, 1, "", "EVs among arrivals; chosen: so many that fifteen MEDs can serve most"
    )
    human_share: Scalar = number(
        0.5, 0, 1, "", "share of EVs driven by a human; chosen, the paper has both kinds of drivers"
    )
    lorry_share: Scalar = number(
        0.0, 0, 1, "", "lorries among the vehicles with fuel; paper: none; German motorways: 0.15"
    )
    arrival_soc_low: Scalar = number(
        0.2,
        0,
        1,
        "",
        "charge on arrival, at least; chosen with `battery_scale`: most run out unaided",
    )
    arrival_soc_high: Scalar = number(0.7, 0, 1, "", "charge on arrival, at most; chosen")
    ramp_speed: Scalar = number(20.0, 1, 60, "m/s", "at the start of the acceleration lane; chosen")

    def flows(self, time_s: Scalar) -> tuple[jax.Array, jax.Array]:
        """Demand on the main road `()` and at each ramp `(num_ramps,)`, 1/h, at time_s after the episode's start."""
        period = jnp.floor((self.start_s + time_s) / self.period_s).astype(jnp.int32)
        factor = jnp.asarray(self.profile)[jnp.minimum(period, self.profile.shape[0] - 1)]
        return self.mainline_per_h * factor[0], self.ramp_per_h * factor[1:]

    @property
    def class_shares(self) -> tuple[Scalar, ...]:
        """Share of each kind among the vehicles of its class, in the order of `medjax.world.kinds.KINDS`."""
        human, lorries = self.human_share, self.lorry_share
        return 1.0, human, 1.0 - human, 1.0 - lorries, lorries


class DriverParams(struct.PyTreeNode):
    """Car-following and body parameters, each `(num_kinds,)`, and the response of EV drivers to low charge."""

    desired_speed: jax.Array = number(
        (22.0, 30.0, 30.0, 30.0, 23.6),
        1,
        100,
        "m/s",
        "mean of the kind; paper: about 110 km/h; a MED drives `fleet.service_speed` once it is in service; a lorry: "
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
        (3, 2, 2, 2, 4), 0.1, 20, "m", "bumper to bumper; Treiber et al. 2000: 2", per="kind"
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
        (2.0, 2.0, 2.0, 2.0, 2.0), 0.1, 20, "m/s2", "the same", per="kind"
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
        "paper (highway-env's car); a rigid truck; an articulated lorry (Directive 96/53/EC)",
        per="kind",
    )
    eco_compliance: Scalar = number(
        0.0, 0, 1, "", "share of EVs' drivers who slow down to save charge; paper: none does"
    )
    eco_speed: Scalar = number(22.0, 1, 100, "m/s", "they do not drive slower than a lorry; chosen")
    eco_horizon_m: Scalar = number(
        30e3,
        0,
        math.inf,
        "m",
        "charge is to last for this, or to the road's end if that is further",
    )
    eco_soc: Scalar = number(1.0, 0, 1, "", "who has more charge does not think of it")


class MotionParams(struct.PyTreeNode):
    """Motion limits and noise that all vehicles share."""

    max_braking: Scalar = number(9.0, 1, 50, "m/s2", "the tyres' limit; dry road")
    noise_time_s: Scalar = number(
        5.0, 0.1, 10e3, "s", "correlation time of acceleration noise and lateral wander; chosen"
    )
    lateral_rate: Scalar = number(
        2.0, 0.1, 4, "1/s", "of steering; half of it is what is left of an offset once it is small"
    )
    lateral_acceleration: Scalar = number(
        2.0, 0.1, 20, "m/s2", "sideways, at most; comfortable steering"
    )
    lateral_speed: Scalar = number(
        1.5,
        0.1,
        10,
        "m/s",
        "sideways, at most: a lane in 4 s; Toledo, Zohar 2007: 4.6 s on average",
    )
    lateral_slope: Scalar = number(
        0.2, 0.01, 1, "", "sideways speed over the speed along, at most: nobody slides; chosen"
    )


class LaneChangeParams(struct.PyTreeNode):
    """MOBIL (Kesting, Treiber, Helbing 2007)."""

    politeness: Scalar = number(0.2, 0, 1, "", "Kesting, Treiber, Helbing 2007: 0.2-0.5")
    threshold: Scalar = number(0.2, 0, 100, "m/s2", "the same: 0.1-0.2")
    right_bias: Scalar = number(
        0.0, -100, 100, "m/s2", "in favour of the right lane; symmetric rules, as in the USA"
    )
    safe_braking: Scalar = number(
        4.0, 0.1, 50, "m/s2", "imposed on the new follower or on oneself, at most; the same"
    )
    mandatory_bias: Scalar = number(
        10.0, 0, 1000, "m/s2", "a mandatory change's; chosen: beats any incentive, never safety"
    )
    urgency_bias: Scalar = number(
        10.0, 0, 1000, "m/s2", "more at the end of an acceleration lane; chosen"
    )
    accepted_headway: Scalar = number(
        0.56, 0.1, 10, "s", "where a change is most urgent; Schakel, Knoop, van Arem 2012"
    )
    relaxation_s: Scalar = number(
        15.0, 0.1, 1e3, "s", "in which a short headway grows back; Laval, Leclercq 2008: 10-20"
    )
    courtesy_braking: Scalar = number(
        2.0, 0, 20, "m/s2", "for one who must change, at most; Schakel et al. 2012: comfortable"
    )
    view_m: Scalar = number(
        360.0,
        1,
        10e3,
        "m",
        "where a change begins to be urgent, before the place where it must be done; and how far others look",
    )
    exit_view_m: Scalar = number(
        295.0,
        1,
        10e3,
        "m",
        "the same before a deceleration lane, for each lane to cross; Schakel, Knoop, van Arem 2012: 295",
    )
    recovery_s: Scalar = number(
        6.0, 0, 1e3, "s", "from a change to the next one that is only an advantage; chosen"
    )
