"""Books of energy are shown a simulator that pays for what nothing took."""

import jax
import jax.numpy as jnp
import pytest

import medjax
from benchmarks.verification.decisions import DRIVING, Decision, check_decision
from benchmarks.verification.flows import driving

pytestmark = pytest.mark.usefixtures("quick_compiles")


def test_energy_that_nothing_took_is_found():
    """Downhill full batteries take no braking energy: a tally by the formula alone pays for what is nowhere."""
    env, params = medjax.make("paper", slope=-0.1, arrival_soc_low=1.0, arrival_soc_high=1.0)
    env, config, road = env.with_probe(lambda state: state), env.config, params.road

    @jax.jit
    def play():
        _, before = env.reset(jax.random.key(0), params)
        obs, after, reward, *_, info = env.step_env(jax.random.key(1), before, 0, params)
        ticks = info["begun"], info["ticks"]
        states = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), *ticks)

        def by_formula(index):
            old = jax.tree.map(lambda each: each[index], states.vehicles)
            new = jax.tree.map(lambda each: each[index + 1], states.vehicles)
            bodies = ((config.ev_slots, params.ev), (config.med_slots, params.med))
            used = [driving(old, new, *pair, road, config.tick_s)[0].sum() for pair in bodies]
            steady = old.replace(speed=old.desired_speed)
            power = driving(steady, steady, *bodies[0], road, 1.0)[0]
            way = (new.x - old.x)[config.ev_slots] / old.desired_speed[config.ev_slots]
            return used[0], jnp.sum(power * way), used[1]

        formula = jax.tree.map(jnp.sum, jax.vmap(by_formula)(jnp.arange(4)))
        return Decision(before, after, obs, reward, info), dict(zip(DRIVING, formula, strict=True))

    decision, formula = play()
    tally, check = decision.info["tally"], jax.jit(check_decision, static_argnums=1)
    assert sum(map(int, check(decision, config, params).values())) == 0
    assert float(formula["ev_driving_j"]) < -1e4 < float(tally.ev_driving_j)
    for name in ("ev_driving_j", "ev_cruising_j"):
        paid = tally.replace(**{name: formula[name]})
        found = check(decision._replace(info=decision.info | {"tally": paid}), config, params)
        assert int(found["energy"]) == 1, name
