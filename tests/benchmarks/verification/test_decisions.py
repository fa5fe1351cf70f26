"""Every check of `benchmarks.verification.invariants` is shown a fault, and counts that one."""

import functools

import jax
import jax.numpy as jnp
import pytest

import medjax
from benchmarks.verification.books import entry_books
from benchmarks.verification.decisions import SHARES, Decision, check_closing
from benchmarks.verification.invariants import (
    INVARIANTS,
    check_entry,
    check_lanes,
    check_state,
    check_tick,
    count,
    stands_open,
)
from medjax.world.kinds import GAS, KINDS
from medjax.world.params import EnvConfig
from medjax.world.state import AT_DEPOT, IN_SERVICE, NOT_BOOKED, EpisodeStats

pytestmark = pytest.mark.usefixtures("quick_compiles")


def sized(**changes):
    """A world with little energy spent at rest, so that standing still changes nothing."""
    still = {"num_meds": 2, "num_evs": 4, "num_gas": 4}
    still |= {"ev.auxiliary_w": 1e-9, "med.auxiliary_w": 1e-9}
    return medjax.make("paper", **still | changes)


@pytest.fixture(scope="module")
def still():
    """A state in which all stand and nothing is wrong, and its environment and numbers.

    MED 0 is in service at 500 m in lane 2, EVs 0 and 1 are booked on its sides, EV 2 and gas vehicle 0 stand in lane 0.
    """
    env, params = sized()
    _, state = jax.jit(env.reset)(jax.random.key(0), params)
    vehicles, evs, meds = state.vehicles, state.evs, state.meds
    slots = jnp.array([0, 2, 3, 4, 6])  # MED 0, EVs 0 to 2, gas 0
    vehicles = vehicles.replace(
        active=jnp.zeros_like(vehicles.active).at[slots].set(True),
        x=vehicles.x.at[slots].set(jnp.array([500.0, 498.0, 499.0, 300.0, 320.0])),
        lane=vehicles.lane.at[slots].set(jnp.array([2, 1, 3, 0, 0])),
        speed=jnp.zeros_like(vehicles.speed),
        destination=jnp.full_like(vehicles.x, params.road.length_m),
    )
    free = jnp.full((4,), NOT_BOOKED)
    evs = evs.replace(
        energy_j=jnp.full((4,), 0.5 * params.ev_capacity_j),
        med=free.at[:2].set(0),
        panel=free.at[:2].set(jnp.array([0, 1])),
        is_charging=jnp.zeros((4,), bool),
    )
    meds = meds.replace(status=meds.status.at[0].set(IN_SERVICE))
    entered = jnp.zeros((len(KINDS),)).at[vehicles.kind[slots]].add(1.0)
    state = state.replace(vehicles=vehicles, evs=evs, meds=meds, queue=jnp.zeros_like(state.queue))
    return state.replace(tally=EpisodeStats.zeros().replace(entered=entered)), env.config, params


@functools.cache
def counter(check, config_at):
    """Counts of what a check flags, compiled; `config_at`: where its sizes are among its arguments."""

    def counts(*args):
        flags = check(*args)
        return count(flags[0] if isinstance(flags, tuple) else flags)

    return jax.jit(counts, static_argnums=config_at)


def violated(check, *args):
    """Violations that a check counts, by invariant, of those that are not 0."""
    config_at = tuple(i for i, argument in enumerate(args) if isinstance(argument, EnvConfig))
    return {name: int(n) for name, n in counter(check, config_at)(*args).items() if n}


def set_at(state, path, index, value):
    """The state with one entry of the array at `path` (`vehicles.x`) changed."""
    group, leaf = path.split(".")
    member = getattr(state, group)
    changed = getattr(member, leaf).at[index].set(value)
    return state.replace(**{group: member.replace(**{leaf: changed})})


def test_nothing_wrong_is_found_where_nothing_is(still):
    """The scene that the faults below are put into."""
    state, config, params = still
    assert violated(check_state, state, config, params) == {}
    assert violated(check_tick, state, state, config, params) == {}
    assert violated(check_entry, state, state, config, params) == {}


