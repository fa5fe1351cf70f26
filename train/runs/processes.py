"""Several processes, on one machine or many, that train one learner: JAX's distributed runtime, and what they agree on.

Every process runs the same program on the same settings and holds a share of the environments. The first one alone
writes and reports. With one process all of this is nothing.
"""

import os
import sys
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import numpy as np
from jax.experimental import multihost_utils

from medjax.errors import InputError
from train.runs.arguments import AUTO, Processes

Result = TypeVar("Result")

PATIENCE_S = 7 * 86400  # the others wait while the first evaluates


def join(processes: Processes) -> None:
    """Waits for the others, before JAX computes anything; InputError if they or the scheduler cannot be found."""
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
    """Ends this process at once if there are others, who notice and end as well; else just returns `code`."""
    if jax.process_count() > 1:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code


def together(action: Callable[[], Result]) -> Result:
    """What `action` gives, if it went well in every process; InputError if it was refused here, or in another."""
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
    """What every process says, `(num_processes, len(numbers))` int32; all of them must ask.

    They take the same steps only if they decide alike, and clocks, signals and disks are their own.
    """
    said = np.asarray(numbers, np.int32)
    if jax.process_count() == 1:
        return said[None]
    return np.asarray(multihost_utils.process_allgather(said))


def fetch(tree: Any) -> Any:
    """The arrays as NumPy, with the parts that other processes hold; all of them must ask."""

    def whole(leaf: Any) -> np.ndarray:
        if leaf.is_fully_addressable or leaf.is_fully_replicated:
            return np.asarray(leaf)
        return np.asarray(multihost_utils.process_allgather(leaf, tiled=True))

    return jax.tree.map(whole, tree)
