"""`benchmarks.prices`: means by hand in both styles of dates, daylight saving time, and what is refused."""

import json
import zipfile
from datetime import datetime, timedelta

import numpy as np
import pytest

import medjax
from benchmarks.studies import price_file, prices
from benchmarks.studies.price_file import is_summer, parse_prices
from medjax.commandline import parse_overrides
from medjax.errors import InputError
from tests.benchmarks.refusal import refused
from tests.benchmarks.studies.price_rows import (
    CHANGES,
    DAY_FIRST,
    ISO,
    row,
    rows,
    text_of,
)

HOURS = np.arange(24)


def both_styles():
    """As in ev2gym's file: ISO, a row without dates, then day first from before the ISO rows end."""
    iso = rows((2023, 9, 1), (2023, 10, 2), ISO)
    return text_of(*iso, "Netherlands,,,0.0", *rows((2023, 9, 20), (2023, 11, 2), DAY_FIRST))


def june():
    """Day first, from midnight in the Netherlands."""
    return rows((2024, 6, 1), (2024, 6, 30), DAY_FIRST)


def run(tmp_path, text, *argv):
    """Runs the command on a file with the text; returns the report that it writes."""
    file, report = tmp_path / "prices.csv", tmp_path / "report.json"
    file.write_text(text)
    prices.main([str(file), f"--json={report}", *argv])
    return json.loads(report.read_text())


def wheel(path, licence="Classifier: License :: OSI Approved :: MIT License", names=("nl",)):
    """A wheel with a file of prices for each name."""
    with zipfile.ZipFile(path, "w") as file:
        metadata = f"Metadata-Version: 2.4\nName: ev2gym\nVersion: 2.0.0\n{licence}\n\nLicense: GPL"
        file.writestr("ev2gym-2.0.0.dist-info/METADATA", metadata)
        for name in names:
            file.writestr(f"ev2gym/data/{name}_day-ahead-2015.csv", text_of(*june()))
    return path


def test_days_of_summer_time():
    """The first and the last hour, of the years in `CHANGES`."""
    for year, (spring, autumn) in CHANGES.items():
        for date, before in ((spring, False), (autumn, True)):
            change = datetime(year, *date, 1)
            assert is_summer(change - timedelta(hours=1)) == before
            assert is_summer(change) == (not before)


def test_means_by_hand_in_both_styles(tmp_path):
    """September is in ISO dates and day first, October day first; its hour 2 comes twice on the 29th."""
    text = both_styles()
    found = run(tmp_path, text, "--year=2023", "--month=9")
    assert found["hours"] == 30 * 24
    np.testing.assert_allclose(found["eur_per_mwh"], 900 + 10 * HOURS + 15.5)
    np.testing.assert_allclose(found["hourly_price"], (915.5 + 10 * HOURS) / 1030.5, atol=1e-6)
    found = run(tmp_path, text, "--year=2023", "--month=10")
    assert found["hours"] == 31 * 24 + 1
    means = 1000.0 + 10 * HOURS + 16
    means[2] = 1020 + (16 * 31 + 29) / 32
    mean = ((1131 * 31 * 24) + 1020 + 29) / (31 * 24 + 1)
    np.testing.assert_allclose(found["eur_per_mwh"], means, atol=1e-6)
    np.testing.assert_allclose(found["hourly_price"], means / mean, atol=1e-6)


def test_the_year_has_every_hour_once(tmp_path, capsys):
    """One is gone: it is named and left out. Hour 2 lacks one in spring and has one more in autumn."""
    lines = rows((2024, 1, 1), (2024, 12, 31), DAY_FIRST)
    del lines[-24]
    found = run(tmp_path, text_of(*lines), "--year=2024")
    assert (found["year"], found["month"], found["hours"]) == (2024, None, 366 * 24 - 1)
    assert "without a price, left out: 2024-12-31 00:00\n" in capsys.readouterr().out
    days = [datetime(2024, 1, 1) + timedelta(days=day) for day in range(366)]
    base = np.array([100 * day.month + day.day for day in days])
    means = base.mean() + 10.0 * HOURS
    means[0] = base[:-1].mean()
    means[2] = 20 + (base.sum() - 331 + 1027) / 366
    np.testing.assert_allclose(found["eur_per_mwh"], means, atol=1e-6)