@pytest.mark.parametrize(
    ("path", "index", "value", "invariant"),
    [
        ("vehicles.speed", 6, -0.1, "speed"),
        ("vehicles.x", 6, 4000.1, "road"),
        ("vehicles.x", 6, -0.1, "road"),
        ("vehicles.lane", 6, -1, "road"),
        ("vehicles.lane", 0, 4, "road"),  # 500 m: between the acceleration lanes of two ramps
        ("meds.status", 0, AT_DEPOT, "vehicles"),
        ("meds.status", 1, IN_SERVICE, "vehicles"),
        ("evs.med", 2, 0, "bookings"),  # without a panel
        ("evs.panel", 1, 0, "bookings"),  # the panel that EV 0 has
        ("evs.panel", 1, 4, "bookings"),  # no such panel
        ("evs.is_charging", 2, True, "bookings"),
        ("evs.med", 0, 1, "bookings"),  # a MED at the depot
        ("vehicles.active", 2, False, "bookings"),
        ("evs.energy_j", 3, -1.0, "soc"),
        ("evs.energy_j", 3, 4e6, "soc"),
        ("meds.energy_j", 1, 1e9, "soc"),
        ("vehicles.wander", 9, jnp.nan, "finite"),
        ("meds.ready_in_s", 0, -jnp.inf, "finite"),
        ("evs.timer_s", 0, jnp.inf, "finite"),
    ],
)
def test_a_wrong_state_is_found(still, path, index, value, invariant):
    """Each fault violates its invariant, and no other; a MED that leaves its bookings behind violates both."""
    state, config, params = still
    found = violated(check_state, set_at(state, path, index, value), config, params)
    assert set(found) - ({"bookings"} if path == "meds.status" else set()) == {invariant}


def test_overlaps_and_passing_are_found(still):
    """By bumpers within a lane: the gap between EV 2 and the gas vehicle before it is 15 m."""
    state, _, _ = still
    vehicles, length = state.vehicles, jnp.full((10,), 5.0)

    def moved(slot, x):
        return vehicles.replace(x=vehicles.x.at[slot].set(x))

    assert violated(check_lanes, vehicles, vehicles, length) == {}
    assert violated(check_lanes, vehicles, moved(4, 314.99), length) == {}
    assert violated(check_lanes, vehicles, moved(4, 315.01), length) == {"overlap": 1}
    assert violated(check_lanes, vehicles, moved(4, 330.0), length) == {"passed": 1}
    assert violated(check_lanes, vehicles, moved(4, 320.0), length) == {"overlap": 1}
    beside = moved(4, 320.0).replace(lane=vehicles.lane.at[4].set(1))
    assert violated(check_lanes, vehicles, beside, length) == {}


@pytest.mark.parametrize(
    ("path", "index", "value", "invariant"),
    [
        ("vehicles.x", 6, 320.1, "motion"),
        ("vehicles.x", 6, 319.9, "motion"),
        ("vehicles.speed", 0, 9.5, "motion"),  # from 0 within 0.25 s
        ("vehicles.lane", 6, 2, "motion"),
        ("vehicles.desired_speed", 6, 1.0, "motion"),
        ("vehicles.active", 6, False, "vehicles"),
        ("vehicles.active", 7, True, "vehicles"),
        ("evs.med", 1, 1, "bookings"),
        ("evs.energy_j", 2, lambda e: e + 20.0, "energy"),
        ("evs.energy_j", 2, lambda e: e - 20.0, "energy"),
        ("evs.energy_j", 0, lambda e: e + 20.0, "energy"),  # booked, but no MED gave it
        ("meds.energy_j", 0, lambda e: e - 200.0, "energy"),  # and no EV has charged
        ("meds.energy_j", 1, lambda e: e - 200.0, "energy"),
    ],
)
def test_a_wrong_tick_is_found(still, path, index, value, invariant):
    """20 J is 6e-6 of an EV's battery, 200 J 4e-6 of a MED's."""
    state, config, params = still
    group, leaf = path.split(".")
    old = getattr(getattr(state, group), leaf)[index]
    after = set_at(state, path, index, value(old) if callable(value) else value)
    found = violated(check_tick, state, after, config, params)
    # A speed out of nowhere is energy out of nowhere too.
    assert set(found) - ({"energy"} if path == "vehicles.speed" else set()) == {invariant}


def test_charging_is_held_to_what_a_link_lets_through(still):
    """Of 5 kJ sent arrives what the load's share of load and coil lets through, at most; a slot has a power."""
    state, config, params = still
    before = set_at(state, "meds.energy_j", 0, 0.5 * params.med_capacity_j)
    charging = set_at(before, "evs.served", 0, True)
    sent, link = 5000.0, params.link
    best = float(link.load_ohm / (link.load_ohm + link.ev_resistance_ohm))

    def exchanged(share, sent=sent):
        after = set_at(charging, "meds.energy_j", 0, before.meds.energy_j[0] - sent)
        after = set_at(after, "evs.energy_j", 0, before.evs.energy_j[0] + share * sent)
        return violated(check_tick, before, after, config, params)

    assert exchanged(0.9) == exchanged(0.999 * best) == {}
    assert exchanged(1.03 * best) == {"energy": 1}
    # The only EV that charges draws 40 kW for 0.25 s at most.
    assert exchanged(0.4, sent=9990.0) == {}
    assert exchanged(0.4, sent=10060.0) == {"energy": 1}
    # Nor does it receive more, or all that is sent.
    assert exchanged(1.0, sent=10200.0) == {"energy": 3}


