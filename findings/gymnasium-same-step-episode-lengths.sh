#!/usr/bin/env bash
# Gymnasium 1.3.0: vector.RecordEpisodeStatistics loses the first step of every later episode under SAME_STEP autoreset.
#
# Expected: a vector environment may say in its metadata that it resets in the same step (AutoresetMode.SAME_STEP, one
#   of the three modes of Gymnasium's own SyncVectorEnv), and Gymnasium's own wrapper counts its episodes right.
# What happens: the wrapper leaves out the step after an end, which is the reset of NEXT_STEP environments only. Under
#   SAME_STEP that step is the next episode's first one: episodes of five steps are counted as 5, 4, 4, and their
#   returns lack a reward. Nothing warns. From 1.4.0 on lengths are 5, 5, 5; gymnax 1.0.1 asks for gymnasium<1.4,
#   so that the mend cannot be installed beside it.
# Source: gymnasium/wrappers/vector/common.py, `RecordEpisodeStatistics.step` (`prev_dones`) in both versions.
# Output seen:
#   gymnasium 1.3.0: lengths of three episodes of five steps: [5, 4, 4]
#   gymnasium 1.4.0: lengths of three episodes of five steps: [5, 5, 5]
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/count.py" <<'PYTHON'
import sys

import gymnasium
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TimeLimit
from gymnasium.wrappers.vector import RecordEpisodeStatistics


class Still(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
    action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observation_space.sample() * 0, {}

    def step(self, action):
        return self.observation_space.sample() * 0, 1.0, False, False, {}


envs = SyncVectorEnv([lambda: TimeLimit(Still(), 5)], autoreset_mode=AutoresetMode.SAME_STEP)
envs = RecordEpisodeStatistics(envs)
envs.reset(seed=0)
lengths = []
while len(lengths) < 3:
    *_, infos = envs.step(envs.action_space.sample())
    if "episode" in infos:
        lengths.append(int(infos["episode"]["l"][0]))
    elif "final_info" in infos and "episode" in infos["final_info"]:
        lengths.append(int(infos["final_info"]["episode"]["l"][0]))
print(f"gymnasium {gymnasium.__version__}: lengths of three episodes of five steps: {lengths}")
sys.exit(lengths != [int(word) for word in sys.argv[1].split(",")])
PYTHON
for case in 1.3.0=5,4,4 1.4.0=5,5,5; do
  python3 -m venv "$folder/${case%=*}"
  "$folder/${case%=*}/bin/pip" install --quiet --disable-pip-version-check "gymnasium==${case%=*}" "numpy==2.3.4"
  "$folder/${case%=*}/bin/python" "$folder/count.py" "${case#*=}"
done