def month_first(place, text):
    """As pandas reads a date by default: the month first where there is such a month."""
    try:
        return "swapped", datetime.strptime(text, "%m/%d/%Y %H:%M")
    except ValueError:
        return "swapped", datetime.strptime(text, DAY_FIRST)


def test_a_day_is_not_read_as_a_month(tmp_path, monkeypatch):
    """Swapped, the first twelve days of June would be the sixth of each month; such a reading is refused, too."""
    text = text_of(*rows((2024, 1, 1), (2024, 12, 31), DAY_FIRST))
    found = run(tmp_path, text, "--month=6")
    by_hand, swapped = 600 + 15.5, (100 * 78 + 12 * 6 + 18 * 600 + sum(range(13, 31))) / 30
    assert swapped == pytest.approx(by_hand + 19.8)
    np.testing.assert_allclose(found["eur_per_mwh"], by_hand + 10 * HOURS)
    monkeypatch.setattr(price_file, "_date", month_first)
    for line in (text, text_of(*june())):
        with pytest.raises(InputError, match=r"line [0-9]+: local '../../2024 00:00' at"):
            parse_prices("swapped.csv", line)


@pytest.mark.usefixtures("quick_compiles")
def test_the_output_is_for_make(tmp_path, capsys):
    """The list in the file, and the last line for `--set`; the table has both columns."""
    found = run(tmp_path, text_of(*june()), "--month=6")
    params = medjax.make("corridor", hourly_price=found["hourly_price"])[1]
    np.testing.assert_allclose(params.market.hourly_price, (615.5 + 10 * HOURS) / 730.5, rtol=1e-5)
    out = capsys.readouterr().out
    assert "2024-06: 720 hours, mean 730.50 EUR/MWh\n" in out
    assert "   7   685.50   0.938\n" in out
    again = medjax.make("corridor", **parse_overrides([out.splitlines()[-1]]))[1]
    np.testing.assert_allclose(again.market.hourly_price, params.market.hourly_price, atol=5.1e-4)


@pytest.mark.parametrize(
    "licence", ["Classifier: License :: OSI Approved :: MIT License", "License-Expression: MIT"]
)
def test_a_wheel_states_source_and_licence(licence, tmp_path, capsys):
    """A CSV file states neither."""
    report = tmp_path / "report.json"
    prices.main([str(wheel(tmp_path / "ev.whl", licence)), "--month=6", f"--json={report}"])
    found = json.loads(report.read_text())
    source = "ev2gym 2.0.0, ev2gym/data/nl_day-ahead-2015.csv"
    assert (found["source"], found["licence"]) == (source, "MIT")
    assert f"source: {source}\nlicence: MIT\n" in capsys.readouterr().out
    bare = run(tmp_path, text_of(*june()), "--month=6")
    assert (bare["source"], bare["licence"]) == ("prices.csv", None)
    for key in ("hours", "eur_per_mwh", "hourly_price"):
        assert bare[key] == found[key]


def test_notes_say_what_the_file_is_like(tmp_path, capsys):
    """Hours in both styles with one price, and rows without dates."""
    run(tmp_path, both_styles(), "--year=2023", "--month=10")
    out = capsys.readouterr().out
    assert f"{13 * 24} hours of the file come twice, with the same price\n" in out
    assert "rows of the file without a date, left out: 1\n" in out
    assert "without a price" not in out


def edited(old, new):
    """June with a change in line 7, 01/06/2024 03:00 UTC, 05:00 in the Netherlands, which costs 651."""
    lines = june()
    assert old in lines[5]
    lines[5] = lines[5].replace(old, new)
    return text_of(*lines)


def priced(by_hour, otherwise):
    """June with other prices by the local hour."""
    start = [line.rpartition(",")[0] for line in june()]
    return text_of(*(f"{line},{by_hour.get(int(line[-5:-3]), otherwise)}" for line in start))


