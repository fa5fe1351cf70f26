"""Compares the speed of medjax with other traffic simulators on the same road: `python -m benchmarks.peers`.

To add a peer, write a module with a `Peer` and list it in `PEERS` of `__main__`.
"""

import abc
import dataclasses
import importlib.metadata
import math
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from medjax.world.params import EnvConfig, EnvParams


@dataclasses.dataclass(frozen=True)
class Rate:
    """Result of one measurement."""

    active_vehicle_updates_per_s: float  # vehicles on the road, summed over ticks, per wall time
    mean_active_vehicles: float  # on one road

    @classmethod
    def added(cls, rates: Sequence["Rate"]) -> "Rate":
        """The rate of roads that were timed at the same time, one in each process."""
        return cls(
            math.fsum(rate.active_vehicle_updates_per_s for rate in rates),
            statistics.fmean(rate.mean_active_vehicles for rate in rates),
        )


@dataclasses.dataclass(frozen=True)
class World:
    """The world that every simulator gets."""

    config: EnvConfig
    params: EnvParams
    num_vehicles: int  # mean number on the road in medjax
    cores: int  # number of processes of a single-core simulator
    folder: Path  # for files; deleted after the run

    @property
    def span_s(self) -> float:
        """Simulated time of one episode, s."""
        return int(self.params.episode_decisions) * self.config.decision_s


def installed_version(package: str) -> str | None:
    """The version of a distribution, or None if it is not installed."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


class Peer(abc.ABC):
    """A simulator to time; only building one with a World needs its package."""

    name: str
    package: ClassVar[str]  # distribution that must be installed
    differences: ClassVar[tuple[str, ...]]  # sentences on what it does differently

    def version(self) -> str:
        """The version that is measured."""
        return installed_version(self.package) or "unknown"

    @abc.abstractmethod
    def measure(self) -> Rate:
        """Measures once on all cores; set-up, loading and warm-up are not timed."""
