"""Several depots: their ramps, their MEDs, and the way home."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.env.depots import med_to_send, next_to_be_sent
from medjax.env.observation import RoadProfile
from medjax.errors import InputError
from medjax.policies.rules import BASELINES
from medjax.world.params import EnvConfig
from medjax.world.state import AT_DEPOT, QUEUED, RETIRED

pytestmark = pytest.mark.usefixtures("quick_compiles")

DEPOT_W, TURNAROUND_S, RETURN_SPEED = 400e3, 30.0, 25.0
RAMPS, EXIT = (200.0, 900.0, 5200.0), 4000.0


@pytest.fixture(scope="module")
def road():
    """Two ramps with one depot, and behind an exit a third with its own; nobody but MEDs, which leave there."""
    size = {"num_depots": 2, "num_meds": 3, "size": 3, "num_evs": 1, "num_gas": 1}
    size |= {"length_m": 6000.0, "ramp_x_m": list(RAMPS), "exit_x_m": [EXIT], "exit_share": 0.0}
    size |= {"mainline_per_h": 0, "ramp_per_h": 0, "battery_scale": 1.0, "slope": 0.01}
    size |= {"trip_m": 2000.0, "turnaround_s": TURNAROUND_S, "depot_power_w": DEPOT_W}
    size |= {"return_speed": RETURN_SPEED, "cooldown_s": 5.0, "episode_decisions": 600}
    env, params = medjax.make("paper", **size)
    return env, params, jax.jit(env.reset)(jax.random.key(0), params)[1], jax.jit(env.step_env)


def test_adjacent_ramps_share_a_depot():
    """As evenly as possible; a single depot serves all."""
    shares = {3: (0, 0, 1, 1, 2), 1: (0,) * 5, 5: (0, 1, 2, 3, 4), 2: (0, 0, 0, 1, 1)}
    for depots, expected in shares.items():
        config = EnvConfig(num_ramps=5, num_depots=depots)
        assert config.ramp_depots == expected
    with pytest.raises(InputError, match="num_depots = 5: allowed at most one per ramp, 4"):
        EnvConfig(num_depots=5)


@pytest.mark.thorough
def test_a_ramp_gets_meds_of_its_depot(road):
    """MEDs 0 and 2 wait at the first depot, 1 at the second; each ramp gets the first of its own."""
    env, params, state, step = road
    assert state.meds.depot.tolist() == [0, 1, 0]
    assert next_to_be_sent(state.meds).tolist() == [True, True, False]
    sent = [med_to_send(jnp.int32(action), state.meds, env.config).tolist() for action in range(4)]
    first, second, none = [True, False, False], [False, True, False], [False] * 3
    assert sent == [none, first, first, second]
    allowed = []
    for number, action in enumerate([3, *[0] * 9, 3, 2, *[0] * 9, 1]):
        allowed.append(env.action_mask(state, params).tolist())
        state = step(jax.random.key(number), state, action, params)[1]
    assert allowed[0] == [True] * 4
    assert allowed[1] == [True, False, False, False]  # cooldown
    assert allowed[10] == [True, True, True, False]  # the second depot is empty
    assert state.stats.meds_dispatched == 3.0
    assert state.stats.invalid_actions == 1.0
    assert state.meds.ramp[1] == 2
    assert (state.meds.status != AT_DEPOT).all()
    assert not env.action_mask(state, params)[1:].any()


@pytest.mark.parametrize(("depot", "middle"), [(0, (RAMPS[0] + RAMPS[1]) / 2), (1, RAMPS[2])])
def test_the_way_home_takes_its_time_and_its_energy(road, depot, middle):
    """By hand in float64, by eqs (7)-(8) at a steady speed on the level; then the MED waits there."""
    env, params, state, step = road
    state = step(jax.random.key(0), state, 2, params)[1]
    state = state.replace(meds=state.meds.replace(depot=state.meds.depot.at[0].set(depot)))
    left = None
    for number in range(1, 600):
        driven = float(state.stats.med_driving_j)
        state = step(jax.random.key(number), state, 0, params)[1]
        status = int(state.meds.status[0])
        if left is None and status == RETIRED:
            left, spent = number, float(params.med_capacity_j - state.meds.energy_j[0])
            x = float(state.vehicles.x[0])
        if left is not None and status == AT_DEPOT:
            break
    body, way = params.med, abs(x - middle)
    force = float(body.mass_kg) * 9.81 * float(body.rolling_resistance)
    drag = float(body.drag_coefficient * body.frontal_area_m2) * RETURN_SPEED**2
    force += 0.5 * float(params.road.air_density) * drag
    power = force * RETURN_SPEED / float(body.drivetrain_efficiency) + float(body.auxiliary_w)
    home_j = power * way / RETURN_SPEED
    away_s = TURNAROUND_S + way / RETURN_SPEED + (spent + home_j) / DEPOT_W
    # It leaves within a second, and is seen after the last one.
    assert abs(number - left - away_s - 1.0) <= 1.0
    assert float(state.stats.med_driving_j) - driven == pytest.approx(home_j, rel=1e-3)
    assert float(state.stats.depot_energy_j) == pytest.approx(spent + home_j, rel=1e-5)
    assert float(state.meds.energy_j[0]) == float(params.med_capacity_j)
    assert state.meds.depot[0] == depot
    assert env.action_mask(state, params).all()
    assert bool(med_to_send(jnp.int32(3), state.meds, env.config)[0]) == (depot == 1)


@pytest.mark.parametrize("name", ["greedy", "forecast", "budgeted"])
def test_rules_choose_a_ramp_whose_depot_has_meds(road, name, monkeypatch):
    """The one with the greatest need."""
    env, params, state, _ = road
    need = jnp.array([1.0, 2.0, 9.0]) * 100.0
    monkeypatch.setattr("medjax.policies.rules.stranded_need", lambda *_: need)
    monkeypatch.setattr("medjax.policies.rules.forecast_need", lambda *_: need)
    monkeypatch.setattr("medjax.policies.rules.Budget.margin", lambda *_: need)
    policy = jax.jit(BASELINES[name](env))

    def acts(status):
        meds = state.meds.replace(status=jnp.array(status, jnp.int32))
        now = state.replace(meds=meds)
        return int(policy(jax.random.key(0), None, now, params).action)

    assert acts([AT_DEPOT, AT_DEPOT, AT_DEPOT]) == 3
    assert acts([AT_DEPOT, QUEUED, AT_DEPOT]) == 2
    assert acts([QUEUED, QUEUED, QUEUED]) == 0


def test_the_road_profile_shows_depots(road):
    """The share of the fleet at each comes first; a single depot adds nothing."""
    env, params, state, _ = road
    profile = RoadProfile()
    tell = jax.jit(lambda state: profile(state, env.config, params))
    seen = np.asarray(tell(state))
    assert seen.shape == (profile.size(env.config),)
    np.testing.assert_allclose(seen[:2], [2 / 3, 1 / 3], rtol=1e-6)
    out = state.replace(meds=state.meds.replace(status=state.meds.status.at[0].set(QUEUED)))
    np.testing.assert_allclose(tell(out)[:2], [1 / 3, 1 / 3], rtol=1e-6)
    one = EnvConfig(num_ramps=3)
    assert profile.size(env.config) - profile.size(one) == 2
