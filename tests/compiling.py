"""Compilation in a quarter of the time, for programs that play a few steps only."""

import contextlib

import jax
import pytest
from jax._src import compiler

# Most of XLA's time goes to its fusion emitters, which newer versions cannot do without. Short loops need no repeated
# simplification, and other tests use the other cores.
LOOP_PASSES = (
    "simplify-while-loops",
    "while-loop-invariant-code-motion",
    "while-loop-constant-sinking",
)
QUICK = {
    "xla_backend_optimization_level": 0,
    "xla_llvm_disable_expensive_passes": True,
    "xla_cpu_parallel_codegen_split_count": 1,
    "xla_disable_hlo_passes": ",".join(LOOP_PASSES),
}
if jax.__version_info__ < (0, 11):
    QUICK["xla_cpu_use_fusion_emitters"] = False


@contextlib.contextmanager
def quickly():
    """Programs compiled in this context; they round differently, so caches are cleared on both sides.

    JAX has a public setting for the options of one program only (`jax.jit(compiler_options=...)`).
    """
    default = compiler.get_compile_options

    def quick(**settings):
        overrides = settings.pop("env_options_overrides", None) or {}
        return default(**settings, env_options_overrides=QUICK | overrides)

    jax.clear_caches()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiler, "get_compile_options", quick)
        yield
    jax.clear_caches()
