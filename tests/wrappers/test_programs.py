"""What environments of Gymnasium share."""

import functools

from medjax.charging.link import couple
from medjax.traffic.idm import IDM, IDM_PLUS
from medjax.wrappers.gymnasium.programs import chosen
from tests.wrappers.test_gymnasium import SMALL


def test_another_model_is_another_environment():
    """Whoever asks for a car following or a coupling of their own gets that, whatever was made before."""
    weak = functools.partial(couple, form="paper")
    usual = _made()
    assert _made() is usual
    assert usual.following is IDM_PLUS
    assert _made(following=IDM()).following == IDM()
    assert _made(coupling=weak).coupling is weak
    assert _made() is usual


def _made(**how):
    env, _ = chosen(None, None, None, 1, SMALL | how)
    return env
