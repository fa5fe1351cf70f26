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


def write_run(path, summary, update_s, from_s):
    """A run directory as train.ppo leaves it, with 25 updates; no whole episode ended."""
    path.mkdir(parents=True)
    (path / "summary.json").write_text(json.dumps(summary))
    rows = [
        {"update": n, "wall_s": from_s + update_s * n, "episode_return": None} for n in range(1, 26)
    ]
    (path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return RunDir(path)
