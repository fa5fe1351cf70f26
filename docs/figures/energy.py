"""Energy consumption of an EV."""

import csv
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from docs.figures.look import BLUE, GREEN, ORANGE, RED, SKY
from medjax.charging.energy import drive_energy
from medjax.world.kinds import HUMAN_EV
from medjax.world.params import BodyParams, EnvParams
from train.reporting.figures import new_figure, save

KNOWN = Path(__file__).parents[2] / "tests/data/ev_energy.csv"


def draw_energy(path: Path, params: EnvParams) -> None:
    """Battery power of an EV over speed, and energy per distance beside FASTSim's."""
    speed = np.linspace(0.5, 40, 159)

    def kilowatt(body: BodyParams) -> np.ndarray:
        steady = jnp.asarray(speed)
        return np.asarray(drive_energy(steady, steady, body, params.road, 1.0)) / 1e3

    figure = new_figure(8.5, 3.8)
    power, distance = figure.subplots(1, 2)
    auxiliary = kilowatt(params.ev.replace(drag_coefficient=0.0, rolling_resistance=0.0))
    rolling = kilowatt(params.ev.replace(drag_coefficient=0.0))
    total = kilowatt(params.ev)
    shares = {
        "auxiliaries": (np.zeros_like(total), auxiliary, GREEN, "///"),
        "rolling resistance": (auxiliary, rolling, ORANGE, "\\\\\\"),
        "air drag": (rolling, total, SKY, ""),
    }
    for name, (low, high, color, hatch) in shares.items():
        look = {"facecolor": color, "edgecolor": "white", "hatch": hatch, "lw": 0}
        power.fill_between(speed, low, high, label=name, **look)
    power.plot(speed, total, color="black", lw=2)
    power.set_ylabel("power from an EV's battery (kW)")
    power.legend(loc="upper left")

    distance.plot(speed, total / speed / 3.6 * 100, color="black", lw=2, label="medjax")
    with KNOWN.open(encoding="utf-8") as table:
        leaf = next(row for row in csv.DictReader(table) if row["vehicle"].startswith("Nissan"))
    known = [100, 110, 120, 130]
    use = [float(leaf[f"battery_kwh_per_100km_at_{kmh}kmh"]) for kmh in known]
    places = [kmh / 3.6 for kmh in known]
    distance.plot(places, use, "o", color=RED, ms=7, label="FASTSim 2.1.5, Nissan Leaf")
    for at in (float(params.fleet.service_speed), float(params.drivers.desired_speed[HUMAN_EV])):
        value = float(np.interp(at, speed, total / speed / 3.6 * 100))
        distance.plot([at, at], [0, value], color=BLUE, lw=1, ls="--")
        how = {"textcoords": "offset points", "ha": "right", "va": "bottom", "color": BLUE}
        distance.annotate(f"{value:.1f} at {at:.0f} m/s", (at, value), (-6, 6), **how)
    distance.set_ylabel("energy from an EV's battery (kWh/100 km)")
    distance.legend(loc="upper left", fontsize="small")
    for axes in (power, distance):
        axes.set(xlabel="steady speed (m/s)", xlim=(0, 40), ylim=(0, None))
        axes.grid(alpha=0.3)
    save(figure, path)
