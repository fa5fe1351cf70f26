"""`PYTHON highjax_worker.py [VEHICLES ROADS DECISIONS]` times HighJax, in a Python that has it and needs no medjax.

It prints one line of JSON: HighJax's version and, with the three numbers, `updates_per_s`.
"""

import importlib.metadata
import json
import sys
import time

import jax
from highjax.envs.highway_env import HighJaxEnv


def updates_per_s(num_vehicles: int, num_roads: int, decisions: int) -> float:
    """Vehicle updates a second under random actions, resets included, after as many decisions for warm-up."""
    env = HighJaxEnv(n_npcs=num_vehicles - 1)
    params = env.default_params

    def decide(state, key):  # type: ignore[no-untyped-def]
        act_key, step_key = jax.random.split(key)
        actions = jax.random.randint(act_key, (num_roads,), 0, env.num_actions)
        keys = jax.random.split(step_key, num_roads)
        step = jax.vmap(env.step, (0, 0, 0, None))
        obs, state, reward, done, _ = step(keys, state, actions, params)
        return state, (obs.sum(), reward.sum(), done.sum())

    @jax.jit
    def play(state, key):  # type: ignore[no-untyped-def]
        return jax.lax.scan(decide, state, jax.random.split(key, decisions))

    keys = jax.random.split(jax.random.key(0), num_roads)
    _, state = jax.vmap(env.reset, (0, None))(keys, params)
    state, _ = jax.block_until_ready(play(state, jax.random.key(1)))
    start = time.perf_counter()
    jax.block_until_ready(play(state, jax.random.key(2)))
    took = time.perf_counter() - start
    return num_vehicles * num_roads * decisions * env.n_sub_ts_per_t / took


if __name__ == "__main__":
    answer: dict[str, float | str] = {"version": importlib.metadata.version("highjax")}
    if len(sys.argv) > 1:
        answer["updates_per_s"] = updates_per_s(*map(int, sys.argv[1:]))
    print(json.dumps(answer))
