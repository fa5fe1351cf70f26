"""No read or write of a reset or a step is out of bounds, except writes that are meant to be dropped."""

import inspect

import jax
import pytest
from jax import lax
from jax.experimental import checkify

import medjax
from medjax.numerics import gathers

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {"num_meds": 3, "num_evs": 8, "num_gas": 12, "mainline_per_h": 900.0}


@pytest.fixture
def heeds_modes(monkeypatch):
    """Lets checkify heed `mode="drop"` (findings/checkify-reports-dropped-updates.sh) and look into medjax's reads,
    whose custom batching would hide them.
    """
    checks = inspect.getmodule(checkify.checkify).error_checks
    for primitive in (lax.scatter_p, lax.scatter_add_p, lax.scatter_min_p, lax.scatter_max_p):

        def check(error, enabled, *given, check=checks[primitive], primitive=primitive, **how):
            if how["mode"] == lax.GatherScatterMode.FILL_OR_DROP:
                return error, primitive.bind(*given, **how)
            return check(error, enabled, *given, **how)

        monkeypatch.setitem(checks, primitive, check)
    monkeypatch.setattr(gathers, "_read", gathers._pick_all)


def test_the_checks_find_indices_out_of_bounds(heeds_modes):
    """In medjax's reads and in writes, but not in writes that are meant to be dropped."""

    def said(function, index):
        checked = checkify.checkify(function, errors=checkify.index_checks)
        return checked(jax.numpy.arange(3.0), index)[0].get()

    assert "index 3 is out of bounds" in said(gathers.read, jax.numpy.array([0, 3]))
    assert said(gathers.read, jax.numpy.array([0, 2])) is None
    assert "index 3 is out of bounds" in said(lambda x, i: x.at[i].set(1.0, mode="clip"), 3)
    assert said(lambda x, i: x.at[i].set(1.0, mode="drop"), 3) is None


@pytest.mark.thorough
def test_nothing_is_out_of_bounds(heeds_modes):
    """In forty random decisions, in which an episode ends and another begins."""
    env, params = medjax.make("paper", **SMALL, episode_decisions=35)
    reset, step = (
        jax.jit(checkify.checkify(call, errors=checkify.index_checks))
        for call in (env.reset, env.step)
    )
    error, (_, state) = reset(jax.random.key(0), params)
    error.throw()
    for key in jax.random.split(jax.random.key(1), 40):
        action = env.action_space(params).sample(key)
        error, (_, state, *_) = step(key, state, action, params)
        error.throw()
    assert int(state.time) == 5
