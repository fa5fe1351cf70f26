"""The loop that computes before its first pass what no pass changes."""

from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.numerics import loops

RATE, INIT, XS = jnp.float32(0.7), jnp.float32(2.0), jnp.arange(5.0)
TABLE = jnp.linspace(0.0, 1.0, loops.MOST_NUMBERS + 1)

pytestmark = pytest.mark.versions


@pytest.fixture(autouse=True)
def _on_a_gpu():
    with mock.patch.object(jax, "default_backend", return_value="gpu"):
        yield


def played(scan, rate, table, init, xs):
    """A loop whose passes read a number and an array that they do not change; its results as a dict."""

    def body(carry, x):
        total, count = carry["total"], carry["count"]
        total += jnp.exp(jnp.sin(rate)) * x + jnp.cos(table).sum() / (1.0 + total**2)
        return {"count": count + 1, "total": total}, (total * jnp.tanh(x), rate)

    return scan(body, {"total": init, "count": jnp.int32(0)}, xs)


def ours(*given):
    return played(loops.scan, *given)


def theirs(*given):
    return played(jax.lax.scan, *given)


def primitives_of_the_pass(run, *given):
    """Names of all operations in the body of the only loop."""
    (loop,) = [each for each in jax.make_jaxpr(run)(*given).eqns if each.primitive.name == "scan"]
    return [each.primitive.name for each in loop.params["jaxpr"].jaxpr.eqns]


@pytest.mark.parametrize("axes", [None, (0, None, None, None), (None, 0, 0, None)])
def test_results_are_those_of_lax_scan(axes):
    """Alone, and in a batch of the constants or of the carry."""
    given = [RATE, TABLE, INIT, XS]
    if axes is not None:
        given = [
            leaf if a is None else jnp.stack([leaf, leaf + 0.5])
            for leaf, a in zip(given, axes, strict=True)
        ]
    runs = [run if axes is None else jax.vmap(run, axes) for run in (ours, theirs)]
    one, other = (jax.jit(run)(*given) for run in runs)
    assert jax.tree.structure(one) == jax.tree.structure(other)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-6), one, other)


def test_a_pass_computes_what_changes_and_large_arrays():
    """`lax.scan` leaves the sine and the exponential of a constant in the body."""
    given = RATE, TABLE, INIT, XS
    kept, moved = (primitives_of_the_pass(run, *given) for run in (theirs, ours))
    assert {"sin", "exp", "cos", "tanh"} <= {*kept}
    assert {"cos", "tanh"} <= {*moved}
    assert not {"sin", "exp"} & {*moved}


def test_derivatives_are_those_of_lax_scan():
    """By the constants and by the carry."""

    def total(run, rate, init):
        return run(rate, TABLE, init, XS)[0]["total"]

    of_ours, of_theirs = (
        jax.grad(lambda rate, init, run=run: total(run, rate, init), (0, 1))(RATE, INIT)
        for run in (ours, theirs)
    )
    np.testing.assert_allclose(of_ours, of_theirs, rtol=1e-5)
    assert all(of_theirs)


def test_no_passes():
    """The carry is the first one, and the outputs are empty."""
    carry, (outputs, _) = ours(RATE, TABLE, INIT, XS[:0])
    assert carry["total"] == INIT
    assert outputs.shape == (0,)


def test_effects_stay_in_their_pass(capfd):
    """What a body prints is printed in every pass, though it is a constant."""

    def body(carry, x):
        jax.debug.print("a pass of {}", jnp.float32(0.5), ordered=True)
        return carry + x, None

    jax.block_until_ready(jax.jit(lambda xs: loops.scan(body, INIT, xs))(XS))
    jax.effects_barrier()
    assert capfd.readouterr().out.count("a pass of 0.5") == len(XS)


@pytest.mark.parametrize(
    ("init", "xs"),
    [
        (0, jnp.ones(3)),  # lax.scan promotes the first carry
        (jnp.float16(1), jnp.full(3, 1.0)),
        ({"none": None, "count": jnp.int32(1)}, {"none": None, "x": jnp.arange(3)}),
        (jax.random.key(0), jnp.arange(3)),
    ],
)
def test_types_are_those_of_lax_scan(init, xs):
    """Weak types, leaves that are None, and keys."""

    def body(carry, x):
        if not isinstance(carry, dict):
            is_key = jnp.issubdtype(getattr(carry, "dtype", int), jax.dtypes.prng_key)
            return (jax.random.fold_in(carry, x), x) if is_key else (carry * 2 + x, x)
        return {"none": None, "count": carry["count"] + x["x"] * jnp.int32(2)}, x

    one, other = (scan(body, init, xs) for scan in (loops.scan, jax.lax.scan))
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for mine, its in zip(*map(jax.tree.leaves, (one, other)), strict=True):
        assert jax.typeof(mine) == jax.typeof(its)
        assert jnp.all(mine == its)


def test_a_carry_that_changes_its_type_is_refused():
    """With the error of `lax.scan`."""
    with pytest.raises(TypeError, match="carry"):
        loops.scan(lambda carry, x: ((carry, x), None), INIT, XS)


def test_a_body_that_moves_nothing():
    """All that it computes depends on its arguments."""
    body = lambda carry, x: (carry + x, None)  # noqa: E731
    assert loops.scan(body, INIT, XS)[0] == INIT + XS.sum()
