"""A healthy run computes no NaN, not even as a placeholder: JAX_DEBUG_NANS=1 would stop at the first."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.train.conftest import TINY

ROOT = Path(__file__).parents[2]


@pytest.mark.thorough
def test_a_healthy_run_goes_through(tmp_path):
    """In some updates no episode ends: their means are null, as without JAX_DEBUG_NANS."""
    run = tmp_path / "run"
    done = subprocess.run(
        [sys.executable, "-m", "tests.train.probe_run", *TINY, "--run-dir", str(run)],
        env={**os.environ, "JAX_DEBUG_NANS": "1"},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert any(row["episode_return"] is None for row in rows)
    assert any(row["episode_return"] is not None for row in rows)
