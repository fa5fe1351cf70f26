"""Distributes environments over devices; on a CPU, over its cores, each of which works block by block.

With one CPU device for all cores, XLA splits each operation among the cores and waits for all of them, hundreds of
times per decision. With one device per core, each core runs its own environments from end to end.
"""

import contextlib
import inspect
import os
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import numpy as np
from jax.sharding import AxisType, Mesh, PartitionSpec

from medjax.errors import InputError, shown
from medjax.numerics.rows import in_blocks

Result = TypeVar("Result")

AXIS = "environments"

# Unrolled loops run no faster here and take a quarter longer to compile.
CPU_OPTIONS = "xla_cpu_disable_loop_unrolling"


def cpu_cores() -> int:
    """Cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def prepare_cpu() -> None:
    """Makes every core that this process may use a CPU device of JAX, and speeds up compilation.

    Call it before JAX computes anything; later it has no effect. It never overrides the user's own settings.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    chosen = getattr(jax.config, "jax_num_cpu_devices", -1) != -1
    if not chosen and "xla_force_host_platform_device_count" not in flags:
        with contextlib.suppress(RuntimeError):  # JAX has already started
            jax.config.update("jax_num_cpu_devices", cpu_cores())
    if "xla_backend_extra_options" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_backend_extra_options={CPU_OPTIONS}".strip()


def environment_mesh(
    num_envs: int, num_devices: int = 0, devices: Sequence[jax.Device] | None = None
) -> Mesh:
    """A mesh of devices for an equal share of `num_envs` environments each.

    Args:
        num_envs: environments, or groups of them that must stay together.
        num_devices: how many; 0 takes the most that divide num_envs.
        devices: to choose from, equally many of each process; None: those of this process.

    Raises:
        InputError: no whole number, more devices than there are, or a number that does not divide num_envs.
    """
    for name, value in (("num_envs", num_envs), ("num_devices", num_devices)):
        if not isinstance(value, int | np.integer):
            raise InputError(f"{name} is {shown(value)}, allowed: a whole number")
    if num_envs < 1:
        raise InputError(f"num_envs is {num_envs}, allowed: at least 1")
    by_process: dict[int, list[jax.Device]] = {}
    for device in jax.local_devices() if devices is None else devices:
        by_process.setdefault(device.process_index, []).append(device)
    processes, most = len(by_process), sum(map(len, by_process.values()))
    if not num_devices:
        even = range(processes, most + 1, processes)
        num_devices = max((n for n in even if num_envs % n == 0), default=processes)
    if not 1 <= num_devices <= most:
        raise InputError(f"num_devices is {num_devices}, allowed: 0 to {most}")
    if num_envs % num_devices or num_devices % processes:
        also = f" and a multiple of {processes} processes" if processes > 1 else ""
        raise InputError(f"num_devices is {num_devices}, allowed: a divisor of {num_envs}{also}")
    each = num_devices // processes
    chosen = [device for group in by_process.values() for device in group[:each]]
    return jax.make_mesh((num_devices,), (AXIS,), devices=chosen, axis_types=(AxisType.Auto,))


def on_devices(
    mesh: Mesh,
    function: Callable[[Any, Any], Result],
    rows_at_once: int = 0,
    out_axes: Any = 0,
    group: int = 1,
) -> Callable[[Any, Any], Result]:
    """`function(rows, same)` with the rows distributed over the devices of the mesh.

    Pass a whole rollout: its environments stay in a core's cache, and no device waits for another before the end.

    Args:
        mesh: from `environment_mesh`.
        function: works on any number of independent rows, with results that do not depend on their number. The first
            axis of every leaf of `rows` is that of the rows; `same` is common to all.
        rows_at_once, out_axes, group: see `in_blocks`; each device must get whole groups.

    Raises:
        InputError: the function does not take two arguments.
    """
    try:
        inspect.signature(function).bind(None, None)
    except TypeError:
        raise InputError(f"function = {shown(function)}: allowed function(rows, same)") from None

    def share(rows: Any, same: Any) -> Result:
        return in_blocks(lambda block: function(block, same), rows, rows_at_once, out_axes, group)

    split, whole = PartitionSpec(AXIS), PartitionSpec()
    joined = jax.tree.map(lambda axis: PartitionSpec(*[None] * axis, AXIS), out_axes)
    return jax.shard_map(
        share, mesh=mesh, in_specs=(split, whole), out_specs=joined, check_vma=False
    )
