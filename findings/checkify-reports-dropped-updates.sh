#!/usr/bin/env bash
# jax 0.10.2: checkify's index checks report updates that mode="drop" drops as intended
#
# One would expect: with `x.at[i].set(v, mode="drop")` an index beyond the end is asked for and well defined (the
# documentation of `jax.numpy.ndarray.at`: "out-of-bound updates will be discarded"), so that `checkify.index_checks`,
# which looks for indexing by mistake, lets it pass.
# What happens: the check of a scatter does not look at its mode; it reports "out-of-bounds indexing". The same holds
# for a read with mode="fill" and an index beyond the end, which gives the fill value. The values are right.
# Source: jax/_src/checkify.py, `scatter_error_check` and `gather_error_check`; documentation:
# https://docs.jax.dev/en/latest/_autosummary/jax.numpy.ndarray.at.html
#
# Output seen:
# set drop: [1. 0. 0.] out-of-bounds indexing for array of shape (3,)
# get fill: 7.0 out-of-bounds indexing for array of shape (3,)
# in bounds: [1. 0. 0.] None
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install -q jax==0.10.2
cat > show.py <<'PYTHON'
import jax.numpy as jnp
from jax.experimental import checkify


def checked(function, *given):
    error, value = checkify.checkify(function, errors=checkify.index_checks)(*given)
    said = error.get()
    return value, said and said.split(":")[0]


zeros, places = jnp.zeros(3), jnp.array([0, 3])
value, drop = checked(lambda x, i: x.at[i].set(1.0, mode="drop"), zeros, places)
print("set drop:", value, drop)
assert value.tolist() == [1.0, 0.0, 0.0]
value, fill = checked(lambda x, i: x.at[i].get(mode="fill", fill_value=7.0), zeros, jnp.array(3))
print("get fill:", value, fill)
assert value == 7.0
value, inside = checked(lambda x, i: x.at[i].set(1.0, mode="drop"), zeros, jnp.array([0]))
print("in bounds:", value, inside)
assert inside is None
assert drop and fill, "the behaviour has changed"
PYTHON
JAX_PLATFORMS=cpu venv/bin/python show.py
