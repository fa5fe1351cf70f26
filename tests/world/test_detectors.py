"""Detector counts as demand, and refusals of bad files."""

import numpy as np
import pytest

import medjax
from medjax.errors import InputError
from medjax.traffic.demand import entry_rates

COUNTS = """time_s,entry,vehicles_per_h,speed_m_per_s
0,main,1200,31
0,main,1400,29
0,1,100,18
0,2,0,
900,1,300,18
900,main,1600,30

900,main,1400,30
900,2,0,
"""


@pytest.fixture
def file(tmp_path):
    file = tmp_path / "counts.csv"
    file.write_text(COUNTS)
    return file


def test_counts_are_the_demand(file):
    """Each entry's demand in each interval is its count; lanes add up, and the last interval stays in force."""
    env, params = medjax.make(
        "paper", ramp_x_m=[500, 2000], demand=medjax.read_detectors(file), num_gas=10
    )
    assert env.config.num_periods == 2
    expected = {0: (2600, 100), 899: (2600, 100), 901: (3000, 300), 9e4: (3000, 300)}
    for time_s, (main, first) in expected.items():
        rates = 3600 * np.asarray(entry_rates(params.demand, 4, float(time_s)))
        np.testing.assert_allclose(rates, [*[main / 4] * 4, first, 0.0], rtol=1e-5)


def test_overrides_take_precedence(file):
    """And the recipe records the file's numbers."""
    demand = medjax.read_detectors(file)
    env, params = medjax.make("paper", num_ramps=2, demand=demand, mainline_per_h=100)
    assert float(params.demand.mainline_per_h) == 100
    assert env.recipe.overrides["ramp_per_h"] == [200.0, 0.0]
    _, again = medjax.make("paper", **env.recipe.overrides)
    np.testing.assert_array_equal(again.demand.profile, params.demand.profile)


BAD = {
    "time_s,entry\n0,main\n": "vehicles_per_h",
    "": "columns",
    "time_s,entry,vehicles_per_h\n": "columns",
    COUNTS.replace("1400", "many"): "line 3.*vehicles_per_h = 'many'",
    COUNTS.replace("1400", "-1"): "line 3.*vehicles_per_h = '-1'",
    COUNTS.replace("1400", "nan"): "line 3.*vehicles_per_h = 'nan'",
    COUNTS.replace("0,1,100", "0,ramp,100"): "entry = 'ramp'",
    COUNTS.replace("900,2,0", "900,3,0"): "no row of ramp",
    COUNTS + "1000,main,1,1\n1000,1,1,1\n1000,2,1,1\n": "evenly",
    COUNTS + "1800\n": "line 11: 1 fields, '1800': allowed 4",
    COUNTS.replace("1400,29", "1,400,29"): "line 3: 5 fields, '0,main,1,400,29': allowed 4",
    COUNTS.replace("1400,30", '1400,"30'): "cannot be read: unexpected end",  # swallows the rest
    COUNTS.replace("1400,30\n", '1400,"30"\n900,main,1,"5\n'): "cannot be read: unexpected end",
    COUNTS.replace("900,main,1400,30\n", ""): "line 7: rows of main at time_s = 900: 1; allowed 2",
    COUNTS + "900,1,300,18\n": "line 11: rows of ramp 1 at time_s = 900: 2; allowed 1",
    "time_s,entry,vehicles_per_h\n300,main,1,450\n": "line 2: 4 fields.*allowed 3",
    COUNTS.replace("1400", "1_400"): "line 3.*vehicles_per_h = '1_400'",
    COUNTS.replace("1400", "\u0663"): "line 3.*vehicles_per_h = '\u0663'",
    COUNTS.replace("1400", "1e300"): "line 3.*allowed a number from 0 to 1e.12",
    COUNTS.replace("0,1,100", "0," + "1" * 5000 + ",100"): "entry = '111.*allowed main",
    "time_s,entry,vehicles_per_h,vehicles_per_h\n0,main,5,6\n": "each once",
    "time_s,entry,vehicles_per_h\n0,main,9e11\n0,main,9e11\n": "line 3.*together",
}


@pytest.mark.parametrize("text", BAD, ids=list(BAD.values()))
def test_bad_files_are_refused_in_one_line(file, text):
    """It names line, column, value and what is allowed."""
    file.write_text(text)
    with pytest.raises(InputError, match=BAD[text]) as error:
        medjax.read_detectors(file)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("/nonexistent/counts.csv", "cannot be read"),
        (3, "file 3: allowed a path"),
        (None, "file None"),
        ("a\0b", "printable"),
        ("/dev/zero", "is not a file"),  # which never ends
        (".", "is not a file"),
    ],
)
def test_bad_paths(file, words):
    with pytest.raises(InputError, match=words):
        medjax.read_detectors(file)


def test_ramps_must_be_as_many_as_counted(file):
    with pytest.raises(InputError, match="has shape"):
        medjax.make("paper", demand=medjax.read_detectors(file))
    with pytest.raises(InputError, match="demand"):
        medjax.make("paper", demand=[1, 2])
