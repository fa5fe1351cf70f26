"""Where compiled programs are kept."""

import os
from pathlib import Path

import jax


def enable_compilation_cache() -> None:
    """Keeps compiled programs in the user's cache directory, unless the user chose another place."""
    chosen = getattr(jax.config, "jax_compilation_cache_dir", None)
    if chosen or "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    jax.config.update("jax_compilation_cache_dir", str(Path(root) / "medjax" / "xla"))
