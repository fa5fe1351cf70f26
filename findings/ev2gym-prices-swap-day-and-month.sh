#!/bin/bash
# ev2gym 2.0.0: simulations of 1 to 12 of a month after September 2023 get another month's day-ahead prices.
#
# Library: ev2gym 2.0.0 (PyPI), ev2gym.utilities.loaders.load_electricity_prices, with pandas 2.3.3.
# Expected: a simulation of 5 September 2024 has the prices that ENTSO-E published for that day, which the package has in
#   data/Netherlands_day-ahead-2015-2024.csv.
# What happens: rows of that file up to September 2023 are dated 2023-09-05 00:00:00, later ones 05/09/2024 00:00, day
#   first (those of January to September 2023 stand there in both forms). pandas.DatetimeIndex reads each text by itself, month first where that is possible, and warns of nothing. So
#   5 September and 9 May 2024 swap their prices, the 13th and later days are right, and nothing fails.
# Source: the file and the function named above; pandas' documentation of `dayfirst` (it is no strict setting, and the
#   default reads the month first).
# Output seen:
#   2024-09-05: first hours 85.00 81.61 75.51 EUR/MWh; the file has 90.00 87.11 80.57: the prices of 2024-05-09
#   2024-05-09: first hours 90.00 87.11 80.57 EUR/MWh; the file has 85.00 81.61 75.51: the prices of 2024-09-05
#   2024-09-15: first hours 73.28 75.76 71.32 EUR/MWh; the file has 73.28 75.76 71.32: its own prices
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"

python3 -m venv env
# The packages after gurobipy are imported by ev2gym, which does not declare them.
env/bin/pip install -q --disable-pip-version-check "ev2gym==2.0.0" "pandas==2.3.3" "numpy==2.3.5" "gymnasium==1.4.0" \
    "gurobipy==13.0.3" "pandapower==3.1.2" "multicopula==0.0.2" "numba==0.62.1" "psutil==7.2.2" "setuptools==80.9.0"

cat > prices.py <<'PY'
import csv
import datetime
import importlib.resources
from types import SimpleNamespace

from ev2gym.utilities.loaders import load_electricity_prices

file = importlib.resources.files("ev2gym") / "data/Netherlands_day-ahead-2015-2024.csv"
with file.open() as lines:
    rows = {row["Datetime (UTC)"]: float(row["Price (EUR/MWhe)"]) for row in csv.DictReader(lines)}


def published(day):
    """The prices of a day in the file, whose dates of 2024 are day first."""
    return [rows[f"{day:%d/%m/%Y} {hour:02d}:00"] for hour in range(24)]


def simulated(day):
    """The prices that a simulation of one charging station has on that day, EUR/MWh."""
    world = SimpleNamespace(load_from_replay_path=None, price_data=None, cs=1, simulation_length=24, timescale=60)
    world.sim_date, world.config = day, {"discharge_price_factor": 1}
    return [round(1000 * float(price), 2) for price in load_electricity_prices(world)[1][0]]


def first(prices):
    return " ".join(f"{price:.2f}" for price in prices[:3])


days = {text: datetime.datetime.fromisoformat(text) for text in ("2024-09-05", "2024-05-09", "2024-09-15")}
found = {}
for text, day in days.items():
    got = simulated(day)
    found[text] = [other for other, its in days.items() if published(its) == got]
    whose = "its own prices" if found[text] == [text] else "the prices of " + ", ".join(found[text])
    print(f"{text}: first hours {first(got)} EUR/MWh; the file has {first(published(day))}: {whose}")
assert found == {"2024-09-05": ["2024-05-09"], "2024-05-09": ["2024-09-05"], "2024-09-15": ["2024-09-15"]}
PY
env/bin/python -W ignore prices.py
