#!/usr/bin/env bash
# jax 0.10.2 (jaxlib 0.10.2), CPU: XLA runs one loop for each output, and the option that joins them is not a flag
#
# One would expect: a jitted function whose outputs share most of their work (a car's acceleration, and the position and
# speed that follow from it) becomes one loop that writes all of them, as on a GPU, where XLA's multi-output fusion is
# part of the usual pipeline; and if not, that a flag of XLA switches it on.
# What happens: on a CPU each output has a fusion of its own. They read the inputs anew and repeat what is cheap. The
# pass exists, but no flag of `XLA_FLAGS` has its name, and `jax.jit(compiler_options=...)` raises "No such compile
# option". It is one of XLA's extra options, free text that is not checked:
# `XLA_FLAGS=--xla_backend_extra_options=xla_cpu_use_multi_output_fusion`. Results keep their bits here.
# Source: xla/service/cpu/cpu_options.cc (names of the extra options), xla/service/cpu/cpu_compiler.cc (the pass).
#
# Output seen:
# default:       4 fusions, 0 of several outputs
# extra option:  2 fusions, 1 of several outputs
# as a compile option: INVALID_ARGUMENT: No such compile option: 'xla_cpu_use_multi_output_fusion'
# same bits: True
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install -q jax==0.10.2 jaxlib==0.10.2
cat > show.py <<'PYTHON'
import sys

import jax
import jax.numpy as jnp
import numpy as np


def drive(x, v, gap):
    a = jnp.clip(1.4 * (1 - (v / 33.0) ** 4 - ((2 + 1.2 * v) / gap) ** 2), -9.0, 2.0)
    return x + 0.25 * v + 0.03125 * a, jnp.maximum(v + 0.25 * a, 0.0), a


x, v, gap = (1.0 + 30.0 * jax.random.uniform(key, (200_000,)) for key in jax.random.split(jax.random.key(0), 3))
lowered = jax.jit(drive).lower(x, v, gap)
program = lowered.compile()
entry = program.as_text().split("ENTRY")[1].splitlines()
fusions = [line for line in entry if " fusion(" in line]
several = [line for line in fusions if line.split("=")[1].strip().startswith("(")]
print(len(fusions), "fusions,", len(several), "of several outputs")
np.savez(sys.argv[1], *program(x, v, gap))
if "refused" in sys.argv:
    try:
        lowered.compile(compiler_options={"xla_cpu_use_multi_output_fusion": True})
    except Exception as error:
        print(str(error).splitlines()[0], file=sys.stderr)
PYTHON
export JAX_PLATFORMS=cpu
plain=$(venv/bin/python show.py plain.npz refused 2> refused.txt)
joined=$(XLA_FLAGS=--xla_backend_extra_options=xla_cpu_use_multi_output_fusion venv/bin/python show.py joined.npz)
refused=$(tail -1 refused.txt)
same=$(venv/bin/python -c "
import numpy as np
a, b = np.load('plain.npz'), np.load('joined.npz')
print(all((a[name] == b[name]).all() for name in a))")
echo "default:       $plain"
echo "extra option:  $joined"
echo "as a compile option: $refused"
echo "same bits: $same"
[[ $plain == *" 0 of several outputs" && $joined == *" 1 of several outputs" && $refused == *"No such compile option"* ]] ||
  { echo "the behaviour has changed"; exit 1; }
