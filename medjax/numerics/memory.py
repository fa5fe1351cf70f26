"""How much memory there is, and a refusal of what does not fit into it, before anything is compiled."""

import os
from pathlib import Path

import jax

from medjax.errors import InputError

GIGA = 1e9
LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def memory_bytes() -> int:
    """Memory of the devices that JAX computes on: their own, or of this machine what this process may have."""
    own = [(device.memory_stats() or {}).get("bytes_limit", 0) for device in jax.local_devices()]
    if jax.default_backend() != "cpu" and all(own):
        return sum(own)
    there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    texts = [Path(limit).read_text() for limit in LIMITS if Path(limit).exists()]
    return min([there, *(int(text) for text in texts if text.strip().isdecimal())])


def check_memory(what: str, needed_bytes: float, force: bool | None = None) -> None:
    """Refuses what takes more memory than there is.

    Args:
        what: takes it, with the numbers that it depends on.
        needed_bytes: about how much.
        force: leave it to the machine; None where a command has no `--force`.

    Raises:
        InputError: one line with what, how much it takes, and how much there is.
    """
    there = memory_bytes()
    if needed_bytes > there and not force:
        allowed = f"{there / GIGA:.3g} GB, all that there is" + ", or --force" * (force is not None)
        raise InputError(
            f"{what}: about {needed_bytes / GIGA:.3g} GB of memory, allowed: {allowed}"
        )


def tree_bytes(tree: object) -> int:
    """Bytes of the arrays of a tree, or of what they will be."""
    return sum(leaf.size * _item_bytes(leaf) for leaf in jax.tree.leaves(tree))


def _item_bytes(leaf: jax.Array) -> int:
    """Of one number; a key has several, four bytes each."""
    if jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return 16
    return int(leaf.dtype.itemsize)
