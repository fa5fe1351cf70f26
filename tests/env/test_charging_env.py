"""ChargingEnv's contract: pure, jitted once, batched over environments and parameters."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.verification.cases import episode_program
from benchmarks.verification.invariants import INVARIANTS
from medjax.charging.link import COUPLINGS, Coupled
from medjax.env import ChargingEnv
from medjax.world.state import AT_DEPOT, QUEUED, RETIRED

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.fixture(scope="module")
def raw(paper, quick_compiles):
    """The preset's step without reset, compiled for numbers of any world of its sizes."""
    return jax.jit(paper[0].step_env)


@pytest.fixture(scope="module")
def step(paper, raw):
    """The same with the preset's own numbers."""
    return lambda key, state, action: raw(key, state, action, paper[1])


@pytest.fixture(scope="module")
def reset(paper, quick_compiles):
    """The state at reset in a world of the preset's sizes."""
    program = jax.jit(paper[0].reset)
    return lambda params: program(jax.random.key(0), params)[1]


def test_spaces_and_shapes(paper, started):
    """Observations and actions fit their spaces; dtypes are fixed at reset."""
    (env, params), (obs, _) = paper, started
    assert obs.shape == env.observation_space(params).shape == (15 * 14 + 40 * 8 + 4,)
    assert obs.dtype == jnp.float32
    actions = env.action_space(params)
    assert actions.n == env.num_actions == 5
    assert bool(env.observation_space(params).contains(obs))
    assert bool(actions.contains(actions.sample(jax.random.key(0))))
    assert env.name == "paper"


def test_step_keeps_types_and_sums_reward_terms(started, step):
    """Scan can carry the state: no weak types. Depletion costs; charge, distance and speed pay, as in eq (10)."""
    _, state = started
    _, after, reward, *_, info = step(jax.random.key(4), state, 0)
    chex.assert_trees_all_equal_shapes_and_dtypes(state, after)
    assert not any(leaf.aval.weak_type for leaf in jax.tree.leaves((state, after)))
    terms = {name: float(value) for name, value in info["reward_terms"].items()}
    assert float(reward) == pytest.approx(sum(terms.values()), rel=1e-5)
    assert terms["depleted"] <= 0.0
    assert min(terms["soc"], terms["distance"], terms["speed"]) > 0.0


def test_same_key_same_step(started, step):
    """Equal arguments give equal results; another key gives others."""
    _, state = started
    one, two = (step(jax.random.key(7), state, 2) for _ in range(2))
    chex.assert_trees_all_equal(one, two)
    other = step(jax.random.key(8), state, 2)
    assert not np.array_equal(one[0], other[0])


@pytest.mark.thorough
def test_compiles_once(paper, reset):
    """Other keys, states, actions and parameter values reuse the program."""
    env, params = paper
    chex.clear_trace_counter()
    traced = []

    @jax.jit
    @chex.assert_max_traces(n=1)
    def step(key, state, action, params):
        traced.append(action)
        return env.step(key, state, action, params)

    state = reset(params)
    for seed, action in enumerate((0, 3, 1)):
        changed = params.replace(battery_scale=params.battery_scale + seed)
        _, state, *_ = step(jax.random.key(seed), state, jnp.int32(action), changed)
    assert len(traced) == 1


def test_vmap_over_parameters(paper, started):
    """One program takes several numbers of the world at once; each entry acts on its own number."""
    env, params = paper
    batch = params.replace(
        charging=params.charging.replace(slot_power_w=jnp.array([10e3, 40e3])),
        reward_weights={**params.reward_weights, "soc": jnp.array([0.0, 1.0])},
    )
    axes = jax.tree.map(lambda _: None, params)
    axes = axes.replace(
        charging=axes.charging.replace(slot_power_w=0),
        reward_weights={**axes.reward_weights, "soc": 0},
    )
    step = jax.vmap(env.step_env, (None, None, None, axes))
    _, _, reward, _, _, info = jax.jit(step)(jax.random.key(1), started[1], 0, batch)
    terms = info["reward_terms"]
    assert float(terms["soc"][0]) == 0.0 < float(terms["soc"][1])
    np.testing.assert_allclose(reward[1] - reward[0], terms["soc"][1], rtol=1e-5)


