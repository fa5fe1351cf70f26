#!/usr/bin/env bash
# jax 0.10.2 (jaxlib 0.10.2), CPU: optimization_barrier does not keep XLA from computing a value once for each reader
#
# One would expect: `lax.optimization_barrier` around a value that several readers need makes XLA compute it once, as its
# documentation says that the barrier stops optimisation across it; and a read by index, `value[index]`, reads a value
# that is already there.
# What happens: XLA for CPUs removes barriers before it fuses. A chain of eight products with three readers is computed in
# each of them, 24 products with and without the barrier, and the read by index computes the whole chain entry by entry,
# in a loop that is not vectorised. A conditional whose branch is always taken does stop it: fusion does not cross the end
# of a branch. In a traffic simulator a few such conditionals made every step a tenth faster.
# Source: xla/service/cpu/cpu_compiler.cc (OptimizationBarrierExpander among the passes); the counts below.
#
# Output seen:
# as written:   24 products, read by index computes 8 of them
# barrier:      24 products, read by index computes 8 of them
# branch:       8 products, read by index computes 0 of them
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install -q jax==0.10.2 jaxlib==0.10.2
cat > count.py <<'PYTHON'
import re

import jax
import jax.numpy as jnp


def branch(value, index):
    return jax.lax.cond(index[0] >= 0, lambda v: v, jnp.zeros_like, value)


WAYS = {
    "as written": lambda value, index: value,
    "barrier": lambda value, index: jax.lax.optimization_barrier(value),
    "branch": branch,
}


def run(x, index, settle):
    value = x
    for _ in range(8):
        value = value * x - 0.3
    value = settle(value, index)
    return value[index], value[::-1] + 1.0, value.reshape(64, 64).T - 2.0


x, index = jnp.linspace(0.0, 1.0, 4096), jnp.arange(4096, dtype=jnp.int32)
for name, settle in WAYS.items():
    text = jax.jit(run, static_argnums=2).lower(x, index, settle).compile().as_text()
    bodies = re.split(r"\n\n", text)
    reads = [body for body in bodies if " gather(" in body]
    products, inside = text.count(" multiply("), sum(body.count(" multiply(") for body in reads)
    print(f"{name + ':':<13} {products} products, read by index computes {inside} of them")
PYTHON
JAX_PLATFORMS=cpu venv/bin/python count.py | tee seen.txt
diff seen.txt - <<'SEEN'
as written:   24 products, read by index computes 8 of them
barrier:      24 products, read by index computes 8 of them
branch:       8 products, read by index computes 0 of them
SEEN
