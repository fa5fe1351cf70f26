"""Presets, overrides by name, and one clear line for what is not allowed."""

import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.charging.link import COUPLINGS, couple
from medjax.physics import interpolate_inductance, mutual_inductance
from medjax.traffic.idm import IDM, IDM_PLUS

pytestmark = pytest.mark.usefixtures("quick_compiles")


def test_presets_build_and_step():
    """Every preset resets and steps; `realistic` keeps true packs."""
    programs, made = {}, {}  # presets of the same sizes share a program
    for name in medjax.SCENARIOS:
        env, made[name] = medjax.make(name)

        def start(key, params, env=env):
            _, state = env.reset(key, params)
            return env.step_env(key, state, 1, params)[0]

        play = programs.setdefault((env.config, *env.reward), jax.jit(start))
        assert np.all(np.isfinite(play(jax.random.key(0), made[name])))
    realistic, paper = made["realistic"], made["paper"]
    assert float(realistic.ev_capacity_j) == pytest.approx(30 * 3.6e6)
    assert float(paper.ev_capacity_j) == pytest.approx(30 * 3.6e6 / float(paper.battery_scale))
    assert float(paper.charging.slot_power_w) == float(realistic.charging.slot_power_w)


def test_overrides_reach_their_place():
    """Sizes, numbers, numbers of a group, arrays, weights and coils."""
    env, params = medjax.make(
        "paper",
        num_evs=70,
        cooldown_s=30,
        ramp_per_h=[100, 200, 300, 400],
        med_coil_radius_m=0.4,
        reward_weights={"dispatches": -1},
        **{"ev.mass_kg": 2000.0},
    )
    assert env.config.num_evs == 70
    assert float(params.fleet.cooldown_s) == 30.0
    np.testing.assert_array_equal(params.demand.ramp_per_h, [100, 200, 300, 400])
    assert float(params.reward_weights["dispatches"]) == -1.0
    assert float(params.ev.mass_kg) == 2000.0
    expected = mutual_inductance(0.4, 0.3, 0.2, 0.0, 0.0, primary_turns=10, secondary_turns=10)
    got = interpolate_inductance(params.link.inductance, 0.2, 0.0, 0.0)
    assert float(got) == pytest.approx(float(expected), rel=1e-2)


@pytest.mark.parametrize("name", ["ramp_x_m", "road.ramp_x_m"])
def test_places_of_ramps_set_their_number(name):
    """Arrays with one value per ramp take the new length."""
    env, params = medjax.make("paper", length_m=6000, **{name: [500, 2500, 4500]})
    assert env.num_actions == 4
    np.testing.assert_array_equal(params.road.ramp_x_m, [500, 2500, 4500])
    np.testing.assert_array_equal(params.demand.ramp_per_h, [250, 250, 250])


def test_all_leaves_are_strong_arrays():
    """No leaf is weakly typed, so a literal never recompiles or widens a carry."""
    _, params = medjax.make("paper")
    for leaf in jax.tree.leaves(params):
        assert isinstance(leaf, jax.Array)
        assert leaf.dtype in (np.float32, np.int32)
        assert not leaf.aval.weak_type


BAD = [
    ({"name": "papre"}, "papre"),
    ({"cooldown": 3}, "cooldown"),
    ({"cooldown_s": -1.0}, "cooldown_s"),
    ({"cooldown_s": math.nan}, "cooldown_s"),
    ({"slot_power_w": math.inf}, "slot_power_w"),
    ({"cooldown_s": "soon"}, "cooldown_s"),
    ({"size": 16}, "size"),
    ({"size": -1}, "size"),
    ({"size": 2.5}, "size"),
    ({"num_lanes": 0}, "num_lanes"),
    ({"num_lanes": 7}, "num_lanes"),
    ({"num_lanes": 2.0}, "num_lanes"),
    ({"tick_s": 2.0}, "tick_s"),
    ({"ramp_x_m": [100.0, 1200.0, 2100.0, 4100.0]}, "ramp_x_m"),
    ({"ramp_x_m": [100.0, 200.0, 2100.0, 3200.0]}, "ramp_x_m"),
    ({"ramp_x_m": [100.0, 1200.0], "num_ramps": 4}, "ramp_x_m"),
    ({"ramp_x_m": [100.0, 1200.0], "ramp_per_h": [100.0, 100.0, 100.0]}, "ramp_per_h"),
    ({"ramp_x_m": list(range(0, 3600, 400))}, "num_ramps"),
    ({"ev_share": 1.5}, "ev_share"),
    ({"service_lane": 4}, "service_lane"),
    ({"mass_kg": 1000.0}, "mass_kg"),
    ({"reward_weights": {"depletion": 1.0}}, "depletion"),
    ({"reward_weights": {"soc": math.nan}}, "soc"),
    ({"arrival_soc_low": 0.9, "arrival_soc_high": 0.5}, "arrival_soc_low"),
    ({"request_soc": 0.9, "target_soc": 0.5}, "request_soc"),
    ({"med_coil_radius_m": 0.0}, "med_coil_radius_m"),
    ({"med_coil_turns": "ten"}, "med_coil_turns"),
    ({"following": "idm"}, "following"),
    ({"following": IDM}, "following"),
    ({"coupling": "paper"}, "coupling"),
    ({"demand": {3: 4}}, "unknown option 3"),
]


