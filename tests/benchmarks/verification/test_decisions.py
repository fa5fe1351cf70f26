"""Every check of `benchmarks.verification` finds a fault that is put before it, and only that one."""

import functools
import operator
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import pytest

import medjax
from benchmarks.verification.decisions import (
    SHARES,
    Decision,
    check_results,
    seconds_at_plugs,
    with_means,
)
from benchmarks.verification.invariants import (
    INVARIANTS,
    check_entry,
    check_lanes,
    check_state,
    check_tick,
    count,
    stands_open,
)
from benchmarks.verification.ledger import entry_ledger, tick_ledger
from medjax.world.kinds import GAS, KINDS
from medjax.world.params import EnvConfig
from medjax.world.state import AT_DEPOT, IN_SERVICE, NOT_BOOKED, EpisodeStats

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.fixture(scope="module")
def still():
    """A state in which all stand and nothing is wrong, and its sizes and numbers.

    MED 0 is in service at 500 m in lane 2, EVs 0 and 1 are booked on its sides, EV 2 and gas vehicle 0 stand in lane 0.
    Hardly any energy is spent at rest, so that standing still changes nothing.
    """
    rest = {"ev.auxiliary_w": 1e-9, "med.auxiliary_w": 1e-9}
    env, params = medjax.make("paper", num_meds=2, num_evs=4, num_gas=4, **rest)
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
    evs = evs.replace(
        energy_j=jnp.full((4,), 0.5 * params.ev_capacity_j),
        med=jnp.array([0, 0, NOT_BOOKED, NOT_BOOKED]),
        charging_slot=jnp.array([0, 1, NOT_BOOKED, NOT_BOOKED]),
        is_charging=jnp.zeros((4,), bool),
    )
    meds = meds.replace(status=meds.status.at[0].set(IN_SERVICE))
    entered = jnp.zeros((len(KINDS),)).at[vehicles.kind[slots]].add(1.0)
    state = state.replace(vehicles=vehicles, evs=evs, meds=meds, queue=jnp.zeros_like(state.queue))
    return state.replace(stats=EpisodeStats.zeros().replace(entered=entered)), env.config, params


@functools.cache
def counter(check, config_at):
    """Counts of what a check flags, compiled; `config_at`: the position of the sizes among its arguments."""

    def counts(*args):
        flags = check(*args)
        return count(flags[0] if isinstance(flags, tuple) else flags)

    return jax.jit(counts, static_argnums=config_at)


def violated(check, *args):
    """Nonzero counts of a check, by invariant."""
    config_at = tuple(i for i, argument in enumerate(args) if isinstance(argument, EnvConfig))
    counts = counter(check, config_at)(*args).tolist()
    return {name: count for name, count in zip(INVARIANTS, counts, strict=True) if count}


def set_at(state, path, index, value):
    """The state with one entry of the array at `path` (`vehicles.x`) changed."""
    group, leaf = path.split(".")
    member = getattr(state, group)
    changed = getattr(member, leaf).at[index].set(value)
    return state.replace(**{group: member.replace(**{leaf: changed})})


def test_a_sound_state_violates_nothing(still):
    """The state that the faults below are put into."""
    state, config, params = still
    assert violated(check_state, state, config, params) == {}
    assert violated(check_tick, state, state, config, params) == {}
    assert violated(check_entry, state, state, config, params) == {}


