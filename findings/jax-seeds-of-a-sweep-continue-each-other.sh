#!/usr/bin/env bash
# jax 0.10.2: the first learner of `split(key, n)` replays the run of `key` itself, and `fold_in(key, i)` is `split(key, n)[i]`
#
# One would expect: who runs a learner on `key`, and later n learners on `split(key, n)`, has n + 1 runs with random numbers
# of their own, as with jax 0.4. Likewise `split(key, n)` for n environments and `fold_in(key, step)` for steps give streams
# that share nothing, since the number of keys and the way of making them differ.
# What happens: since 0.5 the key at index i depends on the key and i alone, however many are made, and fold_in makes the
# same ones. A loop that goes on with the first key of each split (`key, use = split(key)`, as PureJaxRL's does) passes through
# `split(key, 2)[0]`, which is `split(key, n)[0]`. So learner 0 of the sweep draws in update u what the single run draws in
# u + 1: the same resets, the same exploration. A loop that splits into three and goes on with the last collides with learner
# 2. And the noise of environment i at the reset is that of all of them at step i, with correlation 1. Nothing warns. A
# name in between, `split(fold_in(key, 2**31), n)`, keeps the streams apart.
# Source: https://github.com/jax-ml/jax/pull/13341 makes fold_in and split alike under the flag jax_threefry_partitionable,
# https://github.com/jax-ml/jax/discussions/18480 announces it as the default.
#
# Output seen:
# jax 0.4.38: draws that learner 0 of 4 shares with the single run, of 6 updates: 0; fold_in is split: False; equal noise: 0 of 8
# jax 0.10.2: draws that learner 0 of 4 shares with the single run, of 6 updates: 5; fold_in is split: True; equal noise: 8 of 8
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python=$(for name in python3.12 python3.11 python3; do
    "$name" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 13))' 2> /dev/null && echo "$name" && break
done) # jax 0.4.38 has no wheels of jaxlib for later ones
cat > show.py <<'PYTHON'
import jax
import numpy as np


def data(key):
    return np.asarray(jax.random.key_data(key))


def draws(key, updates):
    """What a learner draws in each update: its loop goes on with the first key of each split."""
    drawn = []
    for _ in range(updates):
        key, use = jax.random.split(key)
        drawn.append(tuple(np.asarray(jax.random.normal(use, (4,))).tolist()))
    return drawn


root = jax.random.key(7)
alone, first = draws(root, 6), draws(jax.random.split(root, 4)[0], 6)
shared = len({*alone} & {*first})
folded = all((data(jax.random.fold_in(root, i)) == data(jax.random.split(root, 8)[i])).all() for i in range(8))
at_reset = [float(jax.random.normal(key)) for key in jax.random.split(root, 8)]
at_step = [float(jax.random.normal(jax.random.fold_in(root, step))) for step in range(8)]
equal = sum(one == other for one, other in zip(at_reset, at_step))
print(
    f"jax {jax.__version__}: draws that learner 0 of 4 shares with the single run, of 6 updates: {shared}; "
    f"fold_in is split: {folded}; equal noise: {equal} of 8"
)
apart = draws(jax.random.split(jax.random.fold_in(root, 2**31), 4)[0], 6)
assert not {*alone} & {*apart}
before = jax.__version__ == "0.4.38"
assert (shared, folded, equal) == ((0, False, 0) if before else (5, True, 8))
PYTHON
for version in 0.4.38 0.10.2; do
    "$python" -m venv "$version"
    "$version/bin/pip" install --quiet "jax==$version" "jaxlib==$version" numpy==2.2.6
    JAX_PLATFORMS=cpu "$version/bin/python" show.py
done
