"""Day-ahead prices of every hour from a CSV file, or from a wheel that holds one.

The columns are `COLUMNS`; others are ignored. Dates are ISO (`2023-09-05 00:00:00`) or day first (`05/09/2024 00:00`):
the file in `ev2gym` 2.0.0 has 2015 to September 2023 in the first style, then 2023 to 7 January 2025 in the second.
Nothing is guessed: the rows of a style must be in order, and each row's local time must be what the EU's daylight
saving time makes of its UTC. A day that is read as a month fails at once.
"""

import csv
import functools
import io
import math
import re
import zipfile
import zlib
from collections.abc import Iterator
from datetime import datetime, timedelta
from email.parser import HeaderParser
from pathlib import Path
from typing import NamedTuple

from medjax.errors import InputError, shown
from medjax.files import check_input

COLUMNS = ("Datetime (UTC)", "Datetime (Local)", "Price (EUR/MWhe)")
_TIME = "(?P<hour>[0-9]{2}):00(:00)?"
STYLES = {
    "ISO": re.compile(f"(?P<year>[0-9]{{4}})-(?P<month>[0-9]{{2}})-(?P<day>[0-9]{{2}}) {_TIME}"),
    "day first": re.compile(
        f"(?P<day>[0-9]{{2}})/(?P<month>[0-9]{{2}})/(?P<year>[0-9]{{4}}) {_TIME}"
    ),
}
PARTS = ("year", "month", "day", "hour")
HOUR = timedelta(hours=1)
MOST_ZONE_H = 2  # standard time in the EU is 0 to 2 h ahead of UTC
MOST_PRICE = 1e4  # EUR/MWh, of either sign; the exchanges' own limits are -500 and 4000 or 5000
MOST_BYTES = 10**8
MIT = ("MIT", "MIT License", "License :: OSI Approved :: MIT License")
METADATA = ("*.dist-info/METADATA", re.compile(r"[^/]+\.dist-info/METADATA"))
MEMBER = ("*day-ahead*.csv", re.compile(r"(.*/)?[^/]*day-ahead[^/]*\.csv"))
# RuntimeError: the wheel is encrypted, or compressed in a way that zipfile does not know.
BROKEN = (OSError, EOFError, zipfile.BadZipFile, zlib.error, UnicodeDecodeError, RuntimeError)


class PriceText(NamedTuple):
    """A CSV file's text and where it comes from."""

    source: str  # package, version and file, or the file's name alone
    licence: str | None  # of the package, checked; a CSV file states none
    text: str


class Prices(NamedTuple):
    """Prices by the hour."""

    eur_per_mwh: dict[datetime, float]  # by the start of the hour, UTC
    zone_h: int  # standard time, hours ahead of UTC
    repeated: int  # hours that stand in both styles of dates, with the same price
    undated: int  # rows without a date, left out


class Row(NamedTuple):
    """A row of the file."""

    place: str  # for messages
    style: str  # a key of STYLES
    utc: datetime
    zone_h: int
    price: float  # EUR/MWh


def read_text(path: Path) -> PriceText:
    """Reads a CSV file, or the only CSV file of day-ahead prices in a wheel.

    Raises:
      InputError: the file is missing, too large or of another kind, or the wheel's licence is not MIT.
    """
    if path.suffix not in (".csv", ".whl"):
        raise InputError(f"file {path}: allowed a file whose name ends in .csv or .whl")
    check_input("file", path)
    try:
        if path.suffix == ".csv":
            _check_size(path, path.stat().st_size)
            return PriceText(path.name, None, path.read_text(encoding="utf-8-sig"))
        with zipfile.ZipFile(path) as wheel:
            package, licence = _licence(path, _member(path, wheel, *METADATA)[1])
            name, text = _member(path, wheel, *MEMBER)
            return PriceText(f"{package}, {name}", licence, text)
    except BROKEN as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"file {path}: {reason}; allowed a CSV file or a wheel") from None


def _member(
    path: Path, wheel: zipfile.ZipFile, pattern: str, kind: re.Pattern[str]
) -> tuple[str, str]:
    """Name and text of the wheel's only file of a kind."""
    found = [member for member in wheel.infolist() if kind.fullmatch(member.filename)]
    if len(found) != 1:
        raise InputError(f"file {path}: has {len(found)} files {pattern}: allowed 1")
    _check_size(path, found[0].file_size)
    return found[0].filename, wheel.read(found[0]).decode("utf-8-sig")


def _check_size(path: Path, size: int) -> None:
    if size > MOST_BYTES:
        raise InputError(f"file {path}: {size} bytes: allowed up to {MOST_BYTES}")


def _licence(path: Path, metadata: str) -> tuple[str, str]:
    """Name with version of a wheel's package, and its licence, MIT."""
    fields = HeaderParser().parsestr(metadata)
    stated = [
        *fields.get_all("License-Expression", []),
        *fields.get_all("License", []),
        *(text for text in fields.get_all("Classifier", []) if text.startswith("License ::")),
    ]
    if not stated or not set(stated) <= set(MIT):
        raise InputError(f"file {path}: licence {shown('; '.join(stated))}: allowed MIT")
    return f"{fields['Name']} {fields['Version']}", "MIT"