# Check, changed number and its new value, violated invariant; 20 J is 6e-6 of an EV's battery, 200 J 4e-6 of a MED's.
FAULTS = [
    (check_state, "vehicles.speed", 6, -0.1, "speed"),
    (check_state, "vehicles.x", 6, 4000.1, "road"),
    (check_state, "vehicles.x", 6, -0.1, "road"),
    (check_state, "vehicles.lane", 6, -1, "road"),
    (check_state, "vehicles.lane", 0, 4, "road"),  # 500 m: between two acceleration lanes
    (check_state, "meds.status", 0, AT_DEPOT, "vehicles"),
    (check_state, "meds.status", 1, IN_SERVICE, "vehicles"),
    (check_state, "evs.med", 2, 0, "bookings"),  # without a panel
    (check_state, "evs.charging_slot", 1, 0, "bookings"),  # the panel that EV 0 has
    (check_state, "evs.charging_slot", 1, 4, "bookings"),  # no such panel
    (check_state, "evs.is_charging", 2, True, "bookings"),
    (check_state, "evs.med", 0, 1, "bookings"),  # a MED at the depot
    (check_state, "vehicles.active", 2, False, "bookings"),
    (check_state, "evs.energy_j", 3, -1.0, "soc"),
    (check_state, "evs.energy_j", 3, 4e6, "soc"),
    (check_state, "meds.energy_j", 1, 1e9, "soc"),
    (check_state, "vehicles.wander", 9, jnp.nan, "finite"),
    (check_state, "meds.ready_in_s", 0, -jnp.inf, "finite"),
    (check_state, "evs.waiting_s", 0, jnp.inf, "finite"),
    (check_state, "evs.retry_in_s", 0, jnp.inf, "finite"),
    (check_state, "evs.standing_s", 0, jnp.inf, "finite"),
    (check_tick, "vehicles.x", 6, 320.1, "motion"),
    (check_tick, "vehicles.x", 6, 319.9, "motion"),
    (check_tick, "vehicles.speed", 0, 9.5, "motion"),  # from 0 within 0.25 s
    (check_tick, "vehicles.lane", 6, 2, "motion"),
    (check_tick, "vehicles.desired_speed", 6, 1.0, "motion"),
    (check_tick, "vehicles.active", 6, False, "vehicles"),
    (check_tick, "vehicles.active", 7, True, "vehicles"),
    (check_tick, "evs.med", 1, 1, "bookings"),
    (check_tick, "evs.energy_j", 2, lambda e: e + 20.0, "energy"),
    (check_tick, "evs.energy_j", 2, lambda e: e - 20.0, "energy"),
    (check_tick, "evs.energy_j", 0, lambda e: e + 20.0, "energy"),  # booked, but no MED gave it
    (check_tick, "meds.energy_j", 0, lambda e: e - 200.0, "energy"),  # and no EV has charged
    (check_tick, "meds.energy_j", 1, lambda e: e - 200.0, "energy"),
]
# A MED's status also breaks the bookings that it leaves; speed out of nowhere is energy out of nowhere, too.
ALSO = {(check_state, "meds.status"): "bookings", (check_tick, "vehicles.speed"): "energy"}


@pytest.mark.parametrize(("check", "path", "index", "value", "invariant"), FAULTS)
def test_a_fault_violates_its_invariant_only(still, check, path, index, value, invariant):
    state, config, params = still
    old = operator.attrgetter(path)(state)[index]
    wrong = set_at(state, path, index, value(old) if callable(value) else value)
    found = violated(check, *([state] if check is check_tick else []), wrong, config, params)
    assert set(found) - {ALSO.get((check, path))} == {invariant}


@pytest.mark.parametrize(
    ("x", "lane", "expected"),
    [
        (300.0, 0, {}),
        (314.99, 0, {}),
        (315.01, 0, {"overlap": 1}),
        (320.0, 0, {"overlap": 1}),
        (330.0, 0, {"passed": 1}),
        (320.0, 1, {}),
    ],
)
def test_overlaps_and_passing_are_found(still, x, lane, expected):
    """Between EV 2 and the gas vehicle ahead of it are 15 m."""
    before = still[0].vehicles
    after = before.replace(x=before.x.at[4].set(x), lane=before.lane.at[4].set(lane))
    assert violated(check_lanes, before, after, jnp.full((10,), 5.0)) == expected


def test_charging_is_limited_by_the_link(still):
    """Of what is sent the load's share of load and coil arrives at most; a slot sends 40 kW for 0.25 s at most."""
    state, config, params = still
    link = params.link
    best = float(link.load_ohm / (link.load_ohm + link.ev_resistance_ohm))
    before = set_at(state, "meds.energy_j", 0, 0.5 * params.med_capacity_j)
    charging = set_at(before, "evs.served", 0, True)

    def exchanged(share, sent=5000.0):
        after = set_at(charging, "meds.energy_j", 0, before.meds.energy_j[0] - sent)
        after = set_at(after, "evs.energy_j", 0, before.evs.energy_j[0] + share * sent)
        return violated(check_tick, before, after, config, params)

    assert exchanged(0.9) == exchanged(0.999 * best) == {}
    assert exchanged(1.03 * best) == {"energy": 1}
    # The only EV that charges draws 40 kW for 0.25 s at most.
    assert exchanged(0.4, sent=9990.0) == {}
    assert exchanged(0.4, sent=10060.0) == {"energy": 1}
    # Nor does it receive more, or all that is sent.
    assert exchanged(1.0, sent=10200.0) == exchanged(1.03 * best, sent=10200.0) == {"energy": 3}


def test_arrivals_fit_entries_and_queues(still):
    """An arrival stands at an entry, alone, and the queue shrinks by one; nothing else changes."""
    state, config, params = still

    def come(slot, x=0.0):
        return (
            ("vehicles.active", slot, True),
            ("vehicles.lane", slot, 3),
            ("vehicles.x", slot, x),
        )

    def found(before, *changes):
        begun = state
        for change in changes:
            begun = set_at(begun, *change)
        return violated(check_entry, before, begun, config, params)

    waits = state.replace(queue=state.queue.at[3].set(1))
    assert found(waits, *come(7)) == {}
    assert found(waits) == {"vehicles": 1}
    assert found(waits, *come(7, x=1.0)) == {"vehicles": 2}
    assert found(waits, *come(7), *come(8)) == {"vehicles": 1}
    assert found(state, ("vehicles.x", 6, 321.0)) == {"motion": 1}
    assert found(state, ("evs.charging_slot", 0, 2)) == {"bookings": 1}
    assert found(state, ("evs.energy_j", 3, 7.0)) == {"energy": 1}


