"""References match closed forms and detect every kind of wrong neighbour."""

import jax
import numpy as np
import pytest

import medjax
from benchmarks.speed import references
from benchmarks.speed.kernels import SCENARIO, TABLE_GAP_M
from medjax.traffic import find_neighbours, sort_by_road

special = pytest.importorskip("scipy.special")


@pytest.mark.parametrize("axial", [0.05, 0.2, 1.0])
def test_neumanns_integral_is_maxwells_closed_form_on_one_axis(axial):
    """DLMF 19.34; the wires' distance is that of two rings."""
    coils = references.COILS
    radius_1, radius_2 = coils.med_coil_radius_m, coils.ev_coil_radius_m
    m = 4 * radius_1 * radius_2 / ((radius_1 + radius_2) ** 2 + axial**2)
    k = np.sqrt(m)
    psi = (2 / k - k) * special.ellipk(m) - 2 / k * special.ellipe(m)
    turns = coils.med_coil_turns * coils.ev_coil_turns
    expected = turns * 4e-7 * np.pi * np.sqrt(radius_1 * radius_2) * psi
    inductance, gap = references.neumann(axial, 0.0, 0.0)
    assert inductance == pytest.approx(expected, rel=1e-10)
    assert gap == pytest.approx(np.hypot(axial, radius_1 - radius_2))


def test_neumanns_integral_has_converged_where_it_is_used():
    """The nearest wires that are checked: one rim dips to the other."""
    position = (0.105, -0.05, 0.25)
    inductance, gap = references.neumann(*position)
    assert gap == pytest.approx(TABLE_GAP_M, abs=0.003)
    assert inductance == pytest.approx(references.neumann(*position, num_nodes=1024)[0], rel=1e-8)


@pytest.fixture(scope="module")
def roads():
    """Two roads and their neighbours."""
    config = medjax.SCENARIOS[SCENARIO].config
    traffic = references.draw_traffic(config, 4000.0, 2)
    x, lane, other, target, active, previous = traffic

    def find(x, lane, other, target, active, previous):
        order = sort_by_road(x, active, 4000.0, previous)
        return find_neighbours(order, lane, other, target, active, config.num_lanes + 1)

    return traffic, jax.jit(jax.vmap(find))(x, lane, other, target, active, previous)


def test_drawn_roads_are_three_quarters_full_and_hold_ties(roads):
    traffic, _ = roads
    for x, active in zip(np.asarray(traffic.x), np.asarray(traffic.active), strict=True):
        assert 0.6 < np.mean(active) < 0.9
        assert 0.0 <= x.min() <= x.max() <= 4000.0
    assert any(len(np.unique(x)) < len(x) for x in np.asarray(traffic.x))


def test_true_neighbours_agree_with_all_pairs(roads):
    traffic, found = roads
    assert references.count_wrong(found, traffic) == 0


@pytest.mark.parametrize("side", range(4))
def test_one_wrong_neighbour_is_counted(roads, side):
    traffic, found = roads
    wrong = [np.array(slots) for slots in found]
    wrong[side][1, 20] += 1
    assert references.count_wrong(type(found)(*wrong), traffic) == 1


def test_wrong_ways_to_find_neighbours_are_detected(roads):
    """Sides exchanged, inactive vehicles seen, and the own lane taken for the target's."""
    traffic, found = roads
    exchanged = found._replace(leader=found.follower, follower=found.leader)
    blind = found._replace(target_leader=found.leader, target_follower=found.follower)
    everybody = traffic._replace(active=np.ones_like(traffic.active))
    for wrong, truth in ((exchanged, traffic), (blind, traffic), (found, everybody)):
        assert references.count_wrong(wrong, truth) > 100
