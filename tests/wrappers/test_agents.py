"""`medjax.make_agents`: JaxMARL's contract, and what it refuses."""

import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.agents import agents_of
from medjax.errors import InputError
from medjax.scenarios import prepare

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {"size": 3, "num_evs": 8, "num_gas": 12, "mainline_per_h": 600.0}


@pytest.fixture(scope="module")
def named():
    return medjax.make_agents("paper", **SMALL, episode_decisions=3, rounds_per_decision=2)


def waiting(env):
    return dict.fromkeys(env.agents, 0)


@pytest.mark.thorough
def test_results_are_dicts_by_agent(named):
    assert named.agents == ["med_0", "med_1", "med_2"]
    assert named.num_agents == 3
    assert named.agent_classes == {"med": named.agents}
    assert named.name == "paper"
    obs, state = named.reset(jax.random.key(0))
    masks = jax.jit(named.get_avail_actions)(state)
    assert set(obs) == set(masks) == set(named.agents)
    for agent in named.agents:
        assert obs[agent].shape == named.observation_space(agent).shape
        assert masks[agent].shape == (named.action_space(agent).n,)
        assert bool(masks[agent][0])
    obs, state, rewards, dones, infos = named.step(jax.random.key(1), state, waiting(named))
    assert set(rewards) == set(named.agents)
    assert set(dones) == {*named.agents, "__all__"}
    assert all(value.shape == (3,) for value in infos.values())
    # Divisions of two programs may differ in the last bit.
    again = jax.jit(named.get_obs)(state)
    np.testing.assert_allclose(obs["med_1"], again["med_1"], rtol=1e-6, atol=1e-7)
    assert jax.eval_shape(named.world_state, state).ndim == 1


@pytest.mark.thorough
def test_an_episode_ends_for_all_agents_and_resets(named):
    """At its last decision, to the given state or to a new one."""
    first_obs, first = named.reset(jax.random.key(0))
    state, ended = first, []
    masks_of = jax.jit(named.get_avail_actions)
    for number in range(3):
        actions = {agent: int(mask[1]) for agent, mask in masks_of(state).items()}
        obs, state, _, dones, infos = named.step(jax.random.key(number), state, actions, first)
        ended.append([bool(dones[agent]) for agent in (*named.agents, "__all__")])
    assert ended == [[False] * 4, [False] * 4, [True] * 4]
    jax.tree.map(np.testing.assert_array_equal, state, first)
    for agent in named.agents:
        np.testing.assert_allclose(obs[agent], first_obs[agent], rtol=1e-6, atol=1e-7)
    assert float(infos["meds_dispatched"][0]) >= 1.0
    late = first.replace(time=jnp.int32(2))
    _, state, _, dones, _ = named.step(jax.random.key(7), late, waiting(named))
    assert bool(dones["__all__"])
    assert int(state.time) == 0
    assert (np.asarray(state.vehicles.x) != np.asarray(first.vehicles.x)).any()


