"""Decisions of several rounds of entries."""

import chex
import jax
import jax.numpy as jnp
import pytest

import medjax

pytestmark = pytest.mark.usefixtures("quick_compiles")


def test_a_decision_of_rounds_is_that_many_decisions_without_an_action():
    """Entries, bookings and traffic, with the same draws; what is counted adds up, and a probe sees it in order."""
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
            tallies.append(info["tally"])
            seen.append((info["begun"], info["ticks"]))
        return (
            state,
            jax.tree.map(lambda *each: sum(each), *tallies),
            jax.tree.map(lambda *each: jnp.concatenate(each), *seen),
        )

    expected, tally, (begun, ticks) = jax.jit(apart)(state)
    _, after, *_, info = jax.jit(three.step_env)(key, state, 1, params)
    assert int(after.time) == 1
    both = ((each.vehicles, each.evs.replace(rest_j=0.0), each.queue) for each in (after, expected))
    chex.assert_trees_all_close(*both, rtol=1e-6, atol=1e-4)
    assert float(jnp.sum(tally.entered)) > 3
    chex.assert_trees_all_close(info["tally"], tally, rtol=1e-5, atol=1e-3)
    assert info["begun"].shape == (3, one.config.num_vehicles)
    chex.assert_trees_all_close((info["begun"], info["ticks"]), (begun, ticks), rtol=1e-6)
