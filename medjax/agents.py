"""Presets in which every MED is an agent."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from medjax.env.agents.actions import AgentActions
from medjax.env.agents.environment import CREDITS, ROAD, VIEW, AgentsEnv
from medjax.env.agents.view import AgentView
from medjax.env.charging_env import ChargingEnv
from medjax.errors import InputError, shown
from medjax.scenarios import KEYWORDS, OPTIONS, SCENARIOS, check_names, make, prepare
from medjax.world.numbers import numbers_of, read_number
from medjax.world.params import EnvParams, FleetParams

SPEEDS = (14.0, 18.0, 22.0, 25.0)  # m/s; the fleet's service speed is added
CHOICE_S = 4.0  # shortest time between decisions of agents


def agents_of(
    name: str = "corridor",
    *,
    speeds: Sequence[float] = SPEEDS,
    credit: str = "team",
    central: bool = False,
    build: Callable[..., Any] = make,
    **overrides: Any,
) -> tuple[AgentsEnv, EnvParams]:
    """Builds a preset in which every MED is an agent, as `medjax.make_agents` does, with arrays instead of dicts.

    Args:
      name, speeds, credit, **overrides: as in `medjax.make_agents`.
      central: append the whole road to each agent's observation, for a critic (`AgentView.road`).
      build: called like `medjax.make` to build the preset; `medjax.scenarios.prepare` computes nothing.

    Raises:
      InputError: as in `medjax.make`, or a speed or credit is not allowed.
    """
    check_names(overrides, (*OPTIONS, *KEYWORDS), ("speeds", "credit"))
    if credit not in CREDITS:
        raise InputError(f"credit = {shown(credit)}: allowed {', '.join(CREDITS)}")
    if not isinstance(name, str) or name not in SCENARIOS:
        build(name)  # raises the error
    preset = SCENARIOS[name]
    fleet = int(preset.params(preset.config).fleet.size)
    overrides = {"num_meds": overrides.get("size", overrides.get("fleet.size", fleet)), **overrides}
    if "rounds_per_decision" not in overrides:
        overrides = _seldom_enough(*prepare(name, **overrides)[:2]) | overrides
    env, params, *_ = build(name, **overrides)
    allowed = numbers_of(FleetParams)["service_speed"]
    usual_speed, usual_lane = float(params.fleet.service_speed), int(params.fleet.service_lane)
    if isinstance(speeds, str) or not np.iterable(speeds):
        raise InputError(f"speeds = {shown(speeds)}: allowed a list of speeds in m/s")
    given = (read_number(f"speeds[{i}]", speed, allowed) for i, speed in enumerate(speeds))
    ordered = tuple(sorted({usual_speed, *map(float, given)}))
    # A MED has four slots in lanes with neighbours on both sides.
    lanes = tuple(sorted({*range(1, env.config.num_lanes - 1), usual_lane}))
    actions = AgentActions(
        speeds=ordered,
        lanes=lanes,
        num_ramps=env.config.num_ramps,
        exits=env.config.num_exits > 0,
        usual=(ordered.index(usual_speed), lanes.index(usual_lane)),
        depots=env.config.num_depots,
    )
    return AgentsEnv(env, actions, credit, AgentView(road=ROAD) if central else VIEW), params


def _seldom_enough(env: ChargingEnv, params: EnvParams) -> dict[str, int]:
    """Overrides that make decisions last at least CHOICE_S, with proportionally fewer per episode."""
    times = math.ceil(CHOICE_S / env.config.decision_s)
    decisions = math.ceil(int(params.episode_decisions) / times)
    rounds = times * env.config.rounds_per_decision
    return {"rounds_per_decision": rounds, "episode_decisions": decisions} if times > 1 else {}
