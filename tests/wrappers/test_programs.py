"""Environments of Gymnasium share compiled programs where they differ only in numbers."""

import dataclasses
import functools

import jax.numpy as jnp
import pytest

from medjax.charging.link import couple
from medjax.env.reward import TERMS
from medjax.traffic.idm import IDM, IDM_PLUS
from medjax.wrappers.gymnasium import ChargingGymEnv
from medjax.wrappers.gymnasium.programs import alike, chosen
from tests.wrappers.test_gymnasium import SMALL


def test_numbers_are_no_part_of_a_program():
    """Nothing else may differ; wrapped environments share, too, and each keeps its own recipe."""
    one, other = _made(cooldown_s=30.0), _made(cooldown_s=40.0)
    assert alike(one) is alike(other)
    single = ChargingGymEnv(**SMALL, cooldown_s=30.0)
    assert single._program is alike(other)
    assert float(single.params.fleet.cooldown_s) == 30.0
    assert [env.recipe.overrides["cooldown_s"] for env in (one, other)] == [30.0, 40.0]
    rarely = [_made(3, cooldown_s=seconds) for seconds in (30.0, 40.0)]
    assert alike(rarely[0]) == alike(rarely[1])
    assert alike(rarely[0]) != alike(_made(2))


def test_models_are_part_of_a_program():
    """Car following, coupling and probe are those asked for, whatever was made before."""
    weak = functools.partial(couple, form="paper")
    usual = alike(_made())
    assert usual.following is IDM_PLUS
    assert alike(_made(following=IDM())).following == IDM()
    assert alike(_made(coupling=weak)).coupling is weak
    assert alike(_made()) is usual
    probe = lambda state: state.time  # noqa: E731
    assert alike(_made().with_probe(probe)).probe is probe


@dataclasses.dataclass
class Weighted:
    """A reward term without a hash, as usual for a dataclass."""

    weight: float

    def __call__(self, outcome):
        return self.weight * outcome.step_stats.depleted


@pytest.mark.parametrize(
    "own",
    [
        {"reward": {**TERMS, "mine": Weighted(2.0)}},
        {"following": dataclasses.replace(IDM(), exponent=jnp.float32(4.0))},
    ],
    ids=["term", "model"],
)
def test_environments_without_a_hash_are_not_shared(own):
    env = _made(**own)
    assert alike(env) is env


def _made(decide_every=1, **how):
    env, _ = chosen(None, None, None, decide_every, SMALL | how)
    return env
