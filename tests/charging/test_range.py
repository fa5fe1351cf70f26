"""Driving energy on other roads, and drivers who slow down when their charge does not last."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.charging.energy import drive_energy
from medjax.charging.range import apply_eco_speed, lasting_speed, required_range

pytestmark = pytest.mark.usefixtures("quick_compiles")


def per_metre(speed, body, slope=0.0, density=1.2):
    """Battery energy of a metre at constant speed, J: eqs (7)-(8) and the drivetrain in float64, uphill or level."""
    number = {k: float(getattr(body, k)) for k in body.__dataclass_fields__}
    rolling = number["mass_kg"] * 9.81 * (number["rolling_resistance"] + np.sin(slope))
    drag = 0.5 * density * number["drag_coefficient"] * number["frontal_area_m2"] * speed**2
    return (rolling + drag) / number["drivetrain_efficiency"] + number["auxiliary_w"] / speed


@pytest.mark.parametrize(("slope", "density"), [(0.0, 1.2), (0.04, 1.2), (0.0, 0.9), (0.03, 1.1)])
def test_slope_and_air_reach_the_batteries(paper, slope, density):
    """Energy per metre of EVs and MEDs, by hand."""
    _, params = medjax.make("paper", slope=slope, air_density=density)
    speed = jnp.array([10.0, 20.0, 30.0])
    for body in (params.ev, params.med):
        ours = drive_energy(speed, speed, body, params.road, 0.25) / (0.25 * speed)
        np.testing.assert_allclose(
            ours, per_metre(np.asarray(speed), body, slope, density), rtol=1e-5
        )


@pytest.mark.parametrize("slope", [0.0, 0.02])
def test_the_lasting_speed_is_the_fastest_that_lasts(paper, slope):
    """A search over a grid of speeds in float64 agrees; where no speed lasts, the most economical one is taken."""
    _, params = medjax.make("paper", slope=slope)
    rng = np.random.default_rng(0)
    own = rng.uniform(15.0, 40.0, 400)
    way = rng.uniform(1e3, 50e3, 400)
    energy = way * rng.uniform(0.3, 1.3, 400) * per_metre(own, params.ev, slope)
    for eco in (5.0, 18.0, 22.0):
        arguments = (jnp.asarray(x, jnp.float32) for x in (energy, way, own))
        found = np.asarray(
            lasting_speed(*arguments, jnp.float32(eco), params.ev, params.road), np.float64
        )
        for speed, charge, metres, most in zip(found, energy, way, own, strict=True):
            grid = np.linspace(min(eco, most), most, 20_001)
            takes = per_metre(grid, params.ev, slope) * metres
            lasts = grid[takes <= charge]
            best = lasts.max() if lasts.size else grid[takes.argmin()]
            assert speed == pytest.approx(best, rel=0.01, abs=0.02)
            if not lasts.size:
                assert per_metre(speed, params.ev, slope) * metres <= takes.min() * (1 + 1e-5)


def test_speed_when_no_charge_is_enough(paper):
    """Drivers take the lowest allowed speed, or their desired speed if that is lower."""
    _, params = paper
    speed = lasting_speed(
        jnp.full(2, 1e8),
        jnp.full(2, jnp.inf),
        jnp.array([30.0, 15.0]),
        18.0,
        params.ev,
        params.road,
    )
    np.testing.assert_allclose(speed, [18.0, 15.0])


def test_which_drivers_slow_down(started, paper):
    """Those of unbooked EVs who comply and whose charge is below `eco_soc` and does not last."""
    env, params = paper
    config, slots = env.config, env.config.ev_slots
    capacity = float(params.ev_capacity_j)
    drivers = params.drivers.replace(eco_soc=jnp.float32(0.4), eco_speed=jnp.float32(18.0))
    params = params.replace(drivers=drivers.replace(eco_horizon_m=jnp.float32(1000.0)))
    _, state = started
    soc = jnp.full(config.num_evs, 0.01).at[1].set(0.39).at[2].set(0.41)
    x = state.vehicles.x.at[slots].set(3500.0)
    evs = state.evs.replace(
        energy_j=soc * capacity,
        complies=jnp.ones(config.num_evs, bool).at[3].set(False),
        med=state.evs.med.at[4].set(0),
    )
    state = state.replace(evs=evs, vehicles=state.vehicles.replace(x=x))
    np.testing.assert_allclose(required_range(state.vehicles, config, params), 1000.0)
    own = np.asarray(state.vehicles.desired_speed)
    ours = np.asarray(
        jax.jit(lambda s: apply_eco_speed(s, config, params))(state).vehicles.desired_speed
    )
    slower = np.flatnonzero(ours < own)
    # 0.39 of a pack of 1 kWh is enough for a kilometre; 0.01 is not.
    expected = set(range(config.num_evs)) - {1, 2, 3, 4}
    assert set(slower - slots.start) == expected
    np.testing.assert_allclose(ours[slower], np.minimum(own[slower], 18.0))
    # An infinite horizon is for all, also for those who have an exit.
    vehicles = state.vehicles.replace(destination=jnp.full_like(x, 3600.0))
    np.testing.assert_allclose(required_range(vehicles, config, params), 100.0)
    drivers = params.drivers.replace(eco_horizon_m=jnp.float32(jnp.inf))
    assert np.isinf(required_range(vehicles, config, params.replace(drivers=drivers))).all()
    further = params.replace(drivers=params.drivers.replace(eco_horizon_m=jnp.float32(1e9)))
    far = np.asarray(apply_eco_speed(state, config, further).vehicles.desired_speed)
    assert set(np.flatnonzero(far < own) - slots.start) == expected | {1}


@pytest.mark.thorough
def test_the_share_of_compliant_drivers():
    """It holds at reset and at entry; no driver on the road changes."""
    env, params = medjax.make("paper", eco_compliance=0.3, ev_share=0.6, eco_horizon_m=0.0)

    def episode(key):
        _, state = env.reset(key, params)

        def step(state, key):
            after = env.step_env(key, state, 0, params)[1]
            both = (state.vehicles.active & after.vehicles.active)[env.config.ev_slots]
            new = after.vehicles.active[env.config.ev_slots] & ~both
            changed = both & (state.evs.complies != after.evs.complies)
            return after, (new & after.evs.complies, new, changed)

        first = state.vehicles.active[env.config.ev_slots]
        _, (comply, new, changed) = jax.lax.scan(step, state, jax.random.split(key, 300))
        return (
            (first & state.evs.complies).sum(),
            first.sum(),
            comply.sum(),
            new.sum(),
            changed.any(),
        )

    ours = jax.jit(jax.vmap(episode))(jax.random.split(jax.random.key(1), 8))
    at_reset, there, at_entry, came, changed = (np.asarray(x) for x in ours)
    assert not changed.any()
    for drawn, of in ((at_reset.sum(), there.sum()), (at_entry.sum(), came.sum())):
        assert of > 100
        assert abs(drawn / of - 0.3) < 4 * np.sqrt(0.3 * 0.7 / of)
