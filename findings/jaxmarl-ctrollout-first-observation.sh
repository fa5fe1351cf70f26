#!/usr/bin/env bash
# JaxMARL 0.2.0: CTRolloutManager hands zeros to every agent as the first observation of each later episode.
#
# Expected: `batch_step` resets an environment whose episode ended, as the environment does by itself, and returns the
#   first observation of the next episode.
# What happens: the manager sets the observations of agents that are done to 0, after the environment has replaced
#   them by those of its reset: the first decision of every episode but the very first is made blind. The state is right,
#   so that the second observation is.
# Source: jaxmarl/wrappers/baselines.py, `CTRolloutManager.wrapped_step`.
# Output seen:
#   jaxmarl 0.2.0, an episode of 4 steps
#     largest number in the first observation of the first episode: 1.766
#     in that of the second one: 0.000; in what its state shows: 1.853
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/reset.py" <<'PYTHON'
import sys
from importlib.metadata import version

import jax
import jaxmarl
import numpy as np
from jaxmarl.wrappers.baselines import CTRolloutManager

env = jaxmarl.make("MPE_simple_spread_v3", max_steps=3)
manager = CTRolloutManager(env, batch_size=2)
obs, state = manager.batch_reset(jax.random.key(0))
seen = [obs]
for number in range(6):
    keys = jax.random.split(jax.random.key(number), len(env.agents))
    actions = {agent: manager.batch_sample(key, agent) for key, agent in zip(keys, env.agents)}
    obs, state, _, dones, _ = manager.batch_step(jax.random.key(number), state, actions)
    seen.append(obs)
    if dones["__all__"].all():
        break
_, after = number, jax.vmap(env.get_obs)(getattr(state, "env_state", state))
first = np.stack([obs[agent] for agent in env.agents])
true = np.stack([after[agent] for agent in env.agents])
begun = np.stack([seen[0][agent] for agent in env.agents])
print(f"jaxmarl {version('jaxmarl')}, an episode of {number + 1} steps")
print(f"  largest number in the first observation of the first episode: {abs(begun).max():.3f}")
print(f"  in that of the second one: {abs(first).max():.3f}; in what its state shows: {abs(true).max():.3f}")
sys.exit(not (abs(begun).max() > 0.1 and abs(first).max() == 0.0 and abs(true).max() > 0.1))
PYTHON
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check "jaxmarl==0.2.0" "jax==0.10.2" "flax==0.12.8" "gymnax==1.0.1" six
"$folder/venv/bin/python" "$folder/reset.py"
