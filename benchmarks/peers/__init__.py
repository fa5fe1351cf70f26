"""medjax beside other traffic simulators, on the same road, in one run: `python -m benchmarks.peers`.

A peer is one module with one `Peer`, and an entry in `PEERS` of `__main__`.
"""

import abc
import dataclasses
from pathlib import Path
from typing import ClassVar

from medjax.world.params import EnvConfig, EnvParams


@dataclasses.dataclass(frozen=True)
class Rate:
    """What one measurement gives."""

    active_vehicle_updates_per_s: float  # vehicles on the road, summed over ticks, by wall time
    mean_active_vehicles: float  # on one road


@dataclasses.dataclass(frozen=True)
class World:
    """The world that every simulator is given."""

    config: EnvConfig
    params: EnvParams
    num_vehicles: int  # on the road; what medjax's traffic comes to
    cores: int  # processes of a simulator that uses one core
    folder: Path  # for files; deleted after the run

    @property
    def span_s(self) -> float:
        """Simulated time of one episode, s."""
        return int(self.params.episode_decisions) * self.config.decision_s


class Peer(abc.ABC):
    """A simulator that is timed; its package may be missing until it is built with a World."""

    name: ClassVar[str]
    package: ClassVar[str]  # distribution that must be installed
    differences: ClassVar[tuple[str, ...]]  # sentences: what it does more, less or otherwise

    @abc.abstractmethod
    def measure(self) -> Rate:
        """One measurement on all cores; set-up, loading and warm-up are not timed."""
