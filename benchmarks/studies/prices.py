"""Day-ahead prices of a month or a year as 24 factors for `hourly_price`, from a file on disk.

The package `ev2gym` 2.0.0 (MIT) ships Dutch prices of 2015 to 2024, which it names ENTSO-E's. Nothing is installed, and
the command fetches nothing:

    pip download ev2gym==2.0.0 --no-deps
    python -m benchmarks.prices ev2gym-2.0.0-py3-none-any.whl --year 2024 --month 6 --json june.json

An hour's price is its mean over the days of the period, by local time, and its factor is that mean over the mean of all
hours of the period. The last line fits `--set`; in Python:

    factors = json.load(open("june.json"))["hourly_price"]
    env, params = medjax.make("corridor", reward="money", hourly_price=factors)
"""

import argparse
import calendar
from datetime import datetime, timedelta
from typing import Any, NamedTuple

import numpy as np

from benchmarks.command import a_path, benchmark_parser, run_command, whole_number
from benchmarks.studies.price_file import HOUR, Prices, local_time, parse_prices, read_text
from medjax.errors import InputError
from medjax.world.numbers import numbers_of
from medjax.world.weights import HOURS_OF_DAY, MarketParams

MOST_MISSING = 1  # hours of a month; ev2gym's file lacks midnight on 31 December of 2023 and 2024
FIRST_YEAR, LAST_YEAR = 1997, 2100  # the EU's daylight saving time is as it is since 1996
DIGITS = 6  # after the point, of what --json writes


class Period(NamedTuple):
    """The prices of a period by the hour of the day, local time."""

    eur_per_mwh: np.ndarray  # (24,) means
    mean: float  # of all hours, EUR/MWh
    hours: int
    missing: list[datetime]  # local time

    @property
    def factors(self) -> np.ndarray:
        """Means over the mean of all hours, `(24,)`."""
        return self.eur_per_mwh / self.mean


def hours_of(year: int, month: int, zone_h: int) -> list[datetime]:
    """The hours of a month of local time, in UTC: 24 a day, one fewer in March and one more in October.

    Args:
      year, month: of local time.
      zone_h: standard time, hours ahead of UTC.
    """
    first = datetime(year, month, 1) - timedelta(days=1)
    days = calendar.monthrange(year, month)[1] + 2
    hours = (first + hour * HOUR for hour in range(HOURS_OF_DAY * days))
    return [utc for utc in hours if _month_of(utc, zone_h) == (year, month)]


def _month_of(utc: datetime, zone_h: int) -> tuple[int, int]:
    local = local_time(utc, zone_h)
    return local.year, local.month


def average(prices: Prices, year: int, month: int | None) -> Period:
    """Averages a month, or the year if `month` is None.

    Raises:
      InputError: more than MOST_MISSING hours of a month have no price, or the factors are not those of `hourly_price`.
    """
    of_hour: list[list[float]] = [[] for _ in range(HOURS_OF_DAY)]
    missing: list[datetime] = []
    for each in range(1, 13) if month is None else [month]:
        hours = hours_of(year, each, prices.zone_h)
        lacking = [local_time(utc, prices.zone_h) for utc in hours if utc not in prices.eur_per_mwh]
        if len(lacking) > MOST_MISSING:
            raise InputError(
                f"{year}-{each:02d}: {len(lacking)} of {len(hours)} hours have no price: allowed"
                f" months within {_range(prices)} that lack at most {MOST_MISSING}"
            )
        missing += lacking
        for utc in hours:
            if utc in prices.eur_per_mwh:
                of_hour[local_time(utc, prices.zone_h).hour].append(prices.eur_per_mwh[utc])
    means = np.array([np.mean(values) for values in of_hour])
    mean = float(np.mean([price for values in of_hour for price in values]))
    limits = numbers_of(MarketParams)["hourly_price"]
    if mean <= 0.0 or not np.all((limits.low <= means / mean) & (means / mean <= limits.high)):
        allowed = f"a mean above 0 that gives factors from {limits.range}"
        raise InputError(f"mean price {mean:g} EUR/MWh: allowed {allowed}")
    return Period(means, mean, sum(map(len, of_hour)), missing)


def _range(prices: Prices) -> str:
    """The first and last day that have prices, local time."""
    ends = (min(prices.eur_per_mwh), max(prices.eur_per_mwh))
    return " to ".join(f"{local_time(utc, prices.zone_h):%Y-%m-%d}" for utc in ends)


def notes(prices: Prices, period: Period) -> list[str]:
    """What is unusual about the file and the period, a line each."""
    found = []
    if prices.repeated:
        found.append(f"{prices.repeated} hours of the file come twice, with the same price")
    if prices.undated:
        found.append(f"rows of the file without a date, left out: {prices.undated}")
    if period.missing:
        named = ", ".join(f"{local:%Y-%m-%d %H:%M}" for local in period.missing)
        found.append(f"hours of the period without a price, left out: {named}")
    return found


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Prints the means and factors; returns them with their source."""
    source, licence, text = read_text(options.file)
    prices = parse_prices(source, text)
    period = average(prices, options.year, options.month)
    name = f"{options.year}" if options.month is None else f"{options.year}-{options.month:02d}"
    print(f"source: {source}")
    print(f"licence: {licence or 'a CSV file states none'}")
    print(f"{name}: {period.hours} hours, mean {period.mean:.2f} EUR/MWh")
    print(*(f"{note}\n" for note in notes(prices, period)), sep="", end="")
    print("\nhour  EUR/MWh  factor")
    for hour, (price, factor) in enumerate(zip(period.eur_per_mwh, period.factors, strict=True)):
        print(f"{hour:4d} {price:8.2f} {factor:7.3f}")
    print(f"\nhourly_price=[{','.join(f'{factor:.3f}' for factor in period.factors)}]")
    return {
        "source": source,
        "licence": licence,
        "year": options.year,
        "month": options.month,
        "hours": period.hours,
        "eur_per_mwh": period.eur_per_mwh.round(DIGITS).tolist(),
        "hourly_price": period.factors.round(DIGITS).tolist(),
    }


def main(arguments: list[str] | None = None) -> None:
    parser = benchmark_parser("prices", __doc__)
    text = "wheel with one file of day-ahead prices, or such a CSV file"
    parser.add_argument("file", type=a_path, metavar="FILE", help=text)
    year, month = whole_number(FIRST_YEAR, LAST_YEAR), whole_number(1, 12)
    parser.add_argument(
        "--year", type=year, default=2024, metavar="N", help="local time (default: 2024)"
    )
    parser.add_argument(
        "--month", type=month, metavar="N", help="1 to 12 (default: all months of the year)"
    )
    run_command(parser, measure, arguments)
