"""The books of energy find a tally of energy that no battery gave."""

import jax
import jax.numpy as jnp
import pytest

import medjax
from benchmarks.verification.decisions import Decision, check_decision
from benchmarks.verification.flows import cruising, driving
from benchmarks.verification.invariants import INVARIANTS

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.mark.thorough
def test_energy_that_no_battery_took_is_found():
    """Full batteries take no braking energy downhill: a tally by the formula alone counts what is nowhere."""
    env, params = medjax.make("paper", slope=-0.1, arrival_soc_low=1.0, arrival_soc_high=1.0)
    env, config = env.with_probe(lambda state: state), env.config

    @jax.jit
    def play():
        _, before = env.reset(jax.random.key(0), params)
        obs, after, reward, *_, info = env.step_env(jax.random.key(1), before, 0, params)
        states = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), info["begun"], info["ticks"])

        def by_formula(old, new):
            evs = old.vehicles, new.vehicles, config.ev_slots, params.ev, params.road
            return driving(*evs, config.tick_s)[0].sum(), cruising(*evs)[0].sum()

        old = jax.tree.map(lambda each: each[:-1], states)
        new = jax.tree.map(lambda each: each[1:], states)
        formula = jax.tree.map(jnp.sum, jax.vmap(by_formula)(old, new))
        return Decision(before, after, obs, reward, info), formula

    decision, (driven, cruised) = play()
    stats, check = decision.info["step_stats"], jax.jit(check_decision, static_argnums=1)
    assert not check(decision, config, params).any()
    assert float(driven) < -1e4 < float(stats.ev_driving_j)
    for wrong in (stats.replace(ev_driving_j=driven), stats.replace(ev_cruising_j=cruised)):
        paid = decision._replace(info=decision.info | {"step_stats": wrong})
        assert check(paid, config, params)[[*INVARIANTS].index("energy")] == 1
