"""What the annotations of the public API say of shapes and types holds."""

import typing

import jax
import jax.numpy as jnp
import jaxtyping
import pytest

import medjax
from medjax.env.charging_env import ChargingEnv
from medjax.env.contract import StepResult
from medjax.traffic import sort_by_road
from medjax.world.state import EnvState, EpisodeStats, EVs, MEDs, Vehicles


def misfits(value, hint, name=""):
    """Names of the fields whose arrays differ from their annotations."""
    if isinstance(value, EnvState | Vehicles | EVs | MEDs | EpisodeStats):
        hints = typing.get_type_hints(type(value))
        for field, own in hints.items():
            yield from misfits(getattr(value, field), own, f"{name}.{field}")
    elif not isinstance(value, hint):
        yield name


@pytest.fixture(scope="module")
def decision(paper, started):
    """Types of what `step` returns."""
    env, params = paper
    return jax.eval_shape(env.step, jax.random.key(1), started[1], jnp.int32(0), params)


def filled(tree):
    return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), tree)


def test_a_state_fits_its_annotations(started, decision):
    """At reset and after a decision; one name of an axis has one length."""
    for state in (started[1], filled(decision[1])):
        with jaxtyping.jaxtyped("context"):
            assert list(misfits(state, EnvState)) == []


def test_a_misfit_is_seen(started):
    """A vehicle too few, and another type."""
    state = started[1]
    short = state.replace(vehicles=state.vehicles.replace(speed=state.vehicles.speed[1:]))
    other = state.replace(time=state.time.astype(jnp.float32))
    for broken, name in ((short, ".vehicles.speed"), (other, ".time")):
        with jaxtyping.jaxtyped("context"):
            assert list(misfits(broken, EnvState)) == [name]


def test_what_the_environment_returns_fits_its_annotations(paper, started, decision):
    env, params = paper
    (obs, state), step = started, filled(decision)
    with jaxtyping.jaxtyped("context"):
        for value, hint in zip(step[2:5], typing.get_args(StepResult)[2:5], strict=True):
            assert isinstance(value, hint)
        hints = typing.get_type_hints(ChargingEnv.get_obs)
        assert all(isinstance(seen, hints["return"]) for seen in (obs, step[0]))
        mask = typing.get_type_hints(ChargingEnv.action_mask)["return"]
        assert isinstance(env.action_mask(state, params), mask)


@pytest.mark.parametrize(
    "call",
    [
        lambda: medjax.physics.ellipk("half"),
        lambda: medjax.traffic.idm_acceleration(
            *(jnp.ones(3), jnp.ones(2), 20.0),
            **{"desired_speed": 30.0, "time_headway": 1.0, "min_gap": 2.0},
            **{"max_acceleration": 1.4, "comfortable_deceleration": 2.0},
        ),
        lambda: sort_by_road(jnp.ones(3), jnp.ones(2, bool), 100.0, jnp.arange(3)),
    ],
)
def test_calls_are_checked_while_tests_run(call):
    with pytest.raises(jaxtyping.TypeCheckError):
        call()
