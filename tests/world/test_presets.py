"""Presets: numbers of one that must go together."""

import pytest

from medjax.world.presets import SCENARIOS


@pytest.mark.parametrize("name", sorted(SCENARIOS))
def test_a_booking_lasts_for_the_way_to_its_slot(name):
    """From as far as a MED may be asked, closing up at the approach speed, and 10 s for the rest."""
    charging = SCENARIOS[name].params(SCENARIOS[name].config).charging
    longest_s = float(charging.reach_ahead_m / charging.approach_speed)
    assert float(charging.patience_s) >= longest_s + 10.0
