"""Decisions of several rounds of entries."""

import chex
import jax
import jax.numpy as jnp
import pytest

import medjax
from medjax.env.reward import MONEY, TERMS
from medjax.wrappers import DecideEvery

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.mark.thorough
def test_a_decision_of_several_rounds_equals_several_decisions():
    """The later ones take action 0. States, tallies and probes agree, with the same draws."""
    size = {"num_meds": 2, "num_gas": 240, "ramp_per_h": 600.0, "mainline_per_h": 5000.0}
    one, params = medjax.make("paper", **size)
    three, _ = medjax.make("paper", **size, rounds_per_decision=3)
    one, three = (env.with_probe(lambda state: state.vehicles.x) for env in (one, three))
    key, (_, state) = jax.random.key(1), jax.jit(one.reset)(jax.random.key(0), params)

    def apart(state):
        """Round by round."""
        tallies, seen = [], []
        for number, round_key in enumerate(jax.random.split(key, 3)):
            _, state, *_, info = one.step_env(round_key, state, 1 if number == 0 else 0, params)
            tallies.append(info["step_stats"])
            seen.append((info["begun"], info["ticks"]))
        return (
            state,
            jax.tree.map(lambda *each: sum(each), *tallies),
            jax.tree.map(lambda *each: jnp.concatenate(each), *seen),
        )

    expected, stats, (begun, ticks) = jax.jit(apart)(state)
    _, after, *_, info = jax.jit(three.step_env)(key, state, 1, params)
    assert int(after.time) == 1
    both = ((each.vehicles, each.evs.replace(rest_j=0.0), each.queue) for each in (after, expected))
    chex.assert_trees_all_close(*both, rtol=1e-6, atol=1e-4)
    assert float(jnp.sum(stats.entered)) > 3
    chex.assert_trees_all_close(info["step_stats"], stats, rtol=1e-5, atol=1e-3)
    assert info["begun"].shape == (3, one.config.num_vehicles)
    chex.assert_trees_all_close((info["begun"], info["ticks"]), (begun, ticks), rtol=1e-6)


@pytest.mark.thorough
def test_rewards_do_not_depend_on_the_length_of_decisions():
    """Every term, with weight 1, over a minute: a decision of 4 s against one choice in four decisions of 1 s."""
    reward = {**TERMS, **MONEY}
    size = {"num_meds": 4, "num_gas": 100, "ev_share": 0.3, "cooldown_s": 4.0}
    size |= {"reward": reward, "reward_weights": dict.fromkeys(reward, 1.0), "turnaround_s": 5.0}
    size |= {"exit_x_m": [2500.0], "exit_share": 0.0, "num_plugs": 1}
    one, params = medjax.make("paper", **size, request_soc=0.8)
    four, _ = medjax.make("paper", **size, request_soc=0.8, rounds_per_decision=4)
    _, start = jax.jit(one.reset)(jax.random.key(0), params)

    def paid(env):
        """Reward, terms and entries, summed over the minute."""

        def decide(state, key):
            _, state, total, _, _, info = env.step_env(key, state, 1, params)
            return state, (total, info["reward_terms"], info["step_stats"].entered)

        keys = jax.random.split(jax.random.key(1), 15)
        return jax.tree.map(lambda each: each.sum(0), jax.lax.scan(decide, start, keys)[1])

    seldom, often = (jax.jit(paid, static_argnums=0)(env) for env in (four, DecideEvery(one, 4)))
    total, terms, came = seldom
    assert float(came.sum()) > 20
    chex.assert_trees_all_close((total, came), (often[0], often[2]), rtol=1e-4)
    for name, value in terms.items():
        assert float(value) == pytest.approx(float(often[1][name]), rel=1e-3, abs=1e-3), name
        assert name == "collisions" or float(value) != 0.0, name
    # A mean charge of a minute, and a mean speed in 30 m/s.
    assert 60 * 0.1 < float(terms["soc"]) < 60 * 0.8
    assert 60 * 0.5 < float(terms["speed"]) < 60 * 1.1
