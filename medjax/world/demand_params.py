"""Parameters of the traffic demand, each declared once with default, range, unit, description and source."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from medjax.world.numbers import number
from medjax.world.traffic_params import Scalar


class DemandParams(struct.PyTreeNode):
    """Traffic demand at the entries, and its mix of vehicles."""

    mainline_per_h: Scalar = number(
        2600.0, 0, 100e3, "1/h", "sum over all lanes; chosen: 650 per hour and lane, free flow"
    )
    ramp_per_h: jax.Array = number(
        (250.0,) * 4, 0, 100e3, "1/h", "demand at each ramp, `(num_ramps,)`; chosen", per="ramp"
    )
    profile: jax.Array = number(
        ((1.0,) * 5,),
        0,
        100,
        "",
        "factors of `mainline_per_h` and of each `ramp_per_h` over the day, `(num_periods, 1 + num_ramps)`, one row "
        "per period; the last row stays in force; paper: always 1",
        per="period",
    )
    period_s: Scalar = number(3600.0, 1, 1e6, "s", "length of a period of the profile")
    start_s: Scalar = number(0.0, 0, 1e9, "s", "time in the profile at which an episode starts")
    surge_factor: Scalar = number(
        3.0,
        0,
        100,
        "",
        "factor of a ramp's demand during a surge (`EnvConfig.num_surges`); chosen; below 1: fewer come",
    )
    surge_s: Scalar = number(
        600.0, 0, 1e6, "s", "length of a surge, such as an event's end; chosen"
    )
    surge_from_s: Scalar = number(
        0.0,
        0,
        1e9,
        "s",
        "earliest start of a surge after the episode's; its start is drawn uniformly",
    )
    surge_until_s: Scalar = number(
        600.0,
        0,
        1e9,
        "s",
        "latest start of a surge, the end of an episode of `paper`; equal to `surge_from_s`: no drawing",
    )
    detector_s: Scalar = number(
        120.0,
        0.1,
        1e6,
        "s",
        "time constant with which detectors at entries smooth their counts (`EnvConfig.has_detectors`); chosen",
    )
    exit_share: jax.Array = number(
        (),
        0,
        1,
        "",
        "share of vehicles reaching an exit that leave there, `(num_exits,)`",
        per="exit",
    )
    ev_share: Scalar = number(
        0.12,
        0,
        1,
        "",
        "share of EVs among arrivals; chosen so that fifteen MEDs can serve most of them",
    )
    human_share: Scalar = number(
        0.5,
        0,
        1,
        "",
        "share of EVs with a human driver; chosen, the paper has both kinds of drivers",
    )
    lorry_share: Scalar = number(
        0.0, 0, 1, "", "share of lorries among gas vehicles; paper: none; German motorways: 0.15"
    )
    arrival_soc_low: Scalar = number(
        0.2,
        0,
        1,
        "",
        "lowest charge on arrival; chosen with `battery_scale` so that most EVs run out unaided",
    )
    arrival_soc_high: Scalar = number(0.7, 0, 1, "", "highest charge on arrival; chosen")
    ramp_speed: Scalar = number(
        20.0, 1, 60, "m/s", "speed at the start of the acceleration lane; chosen"
    )

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
