"""The player's file: its contents, its size, and bad input."""

import base64
import dataclasses
import gzip
import json
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from medjax.render.episode_data import charts_of
from medjax.render.packing import MISSING, Packer
from medjax.render.player import player_page, write_player
from medjax.render.tracks import tracks_of
from tests.render.made import TICKS, blank

MEGABYTE = 1e6


def unpacked(index, text):
    """Second implementation of `web/packing.js`: undoes each step of `Packer`."""
    raw = gzip.decompress(base64.b64decode(text))
    tables, start = {}, 0
    for entry in index:
        shape = entry["rows"], entry["times"]
        size = 4 * shape[0] * shape[1]
        planes = np.frombuffer(raw[start : start + size], np.uint8).reshape(4, -1)
        folded = np.ascontiguousarray(planes.T).view("<u4").ravel().astype(np.int64)
        whole = np.where(folded % 2, -(folded + 1) // 2, folded // 2).reshape(shape)
        for _ in range(entry["order"]):
            whole = np.cumsum(whole, axis=1)
        whole = (whole + 2**31) % 2**32 - 2**31
        tables[entry["name"]] = np.where(whole == MISSING, np.nan, whole * entry["step"])
        start += size
    assert start == len(raw)
    return tables


@given(
    values=arrays(np.float64, (3, 7), elements=st.floats(-2e7, 2e7) | st.just(np.nan)),
    order=st.integers(0, 3),
)
def test_unpacked_numbers_are_within_half_a_step(values, order):
    packer = Packer()
    packer.add("a", values, 0.01, order)
    packer.add("b", np.arange(4)[None])
    tables = unpacked(packer.index, packer.text())
    np.testing.assert_allclose(tables["a"], values, atol=0.005 + 1e-7, rtol=0, equal_nan=True)
    np.testing.assert_array_equal(tables["b"], [[0, 1, 2, 3]])


def test_a_number_too_large_for_its_step_is_refused():
    with pytest.raises(ValueError, match=r"^x holds 3e\+07: allowed"):
        Packer().add("x", np.array([[3e7]]), 0.01)


def contents(page):
    """(facts, tables) of the first episode of a page."""
    meta = json.loads(re.search(r'id="meta">(.*?)</script>', page, re.DOTALL)[1])
    text = re.search(r'id="data-0">(.*?)</script>', page, re.DOTALL)[1]
    return meta, unpacked(meta["episodes"][0]["arrays"], text)


@pytest.mark.thorough
def test_the_page_holds_the_recording(recording):
    meta, tables = contents(player_page([recording]))
    frames, there = recording.frames, recording.frames.active.T
    for name, values, step in (("x", frames.x, 0.01), ("speed", frames.speed, 0.01)):
        np.testing.assert_allclose(tables[name][there], values.T[there], atol=0.501 * step)
    np.testing.assert_allclose(tables["evSoc"], frames.ev_soc.T, atol=0.51e-4)
    np.testing.assert_array_equal(tables["evCharging"], frames.ev_is_charging.T)
    decisions = recording.decisions
    np.testing.assert_allclose(tables["probability"], decisions.probabilities.T, atol=0.51e-4)
    assert len(meta["episodes"][0]["tracks"]) == len(tracks_of(recording))
    titles = [chart["title"] for chart in meta["episodes"][0]["charts"]]
    assert titles == [chart.title for chart in charts_of(recording)]
    assert titles


@pytest.mark.thorough
def test_the_page_holds_any_reward(recording):
    """Large ones are rounded to more than 1e-4, and there need be no terms."""
    large = recording.decisions.reward * 1e9
    decisions = recording.decisions.replace(reward=large, reward_terms={})
    _, tables = contents(player_page([dataclasses.replace(recording, decisions=decisions)]))
    most = np.abs(large).max()
    assert most > 2**31 * 1e-4
    np.testing.assert_allclose(tables["reward"][0], large, atol=most / 2**30)
    assert tables["terms"].shape == (0, len(large))


def test_charts_end_at_the_totals_of_the_episode(recording):
    charts = {chart.title: chart.values for chart in charts_of(recording)}
    stats, decisions = recording.decisions.stats, recording.decisions
    assert charts["EVs that ran out"][0, -1] == stats.depleted.sum()
    assert charts["Return so far"][0, -1] == pytest.approx(decisions.reward.sum(), rel=1e-5)
    sent = stats.energy_sent_j.sum() / 3.6e6
    assert charts["Energy through the coils"][:, -1].sum() == pytest.approx(sent, rel=1e-5)
    assert sent > 0
    evs, last = recording.config.ev_slots, recording.frames
    there = last.active[-1, evs]
    assert charts["Mean charge of EVs"][0, -1] == pytest.approx(100 * last.ev_soc[-1][there].mean())
    assert all(values.shape[1] == 91 for values in charts.values())


def test_means_over_nobody_are_gaps():
    empty = blank(1 + TICKS)
    assert np.isnan(charts_of(empty)[0].values).all()
    assert np.isnan(contents(player_page([empty]))[1]["chart0"]).all()


def test_600_decisions_of_a_full_highway_stay_under_8_megabytes(full, tmp_path):
    write_player(tmp_path / "two.html", [full, dataclasses.replace(full, policy="again")])
    assert (tmp_path / "two.html").stat().st_size < 8 * MEGABYTE
    assert len(player_page([full])) < 4 * MEGABYTE


def test_the_page_is_self_contained_and_reproducible(recording):
    """And no title breaks it."""
    page = player_page([recording])
    assert page == player_page([recording])
    assert not re.search(r"https?:|@import|\bsrc=|<link(?! rel=.icon. href=.data:)|fetch\(", page)
    assert not re.findall(r"<!--[A-Z]+-->", page)
    page = player_page([dataclasses.replace(recording, policy="</script><b>&")])
    assert "</script><b>" not in page
    assert "&lt;/script&gt;&lt;b&gt;&amp;" in page


def test_bad_input_leaves_the_old_file(recording, other, tmp_path):
    out = tmp_path / "a.html"
    out.write_text("old")
    late, another = (dataclasses.replace(other, **each) for each in ({"seed": 9}, {"episode": 2}))
    same = "allowed two recordings of the same episode"
    for recordings, how, says in (
        ([recording], {"follow": "MED:99"}, "follow = MED:99: allowed MED numbers"),
        ([recording], {"start_s": 91.0}, "start = 91 s: allowed 0 to 90 s"),
        ([recording, late], {}, f"seed is 3 and 9: {same}$"),
        ([recording, another], {}, f"episode is 9 and 2: {same}$"),
        ([recording] * 3, {}, "3 recordings: allowed 1 or 2"),
    ):
        with pytest.raises(ValueError, match=f"^{says}"):
            write_player(out, recordings, **how)
    assert out.read_text() == "old"
    assert list(tmp_path.iterdir()) == [out]
