"""JaxMARL's own wrappers on `medjax.make_agents`, unchanged, and its learners' way to batch actors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.errors import InputError

pytest.importorskip("jaxmarl", reason='pip install "jaxmarl>=0.2"')

from jaxmarl.wrappers.baselines import CTRolloutManager, LogWrapper

pytestmark = pytest.mark.usefixtures("quick_compiles")

DECISIONS, ENVS = 4, 2
SMALL = {"size": 3, "num_evs": 8, "num_gas": 12, "mainline_per_h": 600.0}


@pytest.fixture(scope="module")
def named():
    own = {"episode_decisions": DECISIONS, "rounds_per_decision": 2}
    return medjax.make_agents("paper", **SMALL, **own)


@pytest.mark.thorough
def test_log_wrapper_counts_episodes(named):
    """Each agent's return is the sum of its rewards."""
    env = LogWrapper(named)
    _, state = env.reset(jax.random.key(0))
    paid = np.zeros(3)
    for number in range(DECISIONS):
        actions = dict.fromkeys(env.agents, jnp.int32(0))
        _, state, rewards, _, info = env.step(jax.random.key(number), state, actions)
        paid += [float(rewards[agent]) for agent in env.agents]
    assert info["returned_episode"].all()
    np.testing.assert_allclose(info["returned_episode_returns"], paid, rtol=1e-5)
    assert (np.asarray(info["returned_episode_lengths"]) == DECISIONS).all()


@pytest.mark.thorough
def test_rollout_manager_batches_and_samples(named):
    """As JaxMARL's value-based baselines use it."""
    manager = CTRolloutManager(named, batch_size=ENVS)
    obs, state = manager.batch_reset(jax.random.key(0))
    actions = {agent: manager.batch_sample(jax.random.key(1), agent) for agent in manager.agents}
    obs, state, rewards, dones, _ = manager.batch_step(jax.random.key(2), state, actions)
    size = named.observation_space("med_0").shape[0]
    assert obs["med_0"].shape == (ENVS, size + 3)
    assert obs["__all__"].shape == (ENVS, 3 * size)
    np.testing.assert_allclose(rewards["__all__"], 3 * rewards["med_0"], rtol=1e-5)
    assert dones["__all__"].shape == (ENVS,)
    for number in range(3, 2 + DECISIONS):
        obs, state, _, dones, _ = manager.batch_step(jax.random.key(number), state, actions)
    assert dones["__all__"].all()
    # docs/agents.md warns of this: the manager shows an episode's first observation to the team, and zeros to agents.
    assert not np.asarray(obs["med_0"]).any()
    assert np.asarray(obs["__all__"]).any()


def test_an_action_may_be_an_array_of_one(named):
    """JaxMARL's IPPO for MPE gives `(environments, 1)` by agent, so `(1,)` in each; more is refused."""
    _, state = named.reset(jax.random.key(0))
    steps = []
    for shape in ((), (1,)):
        actions = dict.fromkeys(named.agents, jnp.zeros(shape, jnp.int32).at[...].set(1))
        steps.append(named.step(jax.random.key(1), state, actions))
    jax.tree.map(np.testing.assert_array_equal, *steps)
    assert steps[0][4]["meds_dispatched"][0] == 1.0
    two = dict.fromkeys(named.agents, jnp.zeros((2,), jnp.int32))
    with pytest.raises(InputError, match="action of med_0"):
        named.step(jax.random.key(1), state, two)


def test_actors_batch_as_in_ippo(named):
    """`ippo_ff` of JaxMARL (FLAIROx/JaxMARL, c793d09) stacks agents of all environments and reshapes every info so.

    Its scripts for MPE trained on `make_agents` unchanged but for `jaxmarl.make`, by hand, in November 2026.
    """
    env, actors = LogWrapper(named), ENVS * named.num_agents

    def collect(key):
        obs, state = jax.vmap(env.reset)(jax.random.split(key, ENVS))
        rows = jnp.stack([obs[agent] for agent in env.agents]).reshape((actors, -1))
        masks = jax.vmap(env.get_avail_actions)(state.env_state)
        mask = jnp.stack([masks[agent] for agent in env.agents]).reshape((actors, -1))
        chosen = jax.random.categorical(key, jnp.where(mask, 0.0, -1e9))
        actions = dict(zip(env.agents, chosen.reshape((-1, ENVS)), strict=True))
        step = jax.vmap(env.step)(jax.random.split(key, ENVS), state, actions)
        return rows, mask, chosen, jax.tree.map(lambda x: x.reshape(actors), step[4])

    rows, mask, chosen, infos = jax.eval_shape(collect, jax.random.key(0))
    assert rows.shape == (actors, *named.observation_space("med_0").shape)
    assert mask.shape == (actors, named.env.num_actions)
    assert chosen.shape == infos["returned_episode_returns"].shape == (actors,)
