"""Compiled programs: where they are kept, and what is seen of their making."""

import os
from pathlib import Path
from typing import Any

import jax
from tqdm import tqdm


def enable_compilation_cache() -> None:
    """Keeps compiled programs in the user's cache directory, unless the user chose another place."""
    if (
        getattr(jax.config, "jax_compilation_cache_dir", None)
        or "JAX_COMPILATION_CACHE_DIR" in os.environ
    ):
        return
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    jax.config.update("jax_compilation_cache_dir", str(Path(root) / "medjax" / "xla"))


def compiling() -> Any:
    """A line that says so while it is open as a context; nothing where stderr is no terminal."""
    return tqdm(desc="compiling ...", bar_format="{desc}", disable=None, leave=False)
