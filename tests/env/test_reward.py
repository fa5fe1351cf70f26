"""The reward in money equals prices times metrics."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.charging.plugs import plug_seconds
from medjax.env.reward import MONEY, Outcome, hourly_price, total_reward
from medjax.errors import InputError
from medjax.world.state import EpisodeStats

pytestmark = pytest.mark.usefixtures("quick_compiles")


def test_terms_in_money_by_hand():
    """In hours, kWh and numbers, from a tally in seconds and joules."""
    step_stats = EpisodeStats.zeros().replace(
        ev_delay_s=jnp.float32(1800.0),
        gas_delay_s=jnp.float32(3600.0),
        queue_seconds=jnp.float32(900.0),
        med_driving_j=jnp.float32(7.2e6),
        energy_sent_j=jnp.float32(3.6e6),
        energy_received_j=jnp.float32(1.8e6),
        ev_driving_j=jnp.float32(9.0e6),
        med_seconds=jnp.float32(5400.0),
        depleted=jnp.float32(2.0),
        low_exits=jnp.float32(7.0),
        plug_stops=jnp.float32(4.0),
        plug_wait_s=jnp.float32(1800.0),
        plug_charging_s=jnp.float32(5400.0),
        plug_energy_j=jnp.float32(36e6),
    )
    # The second decision begins at 15:30:01, when electricity costs twice as much.
    prices = np.where(np.arange(24) == 15, 2.0, 1.0)
    env, params = medjax.make(
        "paper",
        reward="money",
        hourly_price=prices,
        start_s=15.5 * 3600.0,
        reward_weights={"med_wear_kwh": -0.04, "ev_wear_kwh": -0.05},
    )
    before = SimpleNamespace(time=jnp.int32(1))
    outcome = Outcome(before, None, step_stats, params, env.config)
    expected = {
        "delay_h": 1.75 * -20.0,
        "depot_kwh": 3.0 * -0.22 * 2.0,
        "ev_kwh": 2.0 * -0.285,
        "med_h": 1.5 * -70.0,
        "tows": 2.0 * -250.0,
        "charging_stops": 3.0 * -18.0,
        "med_wear_kwh": 3.0 * -0.04,
        "ev_wear_kwh": 2.5 * -0.05,
        "plug_h": 2.0 * -20.0,
        "plug_kwh": 10.0 * -0.315,
    }
    total, parts = total_reward(outcome, MONEY)
    assert set(parts) == set(expected) == set(env.reward) == set(params.reward_weights)
    for name, value in expected.items():
        assert float(parts[name]) == pytest.approx(value, rel=1e-6), name
    assert float(total) == pytest.approx(sum(expected.values()), rel=1e-6)


def test_a_stop_put_off_beyond_the_road_gains_its_wait_alone():
    """On `freight` the time at a plug is paid with the kWh that lorries use, so a stop itself costs its wait."""
    env, params = medjax.make("freight")
    energy_j = jnp.float32(0.15 * 600.0 * 3.6e6)
    charging_s = plug_seconds(energy_j, params)
    assert float(charging_s) == pytest.approx(0.65 * 600.0 / 400.0 * 3600.0, rel=1e-5)
    step_stats = EpisodeStats.zeros().replace(
        plug_wait_s=jnp.float32(720.0),
        plug_charging_s=charging_s,
        plug_energy_j=0.8 * params.ev_capacity_j - energy_j,
    )
    outcome = Outcome(SimpleNamespace(time=jnp.int32(0)), None, step_stats, params, env.config)
    assert float(total_reward(outcome, MONEY)[0]) == pytest.approx(-0.2 * 50.0, rel=1e-5)
    drove = EpisodeStats.zeros().replace(ev_driving_j=jnp.float32(3.6e6))
    total, _ = total_reward(outcome.replace(step_stats=drove), MONEY)
    assert float(total) == pytest.approx(-(0.4 + 50.0 / 400.0), rel=1e-6)


def test_the_hour_of_the_day_goes_round():
    """From eleven at night on: the last hour, then the first."""
    env, params = medjax.make("corridor", hourly_price=np.arange(24.0), start_s=23 * 3600.0)
    found = [
        float(hourly_price(Outcome(SimpleNamespace(time=time), None, None, params, env.config)))
        for time in (0, 359, 360, 719, 720)
    ]
    assert found == [23.0, 23.0, 0.0, 0.0, 1.0]
    with pytest.raises(InputError, match=r"hourly_price has shape \(23,\)"):
        medjax.make("corridor", hourly_price=np.ones(23))


def test_a_term_without_a_weight_is_named():
    env, params = medjax.make("paper")
    params = params.replace(reward_weights={"depleted": -1.0})
    state = jax.eval_shape(env.reset, jax.random.key(0), params)[1]
    with pytest.raises(InputError, match="reward_weights have no 'soc'"):
        jax.eval_shape(env.step_env, jax.random.key(0), state, 0, params)


@pytest.mark.thorough
def test_rewards_of_an_episode_add_up_to_its_metrics_at_their_prices():
    """One of the prices is changed."""
    env, params = medjax.make("paper", reward="money", reward_weights={"med_h": -50.0})
    policy = medjax.BASELINES["greedy"](env)
    _, state = jax.jit(env.reset)(jax.random.key(0), params)

    def step(state, key):
        action = policy(key, None, state, params).action
        _, state, reward, _, _, info = env.step_env(key, state, action, params)
        return state, (reward, info["metrics"])

    _, (rewards, metrics) = jax.jit(lambda s, keys: jax.lax.scan(step, s, keys))(
        state, jax.random.split(jax.random.key(1), 240)
    )
    end = {name: float(values[-1]) for name, values in metrics.items()}
    evs = end["evs_entered"]
    cost = (
        20.0 * (end["ev_delay_h"] + end["gas_delay_h"] + end["queue_vehicle_s"] / 3600.0)
        + 0.22 * end["energy_drawn_kwh"]
        + 0.285 * (end["ev_driving_kwh"] - end["ev_received_kwh"]) * evs
        + 50.0 * end["med_hours"]
        + 250.0 * end["evs_depleted"]
        + 18.0 * end["low_exits"]
    )
    assert end["meds_dispatched"] > 2
    assert min(end["evs_depleted"], end["low_exits"], end["energy_delivered_kwh"]) > 0.0
    assert float(rewards.sum()) == pytest.approx(-cost, rel=1e-3)


def test_eq_10_stays_the_default():
    """An unknown set is refused."""
    env, params = medjax.make()
    assert set(env.reward) == set(medjax.TERMS) == set(params.reward_weights)
    assert not set(medjax.TERMS) & set(MONEY)
    with pytest.raises(ValueError, match="unknown reward 'gold': allowed money, paper"):
        medjax.make(reward="gold")


def test_the_former_name_of_step_stats(paper):
    """It works for one version, with a warning that names the new one."""
    outcome = Outcome("before", "after", "sums", paper[1], paper[0].config)
    with pytest.warns(DeprecationWarning, match="Outcome.happened is now step_stats"):
        assert outcome.happened == "sums"
