#!/bin/bash
# HighJax 0.1.0: halving the sub-step halves how far everybody drives in a second; the clock does not notice.
#
# Library: highjax 0.1.0 (PyPI), EnvParams.seconds_per_sub_t and EnvParams.seconds_per_t, with jax 0.10.2.
# Expected: both are among the parameters that may be tuned without compiling anew. `seconds_per_sub_t`, 1/15 s, is the
#   resolution of the physics: half of it should give the same drive, computed more finely. `seconds_per_t`, 1 s, is the
#   time of a decision: with 2 s a car at 25 m/s should drive 50 m.
# What happens: a decision always has 15 sub-steps (HighJaxEnv.n_sub_ts_per_t, set at construction). Half the sub-step is
#   half a second of physics in a decision, while the clock, the limit of the episode and the reward count a second; with
#   decisions of 2 s the clock counts two seconds in which one is driven. No error, no warning.
# Source: highjax/envs/highway_env.py (EnvParams, __init__, step_env) and highjax/stepper.py (the loop of sub-steps).
# Output seen:
#   as it comes: the clock counts 1.0 s, a car at 25 m/s drives 25.0 m
#   seconds_per_sub_t=1/30: the clock counts 1.0 s, a car at 25 m/s drives 12.5 m
#   seconds_per_t=2: the clock counts 2.0 s, a car at 25 m/s drives 25.0 m
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"

python3 -m venv env
env/bin/pip install -q --disable-pip-version-check "jax==0.10.2" "flax==0.12.7" "gymnasium==1.3.0"
# Its metadata ask for Python 3.14; the simulator itself runs on earlier ones.
env/bin/pip install -q --disable-pip-version-check --no-deps --ignore-requires-python "highjax==0.1.0"

cat > drive.py <<'PY'
import highjax
import jax
from highjax import kinematics

IDLE = 1
env, params = highjax.make("highjax-v0")
found = []
for name, change in (
    ("as it comes", {}),
    ("seconds_per_sub_t=1/30", {"seconds_per_sub_t": 1 / 30}),
    ("seconds_per_t=2", {"seconds_per_t": 2.0}),
):
    changed = params.replace(**change)
    _, before = env.reset(jax.random.key(0), changed)
    _, after, *_ = env.step_env(jax.random.key(1), before, IDLE, changed)
    clock = float(after.time - before.time)
    metres = float(after.ego_state[kinematics.X] - before.ego_state[kinematics.X])
    speed = float(before.ego_state[kinematics.SPEED])
    print(f"{name}: the clock counts {clock:.1f} s, a car at {speed:.0f} m/s drives {metres:.1f} m")
    found.append((round(clock, 1), round(metres, 1)))
assert found == [(1.0, 25.0), (1.0, 12.5), (2.0, 25.0)]
PY
env/bin/python drive.py
