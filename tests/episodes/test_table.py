"""The table of an episode against its recording and the environment's tally."""

import numpy as np

from medjax.traffic.road import lateral_position
from medjax.world.kinds import HUMAN_EV
from medjax.world.params import CHARGING_SLOTS


def test_one_row_per_vehicle_and_tick(recording, table):
    active = recording.frames.active
    rows = len(table["time_s"])
    ticks = recording.decisions.stats.vehicle_ticks.sum()  # the environment's own count
    assert rows == active.sum() == ticks + active[0].sum()
    times, counts = np.unique(table["time_s"], return_counts=True)
    present = active.sum(axis=1)
    np.testing.assert_array_equal(times, recording.time_s[present > 0])
    np.testing.assert_array_equal(counts, present[present > 0])


def test_an_id_belongs_to_one_vehicle_from_entry_to_exit(recording, table):
    ids = table["vehicle_id"].data
    stats = recording.decisions.stats
    assert len(np.unique(ids)) == recording.frames.active[0].sum() + stats.entered.sum()
    for number in np.unique(ids):
        own = ids == number
        ticks = np.diff(table["time_s"].data[own])
        np.testing.assert_allclose(ticks, recording.config.tick_s)
        assert len(np.unique(table["kind"].data[own])) == 1
        assert (np.diff(table["x_m"].data[own]) >= 0.0).all()
    first = np.unique(ids, return_index=True)[1]
    np.testing.assert_array_equal(
        np.flatnonzero(table["acceleration_m_per_s2"].mask), np.sort(first)
    )


def test_rows_equal_the_recording(recording, table):
    frames, config = recording.frames, recording.config
    rng = np.random.default_rng(0)
    frame, slot = (rows := np.nonzero(frames.active))
    width = recording.params.road.lane_width_m
    y = lateral_position(frames.lane, frames.lateral_offset, width)
    np.testing.assert_allclose(table["lateral_m"], y[rows], rtol=1e-6)
    for row in rng.choice(len(frame), 300):
        f, s = frame[row], slot[row]
        got = {name: column[row] for name, column in table.items()}
        assert got["time_s"] == f * config.tick_s
        assert got["x_m"] == frames.x[f, s]
        assert got["speed_m_per_s"] == frames.speed[f, s]
        assert got["lateral_speed_m_per_s"] == frames.lateral_speed[f, s]
        ev = s - config.num_meds
        if s < config.num_meds:
            assert got["kind"] == "med"
            assert got["soc"] == frames.med_soc[f, s]
        elif ev < config.num_evs:
            human = frames.kind[f, s] == HUMAN_EV
            assert got["kind"] == ("human_ev" if human else "autonomous_ev")
            assert got["soc"] == frames.ev_soc[f, ev]
            assert got["is_charging"] == frames.ev_is_charging[f, ev]
        else:
            assert got["kind"] == "gas"
            assert got["soc"] is np.ma.masked


def test_booked_meds_are_on_the_road(recording, table):
    booked = ~np.ma.getmaskarray(table["booked_med_id"])
    assert booked.sum() == (recording.frames.ev_med >= 0).sum() > 0
    charging = table["is_charging"].data
    assert charging.sum() == recording.frames.ev_is_charging.sum() > 0
    assert (booked | ~charging).all()
    seen = zip(*(table[name].tolist() for name in ("time_s", "vehicle_id", "kind")), strict=True)
    kinds = {(time, number): kind for time, number, kind in seen}
    for row in np.flatnonzero(booked):
        assert kinds[table["time_s"][row], table["booked_med_id"][row]] == "med"
        assert table["panel"][row] in CHARGING_SLOTS


def test_acceleration_is_the_change_of_speed(recording, table):
    ids, speed = table["vehicle_id"].data, table["speed_m_per_s"].data
    tick = recording.config.tick_s
    for number in np.unique(ids)[:20]:
        own = ids == number
        change = np.diff(speed[own].astype(float)) / tick
        np.testing.assert_allclose(table["acceleration_m_per_s2"][own][1:], change, atol=1e-4)
