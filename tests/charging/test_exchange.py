"""Energy: what leaves the MEDs arrives in EVs or is lost, in every tick."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.charging.exchange import taper, transfer
from medjax.env.metrics import episode_metrics
from medjax.env.tick import physics_tick, ways
from medjax.traffic.step import drivers_of
from medjax.world.state import IN_SERVICE, MERGING, QUEUED, EpisodeStats

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.fixture(scope="module")
def played():
    """A busy road, and 120 ticks of it: (env, params, states before, states after, tallies), (8, 120, ...) each."""
    env, params = medjax.make("paper", request_soc=0.6, cooldown_s=5.0)
    policy = medjax.BASELINES["greedy"](env)
    config = env.config

    def episode(key):
        reset_key, key = jax.random.split(key)
        _, state = env.reset(reset_key, params)

        def warm(state, key):
            return env.step_env(key, state, policy(key, None, state, params).action, params)[
                1
            ], None

        state, _ = jax.lax.scan(warm, state, jax.random.split(key, 120))

        def tick(state, index):
            after, tally = physics_tick(
                state, drivers_of(state, config, params), index, config, params
            )
            return after, (state, after, tally)

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


def test_books_balance_in_every_tick(played):
    """Battery changes = transfer less driving, recomputed in float64 from speeds, every tick."""
    env, params, before, after, tally = played
    config = env.config
    sent, received = (
        np.asarray(x, np.float64) for x in (tally.energy_sent_j, tally.energy_received_j)
    )
    assert (sent > 0).any()
    assert np.all(received <= sent)

    capacity = float(params.med_capacity_j)
    med_used = driving(before, after, config.med_slots, params.med, config.tick_s)
    old, new = (np.asarray(s.meds.energy_j, np.float64) for s in (before, after))
    # What braking gives back does not fit into a full battery; a full MED has sent nothing.
    inside = new < capacity * (1 - 1e-6)
    given = np.where(inside, old - new - med_used, 0.0)
    np.testing.assert_allclose(given.sum(-1), sent, rtol=1e-4, atol=16 * 6e-8 * capacity)
    assert (new <= capacity * (1 + 1e-6)).all()
    assert (old - med_used >= capacity * (1 - 2e-6))[~inside].all()  # full because it had to be

    ev_used = driving(before, after, config.ev_slots, params.ev, config.tick_s)
    old, new = (np.asarray(s.evs.energy_j, np.float64) for s in (before, after))
    # An EV at the stop of its battery, empty or full, cannot spend or take what the formula says.
    inside = (new > 0) & (new < float(params.ev_capacity_j) * (1 - 1e-6))
    gained = np.where(inside, new - old + ev_used, 0.0)
    np.testing.assert_allclose(
        gained.sum(-1), received, rtol=1e-4, atol=60 * 6e-8 * float(params.ev_capacity_j)
    )


def test_tallies_of_driving_are_what_driving_takes(played):
    """Of EVs, of MEDs, and of the same way at the EVs' own desired speeds, in float64, every tick."""
    env, params, before, after, tally = played
    config, dt = env.config, env.config.tick_s
    for name, slots, body in (
        ("ev_driving_j", config.ev_slots, params.ev),
        ("med_driving_j", config.med_slots, params.med),
    ):
        used = driving(before, after, slots, body, dt)
        inside = np.ones(used.shape[:2], bool)
        if slots == config.ev_slots:
            used = np.where(np.asarray(before.evs.is_depleted), 0.0, used)
            # Who runs out in a tick is driven by less than that.
            inside = ~np.asarray(after.evs.is_depleted & ~before.evs.is_depleted).any(-1)
        scale, ours = np.abs(used).sum(-1).max(), np.asarray(getattr(tally, name))
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
    np.testing.assert_allclose(tally.ev_cruising_j, expected, rtol=1e-3)


@pytest.mark.parametrize("slope", [-0.1, -0.05, -0.03, 0.0])
def test_what_driving_took_is_what_batteries_lost(slope):
    """Over an episode, downhill too, where braking finds full batteries: lost is driven less received, and EVs that
    arrive full and are not charged pay for energy once. No share leaves [0, 1]."""
    env, params = medjax.make(
        "paper", slope=slope, reward="money", arrival_soc_low=0.1, arrival_soc_high=1.0, num_gas=20
    )
    policy = medjax.BASELINES["greedy"](env)

    @jax.jit
    def play(key):
        def decide(state, key):
            action = policy(key, None, state, params).action
            _, state, _, _, _, info = env.step_env(key, state, action, params)
            brought = jnp.sum(info["begun"].energy_j), jnp.sum(info["ticks"].energy_j[-1])
            parts = info["reward_terms"]["ev_kwh"], info["metrics"], info["tally"]
            return state, (*brought, *parts)

        _, state = env.reset(key, params)
        return jax.lax.scan(decide, state, jax.random.split(key, 300))[1]

    env = env.with_probe(lambda state: state.evs)
    begun, ended, paid, metrics, tally = jax.device_get(play(jax.random.key(0)))
    lost = begun.astype(np.float64) - ended
    driven = tally.ev_driving_j.astype(np.float64) - tally.energy_received_j
    # Sums of 40 batteries of 5 MJ, which float32 holds to 8 J or so.
    np.testing.assert_allclose(driven, lost, atol=100.0)
    np.testing.assert_allclose(paid, -0.285 * driven / 3.6e6, rtol=1e-3, atol=1e-6)
    for name in ("system_efficiency", "mean_soc", "exit_soc", "depleted_share"):
        assert 0.0 <= metrics[name].min() <= metrics[name].max() <= 1.0, name
    assert tally.energy_received_j.sum() > 1e6


