"""EVs that see two queues in a row wait as in queues of events in which they join the shorter line."""

import heapq

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.charging.plugs import take_plugs
from medjax.env.trips import needs_charger
from tests.env.quiet_road import SHORTER_S, energy_for, quiet_road, with_evs

SITES, PLUGS, SERVICE_S, LOAD = 2, 2, 900.0, 0.8
ROADS, ROUNDS, WARM = 48, 30_000, 6000
TO_FIRST, TO_SECOND = 15, 182  # s from where EVs decide, rounded to the second for both sides


def arrivals(flexible_share, seed=0):
    """EVs that come by, `(ROUNDS, ROADS)` bool; how long each will charge, s; who reaches either exit."""
    draw, shape = np.random.default_rng(seed), (ROUNDS, ROADS)
    comes = draw.random(shape) < LOAD * SITES * PLUGS / SERVICE_S
    service = np.ceil(draw.exponential(SERVICE_S, shape))
    return comes, service, draw.random(shape) < flexible_share


def by_events(comes, service, flexible, choose):
    """Waits of one road's EVs by when they come, float64; `choose(first_s, second_s)` says who takes the first site.

    An EV that decides knows who has arrived at a site, not who is on the way there.
    """
    free, on_way, waits = [[0.0] * PLUGS, [0.0] * PLUGS], [], np.full(comes.size, np.nan)

    def arrive(until):
        while on_way and on_way[0][0] <= until:
            at, site, number = heapq.heappop(on_way)
            start = max(at, heapq.heappop(free[site]))
            heapq.heappush(free[site], start + service[number])
            waits[number] = start - at

    for number in np.flatnonzero(comes):
        arrive(number)
        expected = [
            max(0.0, free[site][0] - number - way) for site, way in enumerate((TO_FIRST, TO_SECOND))
        ]
        site = 0 if not flexible[number] or choose(*expected) else 1
        heapq.heappush(on_way, (number + 1 + (TO_FIRST, TO_SECOND)[site], site, number))
    arrive(np.inf)
    return waits


def pooled(comes, service):
    """Waits at one site that has all plugs."""
    waits = np.full(comes.shape, np.nan)
    for lane in range(ROADS):
        free = [0.0] * SITES * PLUGS
        for number in np.flatnonzero(comes[:, lane]):
            start = max(float(number), heapq.heappop(free))
            heapq.heappush(free, start + service[number, lane])
            waits[number, lane] = start - number
    return waits


def by_medjax(comes, service, flexible, sees):
    """The same with `needs_charger` and `take_plugs`; waits by arrival, `(ROUNDS, ROADS, 2)`, nan: none."""
    env, params, state = quiet_road()
    # Both ways take whole seconds, so that numbers are whole in float32 and in float64.
    exits = 4550.0 + 30.0 * np.array([TO_FIRST, TO_SECOND, 340.0])
    params = params.replace(road=params.road.replace(exit_x_m=jnp.asarray(exits, jnp.float32)))
    energies = energy_for(np.array([100.0, 30.0 * TO_SECOND + 100.0]), params)
    blank = with_evs(state, env.config, energies[0], [0.0] * 3, sees=sees, x=4550.0)
    low, high = jnp.float32(energies)

    def decide(free, flexible):
        energy = jnp.where(flexible, high, low)
        evs = blank.evs.replace(energy_j=jnp.full_like(blank.evs.energy_j, energy))
        plugs = jnp.concatenate([free, jnp.zeros((1, PLUGS))])
        now = blank.replace(evs=evs, plugs_free_in_s=plugs)
        return needs_charger(now, env.config, params)[0]

    def play(carry, now):
        free, ways = carry
        comes, service, flexible = now
        first = jax.vmap(decide)(free, flexible)
        came = jnp.where(comes, service, 0.0)
        bound = jnp.where(first, came, 0.0), jnp.where(first, 0.0, came)
        ways = [jnp.concatenate([way[1:], new[None]]) for way, new in zip(ways, bound, strict=True)]
        here = jnp.stack([way[0] for way in ways], axis=1)  # (ROADS, 2), 0: nobody
        counted = jnp.maximum(free - 1.0, 0.0)
        sites = jnp.arange(SITES, dtype=jnp.int32)
        free, waits = jax.vmap(take_plugs, (0, None, 0, 0))(counted, sites, here > 0.0, here)
        return (free, ways), jnp.where(here > 0.0, waits, jnp.nan)

    ways = [jnp.zeros((way + 1, ROADS)) for way in (TO_FIRST, TO_SECOND)]
    start = jnp.zeros((ROADS, SITES, PLUGS)), ways
    of_rounds = jnp.asarray(comes), jnp.asarray(service, jnp.float32), jnp.asarray(flexible)
    return np.asarray(jax.jit(lambda: jax.lax.scan(play, start, of_rounds))()[1])


@pytest.mark.parametrize("flexible_share", [0.5, 1.0])
def test_two_queues_that_are_seen_come_near_to_one(flexible_share):
    """Half of the EVs, or all, reach either of two exits in a row; two plugs at each, busy four fifths of the time.

    Every wait is that of a queue of events in which drivers join the shorter line. If all have the choice, they wait
    nearly as at one site with four plugs, rather than as at two sites that take half of them each.
    """
    comes, service, flexible = arrivals(flexible_share)
    columns = comes.T, service.T, flexible.T

    def events(choose, *columns):
        waits = [by_events(*column, choose) for column in zip(*columns, strict=True)]
        return np.stack(waits, axis=1)

    joined = events(lambda first, second: first + SHORTER_S < second, *columns)
    for sees, expected in ((True, joined), (False, events(lambda *_: False, *columns))):
        ours = by_medjax(comes, service, flexible, sees)
        assert np.sum(~np.isnan(ours)) > 0.98 * comes.sum()
        for site, way in enumerate((TO_FIRST, TO_SECOND)):
            arrived, lane = np.nonzero(~np.isnan(ours[:, :, site]))
            np.testing.assert_array_equal(ours[arrived, lane, site], expected[arrived - way, lane])
    half = np.random.default_rng(1).random(comes.shape) < 0.5
    apart, one = events(lambda *_: False, *columns[:2], half.T), pooled(comes, service)
    seen, apart, one = (np.nanmean(waits[WARM:-WARM]) for waits in (joined, apart, one))
    print(f"{flexible_share}: one {one:.0f} s, seen {seen:.0f} s, apart {apart:.0f} s")
    assert one < seen < apart
    if flexible_share == 1.0:
        assert seen - one < 0.5 * (apart - one)
