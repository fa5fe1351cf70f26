"""Members that were renamed go on working under their former names, and warn."""

import importlib

import jax.numpy as jnp
import numpy as np
import pytest

from medjax.env.reward import Outcome
from medjax.episodes.recording import Decisions, Frames
from medjax.traffic.following import Drivers, Follower


def warned(name, new):
    """The line that names both."""
    return pytest.warns(DeprecationWarning, match=rf"{name} is now {new}; the old name goes")


@pytest.mark.parametrize(
    ("module", "old", "new"),
    [
        ("medjax.world.params", "PANELS", "CHARGING_SLOTS"),
        ("medjax.charging.booking", "panel_flags", "charging_slot_flags"),
        ("medjax.charging.link", "most_power", "max_power"),
        ("medjax.traffic.entry_gap", "cut_off", "would_cut_off"),
        ("medjax.traffic.motion", "crossing_s", "lateral_travel_time"),
        ("medjax.traffic.motion", "turn_between", "heading_difference"),
    ],
)
def test_a_module_gives_the_renamed_member(module, old, new):
    home = importlib.import_module(module)
    with warned(f"{module}.{old}", new):
        assert getattr(home, old) is getattr(home, new)
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = home.nothing


def test_fields_of_the_state(started):
    state = started[1]
    with warned("EVs.panel", "charging_slot"):
        assert state.evs.panel is state.evs.charging_slot
    with warned("EnvState.tally", "stats"):
        assert state.tally is state.stats


def test_the_former_timer_of_evs_is_the_clock_that_runs(started):
    """Waiting if booked, the time until the next request if not, and standing once depleted."""
    evs = started[1].evs
    first = jnp.arange(evs.med.shape[0])
    evs = evs.replace(
        med=jnp.where(first == 0, 2, -1),
        is_depleted=first == 1,
        waiting_s=jnp.full(first.shape, 3.0),
        retry_in_s=jnp.full(first.shape, 5.0),
        standing_s=jnp.full(first.shape, 7.0),
    )
    with warned("EVs.timer_s", "waiting_s, retry_in_s or standing_s"):
        np.testing.assert_array_equal(evs.timer_s[:3], [3.0, 7.0, 5.0])


def filled(kind, **fields):
    """An object of a class with placeholders in its other fields."""
    return kind(**dict.fromkeys(kind.__dataclass_fields__) | fields)


def test_fields_of_outcomes_and_recordings():
    with warned("Outcome.happened", "step_stats"):
        assert filled(Outcome, step_stats="sums").happened == "sums"
    with warned("Frames.ev_panel", "ev_charging_slot"):
        assert filled(Frames, ev_charging_slot="slots").ev_panel == "slots"
    with warned("Decisions.tally", "stats"):
        assert filled(Decisions, stats="sums").tally == "sums"


@pytest.mark.parametrize("kind", [Drivers, Follower])
def test_fields_of_car_following(kind):
    data = kind(**dict.fromkeys(kind._fields) | {"braking_weight": "weight"})
    with warned(f"{kind.__name__}.closing", "braking_weight"):
        assert data.closing == "weight"


def test_what_has_gone_names_its_successor():
    with pytest.raises(ImportError, match=r"gymnax\.wrappers\.LegacyStepAPIWrapper"):
        from medjax.wrappers import LegacyStep  # noqa: F401