def test_tallies_of_time(played):
    """Delays against everyone's own desired speed, MEDs on their way, and EVs that leave with little charge."""
    env, params, before, after, tally = played
    config, dt = env.config, env.config.tick_s
    was, now = before.vehicles, after.vehicles
    there = np.asarray(was.active)
    way = np.asarray(now.x, np.float64) - np.asarray(was.x, np.float64)
    delay = np.where(there, dt - way / np.asarray(was.desired_speed, np.float64), 0.0)
    # Ticks count the time, and their end what the way would have taken.
    first, last = (jax.tree.map(lambda leaf, i=i: leaf[:, i], v) for v, i in ((was, 0), (now, -1)))
    whole = jax.vmap(lambda a, b: ways(a, b, config))(first, last)
    for name, slots in (("ev_delay_s", config.ev_slots), ("gas_delay_s", config.gas_slots)):
        ours = getattr(tally, name).sum(-1) + getattr(whole, name)
        np.testing.assert_allclose(ours, delay[..., slots].sum((-2, -1)), rtol=1e-4, atol=0.02)
        assert delay[..., slots].sum() > 0.0

    status = np.asarray(before.meds.status)
    on_the_way = ((status == QUEUED) | (status == MERGING) | (status == IN_SERVICE)).sum(-1)
    np.testing.assert_allclose(tally.med_seconds, on_the_way * dt)
    assert on_the_way.max() > 1
    left = there & ~np.asarray(now.active) & (np.asarray(now.x) > float(params.road.length_m))
    low = np.asarray(after.evs.energy_j) < 0.6 * float(params.ev_capacity_j)
    np.testing.assert_array_equal(tally.low_exits, (left[..., config.ev_slots] & low).sum(-1))
    assert np.asarray(tally.low_exits).sum() > 0


def test_metrics_of_energy():
    """Two EVs, a MED: what is drawn, what comes of it, and what each EV saved and got."""
    kwh = 3.6e6
    tally = EpisodeStats.zeros().replace(
        entered=jnp.array([1.0, 1.0, 1.0, 4.0, 1.0]),
        energy_sent_j=jnp.float32(4.0 * kwh),
        energy_received_j=jnp.float32(3.0 * kwh),
        med_driving_j=jnp.float32(6.0 * kwh),
        ev_driving_j=jnp.float32(5.0 * kwh),
        ev_cruising_j=jnp.float32(8.0 * kwh),
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
    metrics = episode_metrics(tally)
    for name, value in expected.items():
        assert float(metrics[name]) == pytest.approx(value, rel=1e-6), name


def test_short_med_shares_and_full_ev_takes_no_more():
    """A MED with too little serves its slots in proportion; an EV fills to the brim and no further."""
    efficiency = jnp.array([0.9, 0.8, 0.9])
    charging = jnp.array([True, True, True])
    med = jnp.array([0, 0, 1], jnp.int32)
    flow = transfer(
        efficiency,
        charging,
        med,
        jnp.array([100.0, 1e6]),
        jnp.array([1e6, 1e6, 45.0]),
        jnp.full(3, 200.0),
    )
    np.testing.assert_allclose(flow.sent_j, [50.0, 50.0, 50.0], rtol=1e-6)
    np.testing.assert_allclose(flow.received_j, [45.0, 40.0, 45.0], rtol=1e-6)


def test_empty_med_and_idle_ev_move_nothing():
    """Below its reserve a MED gives nothing, and an EV that does not charge gets nothing."""
    flow = transfer(
        jnp.array([0.9, 0.9]),
        jnp.array([True, False]),
        jnp.array([0, 1], jnp.int32),
        jnp.array([-5.0, 1e6]),
        jnp.array([1e6, 1e6]),
        jnp.full(2, 200.0),
    )
    assert np.all(np.asarray(flow.sent_j) == 0.0)


def test_a_slot_sends_what_it_may():
    """Each EV's own slot, where the coils of one stand badly."""
    flow = transfer(
        jnp.array([0.9, 0.5]),
        jnp.array([True, True]),
        jnp.array([0, 0], jnp.int32),
        jnp.array([1e6]),
        jnp.array([1e6, 1e6]),
        jnp.array([200.0, 30.0]),
    )
    np.testing.assert_allclose(flow.sent_j, [200.0, 30.0])
    np.testing.assert_allclose(flow.received_j, [180.0, 15.0])
    np.testing.assert_allclose(flow.drawn_j, [230.0])


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
