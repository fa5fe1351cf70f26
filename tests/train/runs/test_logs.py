"""Rows and lines that a run writes about its updates."""

import struct

import numpy as np
import pytest
from tensorboardX.proto.event_pb2 import Event, SessionLog

from medjax.errors import InputError
from train.algorithms.ppo.settings import PPOConfig
from train.runs import logs
from train.runs.logs import MetricsLog, final_return, read_rows, rows_from
from train.runs.run_directory import RunDir


def test_rows_average_over_the_seeds_that_have_a_value():
    metrics = {"episode_return": np.array([[1.0, np.nan, 9.0], [3.0, 5.0, 9.0]])}
    rows = rows_from(metrics, 2)
    assert [row["episode_return"] for row in rows] == [2.0, 5.0]
    assert rows[1]["per_seed"]["episode_return"] == [None, 5.0]
    assert rows_from({"loss": np.array([np.nan, 1.0])}, 2) == [{"loss": None}, {"loss": 1.0}]


def test_final_return_weighs_episodes():
    rows = [{"episode_return": None, "episodes": 0.0}] * 18
    assert final_return(rows) is None
    rows += [{"episode_return": value, "episodes": number} for value, number in ((1, 3), (5, 1))]
    assert final_return(rows) == 2.0


def test_only_a_last_line_may_be_cut_off(tmp_path):
    """One in the middle is damaged: the updates after it would be lost."""
    file = tmp_path / "metrics.jsonl"
    file.write_text('{"update": 1}\n{"update": 2}\n{"upd')
    assert read_rows(file) == [{"update": 1}, {"update": 2}]
    file.write_text('{"update": 1}\n{"upd\n{"update": 3}\n')
    with pytest.raises(InputError, match=r"metrics.jsonl, line 2 = '{\"upd': allowed JSON"):
        read_rows(file)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (b"\xff", "is not a text file: allowed JSON, as train.ppo wrote it"),
        (b"3", "line 2 = '3': allowed JSON"),
        (b"[1]", r"line 2 = '\[1\]': allowed JSON"),
        (b'{"loss": 1.0}', "line 2 = '{\"loss\": 1.0}': allowed JSON"),
        (b'{"update": true}', "line 2 = .*: allowed JSON"),
        (b'{"update": "2"}', "line 2 = .*: allowed JSON"),
    ],
)
@pytest.mark.parametrize("rest", [b"", b'\n{"update": 3}\n'])
def test_what_is_no_row_is_refused(tmp_path, damage, said, rest):
    """Wherever it stands: a line that was cut off is no whole value."""
    file = tmp_path / "metrics.jsonl"
    file.write_bytes(b'{"update": 1}\n' + damage + rest)
    with pytest.raises(InputError, match=f"metrics.jsonl,? {said}"):
        read_rows(file)


@pytest.fixture
def lines(monkeypatch, capsys):
    """Lines that a run of 100 updates of 64 decisions prints if an update takes so many seconds."""

    def play(seconds, quiet=False):
        updates = range(1, 101)
        clock = iter(np.arange(100) * seconds)
        monkeypatch.setattr(logs.time, "perf_counter", lambda: next(clock))
        config = PPOConfig(
            num_envs=64, rollout_length=1, num_minibatches=4, decide_every=1, total_timesteps=6400
        )
        progress = logs.Progress(config, 0, "training", quiet)
        for update in updates:
            row = {"update": update, "env_steps": 64 * update, "env_steps_per_s": 32.0}
            ended = {"episode_return": -12.345} if update > 2 else {"episode_return": None}
            progress.show([row | ended | {"reward_mean": 0.5}])
        progress.close()
        out, err = capsys.readouterr()
        assert err == ""
        return out.splitlines()

    return play


def test_a_line_at_the_first_update_and_every_ten_seconds(lines):
    first, *others = lines(1.0)
    assert first == "update 1 of 100: 64 decisions, 32 a second, reward 0.5, 3 min left"
    left = ["3 min", "3 min", "2 min", "2 min", "98 s", "78 s", "58 s", "38 s", "18 s"]
    for n, time, line in zip(range(11, 101, 10), left, others, strict=True):
        said = f"{64 * n:,} decisions, 32 a second, return -12.35, {time} left"
        assert line == f"update {n} of 100: {said}"
    assert lines(60.0, quiet=True) == []


def sessions(folder):
    """Steps from which on TensorBoard hides what earlier files say, in the order of time."""
    found = []
    for path in sorted(folder.iterdir()):
        data, place = path.read_bytes(), 0
        while place < len(data):  # TFRecord: length, its checksum, the record, its checksum
            (size,) = struct.unpack_from("<Q", data, place)
            event = Event.FromString(data[place + 12 : place + 12 + size])
            place += size + 16
            if event.session_log.status == SessionLog.START:
                found.append(event.step)
    return found


@pytest.mark.parametrize(("done", "hidden"), [(0, 0), (1, 17)])
def test_updates_that_are_done_anew_are_hidden(tmp_path, done, hidden):
    """A killed run hides them when it resumes, also before its first checkpoint; a new run hides nothing."""
    run_dir = RunDir(tmp_path)
    log = MetricsLog(run_dir, 0)
    log.write([{"update": n, "env_steps": 16 * n, "loss": 1.0} for n in (1, 2)])
    log.close()
    assert sessions(run_dir.tensorboard) == []
    MetricsLog(run_dir, done).close()
    assert sessions(run_dir.tensorboard) == [hidden]
