"""The throughput and scaling benchmarks count vehicles on the road and sort operations into stages."""

import dataclasses
import json
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.speed import scaling, throughput, workload
from benchmarks.speed.stages import STAGES, instruction_stages, stage_of, stage_times
from benchmarks.speed.workload import (
    ENVS,
    PRESET_VEHICLES,
    SCALED,
    VEHICLES,
    Measurement,
    Workload,
    road_for,
)
from medjax.scenarios import prepare
from tests.benchmarks.refusal import refused

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.fixture(scope="module")
def work():
    """A small workload on one device."""
    return Workload(4, steps=2, num_devices=1)


@pytest.mark.thorough
def test_counts_the_vehicles_on_the_road(work):
    """Against the state: between two decisions few come and go, so the mean is near the numbers seen."""
    before = int(jnp.sum(work.state.env.vehicles.active))
    _, active = work.play()
    after = int(jnp.sum(work.state.env.vehicles.active))
    ticks = work.steps * work.env.config.ticks_per_decision
    assert active / ticks == pytest.approx((before + after) / 2, rel=0.02)
    assert active / ticks < 4 * work.env.config.num_vehicles  # slots would be more


@pytest.mark.parametrize(
    ("name", "stage"),
    [
        ("jit(play)/while/body/vmap(entry)/add", "entry"),
        ("jit(play)/while/body/vmap()/while/body/neighbours/jit(sort)/sort", "neighbours"),
        ("jit(play)/auto_reset/while/body/vmap()/entry/add", "entry"),
        ("jit(play)/my_entry/add", "other"),
        ("", "other"),
    ],
)
def test_an_operation_belongs_to_its_innermost_stage(name, stage):
    """Scopes are whole words of the name, inside or outside of vmap's brackets."""
    assert stage_of(name) == stage


@pytest.mark.thorough
def test_every_stage_of_the_step_is_found(work):
    """In the compiled program and in its trace; a renamed scope would be missing."""
    assert {*STAGES} - {*instruction_stages(work.program.as_text()).values()} == set()
    times = stage_times(work)
    assert {"neighbours", "lane_changes", "entry"} <= {*times} <= {*STAGES, "other"}
    assert all(seconds > 0.0 for seconds in times.values())


@pytest.mark.thorough
def test_stages_take_about_as_long_as_the_call(work):
    """On one device their seconds add up to some of the wall time, and not to many times it."""
    stages_s = min(sum(stage_times(work).values()) for _ in range(3))
    wall_s = min(work.play()[0] for _ in range(3))
    assert 0.1 * wall_s < stages_s < 5.0 * wall_s


def vehicles_at_reset(**overrides):
    """Mean over 32 roads, with no MED yet, and the slots of a road."""
    env, params = medjax.make("paper", **overrides)
    keys = jax.random.split(jax.random.key(0), 32)
    _, state = jax.jit(jax.vmap(env.reset, (0, None)))(keys, params)
    return float(state.vehicles.active.sum(axis=1).mean()), env.config.num_vehicles


@pytest.mark.thorough
def test_a_longer_road_holds_as_many_as_asked():
    """In proportion to the preset's, which holds 140 with its MEDs; as full in its slots."""
    preset, preset_slots = vehicles_at_reset()
    for count in (64, 512, 1024):
        mean, slots = vehicles_at_reset(**road_for(count))
        assert mean / preset == pytest.approx(count / 140, rel=0.08)
        assert slots / preset_slots == pytest.approx(count / 140, rel=0.15)