def test_arrivals_are_held_to_entries_and_queues(still):
    """Who comes stands at an entry; one at an entry; a queue shrinks by who came."""
    state, config, params = still
    came = set_at(state, "vehicles.active", 7, True)
    came = set_at(set_at(came, "vehicles.lane", 7, 3), "vehicles.x", 7, 0.0)
    waits = state.replace(queue=state.queue.at[3].set(1))

    def found(before, begun):
        return violated(check_entry, before, begun, config, params)

    assert found(waits, came) == {}
    assert found(waits, state) == {"vehicles": 1}
    assert found(waits, set_at(came, "vehicles.x", 7, 1.0)) == {"vehicles": 2}
    twice = set_at(came, "vehicles.active", 8, True)
    twice = set_at(set_at(twice, "vehicles.lane", 8, 3), "vehicles.x", 8, 0.0)
    assert found(waits, twice) == {"vehicles": 1}
    assert found(state, set_at(state, "vehicles.x", 6, 321.0)) == {"motion": 1}
    assert found(state, set_at(state, "evs.panel", 0, 2)) == {"bookings": 1}
    assert found(state, set_at(state, "evs.energy_j", 3, 7.0)) == {"energy": 1}


def closing(still, after=None, obs=0.0, reward=0.0, terms=None, tally=None, share=0.5):
    """What is violated in a decision in which nothing happens, but for what is given."""
    state, config, params = still
    params = params.replace(reward_weights=dict.fromkeys(params.reward_weights, 0.0))
    books = entry_books(state, state, params.road.length_m)
    tally = EpisodeStats.zeros().replace(**tally or {})
    after = after or state.replace(tally=state.tally + tally)
    terms = dict.fromkeys(params.reward_weights, jnp.zeros(())) | (terms or {})
    info = {"tally": tally, "reward_terms": terms, "metrics": dict.fromkeys(SHARES, share)}
    decision = Decision(state, after, jnp.float32(obs), jnp.float32(reward), info)
    return violated(check_closing, state, decision, books, config, params)


def test_a_wrong_outcome_is_found(still):
    """Rewards, tallies and what changes between two decisions."""
    state, _, _ = still
    assert closing(still) == {}
    assert closing(still, obs=jnp.inf) == {"finite": 1}
    assert closing(still, reward=0.1) == {"reward": 1}
    assert closing(still, share=jnp.float32(1.001)) == {"tally": len(SHARES)}
    weightless = {"soc": jnp.float32(0.1)}
    assert closing(still, reward=0.1, terms=weightless) == {"reward": 1}
    names = ["lane_changes", "depleted", "vehicle_ticks", "collisions", "ev_distance_m"]
    for name in [*names, "ev_delay_s", "gas_delay_s", "med_seconds", "low_exits"]:
        found = closing(still, tally={name: jnp.float32(1.0)})
        assert found.pop("tally") == 1
        assert set(found) <= {"vehicles"}  # a depleted one is then missing
    flows = ["energy_sent_j", "energy_received_j", "ev_driving_j", "ev_cruising_j", "med_driving_j"]
    for name in flows:
        assert closing(still, tally={name: jnp.float32(20.0)}) == {"energy": 1}
    lost = state.replace(tally=state.tally.replace(entered=state.tally.entered.at[GAS].add(1.0)))
    assert closing(still, after=lost) == {"vehicles": 1, "tally": 1}
    assert closing(still, after=set_at(state, "vehicles.speed", 0, 1.0)) == {"motion": 1}
    assert closing(still, after=set_at(state, "meds.energy_j", 1, 1.0)) == {"energy": 1}


def test_who_stands_on_an_open_road_is_seen(still):
    """Gas vehicle 0 and those beside the MED, with nobody ahead; EV 2 stands 15 m behind; without energy one may."""
    state, config, params = still

    def standing(state):
        return set(jnp.flatnonzero(stands_open(state, config, params)).tolist())

    assert standing(state) == {0, 2, 3, 6}
    assert standing(set_at(state, "vehicles.speed", 6, 0.6)) == {0, 2, 3}
    assert standing(set_at(state, "evs.is_depleted", 0, True)) == {0, 3, 6}
    assert standing(set_at(state, "vehicles.x", 6, 380.0)) == {0, 2, 3, 4, 6}
    assert standing(set_at(state, "vehicles.lane", 6, config.num_lanes)) == {0, 2, 3, 4}


def test_every_invariant_is_shown_to_fail():
    """No invariant without a fault above that violates it."""
    shown = set()
    for test in (test_a_wrong_state_is_found, test_a_wrong_tick_is_found):
        (mark,) = [mark for mark in test.pytestmark if mark.name == "parametrize"]
        shown |= {fault[-1] for fault in mark.args[1]}
    others = {"overlap", "boxes", "passed", "reward", "tally", "standing"}
    assert shown | others == set(INVARIANTS)
