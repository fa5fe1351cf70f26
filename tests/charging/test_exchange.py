"""Energy: what leaves the MEDs arrives in EVs or is lost, in every tick and over an episode."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.charging.exchange import taper, transfer
from medjax.env.metrics import episode_metrics
from medjax.env.tick import distances_driven, physics_tick
from medjax.traffic.step import drivers_of
from medjax.world.state import IN_SERVICE, MERGING, QUEUED, EpisodeStats

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.fixture(scope="module")
def played():
    """120 ticks of busy roads: (env, params, states before, states after, tallies), (8, 120, ...) each."""
    env, params = medjax.make("paper", request_soc=0.6, cooldown_s=5.0)
    policy = medjax.BASELINES["greedy"](env)
    config = env.config

    def episode(key):
        reset_key, key = jax.random.split(key)
        _, state = env.reset(reset_key, params)

        def warm(state, key):
            action = policy(key, None, state, params).action
            return env.step_env(key, state, action, params)[1], None

        state, _ = jax.lax.scan(warm, state, jax.random.split(key, 120))

        def tick(state, index):
            drivers = drivers_of(state, config, params)
            after, stats = physics_tick(state, drivers, index, config, params)
            return after, (state, after, stats)

        return jax.lax.scan(tick, state, jnp.arange(120))[1]

    return env, params, *jax.jit(jax.vmap(episode))(jax.random.split(jax.random.key(5), 8))


def driving(before, after, slots, body, dt):
    """Eqs (7)-(8) and the drivetrain in NumPy, J for each vehicle and tick; 0 off the road."""
    v0, v1 = (np.asarray(s.vehicles.speed, np.float64)[..., slots] for s in (before, after))
    v = (v0 + v1) / 2
    number = {k: float(getattr(body, k)) for k in body.__dataclass_fields__}
    kinetic = 0.5 * number["rotational_inertia_factor"] * number["mass_kg"] * (v1**2 - v0**2)
    rolling = number["mass_kg"] * 9.81 * number["rolling_resistance"] * v * dt
    drag = 0.5 * 1.2 * number["drag_coefficient"] * number["frontal_area_m2"] * v**3 * dt
    wheels = kinetic + rolling + drag
    battery = np.where(
        wheels > 0,
        wheels / number["drivetrain_efficiency"],
        wheels * number["regeneration_efficiency"],
    )
    on_road = np.asarray(before.vehicles.active)[..., slots]
    return np.where(on_road, battery + number["auxiliary_w"] * dt, 0.0)


@pytest.mark.thorough
def test_books_balance_in_every_tick(played):
    """Battery changes are transfer less driving, recomputed in float64 from speeds."""
    env, params, before, after, stats = played
    config = env.config
    sent, received = (
        np.asarray(x, np.float64) for x in (stats.energy_sent_j, stats.energy_received_j)
    )
    assert (sent > 0).any()
    assert np.all(received <= sent)

    capacity = float(params.med_capacity_j)
    med_used = driving(before, after, config.med_slots, params.med, config.tick_s)
    old, new = (np.asarray(s.meds.energy_j, np.float64) for s in (before, after))
    # A full battery takes no braking energy; a full MED has sent nothing.
    inside = new < capacity * (1 - 1e-6)
    given = np.where(inside, old - new - med_used, 0.0)
    np.testing.assert_allclose(given.sum(-1), sent, rtol=1e-4, atol=16 * 6e-8 * capacity)
    assert (new <= capacity * (1 + 1e-6)).all()
    assert (old - med_used >= capacity * (1 - 2e-6))[~inside].all()  # full because it had to be

    ev_used = driving(before, after, config.ev_slots, params.ev, config.tick_s)
    old, new = (np.asarray(s.evs.energy_j, np.float64) for s in (before, after))
    # An empty EV cannot spend, a full one cannot take what the formula says.
    inside = (new > 0) & (new < float(params.ev_capacity_j) * (1 - 1e-6))
    gained = np.where(inside, new - old + ev_used, 0.0)
    np.testing.assert_allclose(
        gained.sum(-1), received, rtol=1e-4, atol=60 * 6e-8 * float(params.ev_capacity_j)
    )


@pytest.mark.thorough
def test_tallies_of_driving_energy(played):
    """Of EVs, of MEDs, and of the same way at the EVs' own desired speeds, in float64, every tick."""
    env, params, before, after, stats = played
    config, dt = env.config, env.config.tick_s
    for name, slots, body in (
        ("ev_driving_j", config.ev_slots, params.ev),
        ("med_driving_j", config.med_slots, params.med),
    ):
        used = driving(before, after, slots, body, dt)
        inside = np.ones(used.shape[:2], bool)
        if slots == config.ev_slots:
            used = np.where(np.asarray(before.evs.is_depleted), 0.0, used)
            # An EV that runs out in a tick drives on less than that.
            inside = ~np.asarray(after.evs.is_depleted & ~before.evs.is_depleted).any(-1)
        scale, ours = np.abs(used).sum(-1).max(), np.asarray(getattr(stats, name))
        expected = used.sum(-1)[inside]
        np.testing.assert_allclose(ours[inside], expected, rtol=1e-4, atol=1e-4 * scale)
        assert (used.sum((0, 1)) != 0.0).any()
        assert (ours[~inside] < used.sum(-1)[~inside]).all()

    own = np.asarray(before.vehicles.desired_speed, np.float64)[..., config.ev_slots]
    steady = before.replace(vehicles=before.vehicles.replace(speed=before.vehicles.desired_speed))
    power = driving(steady, steady, config.ev_slots, params.ev, dt) / dt
    way = np.asarray(after.vehicles.x, np.float64) - np.asarray(before.vehicles.x, np.float64)
    powered = ~np.asarray(before.evs.is_depleted)
    expected = (powered * power / own * way[..., config.ev_slots]).sum(-1)
    # A position is exact to 1e-4 of what a vehicle drives in a tick.
    np.testing.assert_allclose(stats.ev_cruising_j, expected, rtol=1e-3)


