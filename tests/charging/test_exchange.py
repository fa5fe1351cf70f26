"""Energy: what leaves the MEDs arrives in EVs or is lost; `benchmarks/verification/books.py` has it tick by tick."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.charging.exchange import taper, transfer
from medjax.env.metrics import episode_metrics
from medjax.world.state import EpisodeStats

pytestmark = pytest.mark.usefixtures("quick_compiles")


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
    begun, ended, paid, metrics, stats = jax.device_get(play(jax.random.key(0), params))
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
