"""Axes of the map: numbers of the world, and prices, which only weigh what happened there."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from medjax.errors import InputError, shown
from medjax.world.checks import check_numbers
from medjax.world.numbers import read_number
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.presets import PLACES, change_numbers
from medjax.world.weights import WEIGHT

PRICE = "reward_weights."
# How a number is shown: its heading, and what one unit of the heading is.
HEADINGS = {
    "slot_power_w": ("kW a slot", 1e3),
    "ev_share": ("% EVs", 0.01),
    "arrival_soc_high": ("% highest charge on arrival", 0.01),
    "reward_weights.ev_kwh": ("EUR a kWh elsewhere", -1.0),
    "reward_weights.charging_stops": ("EUR a stop", -1.0),
}
POWERS = {"slot_power_w": (20e3, 50e3, 100e3, 190e3)}
REST = {"ev_share": (0.1, 0.2, 0.3), "arrival_soc_high": (0.5, 0.7, 0.9)}
# The map by preset: power, the price of doing without MEDs, and who comes.
DEFAULTS = {
    "freight": POWERS | {"reward_weights.ev_kwh": (-0.375, -0.525, -0.725)} | REST,
    "corridor": POWERS | {"reward_weights.charging_stops": (-9.0, -18.0, -36.0)} | REST,
}
Point = dict[str, float]  # a value on each axis


@dataclasses.dataclass(frozen=True)
class Axis:
    """One number and the values that it takes."""

    name: str  # as `medjax.make` takes it
    values: tuple[float, ...]

    @property
    def is_price(self) -> bool:
        """Whether it is a weight of the reward, which changes what episodes are worth and not what happens."""
        return self.name.startswith(PRICE)

    @property
    def is_of_meds(self) -> bool:
        """Whether it changes MEDs alone, so that a world without MEDs is the same for all values."""
        group, leaf = PLACES.get(self.name, ("", self.name))
        # The control `slow` drives at the service speed.
        of_meds = group in ("fleet", "link", "med") or leaf == "slot_power_w"
        return of_meds and leaf != "service_speed"

    @property
    def heading(self) -> str:
        """What it is, with the unit in which `number` shows it."""
        return HEADINGS.get(self.name, (self.name, 1.0))[0]

    def number(self, value: float) -> str:
        """A value as text."""
        return f"{value / HEADINGS.get(self.name, (self.name, 1.0))[1]:g}"

    def label(self, value: float) -> str:
        """A value with its heading."""
        return f"{self.number(value)} {self.heading}"


def read_axes(texts: Sequence[str], scenario: str) -> list[Axis]:
    """The axes of texts such as `slot_power_w=20e3,50e3`, else those of the preset.

    Raises:
      InputError: no number of that name, one that is named twice or has no values, or values that are not numbers.
    """
    if not texts:
        if scenario not in DEFAULTS:
            raise InputError(f"no --vary: {scenario} has no axes of its own, allowed: at least one")
        return [Axis(name, values) for name, values in DEFAULTS[scenario].items()]
    found: dict[str, Axis] = {}
    for text in texts:
        name, _, values = text.partition("=")
        if name == "episode_decisions" or not (name in PLACES or name.startswith(PRICE)):
            allowed = "allowed a number of docs/parameters.md, but for the length of episodes"
            raise InputError(f"--vary {shown(name)}: {allowed}")
        if name in found:
            raise InputError(f"--vary {name} is given twice, allowed: once, with all its values")
        try:
            each = tuple(float(value) for value in values.split(","))
        except ValueError:
            raise InputError(f"--vary {shown(text)}: allowed NAME=NUMBER,NUMBER,...") from None
        found[name] = Axis(name, each)
    return [*found.values()]


def points(axes: Sequence[Axis]) -> Iterator[Point]:
    """Every combination of the axes' values."""
    for values in itertools.product(*(axis.values for axis in axes)):
        yield dict(zip((axis.name for axis in axes), values, strict=True))


def world_at(config: EnvConfig, params: EnvParams, point: Mapping[str, float]) -> EnvParams:
    """The params with the numbers of a point; its prices are left out.

    Raises:
      InputError: a value that is not allowed.
    """
    numbers = {name: value for name, value in point.items() if not name.startswith(PRICE)}
    changed = check_numbers(config, change_numbers(params, numbers))
    changed = changed.replace(link=changed.link.replace(inductance=params.link.inductance))
    return jax.tree.map(lambda new, old: np.asarray(new, old.dtype), changed, params)


def check_prices(axes: Sequence[Axis], params: Any) -> None:
    """Raises InputError for a value that is no price, or a price of a term that does not count: nothing scales it."""
    counts = [name for name, weight in params.reward_weights.items() if float(weight)]
    for axis in axes:
        if axis.is_price:
            if axis.name.removeprefix(PRICE) not in counts:
                raise InputError(f"--vary {axis.name}: allowed one of {', '.join(counts)}")
            for value in axis.values:
                read_number(axis.name, value, WEIGHT)
