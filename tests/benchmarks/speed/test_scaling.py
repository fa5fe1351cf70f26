"""What the scaling benchmark prints, of workloads whose speeds are known."""

from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from benchmarks.speed import scaling

TICKS = 4
VEHICLES_A_ROAD = 100


class Known:
    """A workload in place of `Workload`: a vehicle costs `cost_ns` a tick on one device, and its first call is slow."""

    made: ClassVar[list] = []
    now: ClassVar[float] = 0.0  # of its clock

    def __init__(self, num_envs, steps, scenario, num_devices=1, count=VEHICLES_A_ROAD):
        type(self).made.append((num_envs, steps, scenario, num_devices, count))
        self.num_envs, self.steps, self.count = num_envs, steps, count
        self.cost_ns = {4: 40.0, 8: 50.0}.get(num_envs, 30.0) / num_devices
        self.compile_s, self.calls = 1.0, 0
        self.env = SimpleNamespace(config=SimpleNamespace(ticks_per_decision=TICKS))
        self.mesh = SimpleNamespace(size=num_devices)
        self.state = [np.zeros((num_envs, 256), np.float32)]  # 1 KiB each
        needs = SimpleNamespace(temp_size_in_bytes=2048 * num_envs // num_devices)
        self.program = SimpleNamespace(memory_analysis=lambda: needs)

    def play(self):
        self.calls += 1
        active = self.num_envs * self.steps * TICKS * self.count
        return active * self.cost_ns * 1e-9 * (1000.0 if self.calls == 1 else 1.0), active

    def reset(self, key):
        """Advances the clock: compiling takes 100 s, and later calls 1 and 2 decisions of 8 roads."""
        decision_s = 8 * TICKS * VEHICLES_A_ROAD * 50e-9
        self.resets = getattr(self, "resets", iter((100.0, *(n * decision_s for n in (1, 2)))))
        Known.now += next(self.resets)
        return np.zeros(1)


@pytest.fixture
def found(monkeypatch, capsys):
    """The figures, and the words of the printed lines."""
    Known.made, Known.now = [], 0.0
    for name, value in {
        "Workload": Known,
        "ENVS": (4, 8),
        "VEHICLES": (50, 100, 400),
        "road_for": lambda count, scenario: {"count": count},
        "time": SimpleNamespace(perf_counter=lambda: Known.now),
    }.items():
        monkeypatch.setattr(scaling, name, value)
    monkeypatch.setattr(scaling.jax, "local_devices", lambda: [None] * 3)
    figures = []
    monkeypatch.setattr(
        scaling,
        "run_command",
        lambda parser, measure, argv: figures.append(measure(parser.parse_args(argv))),
    )
    scaling.main(["--num-envs=8", "--repeats=2"])
    return figures[0], [line.split() for line in capsys.readouterr().out.splitlines()]


def test_tables_by_hand(found):
    """Environments, vehicles and ns a row; no row counts the first call, which is a thousand times slower."""
    figures, lines = found
    rows = [line for line in lines if line and line[0].isdigit()]
    assert rows == [
        # asked, environments, vehicles a road, M updates/s, ns a vehicle and tick
        ["4", "4", "100", "25.00", "40.0"],
        ["8", "8", "100", "20.00", "50.0"],
        ["50", "8", "50", "20.00", "50.0"],
        ["100", "4", "100", "25.00", "40.0"],
        ["400", "1", "400", "33.33", "30.0"],
        ["1", "8", "100", "20.00", "50.0"],
        ["2", "8", "100", "40.00", "25.0"],  # not 3, which do not share 8 environments
    ]
    spreads = [line[-1] for line in lines if line[:1] == ["dearest"]]
    assert spreads == ["1.25", "1.67", "2.00"]
    assert [figures[f"{name}_spread"] for name in ("envs", "vehicles", "devices")] == [
        pytest.approx(value) for value in (5 / 4, 5 / 3, 2.0)
    ]


def test_a_reset_in_decisions(found):
    """Without the first reset, which compiles."""
    figures, lines = found
    assert figures["reset_in_decisions"] == pytest.approx(1.5)
    said = [" ".join(words) for words in lines]
    assert "a reset costs as much as 1.50 decisions" in said
    assert "an environment takes 1.0 KiB of state and 2.0 KiB of work space" in said


def test_what_it_plays(found):
    """As many decisions in total at each size, and roads of each length with as many vehicles in total."""
    assert Known.made == [
        (4, 100, "paper", 1, 100),
        (8, 50, "paper", 1, 100),
        (8, 50, "paper", 1, 50),
        (4, 50, "paper", 1, 100),
        (1, 50, "paper", 1, 400),
        (8, 50, "paper", 1, 100),
        (8, 50, "paper", 2, 100),
        (8, 20, "paper", 1, 100),  # against which a reset is timed
    ]
