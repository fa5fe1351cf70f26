"""The Gymnasium environments refuse bad options in one line."""

import functools

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason='pip install -e ".[gymnasium]"')

from medjax.agents import agents_of  # noqa: E402
from medjax.errors import InputError  # noqa: E402
from medjax.wrappers.gymnasium import ENV_ID, ChargingGymEnv, ChargingVectorEnv  # noqa: E402
from tests.train.probe_envs import Probe, ProbeParams  # noqa: E402
from tests.wrappers.test_gymnasium import SMALL  # noqa: E402


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({**SMALL, "scenario": "papr"}, "unknown scenario 'papr': did you mean paper"),
        ({**SMALL, "cooldwn_s": 3}, "unknown option 'cooldwn_s': did you mean cooldown_s"),
        ({**SMALL, "render_mode": "ansi"}, "render_mode = 'ansi': allowed None, rgb_array"),
        ({**SMALL, "decide_every": 1.0}, "decide_every is 1.0, must be a whole number"),
        ({"decide_evry": 3}, "unknown option 'decide_evry': did you mean decide_every"),
        ({"scenari": "paper"}, "unknown option 'scenari': did you mean scenario"),
        ({"env": 3, "parms": 3}, "unknown option 'parms': did you mean params"),
        ({"obsrvation": "flat"}, "unknown option 'obsrvation': did you mean observation"),
        ({"max_episode_step": 3}, "unknown option 'max_episode_step': did you mean max_episode_st"),
        ({"vectorisation_mode": 3}, "unknown option 'vectorisation_mode': did you mean vectoriz"),
        ({"env": 3, "params": 3}, "env is 3: allowed an environment"),
        ({"env": 3}, "env: allowed with params, and without a scenario or its options"),
        ({"params": 3}, "params without env: allowed options of medjax.make"),
    ],
)
def test_bad_options_are_refused_in_one_line(change, message):
    def by_gymnasium(**change):
        return gymnasium.make(ENV_ID, **change)

    def several(**change):
        return ChargingVectorEnv(1, **change)

    for make in (ChargingGymEnv, several, *([by_gymnasium] if "render_mode" not in change else [])):
        with pytest.raises(InputError, match=message) as refusal:
            make(**change)
        assert "\n" not in str(refusal.value)


def test_an_environment_of_agents_is_refused():
    env, params = agents_of("paper")
    for make in (ChargingGymEnv, functools.partial(ChargingVectorEnv, 1)):
        with pytest.raises(InputError, match="env is of agents: allowed one of a dispatcher"):
            make(env=env, params=params)


class Clocked(Probe):
    """A probe whose last action is allowed at the start only, with a space like Gymnasium's own."""

    def action_mask(self, state, params):
        return super().action_mask(state, params).at[-1].set(state.time == 0)

    def observation_space(self, params):
        return gymnasium.spaces.Box(np.array([-1.0, 0.0]), np.array([1.0, np.inf]), (2,))


@pytest.mark.parametrize("bounded", [False, True])
def test_an_environment_of_ones_own_needs_no_more_than_the_contract(bounded):
    """No mask and no terms of the reward in its info, and no bounds of its space, or bounds by element."""
    probe, params = (Clocked if bounded else Probe)("follow", num_actions=2), ProbeParams()
    alone = ChargingGymEnv(env=probe, params=params)
    space = alone.observation_space
    bounds = [[-1.0, 0.0], [1.0, 1e6]] if bounded else [[-1e6, -1e6], [1e6, 1e6]]
    np.testing.assert_array_equal([space.low, space.high], bounds)
    obs, info = alone.reset(seed=0)
    assert space.contains(obs)
    assert info["action_mask"].tolist() == [1, 1]
    *_, ended, _, info = alone.step(1)
    assert ended
    assert set(info) == {"action_mask", "metrics"}
    assert info["action_mask"].tolist() == [1, not bounded]
    several = ChargingVectorEnv(4, env=probe, params=params)
    several.reset(seed=0)
    obs, reward, terminated, _, info = several.step(np.ones(4, int))
    assert obs.shape == (4, 2)
    assert terminated.all()
    assert set(reward) <= {0.0, 1.0}
    # The next episode has begun, and the last one is over.
    assert info["action_mask"].tolist() == 4 * [[1, 1]]
    assert info["final_info"]["action_mask"].tolist() == 4 * [[1, not bounded]]


@pytest.mark.parametrize("number", [0, None, "3", 1.5, float("nan")])
def test_bad_numbers_of_copies_are_refused(number):
    def by_gymnasium(number, **options):
        return gymnasium.make_vec(ENV_ID, num_envs=number, **options)

    for make in (ChargingVectorEnv, by_gymnasium):
        with pytest.raises(InputError, match=r"num_envs is .*, must be a whole number, at least 1"):
            make(number, **SMALL)