@pytest.fixture(scope="module")
def closing(still):
    """A function to the violations of a decision in which nothing happens, except for the given changes."""
    state, config, params = still
    params = params.replace(reward_weights=dict.fromkeys(params.reward_weights, 0.0))

    @jax.jit
    def ledger():
        more = with_means(tick_ledger(state, state, config, params)[1], state, config, params)
        return entry_ledger(state, state, params.road.length_m) | more

    nothing = jax.tree.map(jnp.zeros_like, ledger())

    def violations(after=None, obs=0.0, reward=0.0, terms=None, stats=None, share=0.5):
        stats = EpisodeStats.zeros().replace(**stats or {})
        after = after or state.replace(stats=state.stats + stats)
        terms = dict.fromkeys(params.reward_weights, jnp.zeros(())) | (terms or {})
        info = {"step_stats": stats, "reward_terms": terms, "metrics": dict.fromkeys(SHARES, share)}
        info["begun"] = jax.tree.map(lambda leaf: leaf[None], state)
        decision = Decision(state, after, jnp.float32(obs), jnp.float32(reward), info)
        return violated(check_results, state, decision, nothing, config, params)

    return violations


def test_wrong_results_of_a_decision_are_found(still, closing):
    """Rewards, observations, and changes between two decisions."""
    state, _, _ = still
    assert closing() == {}
    assert closing(obs=jnp.inf) == {"finite": 1}
    assert closing(reward=0.1) == {"reward": 1}
    assert closing(reward=0.1, terms={"soc": jnp.float32(0.1)}) == {"reward": 1}
    assert closing(share=jnp.float32(1.001)) == {"tally": len(SHARES)}
    lost = state.replace(stats=state.stats.replace(entered=state.stats.entered.at[GAS].add(1.0)))
    assert closing(after=lost) == {"vehicles": 1, "tally": 1}
    assert closing(after=set_at(state, "vehicles.speed", 0, 1.0)) == {"motion": 1}
    assert closing(after=set_at(state, "meds.energy_j", 1, 1.0)) == {"energy": 1}


# These follow from the state before a decision and from actions, or have no books; waits for plugs are checked against
# a queue of events (tests/charging/test_plugs.py).
UNBOOKED = "queue_seconds invalid_actions told_seconds told_speed_m refusing_seconds left_early plug_wait_s"


def test_each_wrong_number_of_the_tally_is_found(closing):
    """Every number but UNBOOKED, wrong by 1 or by 20 J; arrays are wrong in each entry."""
    for name in EpisodeStats.__dataclass_fields__.keys() - {*UNBOOKED.split()}:
        kind, off = ("energy", 20.0) if name.endswith("_j") else ("tally", 1.0)
        wrong = getattr(EpisodeStats.zeros(), name) + off
        found = closing(stats={name: wrong})
        assert found.pop(kind) == wrong.size, name
        # Vehicles that came, left or ran out are then missing.
        assert set(found) <= ({"vehicles"} if name in ("entered", "left", "depleted") else set())


def test_standing_on_an_open_road_is_seen(still):
    """Gas vehicle 0, the MED and its EVs have nobody ahead; EV 2 is 15 m behind; depleted EVs may stand."""
    state, config, params = still

    def standing(state):
        return set(jnp.flatnonzero(stands_open(state, config, params)).tolist())

    assert standing(state) == {0, 2, 3, 6}
    assert standing(set_at(state, "vehicles.speed", 6, 0.6)) == {0, 2, 3}
    assert standing(set_at(state, "evs.is_depleted", 0, True)) == {0, 3, 6}
    assert standing(set_at(state, "vehicles.x", 6, 380.0)) == {0, 2, 3, 4, 6}
    assert standing(set_at(state, "vehicles.lane", 6, config.num_lanes)) == {0, 2, 3, 4}


def test_every_invariant_is_shown_to_fail():
    """Each is violated by a fault above."""
    others = {"overlap", "boxes", "passed", "reward", "tally", "standing"}
    assert {fault[-1] for fault in FAULTS} | others == set(INVARIANTS)


def test_seconds_at_plugs_go_by_the_clocks():
    """A plug that is free within a hundredth of a round is free at its end; one more EV takes 600 s of the other."""
    env, _ = medjax.make("corridor", num_plugs=2)
    begun = jnp.array([[[1.005, 40.0]], [[0.0, 39.0]]])
    after = SimpleNamespace(plugs_free_in_s=jnp.array([[0.0, 638.0]]))
    decision = SimpleNamespace(info={"begun": SimpleNamespace(plugs_free_in_s=begun)}, after=after)
    assert float(seconds_at_plugs(decision, env.config)) == 600.0
