"""The table of kinds, and the one order of slots."""

import jax
import numpy as np
import pytest

from medjax.world.kinds import CLASSES, KINDS, by_class, kinds_in


def test_counts_of_kinds_add_up_by_class():
    """Every kind is in one class."""
    assert sorted(kinds_in(*CLASSES)) == list(range(len(KINDS)))
    counts = np.arange(2 * len(KINDS), dtype=np.float32).reshape(2, -1)
    expected = [counts[:, list(kinds_in(slots))].sum(axis=1) for slots in CLASSES]
    np.testing.assert_array_equal(by_class(counts), np.stack(expected, axis=-1))


@pytest.mark.thorough
@pytest.mark.usefixtures("quick_compiles")
def test_slots_hold_kinds_of_their_class(paper):
    """At the reset and during 30 decisions, on the road and off it."""
    env, params = paper
    config = env.config
    slots = np.asarray(config.by_slot(0, 1, 2))
    for index, where in enumerate((config.med_slots, config.ev_slots, config.gas_slots)):
        assert (slots[where] == index).all()
    of_kind = np.array([CLASSES.index(kind.slots) for kind in KINDS])

    @jax.jit
    def play(key):
        start = env.reset(key, params)[1]

        def step(state, key):
            state = env.step_env(key, state, 1, params)[1]
            return state, state.vehicles.kind

        return start.vehicles.kind, jax.lax.scan(step, start, jax.random.split(key, 30))[1]

    start, later = jax.tree.map(np.asarray, play(jax.random.key(0)))
    assert (of_kind[start] == slots).all()
    assert (of_kind[later] == slots).all()
    assert (later != start).any()  # another driver in an EV's slot
