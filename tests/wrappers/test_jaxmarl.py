"""JaxMARL's own wrappers on `medjax.make_agents`, unchanged, and a learner in the manner of its IPPO."""

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


@pytest.mark.thorough
def test_a_learner_in_the_manner_of_ippo(named):
    """One step of gradient descent lowers its loss on its own rollout.

    As in JaxMARL's `ippo_ff` (FLAIROx/JaxMARL, c793d09), agents share weights, those of all environments are one batch,
    and masks apply to logits. JaxMARL's package has no baselines; its scripts for MPE trained on `make_agents`
    unchanged but for `jaxmarl.make`, by hand, in November 2026.
    """
    env = LogWrapper(named)
    actors, actions = ENVS * env.num_agents, named.env.num_actions

    def batchify(by_agent):
        return jnp.stack([by_agent[agent] for agent in env.agents]).reshape((actors, -1))

    def unbatchify(rows):
        return dict(zip(env.agents, rows.reshape((env.num_agents, ENVS)), strict=True))

    def logits_of(weights, obs, mask):
        return jnp.where(mask > 0, obs @ weights, -1e9)

    def collect(weights, obs, state, key):
        def step(carry, key):
            obs, state = carry
            mask = batchify(jax.vmap(env.get_avail_actions)(state.env_state))
            rows = batchify(obs)
            act_key, *env_keys = jax.random.split(key, 1 + ENVS)
            chosen = jax.random.categorical(act_key, logits_of(weights, rows, mask))
            obs, state, rewards, _, info = jax.vmap(env.step)(
                jnp.stack(env_keys), state, unbatchify(chosen)
            )
            # As in the baseline, each entry of info has one value per actor.
            jax.tree.map(lambda x: x.reshape(actors), info)
            return (obs, state), (rows, mask, chosen, batchify(rewards)[:, 0])

        return jax.lax.scan(step, (obs, state), jax.random.split(key, DECISIONS))[1]

    @jax.jit
    def losses(weights, key):
        obs, state = jax.vmap(env.reset)(jax.random.split(key, ENVS))
        obs, mask, chosen, rewards = collect(weights, obs, state, key)
        advantage = jnp.cumsum(rewards[::-1], axis=0)[::-1]
        advantage -= advantage.mean()

        def loss(weights):
            log_probs = jax.nn.log_softmax(logits_of(weights, obs, mask))
            taken = jnp.take_along_axis(log_probs, chosen[..., None], axis=-1)[..., 0]
            return -jnp.mean(taken * advantage)

        before, slope = jax.value_and_grad(loss)(weights)
        change = 1e-4 * slope / (1e-9 + jnp.linalg.norm(slope))
        return before, loss(weights - change), jnp.linalg.norm(slope)

    size = named.observation_space("med_0").shape[0]
    weights = 0.01 * jax.random.normal(jax.random.key(0), (size, actions))
    before, after, slope = losses(weights, jax.random.key(1))
    assert np.isfinite([before, after]).all()
    assert float(slope) > 0.0
    assert float(after) < float(before)