BAD_TEXTS = {
    "a month that is not there": (
        text_of(*june()[: 24 * 20]),
        "2024-06: 240 of 720 hours",
        "lack at most 1",
    ),
    "two hours missing": (text_of(*june()[:99], *june()[101:]), "2024-06: 2 of 720 hours"),
    "an hour twice": (text_of(*june()[:29], *june()[28:]), "line 31", "every hour once, in order"),
    "out of order": (text_of(*june()[99:], *june()[:99]), "line 623", "every hour once, in order"),
    "two prices": (
        text_of(*june(), row(datetime(2024, 6, 1, 3), ISO).replace("651", "9")),
        *("costs 9 EUR/MWh", "allowed 651, as before"),
    ),
    "no price": (edited(",651", ",nan"), "line 7: price 'nan'"),
    "a text": (edited(",651", ",dear"), "line 7: price 'dear'"),
    "other digits": (edited(",651", ",6_51"), "line 7: price '6_51'"),
    "too dear": (edited(",651", ",10001"), "line 7: price '10001'", "-10000 to 10000"),
    "a 13th month": (edited("01/06/2024 03", "06/13/2024 03"), "date '06/13/2024 03:00'"),
    "no full hour": (edited("03:00", "03:15"), "date '01/06/2024 03:15'", "full hour"),
    "one date": (edited("01/06/2024 03:00", ""), "line 7: date ''"),
    "no summer time": (
        edited("05:00", "03:00"),
        *("line 7: local '01/06/2024 03:00'", "1 to 3 h ahead"),
    ),
    "another zone": (edited("05:00", "06:00"), "line 7: standard time is 2 h", "allowed 1 h"),
    "too few fields": (edited(",651", ""), "line 7: 3 fields", "allowed 4"),
    "an open quote": (edited("651", '"651'), "allowed a CSV file"),
    "no column of prices": (
        text_of(*june()).replace("EUR", "GBP", 1),
        "columns",
        "Price (EUR/MWhe)",
    ),
    "no rows": (text_of(), "has no prices"),
    "nothing": ("", "columns ''"),
    "nothing to pay": (priced({}, -1), "mean price -1 EUR/MWh", "above 0"),
    "beyond hourly_price": (priced({5: 1000, 6: -999}, 0), "mean price 0.04", "-100 to 100"),
}


@pytest.mark.parametrize("name", BAD_TEXTS)
def test_bad_files_are_one_line(name, tmp_path, capsys):
    """Exit code 2; what, the value and what is allowed."""
    text, *words = BAD_TEXTS[name]
    file = tmp_path / "prices.csv"
    file.write_text(text)
    error = refused(prices.main, [str(file), "--month=6"], capsys)
    assert "allowed" in error
    for word in words:
        assert word in error, error


def test_bad_wheels_are_one_line(tmp_path, capsys):
    """A licence other than MIT or none, two files of prices or none, and what is no wheel."""
    (tmp_path / "text.whl").write_text("no zip")
    (tmp_path / "cut.whl").write_bytes(wheel(tmp_path / "whole.whl").read_bytes()[:-100])
    (tmp_path / "folder.whl").mkdir()
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x80")
    gpl = "License-Expression: MIT\nClassifier: License :: OSI Approved :: GNU GPL"
    wheel(tmp_path / "gpl.whl", gpl)
    wheel(tmp_path / "none.whl", "Keywords: MIT")
    wheel(tmp_path / "two.whl", names=("nl", "de"))
    wheel(tmp_path / "bare.whl", names=())
    said = {
        "text.whl": "not a zip file",
        "cut.whl": "not a zip file",
        "folder.whl": "allowed a file",
        "bytes.csv": "allowed a CSV file or a wheel",
        "gpl.whl": "GNU GPL': allowed MIT",
        "none.whl": "licence '': allowed MIT",
        "two.whl": "has 2 files *day-ahead*.csv: allowed 1",
        "bare.whl": "has 0 files *day-ahead*.csv: allowed 1",
        "nowhere.whl": "No such file or directory",
        "prices.txt": "ends in .csv or .whl",
    }
    for name, words in said.items():
        error = refused(prices.main, [str(tmp_path / name)], capsys)
        assert words in error, error


@pytest.mark.parametrize("argv", [["--month=0"], ["--month=13"], ["--year=1996"], ["--year=2101"]])
def test_bad_options_are_one_line(argv, tmp_path, capsys):
    """Before the file is read."""
    error = refused(prices.main, [str(tmp_path / "nowhere.csv"), *argv], capsys)
    assert f"{argv[0].split('=')[1]!r}: allowed a whole number" in error


def test_files_beyond_the_limit_are_refused(tmp_path, monkeypatch, capsys):
    """A wheel's file by what it unpacks to."""
    monkeypatch.setattr(price_file, "MOST_BYTES", 1000)
    (tmp_path / "large.csv").write_text(text_of(*june()))
    for file in (tmp_path / "large.csv", wheel(tmp_path / "large.whl")):
        assert "bytes: allowed up to 1000" in refused(prices.main, [str(file)], capsys)