def test_truncates_at_the_time_limit_and_resets_in_the_same_step(reset, raw):
    """gymnax's contract: the new episode's state, the old episode's final observation. One program serves all calls."""
    env, params = medjax.make("paper", episode_decisions=3)
    chex.clear_trace_counter()
    step, state = jax.jit(chex.assert_max_traces(env.step, n=1)), reset(params)
    for count in range(1, 4):
        key = jax.random.key(count)
        step_key, _ = jax.random.split(key)
        params = params.replace(battery_scale=params.battery_scale + count)
        last_obs, last_state, *_ = raw(step_key, state, jnp.int32(1), params)
        obs, state, _, terminated, truncated, info = step(key, state, jnp.int32(1), params)
        assert not bool(terminated)
        assert bool(truncated) == (count == 3)
        # Another program, which rounds differently.
        np.testing.assert_allclose(info["final_observation"], last_obs, rtol=2e-6, atol=1e-7)
        np.testing.assert_array_equal(info["action_mask"], env.action_mask(state, params))
    assert int(last_state.time) == 3
    assert int(state.time) == 0
    assert not np.array_equal(obs, last_obs)
    assert float(info["metrics"]["meds_dispatched"]) == 1.0


@pytest.mark.parametrize("action", [-1, 5, 99])
def test_action_out_of_range_counts_as_none(started, step, action):
    """It sends nothing, is counted, and leads to the same state as action 0."""
    _, state = started
    obs, _, _, _, _, info = step(jax.random.key(1), state, action)
    expected, *_ = step(jax.random.key(1), state, 0)
    np.testing.assert_array_equal(obs, expected)
    assert float(info["metrics"]["invalid_actions"]) == 1.0
    assert float(info["metrics"]["meds_dispatched"]) == 0.0


def test_cooldown_and_fleet_limit(reset, raw):
    """A MED every 5 s at most, 3 in all; a masked action sends none and is counted."""
    env, params = medjax.make("paper", cooldown_s=5.0, size=3)
    state, sent, allowed = reset(params), [], []
    for decision in range(25):
        allowed.append(bool(env.action_mask(state, params)[2]))
        _, state, _, _, _, info = raw(jax.random.key(decision), state, 2, params)
        sent.append(float(info["step_stats"].meds_dispatched))
    assert list(np.flatnonzero(sent)) == [0, 5, 10] == list(np.flatnonzero(allowed))
    assert float(info["metrics"]["invalid_actions"]) == 22.0
    assert np.sum(np.asarray(state.meds.status) == AT_DEPOT) == 0
    assert np.sum(np.asarray(state.meds.status) == RETIRED) == 12  # those the fleet does not have


def test_a_med_returns_after_its_turnaround(reset, raw):
    """A MED that left is at the depot again, full, after turnaround_s."""
    size = {"size": 1, "mainline_per_h": 0.0, "ramp_per_h": 0.0, "cooldown_s": 0.0}
    _, params = medjax.make("paper", turnaround_s=20.0, **size)
    state, statuses, energy = reset(params), [], []
    for decision in range(120):
        action = 4 if decision == 0 else 0
        _, state, *_ = raw(jax.random.key(decision), state, action, params)
        statuses.append(int(state.meds.status[0]))
        energy.append(float(state.meds.energy_j[0]))
    left = statuses.index(RETIRED)
    back = statuses.index(AT_DEPOT)
    assert back - left in (19, 20)
    assert energy[left] < energy[back] == pytest.approx(float(params.med_capacity_j))


def test_med_waits_for_a_safe_gap(reset, raw):
    """A MED sent onto a ramp that is blocked stays queued and is not lost."""
    env, params = medjax.make("paper", mainline_per_h=0.0, ramp_per_h=0.0)
    state = reset(params)
    vehicles, slot = state.vehicles, env.config.num_vehicles - 1
    vehicles = vehicles.replace(
        active=jnp.zeros_like(vehicles.active).at[slot].set(True),
        x=vehicles.x.at[slot].set(params.road.ramp_x_m[0] + 6.0),
        lane=vehicles.lane.at[slot].set(env.config.num_lanes),
        speed=vehicles.speed.at[slot].set(0.0),
    )
    _, state, *_ = raw(jax.random.key(0), state.replace(vehicles=vehicles), 1, params)
    assert int(state.meds.status[0]) == QUEUED
    assert not bool(state.vehicles.active[0])