def test_reset_and_step_run_under_vmap(named):
    keys = jax.random.split(jax.random.key(0), 2)
    _, states = jax.eval_shape(jax.vmap(named.reset), keys)
    actions = {agent: jnp.zeros(2, jnp.int32) for agent in named.agents}
    obs, _, rewards, dones, _ = jax.eval_shape(jax.vmap(named.step), keys, states, actions)
    assert obs["med_0"].shape[0] == rewards["med_2"].shape[0] == dones["__all__"].shape[0] == 2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda actions: actions | {"med_9": 0}, "agent 'med_9': allowed med_0 to med_2"),
        (lambda actions: {"med_0": 0}, "no action of med_1: allowed one of each of med_0 to med_2"),
        (lambda actions: actions | {"med_1": 21}, "action of med_1 = 21: allowed an integer from"),
        (lambda actions: actions | {"med_1": -1}, "action of med_1 = -1: allowed an integer from"),
        (
            lambda actions: actions | {"med_2": 0.5},
            "action of med_2 = 0.5: allowed an integer from",
        ),
        (lambda actions: actions | {"med_0": [0, 1]}, "action of med_0 = [0, 1]: allowed an"),
        (lambda actions: actions | {"med_0": "a"}, "action of med_0 = 'a': allowed an integer"),
        (lambda actions: actions | {"med_0": object()}, "action of med_0 = <object object at"),
        (lambda actions: actions | {"med_0": None}, "action of med_0 = None: allowed an integer"),
        (lambda actions: actions | {"med_0": 2**40}, "action of med_0 = 1099511627776: allowed an"),
        (
            lambda actions: actions | {"med_0": np.int64(2**40)},
            "1099511627776): allowed an integer",
        ),
        (lambda actions: actions | {"med_0": 10**5000}, "action of med_0 = something of type int"),
        (lambda actions: actions | {"med_0": [[1], [1, 2]]}, "action of med_0 = [[1], [1, 2]]: "),
        (lambda actions: actions | {"med_0": {}}, "action of med_0 = {}: allowed an integer"),
        (lambda actions: 3, "actions = 3: allowed an integer by agent"),
    ],
)
def test_bad_actions_are_refused_in_a_line(named, change, words):
    """Outside of jit, before the state is read."""
    with pytest.raises(InputError) as caught:
        named.step(jax.random.key(0), None, change(waiting(named)))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"name": "nowhere"}, "unknown scenario 'nowhere'"),
        ({"speeds": (22.0, 300.0)}, "speeds[1] = 300.0: allowed a number from 1 to 100"),
        ({"speeds": ("fast",)}, "speeds[0] = 'fast'"),
        ({"speeds": 14.0}, "speeds = 14.0: allowed a list of speeds"),
        ({"speeds": "fast"}, "speeds = 'fast': allowed a list of speeds"),
        ({"credit": "mine"}, "credit = 'mine': allowed team, own"),
        ({"size": 99}, "99: allowed"),
        ({"colour": 1}, "unknown option 'colour'"),
        ({"build": 1}, "unknown option 'build': allowed those of medjax.make"),
        ({"central": True}, "unknown option 'central': allowed those of medjax.make"),
        ({"credt": "own"}, "unknown option 'credt': did you mean credit"),
    ],
)
def test_bad_options_are_refused_in_a_line(given, words):
    with pytest.raises(InputError) as caught:
        medjax.make_agents(**given)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_agents_have_no_space(named):
    for ask in (named.action_space, named.observation_space):
        with pytest.raises(InputError, match="agent 'med_3': allowed med_0 to med_2"):
            ask("med_3")


def test_the_fleets_service_speed_is_a_choice(named):
    """Action 0 is exactly the rule's."""
    assert float(named.params.fleet.service_speed) in named.env.actions.speeds
    corridor = medjax.make_agents("corridor", speeds=(20.0,), **SMALL)
    assert corridor.env.actions.speeds == (20.0, 23.0)
    assert corridor.env.actions.lanes == (1, 2)
    assert corridor.env.env.config.decision_s == 10.0


@pytest.mark.parametrize(
    ("given", "rounds", "decisions"),
    [
        ({}, 4, 150),
        ({"tick_s": 0.5}, 2, 300),
        ({"ticks_per_round": 30}, 1, 600),
        ({"episode_decisions": 100}, 4, 100),
        ({"rounds_per_decision": 2}, 2, 600),
    ],
)
def test_agents_decide_every_four_seconds(given, rounds, decisions):
    """Whatever the tick, and the episode keeps its length, unless options say otherwise."""
    env, params, *_ = agents_of("paper", build=prepare, **given)
    assert env.env.config.rounds_per_decision == rounds
    assert int(params.episode_decisions) == decisions


def test_a_pickled_copy_plays_the_same_episode(named):
    copy = pickle.loads(pickle.dumps(named))
    first, again = named.reset(jax.random.key(0)), copy.reset(jax.random.key(0))
    jax.tree.map(np.testing.assert_array_equal, first, again)
