"""What environments of Gymnasium share."""

import dataclasses
import functools

import jax.numpy as jnp
import pytest

from medjax.charging.link import couple
from medjax.env.reward import TERMS
from medjax.traffic.idm import IDM, IDM_PLUS
from medjax.wrappers.gymnasium.programs import alike, chosen
from tests.wrappers.test_gymnasium import SMALL


def test_numbers_are_no_part_of_a_program():
    """Environments that differ in nothing else share one, through a wrapper too; each says how it was made itself."""
    one, other = _made(cooldown_s=30.0), _made(cooldown_s=40.0)
    assert alike(one) is alike(other)
    assert [env.recipe.overrides["cooldown_s"] for env in (one, other)] == [30.0, 40.0]
    rarely = [_made(3, cooldown_s=seconds) for seconds in (30.0, 40.0)]
    assert alike(rarely[0]) == alike(rarely[1])
    assert alike(rarely[0]) != alike(_made(2))


def test_another_model_is_another_environment():
    """Whoever asks for a car following or a coupling of their own gets that, whatever was made before."""
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
    """A term that can be called and has no hash, as usual for a dataclass."""

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
def test_what_has_no_hash_is_not_shared(own):
    """`medjax.make` takes it, so Gymnasium does."""
    env = _made(**own)
    assert alike(env) is env


def _made(decide_every=1, **how):
    env, _ = chosen(None, None, None, decide_every, SMALL | how)
    return env