def test_json_has_the_promised_fields(tmp_path, capsys):
    """All fields of the contract, and the figures that the line shows."""
    path = tmp_path / "result.json"
    small = ["--num-envs=4", "--steps=2", "--num-devices=1", "--repeats=1"]  # as `work`
    throughput.main([*small, "--json", str(path)])
    result = json.loads(path.read_text())
    fields = {"active_vehicle_updates_per_s", "env_steps_per_s", "mean_active_vehicles"}
    fields |= {"ticks_per_step", "compile_s", "num_envs", "backend", "device", "jax_version"}
    assert fields <= {*result}
    rate = result["env_steps_per_s"] * result["ticks_per_step"] * result["mean_active_vehicles"]
    assert result["active_vehicle_updates_per_s"] == pytest.approx(rate, rel=1e-3)
    assert f"{result['active_vehicle_updates_per_s'] / 1e6:.2f} M" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("argv", "word"),
    [
        (["--num-envs", "0"], "--num-envs"),
        (["--json", "/no/such/folder/result.json"], "allowed a file"),
        (["--sweep", "lanes"], "lanes"),
        (["--num-devices", "99"], "num_devices is 99"),
        (["--num-envs", "10000000"], "10000000 environments: about"),
        (["--sweep", "vehicles", "--scenario", "corridor"], "--scenario corridor: allowed paper"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(argv, word, capsys):
    """Before anything is compiled."""
    assert word in refused(throughput.main, argv, capsys)


@pytest.mark.parametrize(
    ("argv", "word"),
    [
        (["--sweep", "envs", "--num-envs", "1024"], "--num-envs: allowed without --sweep envs"),
        (["--sweep", "vehicles", "--num-envs", "8", "16"], "--num-envs: allowed one number with"),
        (["--stages", "--num-envs", "8", "16"], "--stages: allowed without --sweep, and with one"),
        (["--stages", "--sweep", "vehicles"], "--stages: allowed without --sweep, and with one"),
    ],
)
def test_an_option_without_effect_is_refused(argv, word, capsys, monkeypatch):
    """Before anything is timed."""
    monkeypatch.setattr(throughput, "measure", None)
    assert word in refused(throughput.main, argv, capsys)


@pytest.mark.parametrize(
    ("argv", "sizes"),
    [
        (["--stages"], [1024]),
        (["--num-envs", "8", "16"], [8, 16]),
        (["--sweep", "envs"], ENVS),
        (["--sweep", "vehicles"], [1024, 1024 * 64 // 140, 256, 128, 64]),
        (["--sweep", "vehicles", "--num-envs", "16"], [16, 16 * 64 // 140, 4, 2, 1]),
    ],
)
def test_what_is_timed(argv, sizes, monkeypatch):
    read = []
    monkeypatch.setattr(
        throughput, "run_command", lambda parser, _, argv: read.append((parser, argv))
    )
    throughput.main(argv)
    (parser, given), roads = read[0], [road_for(count) for count in VEHICLES]
    cases = throughput.cases_of(parser.parse_args(given))
    assert [num_envs for num_envs, _ in cases] == list(sizes)
    assert [overrides for _, overrides in cases] == (
        roads if "vehicles" in argv else [{}] * len(sizes)
    )


def test_first_episodes_end_at_random_decisions(work):
    """So that resets come at their usual rate, and not all at once."""
    _, state = work.reset(jax.random.key(3))
    assert state.cut_in.min() > 0
    assert len(np.unique(state.cut_in)) == work.num_envs


def test_a_call_is_timed_until_its_results_are_there(monkeypatch):
    """And no longer; JAX returns before it has computed."""
    events, clock = [], iter((3.0, 10.0))

    def look():
        events.append("clock")
        return next(clock)

    def program(key, state):
        events.append("program")
        return state + 1, (jnp.float32(12.0), jnp.float32(0.0))

    def wait(results):
        events.append("wait")
        assert results[0] == 1
        return results

    played = object.__new__(Workload)
    played.key, played.state, played.program = jax.random.key(0), 0, program
    monkeypatch.setattr(workload, "time", SimpleNamespace(perf_counter=look))
    monkeypatch.setattr(workload.jax, "block_until_ready", wait)
    assert played.play() == (7.0, 12.0)
    assert events == ["clock", "program", "wait", "clock"]
    assert played.state == 1


def test_scaling_refuses_a_road_before_its_first_table(capsys):
    said = refused(scaling.main, ["--scenario", "long"], capsys)
    assert "--scenario long: allowed paper, realistic" in said


@pytest.mark.parametrize("scenario", SCALED)
def test_roads_of_all_sizes_are_allowed(scenario):
    """Each is as long as its vehicles are many, has as many ramps, and no fewer slots a metre than the preset."""
    preset, numbers, _ = prepare(scenario)
    length_m = float(numbers.road.length_m)
    for count in VEHICLES:
        env, params, _ = prepare(scenario, **road_for(count, scenario))
        scale = float(params.road.length_m) / length_m
        assert scale == pytest.approx(count / PRESET_VEHICLES)
        assert env.config.num_ramps == preset.config.num_ramps
        assert env.config.num_evs >= preset.config.num_evs * scale - 1e-3
        assert env.config.num_gas >= preset.config.num_gas * scale - 1e-3


def test_spread_is_of_costs():
    """Twice the rate is half the cost."""
    fields = {field.name: 1 for field in dataclasses.fields(Measurement)}
    rates = [2e7, 1e7, 1.6e7]
    results = [Measurement(**fields | {"active_vehicle_updates_per_s": rate}) for rate in rates]
    np.testing.assert_allclose([scaling.cost_ns(r) for r in results], [50.0, 100.0, 62.5])
    assert scaling.spread(results) == pytest.approx(2.0)
