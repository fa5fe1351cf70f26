#!/usr/bin/env bash
# jax 0.10.2 with jax-cuda12-plugin 0.10.2: on a GPU a scan computes anew in every pass what no pass changes
#
# One would expect: what depends on nothing that a `lax.scan` carries is computed once, before the loop. XLA has a pass
# for it, WhileLoopInvariantCodeMotion, and on a CPU the loop's body has no exponential or sine left.
# What happens: the CPU's compiler runs that pass, and the GPU's does not. There the body of the loop computes both for
# all elements in each of its hundred passes. Computed before the scan by hand, they are an array that the body reads.
# So on a GPU it is worth knowing which is dearer: arithmetic stays in the loop, memory traffic is what one adds.
# Source: XLA, xla/service/cpu/cpu_compiler.cc adds WhileLoopInvariantCodeMotion to its simplifications;
# xla/service/gpu/gpu_compiler.cc does not. JAX documents no difference: https://docs.jax.dev/en/latest/_autosummary/jax.lax.scan.html
#
# No GPU is needed: the CUDA compiler compiles for a described H100, and nothing runs.
#
# Output seen:
# cpu, inside the scan: the loop's body has 0 exponentials and 0 sines
# gpu, inside the scan: the loop's body has 1 exponentials and 1 sines
# gpu, before the scan: the loop's body has 0 exponentials and 0 sines
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install -q jax==0.10.2 jax-cuda12-plugin==0.10.2 jax-cuda12-pjrt==0.10.2
cat > show.py <<'PYTHON'
import re

import jax
import jax.numpy as jnp
from jax.experimental import topologies
from jax.sharding import SingleDeviceSharding

H100 = """
gpu_device_info {
  cuda_compute_capability { major: 9 }
  core_count: 132 fpus_per_core: 128 clock_rate_ghz: 1.98
  threads_per_warp: 32 threads_per_block_limit: 1024 threads_per_core_limit: 2048
  block_dim_limit_x: 2147483647 block_dim_limit_y: 65535 block_dim_limit_z: 65535
  registers_per_block_limit: 65536 registers_per_core_limit: 65536
  shared_memory_per_block: 49152 shared_memory_per_block_optin: 232448 shared_memory_per_core: 233472
  l2_cache_size: 52428800 device_memory_size: 84942979072 memory_bandwidth: 3352320000000
}
platform_name: "CUDA" device_description_str: "NVIDIA H100 80GB HBM3"
dnn_version_info { major: 9 minor: 10 }
"""


def of(rate):
    return jnp.exp(jnp.sin(rate))


def step(x, factor):
    return x + jnp.roll(x, 1) * factor


def inside(x, rate):
    return jax.lax.scan(lambda x, _: (step(x, of(rate)), None), x, length=100)[0]


def before(x, rate):
    factor = of(rate)
    return jax.lax.scan(lambda x, _: (step(x, factor), None), x, length=100)[0]


def operations(text):
    """Names of the operations that a pass of the loop runs, those of fusions included."""
    lines, name = {}, None
    for line in text.splitlines():
        if head := re.match(r"(?:ENTRY )?%?([\w.\-]+) .*\{$", line):
            name = head[1]
        lines.setdefault(name, []).append(line)

    def walk(name):
        for line in lines[name]:
            if found := re.search(r"= \S+ ([\w\-]+)\(", line):
                yield found[1]
            for called in re.findall(r"(?:calls|to_apply)=%([\w.\-]+)", line):
                yield from walk(called)

    return list(walk(re.search(r"body=%([\w.\-]+)", text)[1]))


gpu = topologies.get_topology_desc("1x1x1", "cuda", target_config=H100, topology="1x1x1").devices[0]
cpu = jax.devices("cpu")[0]
array = jax.ShapeDtypeStruct((2**20,), jnp.float32)
found = []
for name, device, function in (("cpu", cpu, inside), ("gpu", gpu, inside), ("gpu", gpu, before)):
    step_of = jax.jit(function, in_shardings=SingleDeviceSharding(device))
    options = {"xla_gpu_autotune_level": 0} if name == "gpu" else {}
    names = operations(step_of.lower(array, array).compile(compiler_options=options).as_text())
    found.append((names.count("exponential"), names.count("sine")))
    counts = f"{found[-1][0]} exponentials and {found[-1][1]} sines"
    print(f"{name}, {function.__name__} the scan: the loop's body has {counts}")
assert found == [(0, 0), (1, 1), (0, 0)], "the behaviour has changed"
PYTHON
JAX_PLATFORMS=cpu TF_CPP_MIN_LOG_LEVEL=3 venv/bin/python show.py 2> errors || { cat errors; exit 1; }
