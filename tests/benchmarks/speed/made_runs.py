"""Directories of training runs, made by hand."""

import json

from train.runs.run_directory import RunDir

SUMMARY = {
    "compile_s": 10.0,
    "train_s": 20.0,
    "evaluation_s": 5.0,
    "env_steps": 409600,
    "env_steps_per_s": 20480.0,
    "backend": "cpu",
    "device": "cpu",
}


def write_run(path, summary):
    """A run directory as train.ppo leaves it, as far as it is read."""
    path.mkdir(parents=True)
    (path / "summary.json").write_text(json.dumps(summary))
    return RunDir(path)
