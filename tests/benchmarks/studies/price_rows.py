"""Price files as `ev2gym` ships them, for tests."""

from datetime import datetime, timedelta

HEADER = "Country,Datetime (UTC),Datetime (Local),Price (EUR/MWhe)"
ISO, DAY_FIRST = "%Y-%m-%d %H:%M:%S", "%d/%m/%Y %H:%M"
# 01:00 UTC, from the EU's calendars: summer time begins in March and ends in October.
CHANGES = {2023: ((3, 26), (10, 29)), 2024: ((3, 31), (10, 27))}


def local_of(utc):
    spring, autumn = (datetime(utc.year, *date, 1) for date in CHANGES[utc.year])
    return utc + timedelta(hours=2 if spring <= utc < autumn else 1)


def row(utc, style):
    """An hour of the Netherlands; it costs 100 a month, 10 an hour and 1 a day, by local time."""
    local = local_of(utc)
    price = 100 * local.month + 10 * local.hour + local.day
    return f"Netherlands,{utc.strftime(style)},{local.strftime(style)},{price}"


def rows(first, last, style):
    """All hours of days of local time, both included."""
    first, last = datetime(*first), datetime(*last, 23)
    count = 24 * ((last - first).days + 1)
    hours = [first + timedelta(hours=hour) for hour in range(-2, count)]
    return [row(utc, style) for utc in hours if first <= local_of(utc) <= last]


def text_of(*lines):
    return "\r\n".join([HEADER, *lines]) + "\r\n"
