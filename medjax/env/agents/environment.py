"""`ChargingEnv` with every MED as an agent, which decides when to enter and how to serve."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from medjax.env.agents.actions import AgentActions, Parts, allowed_parts, give_orders
from medjax.env.agents.view import AgentView
from medjax.env.contract import StepResult
from medjax.env.dispatch import is_allowed
from medjax.env.observation import RoadProfile, of_shape
from medjax.env.spaces import Box, Discrete
from medjax.env.wrapper import Wrapper
from medjax.numerics.sums import scale_by
from medjax.world.params import EnvParams
from medjax.world.state import IN_SERVICE, NOT_BOOKED, EnvState, EpisodeStats

CREDITS = ("team", "own")
ROAD = RoadProfile()
VIEW = AgentView()


@dataclasses.dataclass(frozen=True)
class AgentsEnv(Wrapper):
    """Every MED of a `ChargingEnv` is an agent, at the depot and in service. A = `config.num_meds`.

    Observations, masks and actions have a leading agent axis; else this is like any other environment. If all other
    agents choose 0, the rule, the agent at the head of the depot's queue acts as the dispatcher of `env`, bit for bit.
    `medjax.make_agents` adds names and dicts.

    Attributes:
      env: the unwrapped environment of one highway.
      actions: action spaces of an agent.
      credit: content of `info["rewards"]`. "team": every agent gets the reward of `env`. "own": an agent gets the
        change in charge, in packs, of the EVs that are booked on it at the start or at the end of the decision.
      view: observation of an agent.
    """

    actions: AgentActions
    credit: str = "team"
    view: AgentView = VIEW

    @property
    def num_agents(self) -> int:
        """One agent per MED slot."""
        return int(self.env.config.num_meds)

    @property
    def num_actions(self) -> int:
        """Number of folded actions of an agent."""
        return self.actions.num_actions

    @property
    def observation(self) -> AgentView:
        """The view that builds an agent's vector."""
        return self.view

    def action_space(self, params: EnvParams | None = None) -> Discrete:
        """Space of an agent's folded action; `actions.parts` has its parts."""
        return Discrete(self.num_actions)

    def observation_space(self, params: EnvParams | None = None) -> Box:
        """Observation space of an agent: an unbounded float32 vector in the units of `AgentView`."""
        return Box(-jnp.inf, jnp.inf, (self.view.size(self.env.config),))

    def reset(self, key: jax.Array, params: EnvParams) -> tuple[jax.Array, EnvState]:
        """Starts an episode; returns the observations `(A, size)` float32 and the state."""
        _, state = self.env.reset(key, params)
        return self.get_obs(state, params), state

    def step_env(
        self, key: jax.Array, state: EnvState, action: jax.Array, params: EnvParams
    ) -> StepResult:
        """`ChargingEnv.step_env` with an action for each agent.

        Args:
          action: (A,) int32, folded; a masked action counts as 0, and towards `metrics["invalid_actions"]`.

        Returns:
          (observations (A, size) float32, state, reward of `env` () float32, terminated () bool, truncated () bool,
          info of `ChargingEnv.step_env` with "action_mask" (A, num_actions) and the agents' "rewards" (A,) float32)
        """
        rule = self.actions.by_rule(state, params)
        fine = is_allowed(action, self.action_mask(state, params))
        parts = self.actions.unfold(jnp.where(fine, action, 0), rule)
        return self._step(key, state, parts, jnp.sum(~fine, dtype=jnp.int32), params)

    def step_parts(
        self, key: jax.Array, state: EnvState, parts: Parts[jax.Array], params: EnvParams
    ) -> StepResult:
        """`step_env` for parts, `(A,)` int32 each; the rule's choice replaces a masked one, which counts as invalid."""
        masks = self.actions.masks(state, self.env.config, params)
        rule = self.actions.by_rule(state, params)
        allowed, wrong = allowed_parts(parts, masks, rule)
        return self._step(key, state, allowed, jnp.sum(wrong, dtype=jnp.int32), params)

    def _step(
        self,
        key: jax.Array,
        state: EnvState,
        parts: Parts[jax.Array],
        wrong: jax.Array,
        params: EnvParams,
    ) -> StepResult:
        """Plays a decision with allowed parts; `wrong` () is the number of invalid choices that were replaced."""
        ordered, action = give_orders(state, parts, self.actions, self.env.config, params)
        order_stats = _order_stats(state, ordered, self.env.config.decision_s)
        order_stats = order_stats.replace(invalid_actions=wrong.astype(jnp.float32))
        ordered = ordered.replace(stats=ordered.stats + order_stats)
        _, after, reward, *ends, info = self.env.step_env(key, ordered, action, params)
        step_stats = info["step_stats"] + order_stats
        rewards = jnp.broadcast_to(reward, (self.num_agents,))
        if self.credit == "own":
            rewards = self._own_rewards(state, after, params)
        info |= {"rewards": rewards, "action_mask": self.action_mask(after, params)}
        info |= {"step_stats": step_stats, "tally": step_stats}
        info["metrics"] = info["metrics"] | agents_metrics(after.stats)
        return self.get_obs(after, params), after, reward, *ends, info

    def _own_rewards(self, before: EnvState, after: EnvState, params: EnvParams) -> jax.Array:
        """Change in charge of each MED's EVs, `(A,)` packs; counts EVs on the road both before and after."""
        slots = self.env.config.ev_slots
        agents = jnp.arange(self.num_agents)[:, None]
        was, now = (
            jax.tree.map(lambda leaf: leaf[slots], each.vehicles) for each in (before, after)
        )
        # A newcomer may have taken the slot of an EV that left; nobody drives backwards, or changes the desired speed.
        same = (now.x >= was.x) & (now.desired_speed == was.desired_speed)
        stayed = was.active & now.active & same
        ours = [(each.evs.med == agents) & (each.evs.med != NOT_BOOKED) for each in (before, after)]
        change = scale_by(after.evs.energy_j - before.evs.energy_j, params.ev_capacity_j)
        return jnp.sum(jnp.where((ours[0] | ours[1]) & stayed, change, 0.0), axis=1)

    def action_mask(self, state: EnvState, params: EnvParams) -> jax.Array:
        """Allowed folded actions, `(A, num_actions)` bool; action 0 is always allowed."""
        return self.actions.folded_mask(self.actions.masks(state, self.env.config, params))

    def present(self, state: EnvState, params: EnvParams) -> jax.Array:
        """Agents with more than one allowed action, `(A,)` bool."""
        return jnp.sum(self.action_mask(state, params), axis=1) > 1

    def get_obs(self, state: EnvState, params: EnvParams) -> jax.Array:
        """Observations, `(A, size)` float32."""
        seen = self.view(state, self.env.config, params)
        return of_shape(seen, (self.num_agents, self.view.size(self.env.config)))

    def global_state(self, state: EnvState, params: EnvParams) -> jax.Array:
        """The whole road for a central critic, `(G,)` float32: `medjax.env.observation.RoadProfile`."""
        return ROAD(state, self.env.config, params)