@pytest.mark.thorough
def test_tallies_of_time(played):
    """Delays against everyone's own desired speed, MEDs on their way, and EVs that leave with little charge."""
    env, params, before, after, stats = played
    config, dt = env.config, env.config.tick_s
    was, now = before.vehicles, after.vehicles
    there = np.asarray(was.active)
    way = np.asarray(now.x, np.float64) - np.asarray(was.x, np.float64)
    delay = np.where(there, dt - way / np.asarray(was.desired_speed, np.float64), 0.0)
    # Ticks count the time; the round's end subtracts the time at desired speed.
    first, last = (jax.tree.map(lambda leaf, i=i: leaf[:, i], v) for v, i in ((was, 0), (now, -1)))
    whole = jax.vmap(lambda a, b: distances_driven(a, b, config))(first, last)
    for name, slots in (("ev_delay_s", config.ev_slots), ("gas_delay_s", config.gas_slots)):
        ours = getattr(stats, name).sum(-1) + getattr(whole, name)
        np.testing.assert_allclose(ours, delay[..., slots].sum((-2, -1)), rtol=1e-4, atol=0.02)
        assert delay[..., slots].sum() > 0.0

    status = np.asarray(before.meds.status)
    on_the_way = ((status == QUEUED) | (status == MERGING) | (status == IN_SERVICE)).sum(-1)
    np.testing.assert_allclose(stats.med_seconds, on_the_way * dt)
    assert on_the_way.max() > 1
    left = there & ~np.asarray(now.active) & (np.asarray(now.x) > float(params.road.length_m))
    low = np.asarray(after.evs.energy_j) < 0.6 * float(params.ev_capacity_j)
    np.testing.assert_array_equal(stats.low_exits, (left[..., config.ev_slots] & low).sum(-1))
    assert np.asarray(stats.low_exits).sum() > 0


@pytest.fixture(scope="module")
def play():
    """300 decisions of a rule: energy at each one's begin and end, the price of EVs' energy, metrics, tally."""
    env, _ = medjax.make("paper", reward="money", num_gas=20)
    env, policy = env.with_probe(lambda state: state.evs), medjax.BASELINES["greedy"](env)

    @jax.jit
    def play(key, params):
        def decide(state, key):
            action = policy(key, None, state, params).action
            _, state, _, _, _, info = env.step_env(key, state, action, params)
            charge = jnp.sum(info["begun"].energy_j), jnp.sum(info["ticks"].energy_j[-1])
            return state, (
                *charge,
                info["reward_terms"]["ev_kwh"],
                info["metrics"],
                info["step_stats"],
            )

        _, state = env.reset(key, params)
        return jax.lax.scan(decide, state, jax.random.split(key, 300))[1]

    return play


@pytest.mark.parametrize("slope", [-0.1, -0.05, -0.03, 0.0])
def test_what_driving_took_is_what_batteries_lost(play, slope):
    """Over an episode, batteries lose what driving takes less what they receive, also downhill, where full batteries
    take no braking energy. EVs pay for energy once. No share leaves [0, 1]."""
    socs = {"arrival_soc_low": 0.1, "arrival_soc_high": 1.0}
    _, params = medjax.make("paper", slope=slope, reward="money", num_gas=20, **socs)
    begun, ended, paid, metrics, stats = jax.device_get(play(jax.random.key(9), params))
    lost = begun.astype(np.float64) - ended
    driven = stats.ev_driving_j.astype(np.float64) - stats.energy_received_j
    # Sums of 40 batteries of 5 MJ, which float32 holds to 8 J or so.
    np.testing.assert_allclose(driven, lost, atol=100.0)
    np.testing.assert_allclose(paid, -0.285 * driven / 3.6e6, rtol=1e-3, atol=1e-6)
    for name in ("system_efficiency", "mean_soc", "exit_soc", "depleted_share"):
        assert 0.0 <= metrics[name].min() <= metrics[name].max() <= 1.0, name
    assert stats.energy_received_j.sum() > 1e6


