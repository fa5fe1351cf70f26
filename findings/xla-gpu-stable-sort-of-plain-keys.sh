#!/usr/bin/env bash
# jax 0.10.2 with jax-cuda12-plugin 0.10.2: on a GPU `jnp.sort` of plain whole numbers sorts pairs, twice the bytes
#
# One would expect: `jnp.sort(keys)` of one integer array sorts that array alone. The default `stable=True` cannot be
# seen there, since equal integers are alike, so that `stable=False` changes nothing.
# What happens: JAX lowers the sort with `is_stable=true`, and XLA for GPUs makes any stable sort stable by a second
# operand, the int32 indices 0, 1, 2, ..., by which it breaks ties. The kernel reads and writes pairs of 8 bytes for
# keys of 4. With `stable=False` the program has one operand. On a CPU both have one.
# Source: XLA, xla/hlo/transforms/expanders/stable_sort_expander (adds the iota operand), which the GPU pipeline runs;
# documentation: https://docs.jax.dev/en/latest/_autosummary/jax.numpy.sort.html ("stable: ... Default = True").
#
# No GPU is needed: the CUDA compiler compiles for a described H100, and nothing runs.
#
# Output seen:
# gpu stable=True: operands u32 s32
# gpu stable=False: operands u32
# cpu stable=True: operands u32
# cpu stable=False: operands u32
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
gpu = topologies.get_topology_desc("1x1x1", "cuda", target_config=H100, topology="1x1x1").devices[0]
keys = jax.ShapeDtypeStruct((4096, 208), jnp.uint32)
found = {}
for name, device in (("gpu", gpu), ("cpu", jax.devices("cpu")[0])):
    for stable in (True, False):
        sort = jax.jit(lambda x: jnp.sort(x, stable=stable), in_shardings=SingleDeviceSharding(device))
        options = {"xla_gpu_autotune_level": 0} if name == "gpu" else {}
        text = sort.lower(keys).compile(compiler_options=options).as_text()
        line = next(line for line in text.splitlines() if re.search(r"\bsort\(", line))
        shape = line.split("=", 1)[1].split(" sort(")[0]
        found[name, stable] = re.findall(r"(\w+)\[4096,208\]", shape)
        print(f"{name} stable={stable}: operands", *found[name, stable])
assert found["gpu", False] == found["cpu", True] == found["cpu", False] == ["u32"]
assert found["gpu", True] == ["u32", "s32"], "the behaviour has changed"
PYTHON
JAX_PLATFORMS=cpu TF_CPP_MIN_LOG_LEVEL=3 venv/bin/python show.py 2> errors || { cat errors; exit 1; }
