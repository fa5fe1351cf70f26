"""Each rule acts as documented and never takes a masked action."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.agents import agents_of
from medjax.charging.energy import drive_energy
from medjax.env.charging_env import ChargingEnv
from medjax.env.forecast import expected_need, forecast_need
from medjax.episodes.scores import Evaluation, evaluate_policies
from medjax.errors import InputError
from medjax.policies.rules import Budget, budgeted, tuned_budget
from medjax.world.presets import SCENARIOS
from medjax.world.state import AT_DEPOT, QUEUED
from medjax.wrappers import DecideEvery

pytestmark = pytest.mark.usefixtures("quick_compiles")


RAMPS = (100.0, 1200.0, 2100.0, 3200.0)


@pytest.fixture(scope="module")
def episodes(paper):
    """Actions, masks and states `(episodes, decisions, ...)` of each baseline over four whole episodes."""
    env, params = paper
    policies = [build(env) for build in medjax.BASELINES.values()]

    def play(keys):
        """All policies in one program; arrays `(decisions, policies, episodes, ...)`."""
        split = jax.vmap(jax.random.split)(keys)
        _, state = jax.vmap(env.reset, (0, None))(split[:, 0], params)
        state = jax.tree.map(lambda x: jnp.broadcast_to(x, (len(policies), *x.shape)), state)

        def step(state, keys):
            act_keys, step_keys = jnp.moveaxis(jax.vmap(jax.random.split)(keys), 1, 0)
            actions = [
                jax.vmap(policy, (0, None, 0, None))(
                    act_keys, None, jax.tree.map(lambda x, i=i: x[i], state), params
                ).action
                for i, policy in enumerate(policies)
            ]
            action = jnp.stack(actions)
            mask = jax.vmap(jax.vmap(env.action_mask, (0, None)), (0, None))(state, params)
            steps = jax.vmap(jax.vmap(env.step_env, (0, 0, 0, None)), (None, 0, 0, None))
            return steps(step_keys, state, action, params)[1], (action, mask, state)

        steps = jnp.moveaxis(jax.vmap(lambda key: jax.random.split(key, 600))(split[:, 1]), 1, 0)
        return jax.lax.scan(step, state, steps)[1]

    played = jax.tree.map(np.asarray, jax.jit(play)(jax.random.split(jax.random.key(9), 4)))
    return {
        name: jax.tree.map(lambda x, i=i: np.moveaxis(x[:, i], 0, 1), played)
        for i, name in enumerate(medjax.BASELINES)
    }


def per_metre(params):
    """Energy of an EV at 30 m/s, J/m."""
    speed = jnp.float32(30.0)
    return float(drive_energy(speed, speed, params.ev, params.road, 1.0)) / 30.0


@pytest.mark.thorough
def test_only_allowed_actions(episodes):
    for action, mask, _ in episodes.values():
        assert action.dtype == jnp.int32
        assert np.take_along_axis(mask, action[..., None], -1).all()
    assert not episodes["none"][0].any()
    assert not episodes["slow"][0].any()


def test_random_sends_all_from_all_ramps(episodes):
    """All 15 MEDs are sent, from all ramps."""
    action, _, _ = episodes["random"]
    assert np.all((action > 0).sum(1) == 15)
    assert len(np.unique(action)) == 5


def test_random_draws_evenly_from_what_is_allowed(paper, started):
    """Of 5000 keys each action gets a fifth, to four and a half standard errors."""
    env, params = paper
    _, state = started
    assert jax.jit(env.action_mask)(state, params).all()
    rule = medjax.BASELINES["random"](env)
    act = jax.jit(jax.vmap(lambda key: rule(key, None, state, params).action))
    drawn = np.bincount(act(jax.random.split(jax.random.key(0), 5000)), minlength=5)
    np.testing.assert_allclose(drawn / 5000, 0.2, atol=0.025)


def test_periodic_spreads_the_fleet(episodes):
    """One every 600 / 15 decisions, ramp after ramp."""
    action, _, _ = episodes["periodic"]
    for row in action:
        when = np.flatnonzero(row)
        np.testing.assert_array_equal(when, np.arange(15) * 40)
        np.testing.assert_array_equal(row[when], 1 + np.arange(15) % 4)


@pytest.mark.thorough
def test_periodic_passes_over_ramps_whose_depot_is_empty():
    """Ramps 1 and 2 share a depot of five, which is empty first."""
    env, params = medjax.make("paper", num_depots=3, num_evs=4, num_gas=8)
    rules = {"periodic": medjax.BASELINES["periodic"](env)}
    sent = evaluate_policies(env, params, rules, 2)["periodic"]["meds_dispatched"]
    np.testing.assert_array_equal(sent, 15.0)


def test_paced_sends_from_the_first_ramp(episodes):
    """One every 32 decisions until all 15 are sent."""
    action, _, _ = episodes["paced"]
    expected = np.zeros(600)
    expected[np.arange(15) * 32] = 1
    np.testing.assert_array_equal(action, np.broadcast_to(expected, action.shape))


def test_without_ramps_none_is_sent():
    env, params = medjax.make("paper", num_ramps=0)
    _, state = jax.jit(env.reset)(jax.random.key(0), params)
    rules = [build(env) for build in medjax.BASELINES.values()]
    key = jax.random.key(1)
    acts = jax.jit(lambda state: [rule(key, None, state, params).action for rule in rules])
    assert acts(state) == [0] * len(rules)


@pytest.mark.parametrize("name", ["periodic", "greedy"])
def test_rules_of_a_dispatcher_refuse_agents(name):
    agents, _ = agents_of("paper")
    with pytest.raises(InputError, match=r"not fit 15 agents: allowed env\.env"):
        medjax.BASELINES[name](agents)


def test_greedy_sends_where_most_evs_need_it(episodes, paper):
    """Low EVs without a slot within reach, counted in loops."""
    _, params = paper
    action, _, state = episodes["greedy"]
    capacity = float(params.ev_capacity_j)
    episode, decision = np.nonzero(action)
    assert len(episode) >= 4
    for e, d in zip(episode, decision, strict=True):
        x = state.vehicles.x[e, d, 15:55]
        low = state.evs.energy_j[e, d] < 0.4 * capacity
        needy = state.vehicles.active[e, d, 15:55] & low & (state.evs.med[e, d] < 0)
        needy &= ~state.evs.is_depleted[e, d]
        counts = [
            sum(n and r - 400 <= p <= r + 100 for p, n in zip(x, needy, strict=True)) for r in RAMPS
        ]
        assert counts[action[e, d] - 1] == max(counts) >= 2


def needs_by_loops(state, params, window):
    """Need at each ramp: EVs that cannot reach the end and those to come, less free slots."""
    closing, need_m = 30.0 - 22.0, per_metre(params)
    capacity = float(params.ev_capacity_j)
    active, x, status = state.vehicles.active, state.vehicles.x, state.meds.status
    expected = np.zeros(4)
    for ramp, at in enumerate(RAMPS):
        for ev in range(40):
            here = x[15 + ev]
            short = float(state.evs.energy_j[ev]) < (4000.0 - here) * need_m
            if active[15 + ev] and short and int(state.evs.med[ev]) < 0:
                expected[ramp] += -100.0 <= at - here <= closing * window
        for entry, per_h in [(0.0, 2600.0), *((p, 250.0) for p in RAMPS)]:
            needs = (4000.0 - entry) * need_m / capacity
            share = min(max((needs - 0.2) / 0.5, 0.0), 1.0)
            time = window - (at - entry) / closing if entry <= at else 0.0
            expected[ramp] += per_h / 3600 * 0.12 * share * max(time, 0.0)
        for med in range(15):
            there = RAMPS[int(state.meds.ramp[med])] if status[med] == QUEUED else x[med]
            if (status[med] == QUEUED or active[med]) and abs(at - there) <= closing * window:
                expected[ramp] -= 4 - sum(int(other) == med for other in state.evs.med)
    return expected


@pytest.mark.parametrize("decision", [1, 65, 200])
def test_forecast_need_in_an_episode(episodes, paper, decision):
    env, params = paper
    state = jax.tree.map(lambda leaf: leaf[0, decision], episodes["paced"][2])
    got = jax.jit(lambda state: forecast_need(state, env.config, params, 60.0))(state)
    np.testing.assert_allclose(got, needs_by_loops(state, params, 60.0), atol=1e-3)
    assert state.vehicles.active[:15].any() or (state.meds.status == QUEUED).any()


@pytest.mark.thorough
def test_forecast_need_with_meds_from_two_ramps(paper):
    env, params = paper
    _, state = jax.jit(env.reset)(jax.random.key(4), params)
    step = jax.jit(env.step_env)
    for ramp in (1, 2, 1):
        for number in range(25):
            action = ramp if number == 0 else 0
            _, state, *_ = step(jax.random.key(number), state, action, params)
    got = jax.jit(lambda state: forecast_need(state, env.config, params, 60.0))(state)
    state = jax.device_get(state)
    np.testing.assert_allclose(got, needs_by_loops(state, params, 60.0), atol=1e-3)
    assert state.vehicles.active[:15].any()


def test_budgeted_sends_where_the_margin_is_greatest(episodes, paper):
    """Margins by loops over vehicles, in float64; actions follow from them."""
    env, params = paper
    action, mask, state = episodes["budgeted"]
    budget, capacity = Budget(), float(params.ev_capacity_j)
    need = jax.jit(jax.vmap(lambda state: expected_need(state, env.config, params, 60.0)))
    need_m, sent = per_metre(params), 0
    for episode in range(4):
        whole = jax.tree.map(lambda leaf, e=episode: leaf[e], state)
        known = need(whole)
        for at in range(0, 600, 7):
            now = jax.tree.map(lambda leaf, at=at: leaf[at], whole)
            lacks = np.zeros((4, 2))
            for ramp, place in enumerate(RAMPS):
                for ev in range(40):
                    here = float(now.vehicles.x[15 + ev])
                    short = (4000.0 - here) * need_m - float(now.evs.energy_j[ev])
                    near = -100.0 <= place - here <= 8.0 * 60.0
                    waits = now.vehicles.active[15 + ev] and int(now.evs.med[ev]) < 0
                    if near and waits and short > 0.0 and not now.evs.is_depleted[ev]:
                        lacks[ramp] += 1.0, short / capacity
            np.testing.assert_allclose(known.there[at], lacks[:, 0])
            np.testing.assert_allclose(known.shortfall[at], lacks[:, 1], atol=1e-4)
            left = float((now.meds.status == AT_DEPOT).mean())
            time_left = 1.0 - at / 600.0
            margin = (
                lacks[:, 0]
                + budget.pack * lacks[:, 1]
                + budget.coming * np.asarray(known.coming[at])
                + budget.free * np.asarray(known.free[at])
                + budget.ahead * (left - time_left)
                + budget.time_left * time_left
                + np.asarray(budget.ramp)
            )
            best = 1 + int(margin.argmax())
            if abs(margin.max()) > 1e-3:
                expected = best if margin.max() > 0.0 and mask[episode, at, best] else 0
                assert action[episode, at] == expected
                sent += expected > 0
    assert sent > 3


def test_forecast_is_a_special_budget(episodes, paper):
    """A budget without packs and pace acts as `forecast` in every state."""
    env, params = paper
    rule = budgeted(env, Budget(0.0, 1.0, -1.0, 0.0, 0.0, (-5.0,)))
    action, _, state = episodes["forecast"]
    act = jax.vmap(jax.vmap(lambda state: rule(jax.random.key(0), None, state, params).action))
    np.testing.assert_array_equal(jax.jit(act)(state), action)
    assert ((action > 0).sum(1) > 10).all()


def test_budgeted_has_the_numbers_of_its_preset():
    """Those of `freight`, also in a wrapper and for agents; those of `paper` where a preset has none of its own."""
    env, _ = medjax.make("freight")
    own = Budget(**SCENARIOS["freight"].budget)
    assert own != Budget()
    assert tuned_budget(env) == tuned_budget(DecideEvery(env, 2)) == own
    assert tuned_budget(agents_of("freight")[0]) == budgeted(env).weights == own
    assert budgeted(env, Budget()).weights == Budget()
    assert tuned_budget(medjax.make("corridor")[0]) == Budget()
    assert tuned_budget(ChargingEnv(env.config, env.reward)) == Budget()


@pytest.mark.thorough
def test_slow_is_none_with_slower_evs():
    """It equals `none` in a world whose low EVs drive at the service speed, and does not change the other rule's."""
    env, params = medjax.make("paper", episode_decisions=60)
    rules = {name: medjax.BASELINES[name](env) for name in ("none", "slow")}
    both = evaluate_policies(env, params, rules, episodes=3)
    eco = {"eco_compliance": 1.0, "eco_speed": 22.0, "eco_soc": 0.4, "eco_horizon_m": float("inf")}
    _, slower = medjax.make("paper", episode_decisions=60, **eco)
    none = {"none": rules["none"]}
    evaluation = Evaluation(env, params, none, episodes=3)
    for world, name in ((params, "none"), (slower, "slow")):
        alone = evaluation.play(none, seed=0, params=world)["none"]
        for metric, values in alone.items():
            np.testing.assert_allclose(both[name][metric], values, rtol=1e-4, atol=1e-4)
    assert (both["slow"]["meds_dispatched"] == 0.0).all()
    assert both["slow"]["ev_saved_kwh"].mean() > both["none"]["ev_saved_kwh"].mean() + 0.01
    again = rules["slow"].params_transform(rules["slow"].params_transform(params))
    np.testing.assert_array_equal(again.drivers.eco_speed, params.fleet.service_speed)