def agents_metrics(stats: EpisodeStats) -> dict[str, jax.Array]:
    """Metrics of the agents' decisions since reset, float32 scalars by name; means are over the MEDs' time in service.

    told_speed is in m/s; refusing_share is of time; left_early counts MEDs that chose to leave at an earlier exit.
    """
    seconds = jnp.maximum(stats.told_seconds, 1.0)
    return {
        "told_speed": stats.told_speed_m / seconds,
        "refusing_share": stats.refusing_seconds / seconds,
        "left_early": stats.left_early,
    }


def _order_stats(before: EnvState, ordered: EnvState, decision_s: float) -> EpisodeStats:
    """Statistics of the orders of one decision."""
    meds = ordered.meds
    serves = jnp.where(meds.status == IN_SERVICE, jnp.float32(decision_s), 0.0)
    slots = slice(meds.status.shape[0])
    leaves = ordered.vehicles.destination[slots] != before.vehicles.destination[slots]
    return EpisodeStats.zeros().replace(
        told_seconds=jnp.sum(serves),
        told_speed_m=jnp.sum(serves * meds.service_speed),
        refusing_seconds=jnp.sum(jnp.where(meds.accepts, 0.0, serves)),
        left_early=jnp.sum(leaves, dtype=jnp.float32),
    )
