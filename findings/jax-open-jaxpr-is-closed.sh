#!/usr/bin/env bash
# jax 0.12.0.1: `ClosedJaxpr` is `Jaxpr`, so the "open" jaxpr keeps constants alive, and walkers count sub-programs twice
#
# One would expect: `jax.make_jaxpr(f)(x)` is a ClosedJaxpr with the constants that f captured, and its `.jaxpr` is the
# program alone. So who keeps only `.jaxpr`, e.g. as the key of a cache or to count operations, holds no arrays. A walker
# over equations asks of each parameter whether it is a ClosedJaxpr, then whether it is a Jaxpr, since it can only be one.
# What happens: both names in jax.extend.core are one class, and `.jaxpr` returns the object itself. A captured table stays
# in memory for as long as `.jaxpr` does. Both questions are answered by yes, so the walker descends twice into every
# sub-program and counts the body of a scan twice, 2**n times at depth n. Nothing warns. With 0.10.2 the table is freed and
# the count is right. A single question, or `elif`, is right with both.
# Source: jax/_src/core.py of 0.12.0.1, where ClosedJaxpr is another name of Jaxpr. The change log of the release,
# https://docs.jax.dev/en/latest/changelog.html, is the place to look for a reason.
#
# Output seen:
# jax 0.10.2: one class: False; a captured table outlives its program: False; equations of a scan in a scan: 7, by two questions 7
# jax 0.12.0.1: one class: True; a captured table outlives its program: True; equations of a scan in a scan: 7, by two questions 18
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
if command -v pyenv > /dev/null; then
    PYENV_VERSION=$(pyenv versions --bare | grep '^3\.1[23]\.' | tail -1)
    export PYENV_VERSION
fi
python=$(for name in python3.13 python3.12 python3; do
    "$name" -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2> /dev/null && echo "$name" && break
done) # jax 0.12 needs Python 3.12
cat > show.py <<'PYTHON'
import gc
import weakref

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Jaxpr


def equations(program, twice):
    """All equations, those of sub-programs included; `twice`: asks for each class, whatever the other answer was."""
    count = 0
    for equation in program.eqns:
        count += 1
        for value in equation.params.values():
            closed = isinstance(value, ClosedJaxpr)
            if closed:
                count += equations(value.jaxpr, twice)
            if isinstance(value, Jaxpr) and (twice or not closed):
                count += equations(value, twice)
    return count


def outlives():
    table = jnp.arange(1_000_000.0)
    closed = jax.make_jaxpr(lambda x: x + table)(1.0)
    program, captured = closed.jaxpr, weakref.ref(table)
    del closed, table
    gc.collect()
    return captured() is not None and len(program.eqns) > 0


def inner(x, y):
    return jax.lax.scan(lambda x, y: (jnp.sin(x) + y, None), x, jnp.stack([y, y]))[0], None


program = jax.make_jaxpr(lambda x: jax.lax.scan(inner, x, jnp.ones(3))[0])(1.0).jaxpr
print(
    f"jax {jax.__version__}: one class: {ClosedJaxpr is Jaxpr}; a captured table outlives its program: {outlives()}; "
    f"equations of a scan in a scan: {equations(program, False)}, by two questions {equations(program, True)}"
)
PYTHON
for version in 0.10.2 0.12.0.1; do
    "$python" -m venv "of-$version"
    "of-$version/bin/pip" install -q --disable-pip-version-check "jax==$version" "jaxlib==$version"
    JAX_PLATFORMS=cpu "of-$version/bin/python" show.py
done | tee seen
grep -q "^jax 0.10.2: one class: False; a captured table outlives its program: False; equations of a scan in a scan: 7, by two questions 7$" seen
grep -q "^jax 0.12.0.1: one class: True; a captured table outlives its program: True; equations of a scan in a scan: 7, by two questions 18$" seen
