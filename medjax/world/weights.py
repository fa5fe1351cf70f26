"""Weights of the terms of the reward, `medjax.env.reward`, and prices by the hour, as declared numbers."""

import jax
from flax import struct

from medjax.world.numbers import Number, number

HOURS_OF_DAY = 24


class MarketParams(struct.PyTreeNode):
    """Prices that change over the day."""

    hourly_price: jax.Array = number(
        (1.0,) * HOURS_OF_DAY,
        -100,
        100,
        "",
        "factors of `reward_weights.depot_kwh` in the hours of the day, `(24,)`; prices may be below 0; 1: the same "
        "all day",
        per="hour",
    )


def weight(default: float, unit: str, text: str) -> Number:
    """Declares the weight of a reward term."""
    return Number(default, -1e9, 1e9, unit, text)


WEIGHT = weight(0.0, "", "off")  # of a term to which the preset gives no weight
WEIGHTS = {
    "depleted": weight(-11.6, "1/EV", "w1 of eq (10); calibrated to Table 2 (docs/paper.md)"),
    "soc": weight(1.02, "1/s", "w2; calibrated, except for its ratio to w3 and w4"),
    "distance": weight(0.102, "1/km", "w3; calibrated as w2"),
    "speed": weight(0.102, "1/s", "w4, of speed in units of 30 m/s; calibrated as w2"),
    "dispatches": weight(0.0, "1/MED", "off"),
    "gas_delay": weight(0.0, "1/s", "off"),
    "lane_changes": WEIGHT,
    "collisions": WEIGHT,
    "transfer_loss": weight(0.0, "1/kWh", "off"),
}
# Weights of the terms in `medjax.env.reward.MONEY`: prices of 2023; costs are negative.
PRICES = {
    "delay_h": weight(
        -20.0,
        "EUR/h",
        "value of a car's time, also for a MED that waits at a ramp, beside `med_h`; UK TAG 2022: 16.83 GBP per "
        "vehicle-hour; other guidance: 12-30",
    ),
    "depot_kwh": weight(
        -0.22,
        "EUR/kWh",
        "0.20 for firms in the EU (Eurostat 2023), divided by the charger's efficiency, 0.92",
    ),
    "ev_kwh": weight(
        -0.285,
        "EUR/kWh",
        "charged at home, EU (Eurostat 2023); `charging_stops` has the extra cost of fast chargers",
    ),
    "med_h": weight(
        -70.0,
        "EUR/h",
        "truck and driver without energy, 66 (ATRI 2025), plus 5 for the pack; coils not included",
    ),
    "tows": weight(
        -250.0,
        "EUR",
        "200 for the tow (120-270 in Germany), plus two hours of the driver; `delay_h` adds the delay of other "
        "vehicles, and that of the EV until it is off the road",
    ),
    "charging_stops": weight(
        -18.0,
        "EUR",
        "30 min of the driver (EnBW 2024: 27 min), plus 25.7 kWh at 0.60 instead of 0.285 (Fastned 2023)",
    ),
    "med_wear_kwh": weight(
        0.0,
        "EUR/kWh",
        "wear of a MED's battery; 0: not counted; a pack of 115 USD a kWh (BNEF 2024) for 3,000 full cycles: -0.04",
    ),
    "ev_wear_kwh": weight(0.0, "EUR/kWh", "wear of an EV's battery, likewise"),
    "plug_h": weight(-20.0, "EUR/h", "as `delay_h`"),
    "plug_kwh": weight(
        -0.315, "EUR/kWh", "0.60 at a fast charger (Fastned 2023) instead of 0.285 at home"
    ),
}
