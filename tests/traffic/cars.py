"""Drivers of named parameter sets, made by the package."""

import jax.numpy as jnp

from medjax.traffic.following import make_drivers
from medjax.traffic.idm import IDM
from medjax.world.params import DriverParams

LENGTH = 5.0


def drivers(kinds):
    """One driver of each of `kinds`, parameter sets as in reference.py; cars of 5 m."""
    count = len(kinds)
    columns = {name: jnp.asarray([kind[name] for kind in kinds], jnp.float32) for name in kinds[0]}
    zeros = jnp.zeros(count)
    params = DriverParams(
        **columns,
        desired_speed_std=zeros,
        acceleration_noise=zeros,
        lateral_wander=zeros,
        vehicle_length=jnp.full(count, LENGTH),
    )
    return make_drivers(jnp.arange(count), params.desired_speed, params, IDM())
