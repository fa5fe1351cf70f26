"""Parameters of incidents, each declared once with default, range, unit and description."""

from __future__ import annotations

import jax
from flax import struct

from medjax.world.numbers import number


class IncidentParams(struct.PyTreeNode):
    """When, where and for how long gas vehicles break down, `(num_incidents,)` each; see `medjax.traffic.incidents`.

    A time and a place are drawn between two bounds; equal bounds give them.
    """

    incident_from_s: jax.Array = number(
        (),
        0,
        1e9,
        "s",
        "earliest time of each incident since the episode's start; 120 where only `num_incidents` is given, chosen",
        per="incident",
    )
    incident_until_s: jax.Array = number(
        (), 0, 1e9, "s", "latest time; 300 likewise", per="incident"
    )
    incident_from_x_m: jax.Array = number(
        (), 0, 200e3, "m", "nearest place; a quarter of the road likewise", per="incident"
    )
    incident_until_x_m: jax.Array = number(
        (), 0, 200e3, "m", "farthest place; three quarters likewise", per="incident"
    )
    incident_lane: jax.Array = number(
        (),
        -1,
        5,
        "",
        "lane, 0 leftmost; -1, the default: any main lane",
        per="incident",
        whole=True,
    )
    incident_s: jax.Array = number(
        (), 0, 1e6, "s", "how long the vehicle stands; 300 likewise, chosen", per="incident"
    )
