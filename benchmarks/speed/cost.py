"""`python -m benchmarks.cost`: launches and bytes of one decision by stage, counted in the compiled program.

Nothing runs, so the figures are the same on an idle and on a busy machine. The program is one step of a batch with
auto-reset. `--target h100` compiles it for an NVIDIA H100 that need not be there, with the compiler that
`pip install -c constraints.txt -e ".[cost]"` brings.

Bytes are the inputs and outputs of every launch, which device memory moves if no cache helps. On a CPU a launch is an
executed instruction of the program's top level, such as a fusion, a sort or a copy. The stages whose instructions a
launch fuses share it: an input's bytes go in equal parts to the stages that read it, an output's to the stage that
computes it, and the launch itself goes as its bytes do.
"""

import argparse
import importlib.metadata
import time
from typing import Any
from unittest import mock

import jax
import jax.numpy as jnp
from jax.experimental import topologies
from jax.sharding import SingleDeviceSharding

import medjax
from benchmarks.command import add_scenario, benchmark_parser, positive, run_command
from benchmarks.speed.hlo import Program
from benchmarks.speed.launches import Cost, cost_of, loops_of
from benchmarks.speed.stages import stage_of
from medjax.errors import InputError
from medjax.numerics.rows import CACHED_ROWS
from medjax.wrappers import BatchAutoReset

DEFAULT_ENVS = {"cpu": CACHED_ROWS, "h100": 65_536}
H100_BYTES_PER_S = 3.35e12  # NVIDIA's data sheet, SXM

# What the compiler asks about a device, from CUDA's properties of an H100 SXM; XLA's own file of them is
# xla/backends/gpu/target_config/specs/h100_sxm.txtpb.
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
PLUGINS = ("jax-cuda12-plugin", "jax-cuda12-pjrt")
OPTIONS: dict[str, dict[str, Any]] = {
    # The code that LLVM makes of the instructions is not looked at; quick code takes half as long.
    "cpu": {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True},
    # Autotuning runs candidates on the device, and there is none.
    "h100": {"xla_gpu_autotune_level": 0, "xla_gpu_shard_autotuning": False},
}


def check_plugins() -> None:
    """Checks that JAX's compiler for CUDA is installed.

    Raises:
      InputError: it is not, or its version is not that of JAX.
    """
    for name in PLUGINS:
        try:
            found = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found = "not installed"
        if found != jax.__version__:
            install = 'pip install -c constraints.txt -e ".[cost]"'
            raise InputError(
                f"--target h100: {name} is {found}, allowed {jax.__version__}: {install}"
            )


def device_of(target: str) -> jax.Device:
    """The CPU, or a described H100 that can only be compiled for."""
    if target == "cpu":
        return jax.devices("cpu")[0]
    one = "1x1x1"
    found = topologies.get_topology_desc(one, "cuda", target_config=H100, topology=one)
    return found.devices[0]


def compile_decision(target: str, scenario: str, num_envs: int) -> tuple[Program, int]:
    """Compiles a step of `num_envs` environments of a preset; returns the program and the ticks of a decision."""
    env, params = medjax.make(scenario)
    batch = BatchAutoReset(env)
    keys = jax.eval_shape(lambda: jax.random.split(jax.random.key(0), num_envs))
    state = jax.eval_shape(batch.reset, keys, params)[1]
    actions = jax.ShapeDtypeStruct((num_envs,), jnp.int32)

    def decide(keys: jax.Array, state: Any, actions: jax.Array, params: Any) -> tuple[Any, ...]:
        """All results that a learner or an evaluation uses; XLA drops the others."""
        obs, state, reward, terminated, truncated, info = batch.step(keys, state, actions, params)
        used = info["metrics"], info["reward_terms"]
        return obs, state, reward, terminated, truncated, *used

    step = jax.jit(decide, in_shardings=SingleDeviceSharding(device_of(target)), donate_argnums=1)
    backend = "cpu" if target == "cpu" else "gpu"
    # medjax asks for the backend where a CPU and a GPU want different code.
    with mock.patch.object(jax, "default_backend", return_value=backend):
        lowered = step.lower(keys, state, actions, jax.eval_shape(lambda: params))
    text = lowered.compile(compiler_options=OPTIONS[target]).as_text()
    return Program(text or ""), env.config.ticks_per_decision


def parts_of(program: Program, ticks: int) -> dict[str, tuple[int, Cost]]:
    """Cost of a tick and of what is around the ticks, each with how often a decision has it.

    Args:
      program: of a decision.
      ticks: of a decision. The dearest loop that goes round as often is that of the ticks; XLA leaves no loop of a
        single tick, so that all is around.
    """
    loops = loops_of(program, program.entry)
    bodies = [loop.called[-1] for loop, times in loops if times == ticks]
    if not bodies:
        return {"around the ticks": (1, cost_of(program, program.entry))}
    tick = max(bodies, key=lambda name: cost_of(program, name).total_bytes)
    return {
        "a tick": (ticks, cost_of(program, tick)),
        "around the ticks": (1, cost_of(program, program.entry, without=tick)),
    }


