"""Programs too large for the memory are refused before anything is computed."""

import jax
import jax.numpy as jnp
import pytest

from medjax.errors import InputError
from medjax.numerics import memory


def test_bytes_of_a_tree_are_those_of_its_arrays():
    tree = {"a": jnp.zeros((3, 4)), "b": (jnp.zeros(5, bool), jnp.zeros((2, 2), jnp.int32))}
    size = sum(leaf.nbytes for leaf in jax.tree.leaves(tree))
    assert memory.tree_bytes(tree) == size == 48 + 5 + 16
    assert memory.tree_bytes(jax.eval_shape(lambda: tree)) == size
    keys = jax.random.split(jax.random.key(0), 7)
    assert memory.tree_bytes(keys) >= jax.random.key_data(keys).nbytes


def test_memory_is_what_the_system_reports():
    with open("/proc/meminfo") as file:
        total = int(file.readline().split()[1]) * 1024
    assert 2**28 < memory.memory_bytes() <= total


def test_too_large_programs_are_refused_unless_forced(monkeypatch):
    monkeypatch.setattr(memory, "memory_bytes", lambda: 8 * 10**9)
    memory.check_memory("--episodes 3", 8e9, force=False)
    memory.check_memory("--episodes 3", 9e9, force=True)
    said = (
        "--episodes 3: about 9 GB of memory, allowed: 8 GB, the memory of this machine, or --force"
    )
    with pytest.raises(InputError, match=f"^{said}$"):
        memory.check_memory("--episodes 3", 9e9, force=False)
    with pytest.raises(InputError, match=r"the memory of this machine$"):
        memory.check_memory("--num-envs 3", 9e9)