@pytest.mark.parametrize(("overrides", "field"), BAD, ids=lambda value: str(value)[:40])
def test_bad_input_is_one_clear_line(overrides, field):
    """The message names what is wrong, its value, and what is allowed or meant."""
    with pytest.raises(ValueError, match=field) as error:
        medjax.make(**overrides)
    message = str(error.value)
    assert "\n" not in message
    assert "allowed" in message or "did you mean" in message


def test_default_weights_of_terms(monkeypatch):
    """Without a weight in the preset, medjax's own terms weigh 0 and the user's 1."""
    monkeypatch.setitem(medjax.TERMS, "new", lambda outcome: outcome.step_stats.depleted)
    _, params = medjax.make(reward={**medjax.TERMS, "mine": lambda outcome: 1.0})
    assert float(params.reward_weights["new"]) == 0.0
    assert float(params.reward_weights["mine"]) == 1.0
    assert float(medjax.make()[1].reward_weights["new"]) == 0.0
    assert float(medjax.make(reward_weights={"new": 2})[1].reward_weights["new"]) == 2.0


def test_car_following_and_coupling_reach_the_environment():
    """None selects medjax's own."""
    model, printed = IDM(exponent=2.0), COUPLINGS["paper"]
    env, _ = medjax.make("paper", following=model, coupling=printed)
    assert (env.following, env.coupling) == (model, printed)
    assert (env.recipe.following, env.recipe.coupling) == (model, printed)
    env, _ = medjax.make("paper")
    assert (env.following, env.coupling) == (IDM_PLUS, couple)
    assert env.recipe.following is env.recipe.coupling is None


def test_the_recipe_makes_the_same_again():
    """`env.recipe` holds the arguments of `make`, numbers in JSON types; an environment built directly has none."""
    given = {
        "num_evs": np.int64(30),
        "ramp_x_m": np.array([500, 2500], np.float32),
        "desired_speed": jnp.full(5, 20.0),
        "ramp_per_h": (100, 200.5),
        "turnaround_s": math.inf,
        "ev.mass_kg": jnp.bfloat16(2000),
        "med_coil_turns": 12,
        "reward_weights": {"soc": np.float32(0.5)},
        "reward_weights.speed": 2,
    }
    env, params = medjax.make("realistic", observation="profile", **given)
    recipe = env.recipe
    assert (recipe.scenario, recipe.observation, recipe.reward) == ("realistic", "profile", None)
    overrides = json.loads(json.dumps(recipe.overrides))
    assert overrides.keys() == given.keys()
    again, same = medjax.make(recipe.scenario, observation=recipe.observation, **overrides)
    assert again.config == env.config
    jax.tree.map(np.testing.assert_array_equal, same, params)
    assert medjax.ChargingEnv(medjax.EnvConfig()).recipe is None


def test_presets_and_environments_describe_themselves():
    """Each preset and an environment has a line of its own."""
    lines = str(medjax.SCENARIOS).splitlines()
    assert [line.split()[0] for line in lines] == list(medjax.SCENARIOS)
    assert all(len(line) < 120 for line in lines)
    env, _ = medjax.make("corridor")
    assert repr(env).startswith("<corridor: 3 lanes, 5 ramps, room for 40 MEDs")
