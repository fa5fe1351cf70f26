"""Programs that play a few steps only: compiled in a quarter of the time, and slow."""

import contextlib

import jax
import pytest
from jax._src import compiler

# Most of XLA's usual time goes to its fusion emitters (newer versions have nothing else). Nor need loops be simplified
# again and again that run a few times, or the work be split among cores that other tests use.
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
    """What is compiled meanwhile.

    It rounds differently, so none is left for tests that compare bits, nor taken over from them. JAX has no public
    setting for options of all programs, only of one (`jax.jit(compiler_options=...)`).
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
