"""The software that ran: versions, and the commit of the sources if they are a checkout."""

import contextlib
import platform
import subprocess
from importlib import metadata
from pathlib import Path

PACKAGES = ("medjax", "jax", "jaxlib", "flax", "optax", "distrax", "numpy")
ROOT = Path(__file__).parents[2]
FOLDERS = ("medjax", "train", "benchmarks")


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that determine results, and `commit`."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return {**found, "commit": commit()}


def commit() -> str:
    """The commit of the sources, and whether they have changed since; "unknown" if they are not a checkout."""

    def git(*words: str) -> str:
        with contextlib.suppress(OSError, subprocess.SubprocessError):
            command = ["git", *words]
            done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=10)
            return done.stdout.strip()
        return ""

    if not (ROOT / ".git").exists():  # installed, perhaps inside another project's checkout
        return "unknown"
    changed = git("status", "--porcelain", "--", *FOLDERS)
    return (git("rev-parse", "--short", "HEAD") or "unknown") + (" with changes" if changed else "")
