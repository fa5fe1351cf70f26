"""Coordinates several processes, on one machine or many, that train one learner over JAX's distributed runtime.

Every process runs the same program with the same settings and holds a share of the environments. Only the first one
writes and reports. With a single process there is nothing to coordinate.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import numpy as np
from jax.experimental import multihost_utils

from medjax.commandline import leave_at_once
from medjax.errors import InputError
from train.runs.arguments import AUTO, Processes

Result = TypeVar("Result")

PATIENCE_S = 7 * 86400  # the others wait for the first, which evaluates


def join(processes: Processes) -> None:
    """Waits for the other processes, before JAX computes anything; InputError if they or the scheduler are missing."""
    if processes.coordinator is None:
        return
    address = None if processes.coordinator == AUTO else processes.coordinator
    try:
        jax.distributed.initialize(
            address, processes.number, processes.index, shutdown_timeout_seconds=PATIENCE_S
        )
    except (RuntimeError, ValueError) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(f"coordinator is {processes.coordinator}: {reason}") from None


def leave(code: int) -> int:
    """Ends this process at once if there are others, which notice and end as well; otherwise returns `code`."""
    if jax.process_count() > 1:
        leave_at_once(code)
    return code


def together(action: Callable[[], Result]) -> Result:
    """The result of `action` if it succeeded in every process; InputError if any process refused it."""
    problem = None
    try:
        result = action()
    except InputError as error:
        problem = error
    failed = agree(problem is not None)[:, 0]
    if problem is not None:
        raise problem
    if failed.any():
        raise InputError(f"process {int(np.argmax(failed))} of {failed.size} refused, see there")
    return result


def is_first() -> bool:
    """Whether this process writes and reports."""
    return jax.process_index() == 0


def agree(*numbers: int) -> np.ndarray:
    """The numbers of every process, `(num_processes, len(numbers))` int32; all processes must call this.

    They stay in step only if they decide alike, but each has its own clock, signals and disk.
    """
    said = np.asarray(numbers, np.int32)
    if jax.process_count() == 1:
        return said[None]
    return np.asarray(multihost_utils.process_allgather(said))


def fetch(tree: Any) -> Any:
    """The arrays as NumPy, including the parts of other processes; all processes must call this."""

    def whole(leaf: Any) -> np.ndarray:
        if leaf.is_fully_addressable or leaf.is_fully_replicated:
            return np.asarray(leaf)
        return np.asarray(multihost_utils.process_allgather(leaf, tiled=True))

    return jax.tree.map(whole, tree)
