"""Auto-reset of a batch against a plain loop over single environments."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.wrappers import BatchAutoReset, EpisodeLog, for_true_rows
from tests.train.probe_envs import Probe, ProbeParams

NUM = 7
ENV = Probe("noisy")
PARAMS = ProbeParams(episode_decisions=4)


def play(env, steps, num_envs=NUM, key=0, params=PARAMS):
    """Observations and states before, and results of, each of `steps` random decisions."""
    obs, state = env.reset(jax.random.split(jax.random.key(key), num_envs), params)
    step = jax.jit(env.step)
    rng = np.random.default_rng(key)
    history = []
    for number in range(steps):
        actions = jnp.asarray(rng.integers(0, 2, num_envs), jnp.int32)
        keys = jax.random.split(jax.random.key(1000 + number), num_envs)
        before = (obs, state, actions)
        obs, state, *rest = step(keys, state, actions, params)
        history.append((*before, obs, state, *rest))
    return history


@pytest.mark.parametrize("pool", [1, 3, NUM])
def test_equals_single_environments_stepped_one_by_one(pool):
    env = BatchAutoReset(ENV, reset_pool_size=pool, stagger=4)
    reset_obs = set()
    reset = jax.jit(ENV.reset)
    for number, (_, state, actions, obs, after, reward, terminated, truncated, info) in enumerate(
        play(env, 13)
    ):
        keys = jax.random.split(jax.random.key(1000 + number), NUM)
        keys = [jax.random.split(key) for key in keys]
        for i in range(NUM):
            own = jax.tree.map(lambda x, i=i: x[i], state.env)
            ref_obs, ref_state, ref_reward, ref_term, ref_trunc, _ = ENV.step_env(
                keys[i][0], own, actions[i], PARAMS
            )
            np.testing.assert_array_equal(info["final_observation"][i], ref_obs)
            assert reward[i] == ref_reward
            assert terminated[i] == ref_term
            cut = bool(state.cut_in[i] == 1) and not bool(ref_trunc)
            assert info["cut_short"][i] == cut
            assert truncated[i] == (ref_trunc or cut)
            if truncated[i]:
                reset_obs.add(float(obs[i, 0]))
                ref_obs, ref_state = reset(keys[i][1], PARAMS)
            np.testing.assert_array_equal(obs[i], ref_obs)
            jax.tree.map(
                np.testing.assert_array_equal,
                jax.tree.map(lambda x, i=i: x[i], after.env),
                ref_state,
            )
    # Fresh randomness for every restart: no two of them started alike.
    assert len(reset_obs) >= 2 * NUM


class Gated(Probe):
    """Action 1 is allowed at the beginning of an episode only, and info says so."""

    def action_mask(self, state, params):
        return jnp.array([True, False]).at[1].set(state.time == 0)

    def step_env(self, key, state, action, params):
        obs, state, *ends, info = super().step_env(key, state, action, params)
        return obs, state, *ends, info | {"action_mask": self.action_mask(state, params)}


def test_the_mask_in_info_is_that_of_the_state_that_is_returned():
    """Where an episode ended, that of the next one."""
    env = BatchAutoReset(Gated("noisy"))
    began = 0
    for _, _, _, _, after, *_, info in play(env, 8):
        np.testing.assert_array_equal(info["action_mask"], env.action_mask(after, PARAMS))
        np.testing.assert_array_equal(info["action_mask"][:, 1], after.env.time == 0)
        assert not info["final_action_mask"][:, 1].any()  # no step leads to a beginning
        began += int((after.env.time == 0).sum())
    assert began == 2 * NUM


def test_staggering_spreads_the_ends_and_cuts_only_the_first_episodes():
    history = play(BatchAutoReset(ENV, stagger=4), 12, num_envs=64)
    truncated = np.array([step[7] for step in history])
    cut = np.array([step[8]["cut_short"] for step in history])
    assert (truncated[:4].sum(axis=0) >= 1).all()
    assert cut[4:].sum() == 0
    assert (cut[:3].sum(axis=1) > 4).all()
    ends = truncated[4:8].sum(axis=1)  # one whole period
    assert ends.sum() == 64
    assert (ends > 4).all()


@pytest.mark.parametrize("pool", [{}, {"reset_pool_size": 2}], ids=str)
def test_without_stagger_all_end_together_and_restart_differently(pool):
    history = play(BatchAutoReset(ENV, **pool), 9)
    truncated = np.array([step[7] for step in history])
    assert truncated.sum(axis=1).tolist() == [0, 0, 0, NUM, 0, 0, 0, NUM, 0]
    assert len(np.unique(np.asarray(history[3][3][:, 0]))) == NUM


def test_copies_of_a_group_start_alike_with_noise_of_their_own():
    """At the start and at every restart, whose times staggering spreads over groups."""
    history = play(BatchAutoReset(ENV, stagger=4, group=3), 9, num_envs=6)
    first = np.asarray(history[0][0]).reshape(2, 3, -1)
    assert (first == first[:, :1]).all()
    assert not np.array_equal(first[0], first[1])
    starts = 0
    for *_, obs, _, _, _, truncated, info in history:
        obs, final = (np.asarray(x).reshape(2, 3, -1) for x in (obs, info["final_observation"]))
        for group, done in enumerate(np.asarray(truncated).reshape(2, 3)):
            assert done.all() == done.any()
            assert len(np.unique(final[group], axis=0)) == 3  # noise is each copy's own
            assert len(np.unique(obs[group], axis=0)) == (1 if done.all() else 3)
            starts += done.all()
    assert starts >= 4


def test_copies_must_form_whole_groups():
    with pytest.raises(ValueError, match="num_envs is 7, must be a multiple of group = 3"):
        play(BatchAutoReset(ENV, group=3), 1)


@pytest.mark.parametrize("block", [1, 2, 5, 8])
def test_for_true_rows_serves_each_true_row_once_in_order(block):
    for seed in range(4):
        mask = jax.random.bernoulli(jax.random.key(seed), (0.0, 0.3, 0.7, 1.0)[seed], (8,))

        def body(call, rows, carry):
            served, calls = carry
            return served.at[rows].add(1, mode="drop"), calls + 1

        served, calls = for_true_rows(mask, block, body, (jnp.zeros(8, jnp.int32), 0))
        np.testing.assert_array_equal(served, mask.astype(int))
        assert calls == -(-int(mask.sum()) // block)


def test_episode_log_equals_a_count_by_hand():
    env = EpisodeLog(BatchAutoReset(ENV, stagger=4))
    total, length = np.zeros(NUM), np.zeros(NUM, int)
    complete = 0
    for *_, reward, terminated, truncated, info in play(env, 13):
        total, length = total + reward, length + 1
        done = np.asarray(terminated | truncated)
        episode = info["episode"]
        np.testing.assert_array_equal(episode["finished"], done)
        np.testing.assert_array_equal(episode["complete"], done & ~np.asarray(info["cut_short"]))
        np.testing.assert_allclose(episode["return"], total, rtol=1e-5)
        np.testing.assert_array_equal(episode["length"], length)
        # The probe's own metrics say the same, so they are those of the episode that ended.
        np.testing.assert_allclose(episode["metrics"]["total"], total, rtol=1e-5)
        np.testing.assert_array_equal(episode["metrics"]["decisions"], length)
        assert (np.asarray(episode["length"])[np.asarray(episode["complete"])] == 4).all()
        complete += int(episode["complete"].sum())
        total, length = np.where(done, 0.0, total), np.where(done, 0, length)
    assert complete >= 2 * NUM