@pytest.mark.slow
def test_random_play_is_sound(paper):
    """Every invariant (`benchmarks.verification`) in whole random episodes of the preset, after every tick."""
    env, params = paper
    rows = 4
    batch = jax.tree.map(lambda x: jnp.broadcast_to(x, (rows, *x.shape)), params)
    batch = batch.replace(link=batch.link.replace(inductance=params.link.inductance))
    program = episode_program(env.config, num_devices=1)
    for episode in range(2000 // rows):
        played = program(batch, jax.random.key(episode), jnp.int32(params.episode_decisions))
        counts = dict(zip(INVARIANTS, played.violations.sum(axis=0).tolist(), strict=True))
        assert counts == dict.fromkeys(counts, 0)
        assert int(played.updates.min()) > 600 * 4 * 50


def test_arrivals_at_a_full_road_wait():
    """Without a free slot, arrivals wait in the queue; none is lost."""
    env, params = medjax.make("paper", num_evs=2, num_gas=2, mainline_per_h=6000.0)
    step = jax.jit(env.step_env)
    _, state = jax.jit(env.reset)(jax.random.key(0), params)
    most, waiting = 0, []
    for decision in range(60):
        _, state, _, _, _, info = step(jax.random.key(decision), state, 0, params)
        most = max(most, int(state.vehicles.active.sum()))
        waiting.append(int(state.queue.sum()))
    assert most <= 4
    # 6000 and 4 x 250 an hour ask for 117 a minute: all but a few of them wait.
    assert waiting[-1] > 80
    assert float(info["metrics"]["queue_vehicle_s"]) == pytest.approx(sum(waiting))
    stats = state.stats
    rolling = (state.vehicles.active[env.config.ev_slots] & state.evs.is_depleted).sum()
    on_road = stats.entered.sum() - stats.left.sum() - stats.depleted + rolling
    assert float(on_road) == int(state.vehicles.active.sum())


def test_coupling_can_be_replaced():
    """Coils without loss deliver all that is sent; eq (6) as printed delivers another share than the circuit."""
    made, params = medjax.make("paper", request_soc=0.6, cooldown_s=5.0)

    def share(coupling):
        env = ChargingEnv(made.config, coupling=coupling)
        _, state = jax.jit(env.reset)(jax.random.key(2), params)

        def step(state, key):
            return env.step_env(key, state, 1, params)[1], None

        run = jax.jit(lambda state, keys: jax.lax.scan(step, state, keys)[0].stats)
        stats = run(state, jax.random.split(jax.random.key(3), 100))
        assert float(stats.energy_sent_j) > 0.0
        return float(stats.energy_received_j / stats.energy_sent_j)

    def lossless(geometry, link):
        return Coupled(jnp.ones_like(geometry.axial), jnp.full_like(geometry.axial, 10.0))

    assert share(lossless) == pytest.approx(1.0)
    circuit, printed = share(COUPLINGS["circuit"]), share(COUPLINGS["paper"])
    # R_MED for R_EV in the first factor: 10.126 / 10.159 of the other.
    assert printed / circuit == pytest.approx(10.126 / 10.159, rel=1e-3)


def test_vmap_traces_the_ticks_once(paper, started):
    """Every carry of the scan is batched from the start, so that JAX need not trace the ticks again."""
    times = []

    @jax.custom_batching.custom_vmap
    def seen(values):
        return values

    @seen.def_vmap
    def _(axis_size, in_batched, values):
        times.append(axis_size)
        return values, in_batched[0]

    def coupling(geometry, link):
        return Coupled(seen(geometry.axial), geometry.axial)

    env = ChargingEnv(paper[0].config, coupling=coupling)
    states = jax.tree.map(lambda leaf: jnp.stack([leaf] * 3), started[1])
    step = jax.vmap(env.step_env, (0, 0, 0, None))
    jax.eval_shape(step, jax.random.split(jax.random.key(0), 3), states, jnp.zeros(3), paper[1])
    assert times == [3]


def test_a_probe_leaves_the_environment_and_its_class_as_they_are(paper, started):
    """`with_probe` returns a copy with all that a subclass adds; the probe's values come tick by tick."""

    class Named(ChargingEnv):
        own = None

    env = Named(paper[0].config)
    env.own = "kept"
    probed = env.with_probe(lambda state: state.vehicles.active.sum())
    assert type(probed) is Named
    assert probed.own == "kept"
    _, state = started
    *_, info = jax.eval_shape(probed.step_env, jax.random.key(0), state, 0, paper[1])
    assert info["ticks"].shape == (env.config.ticks_per_decision,)
    assert env.probe is None
    assert env.highway(state, paper[1]) == (state, paper[1])
    np.testing.assert_array_equal(env.get_obs(state, paper[1]), started[0])


def test_render_draws_with_the_viewer(started, paper, monkeypatch):
    config, calls = paper[0].config, []
    monkeypatch.setattr("medjax.hooks.viewer", lambda *a, **how: calls.append((a, how)))
    ChargingEnv(config, name="mine").render(started[1], None, width=3)
    assert calls == [((started[1], config, None), {"name": "mine", "width": 3})]