def parse_prices(name: str, text: str) -> Prices:
    """Parses the text of a CSV file.

    Args:
      name: of the file, for messages.
      text: a header, then a row per hour. Rows whose dates are empty are left out.

    Raises:
      InputError: a column is missing, a value is no date or price, local time and UTC do not fit, an hour comes twice
        or out of order in one style of dates, or has another price in the other style.
    """
    prices: dict[datetime, float] = {}
    latest: dict[str, datetime] = {}  # by style
    zone_h, dated, undated = None, 0, 0
    for row in _rows(name, text):
        if row is None:
            undated += 1
            continue
        dated += 1
        if row.utc <= latest.setdefault(row.style, row.utc - HOUR):
            said = f"{row.utc} UTC after {latest[row.style]} UTC"
            raise InputError(f"{row.place}: {said}: allowed every hour once, in order")
        latest[row.style] = row.utc
        zone_h = row.zone_h if zone_h is None else zone_h
        if row.zone_h != zone_h:
            said = f"standard time is {row.zone_h} h ahead of UTC"
            raise InputError(f"{row.place}: {said}: allowed {zone_h} h, as before")
        if prices.setdefault(row.utc, row.price) != row.price:
            said = f"{row.utc} UTC costs {row.price:g} EUR/MWh"
            raise InputError(f"{row.place}: {said}: allowed {prices[row.utc]:g}, as before")
    if zone_h is None:
        raise InputError(f"file {name}: has no prices: allowed a row per hour")
    return Prices(prices, zone_h, dated - len(prices), undated)


def _rows(name: str, text: str) -> Iterator[Row | None]:
    """The rows below the header; None for one without dates."""
    table = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        header = next(table, [])
        if any(header.count(column) != 1 for column in COLUMNS):
            needed = f"a CSV file with columns {', '.join(COLUMNS)}, each once"
            raise InputError(f"file {name}: columns {shown(','.join(header))}: allowed {needed}")
        where = [header.index(column) for column in COLUMNS]
        for fields in table:
            place = f"{name}, line {table.line_num}"
            if fields and len(fields) != len(header):
                said = f"{place}: {len(fields)} fields, {shown(','.join(fields))}"
                raise InputError(f"{said}: allowed {len(header)}, as in the header")
            if fields:
                yield _row(place, *(fields[column] for column in where))
    except csv.Error as error:
        raise InputError(f"file {name}: {error}; allowed a CSV file") from None


def _row(place: str, utc_text: str, local_text: str, price_text: str) -> Row | None:
    if not utc_text and not local_text:
        return None
    style, utc = _date(place, utc_text)
    _, local = _date(place, local_text)
    summer_h = int(is_summer(utc))
    zone_h = (local - utc) / HOUR - summer_h
    if zone_h not in range(MOST_ZONE_H + 1):
        ahead = f"{summer_h} to {MOST_ZONE_H + summer_h} h ahead, as in the EU on that day"
        raise InputError(f"{place}: local {shown(local_text)} at {utc} UTC: allowed {ahead}")
    return Row(place, style, utc, int(zone_h), _price(place, price_text))


def _date(place: str, text: str) -> tuple[str, datetime]:
    """The style of a date, and the date."""
    for style, pattern in STYLES.items():
        if found := pattern.fullmatch(text):
            year, month, day, hour = (int(found[part]) for part in PARTS)
            try:
                return style, datetime(year, month, day, hour)
            except ValueError:  # such as the 13th month
                break
    allowed = "allowed a full hour such as 2023-09-05 00:00:00, or day first, 05/09/2023 00:00"
    raise InputError(f"{place}: date {shown(text)}: {allowed}")


def _price(place: str, text: str) -> float:
    try:  # `float` also accepts digits of other scripts, and 1_000
        value = float(text) if text.isascii() and "_" not in text else math.nan
    except ValueError:
        value = math.nan
    if not abs(value) <= MOST_PRICE:
        allowed = f"allowed a number of EUR/MWh from {-MOST_PRICE:g} to {MOST_PRICE:g}"
        raise InputError(f"{place}: price {shown(text)}: {allowed}")
    return value


def is_summer(utc: datetime) -> bool:
    """Whether daylight saving time holds in the EU (Directive 2000/84/EC)."""
    return _last_sunday(utc.year, 3) <= utc < _last_sunday(utc.year, 10)


@functools.cache
def _last_sunday(year: int, month: int) -> datetime:
    """01:00 UTC on the last Sunday of a month of 31 days."""
    last = datetime(year, month, 31, 1)
    return last - timedelta(days=last.isoweekday() % 7)


def local_time(utc: datetime, zone_h: int) -> datetime:
    """Local time in the EU.

    Args:
      utc: the time in UTC.
      zone_h: standard time, hours ahead of UTC.
    """
    return utc + (zone_h + is_summer(utc)) * HOUR
