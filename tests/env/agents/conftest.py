"""One highway of agents, compiled once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.policies.policy import Choice, Policy
from medjax.world.state import IN_SERVICE, MERGING, QUEUED

TRIPS = {"length_m": 3000.0, "ramp_x_m": [50.0, 1300.0], "exit_x_m": [1000.0, 2300.0]}
TRIPS |= {"num_evs": 24, "num_gas": 24, "size": 4, "exit_notice_m": 400.0}
TRIPS |= {"mainline_per_h": 2000.0, "ev_share": 0.6, "arrival_soc_high": 0.3}
TRIPS |= {"cooldown_s": 5.0, "trip_m": 2000.0, "turnaround_s": 20.0}
TRIPS |= {"rounds_per_decision": 4, "episode_decisions": 60}


class World:
    """An environment of agents with its parameters and its compiled programs."""

    def __init__(self, named):
        self.env, self.params = named.env, named.params
        self.actions, self.config = named.env.actions, named.env.env.config
        self.step = jax.jit(self.env.step_env)
        self.mask = jax.jit(self.env.action_mask)
        self.view = jax.jit(self.env.get_obs)
        self.global_state = jax.jit(self.env.global_state)
        self.by_rule = jax.jit(self.actions.by_rule)
        self.masks = jax.jit(lambda state, params: self.actions.masks(state, self.config, params))
        self._reset = jax.jit(self.env.reset)

    def reset(self, seed=0, params=None):
        return self._reset(jax.random.key(seed), self.params if params is None else params)


def refusing(env):
    """A policy whose MEDs take no EVs, serve at the lowest speed, and enter from the first ramp when they may."""

    def act(weights, key, obs, state, params):
        actions, status = env.env.actions, state.meds.status
        usual = actions.by_rule(state, params)
        serves = status == IN_SERVICE
        sent = serves | (status == QUEUED) | (status == MERGING)
        parts = usual._replace(
            speed=jnp.where(serves, 0, usual.speed), accept=jnp.zeros_like(usual.accept)
        )
        enters = env.action_mask(state, params)[:, 1].astype(jnp.int32)
        action = jnp.where(sent, actions.fold(parts, sent), enters)
        return Choice(action, jax.nn.one_hot(action, env.num_actions))

    return Policy(act)


@pytest.fixture(scope="package")
def trips():
    """A short piece of `corridor`: exits, three lanes, four MEDs that come back."""
    return World(medjax.make_agents("corridor", **TRIPS))


@pytest.fixture(scope="package")
def busy(trips):
    """Its state after a minute in which MEDs enter as often as they may and serve as the rule does."""
    _, state = trips.reset(3)
    for number in range(15):
        mask = np.asarray(trips.mask(state, trips.params))
        enter = mask[:, 1 + number % 2]
        actions = np.where(enter, 1 + number % 2, 0)
        key = jax.random.key(100 + number)
        _, state, *_ = trips.step(key, state, jnp.asarray(actions), trips.params)
    assert (state.meds.status == IN_SERVICE).sum() >= 2
    assert (state.evs.med >= 0).any()
    return state