def test_metrics_of_energy():
    """For two EVs and a MED."""
    kwh = 3.6e6
    energies = {"energy_sent_j": 4, "energy_received_j": 3, "med_driving_j": 6}
    energies |= {"ev_driving_j": 5, "ev_cruising_j": 8}
    stats = EpisodeStats.zeros().replace(
        entered=jnp.array([1.0, 1.0, 1.0, 4.0, 1.0]),
        **{name: jnp.float32(energy * kwh) for name, energy in energies.items()},
        ev_delay_s=jnp.float32(1800.0),
        gas_delay_s=jnp.float32(900.0),
        med_seconds=jnp.float32(7200.0),
    )
    expected = {
        "energy_sent_kwh": 4.0,
        "energy_delivered_kwh": 3.0,
        "energy_lost_kwh": 1.0,
        "med_driving_kwh": 6.0,
        "energy_drawn_kwh": 10.0,
        "system_efficiency": 0.3,
        "ev_driving_kwh": 2.5,
        "ev_saved_kwh": 1.5,
        "ev_received_kwh": 1.5,
        "ev_delay_h": 0.5,
        "gas_delay_h": 0.25,
        "med_hours": 2.0,
    }
    metrics = episode_metrics(stats)
    for name, value in expected.items():
        assert float(metrics[name]) == pytest.approx(value, rel=1e-6), name


def test_transfer_by_hand():
    """MED 0 shares too little in proportion, EV 2 fills to the brim; MED 2 is below its reserve, EV 4 does not charge;
    the slots of MED 4 send what each may."""
    rows = np.array(
        [  # efficiency, charging, MED, room, offered, sent, received
            (0.9, 1, 0, 1e6, 200.0, 50.0, 45.0),
            (0.8, 1, 0, 1e6, 200.0, 50.0, 40.0),
            (0.9, 1, 1, 45.0, 200.0, 50.0, 45.0),
            (0.9, 1, 2, 1e6, 200.0, 0.0, 0.0),
            (0.9, 0, 3, 1e6, 200.0, 0.0, 0.0),
            (0.9, 1, 4, 1e6, 200.0, 200.0, 180.0),
            (0.5, 1, 4, 1e6, 30.0, 30.0, 15.0),
        ],
        np.float32,
    )
    efficiency, charging, med, room, offered, sent, received = map(jnp.asarray, rows.T)
    available = jnp.array([100.0, 1e6, -5.0, 1e6, 1e6])
    flow = transfer(efficiency, charging > 0, med.astype(jnp.int32), available, room, offered)
    np.testing.assert_allclose(flow.sent_j, sent, rtol=1e-6)
    np.testing.assert_allclose(flow.received_j, received, rtol=1e-6)
    np.testing.assert_allclose(flow.drawn_j, [100.0, 50.0, 0.0, 0.0, 230.0], rtol=1e-6)
    np.testing.assert_allclose(flow.received_j[5:], received[5:])
    np.testing.assert_allclose(flow.sent_j[5:], sent[5:])
    np.testing.assert_allclose(flow.drawn_j[4:], [230.0])


@pytest.mark.parametrize("taper_soc", [0.8, 0.5, 1.0])
def test_charging_slows_down_towards_a_full_battery(taper_soc):
    """Power falls linearly from `taper_soc` on, so that what is missing decays exponentially: with full power P in a
    battery of capacity C, over tau = (1 - taper_soc) C / P."""
    _, params = medjax.make("paper", taper_soc=taper_soc)
    capacity = float(params.ev_capacity_j)
    share = np.asarray(taper(jnp.linspace(0.0, 1.0, 101) * capacity, params), np.float64)
    soc = np.linspace(0.0, 1.0, 101)
    below = soc < taper_soc - 1e-6
    np.testing.assert_array_equal(share[below], 1.0)
    if taper_soc < 1.0:
        expected = np.minimum(1.0, (1.0 - soc) / (1.0 - taper_soc))
        np.testing.assert_allclose(share, expected, atol=1e-5)
    assert share[-1] == 0.0

    power, dt, ticks = 40e3, 0.25, 400
    energy = jnp.float32(taper_soc * capacity)
    for _ in range(ticks):
        energy = energy + power * dt * taper(energy, params)
    decay = power * dt * ticks / (max(1.0 - taper_soc, 1e-9) * capacity)
    missing = (1.0 - taper_soc) * capacity * np.exp(-decay)
    assert capacity - float(energy) == pytest.approx(missing, rel=0.02, abs=1e-4 * capacity)
