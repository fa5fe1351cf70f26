"""Directories of training runs, made by hand."""

import json

from train.runs.run_directory import RunDir

SUMMARY = {
    "compile_s": 10.0,
    "train_s": 20.0,
    "evaluation_s": 5.0,
    "env_steps": 409600,
    "backend": "cpu",
    "device": "cpu",
}
PACES = (9000.0, 20_480.0, 21_000.0)  # decisions/s of its updates


def write_run(path, summary):
    """A run directory as train.ppo leaves it, as far as it is read."""
    path.mkdir(parents=True)
    (path / "summary.json").write_text(json.dumps(summary))
    rows = [{"update": update + 1, "env_steps_per_s": pace} for update, pace in enumerate(PACES)]
    (path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return RunDir(path)