def describe(cost: Cost) -> dict[str, Any]:
    """A cost as JSON; the dearest stages first."""
    dearest_first = sorted(cost.bytes, key=lambda stage: -cost.bytes[stage])
    stages = {
        stage: {"launches": cost.launches[stage], "bytes": cost.bytes[stage]}
        for stage in dearest_first
    }
    return {"launches": cost.total_launches, "bytes": cost.total_bytes, "stages": stages}


def count_costs(target: str, scenario: str, num_envs: int) -> dict[str, Any]:
    """Compiles a decision and counts.

    Returns:
      What `--json` writes. `parts`: of the tick and of what is around the ticks, `times` a decision, launches, bytes,
      and these by stage. Launches and bytes of a decision leave out the loops of the stages in `left_out`, whose rounds
      depend on the data. For an H100 also `least_s`, the seconds that its memory needs for the bytes.
    """
    start = time.perf_counter()
    program, ticks = compile_decision(target, scenario, num_envs)
    compile_s = time.perf_counter() - start
    parts, total = parts_of(program, ticks), Cost()
    for times, cost in parts.values():
        total.add(cost, times)
    loops = loops_of(program, program.entry)
    return {
        "scenario": scenario,
        "num_envs": num_envs,
        "jax_version": jax.__version__,
        "target": target,
        "compile_s": compile_s,
        "parts": {part: {"times": times} | describe(cost) for part, (times, cost) in parts.items()},
        "launches": total.total_launches,
        "bytes": total.total_bytes,
        "left_out": sorted({stage_of(loop.op_name) for loop, times in loops if not times}),
        **({"least_s": total.total_bytes / H100_BYTES_PER_S} if target == "h100" else {}),
    }


def table(part: str, cost: dict[str, Any]) -> list[str]:
    """Lines of a part's table."""
    often = "once" if cost["times"] == 1 else f"{cost['times']} times"
    lines = [f"{part}, {often} a decision", f"{'stage':15}{'launches':>10}{'MB':>14}{'share':>9}"]
    for stage, its in [*cost["stages"].items(), ("sum", cost)]:
        share = 100 * its["bytes"] / max(cost["bytes"], 1)
        counts = f"{its['launches']:10,.1f}{its['bytes'] / 1e6:14,.2f}{share:7.1f} %"
        lines.append(f"{stage:15}{counts}")
    return lines


def report(result: dict[str, Any]) -> str:
    """Formats the tables."""
    lines = [
        f"{result['num_envs']:,} environments of {result['scenario']}, JAX {result['jax_version']}, "
        f"for {result['target']}, compiled in {result['compile_s']:.0f} s"
    ]
    for part, cost in result["parts"].items():
        lines += ["", *table(part, cost)]
    sums = f"a decision: {result['launches']:,} launches, {result['bytes'] / 1e6:,.1f} MB"
    if "least_s" in result:
        sums += f", at least {1e3 * result['least_s']:.3g} ms at {H100_BYTES_PER_S / 1e12:g} TB/s"
    lines += ["", sums]
    if result["left_out"]:
        stages = ", ".join(result["left_out"])
        lines.append(f"not counted: loops of {stages}, whose rounds depend on the data")
    if result["target"] == "cpu":
        lines.append("a launch on a CPU: an executed instruction of the program's top level")
    return "\n".join(lines)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Counts and prints.

    Raises:
      InputError: the compiler for the target is not installed.
    """
    if options.target == "h100":
        check_plugins()
    # Otherwise JAX looks for a GPU where its plugin is installed, and complains if there is none.
    jax.config.update("jax_platforms", "cpu")
    # A program that is kept with JAX_COMPILATION_CACHE_DIR would show the stages of the tree that compiled it.
    jax.config.update("jax_compilation_cache_include_metadata_in_key", True)
    num_envs = options.num_envs or DEFAULT_ENVS[options.target]
    result = count_costs(options.target, options.scenario, num_envs)
    print(report(result))
    return result


def main(arguments: list[str] | None = None) -> None:
    parser = benchmark_parser("cost", __doc__)
    text = "what to compile for (default: cpu)"
    parser.add_argument("--target", choices=tuple(DEFAULT_ENVS), default="cpu", help=text)
    usual = ", ".join(f"{count:,} on {target}" for target, count in DEFAULT_ENVS.items())
    text = f"environments side by side (default: {usual})"
    parser.add_argument("--num-envs", type=positive, metavar="N", help=text)
    add_scenario(parser)
    run_command(parser, measure, arguments)
