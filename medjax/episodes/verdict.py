"""The player's verdict: a few numbers that sum up one or many episodes for people."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from medjax.env.metrics import SECONDS_PER_HOUR
from medjax.world.weights import PRICES

PRICED = (
    "time lost, electricity, MEDs with drivers, tows, charging stops and wear of batteries, "
    "at the world's own prices, or at those of 2023 if it has none"
)
LEARNED_FROM = "the reward that policies learn from"


class Line(NamedTuple):
    """One number of the verdict."""

    title: str
    digits: int  # decimals for one episode
    mean_digits: int  # decimals for a mean over episodes
    better: int  # -1: lower, 1: higher, 0: neither
    # Takes an episode's metrics, their means over episodes, or arrays (episodes,) of them.
    of: Callable[[Mapping[str, Any]], Any]
    about: str = ""


def _delay_h(metrics: Mapping[str, Any]) -> Any:
    return metrics["ev_delay_h"] + metrics["gas_delay_h"]


def _euros(metrics: Mapping[str, Any]) -> Any:
    """Total cost by the terms of `medjax.env.reward.MONEY`, EUR.

    A world whose reward is in money has counted the terms itself, at its own prices by the hour. In any other world the
    default prices weigh the metrics. Given means over episodes, that cost is accurate to about a cent, because energy
    per EV hardly depends on the number of EVs.
    """
    if all(name in metrics for name in COUNTED):
        return -sum(metrics[name] for name in COUNTED)
    # Evaluations from before there were plugs do not tell of them.
    stops, wait_h, charging_h, plug_kwh = (metrics.get(name, 0.0) for name in AT_PLUGS)
    taken = metrics["ev_driving_kwh"] * metrics["evs_entered"]
    amounts = {
        "delay_h": _delay_h(metrics) + metrics["queue_vehicle_s"] / SECONDS_PER_HOUR,
        "depot_kwh": metrics["energy_drawn_kwh"],
        "ev_kwh": taken - metrics["energy_delivered_kwh"],
        "med_h": metrics["med_hours"],
        "tows": metrics["evs_depleted"],
        "charging_stops": metrics["low_exits"] - stops,
        "plug_h": wait_h + charging_h,
        "plug_kwh": plug_kwh,
    }
    return -sum(PRICES[name].default * amount for name, amount in amounts.items())


COUNTED = tuple(f"reward_{name}" for name in PRICES)  # scores of a world whose reward is in money
AT_PLUGS = ("plug_stops", "plug_wait_h", "plug_charging_h", "plug_kwh")
LINES = (
    Line("ran out", 0, 1, -1, lambda metrics: metrics["evs_depleted"]),
    Line("kWh received", 1, 1, 1, lambda metrics: metrics["energy_delivered_kwh"]),
    Line("hours of delay", 2, 2, -1, _delay_h),
    Line("cost, EUR", 0, 0, -1, _euros, PRICED),
    Line("MEDs sent", 0, 1, 0, lambda metrics: metrics["meds_dispatched"]),
    Line("return", 1, 1, 1, lambda metrics: metrics["return_mean"], LEARNED_FROM),
)
NAMES = (  # metrics that the lines use
    *("evs_depleted", "energy_delivered_kwh", "ev_delay_h", "gas_delay_h", "queue_vehicle_s"),
    *("energy_drawn_kwh", "ev_driving_kwh", "evs_entered", "med_hours", "low_exits"),
    *("meds_dispatched", "return_mean"),
)
