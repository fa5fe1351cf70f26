"""Available memory, and a check before compilation that a program fits into it."""

import os
from pathlib import Path

import jax

from medjax.errors import InputError

GIGA = 1e9
LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def memory_bytes() -> int:
    """Memory for JAX: that of its devices, or on a CPU this process's limit."""
    own = [(device.memory_stats() or {}).get("bytes_limit", 0) for device in jax.local_devices()]
    if jax.default_backend() != "cpu" and all(own):
        return sum(own)
    there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    texts = [Path(limit).read_text() for limit in LIMITS if Path(limit).exists()]
    return min([there, *(int(text) for text in texts if text.strip().isdecimal())])


def check_memory(what: str, needed_bytes: float, force: bool | None = None) -> None:
    """Rejects a program that needs more memory than there is.

    Args:
        what: the program, with the numbers that its memory depends on.
        needed_bytes: estimated need.
        force: skip the check; None for a command without `--force`.

    Raises:
        InputError: one line with the program, the need and the memory that there is.
    """
    there = memory_bytes()
    if needed_bytes > there and not force:
        allowed = f"{there / GIGA:.3g} GB, the memory of this machine" + ", or --force" * (
            force is not None
        )
        raise InputError(
            f"{what}: about {needed_bytes / GIGA:.3g} GB of memory, allowed: {allowed}"
        )


def tree_bytes(tree: object) -> int:
    """Bytes of the arrays, or shapes, of a tree."""
    return sum(leaf.size * _item_bytes(leaf) for leaf in jax.tree.leaves(tree))


def _item_bytes(leaf: jax.Array) -> int:
    """Bytes of one item; a key has several numbers of four bytes each."""
    if jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return 16
    return int(leaf.dtype.itemsize)
