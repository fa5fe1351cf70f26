"""An agent's action: several discrete parts, the single action that they fold into, and the orders that they give."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from medjax.env.depots import next_to_be_sent, own_ramps
from medjax.env.dispatch import action_mask, is_allowed
from medjax.env.spaces import Discrete
from medjax.env.trips import exit_in_time, leaving_early
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import IN_SERVICE, MERGING, QUEUED, EnvState

Each = TypeVar("Each")


class Parts(NamedTuple, Generic[Each]):
    """One item per part of an agent's action: spaces, choices `(A,)` int32, or masks `(A, n)` bool."""

    enter: Each  # 0 waits at the depot, r enters from ramp r, counted from 1
    speed: Each  # index into `AgentActions.speeds`
    lane: Each  # index into `AgentActions.lanes`
    accept: Each  # 0 refuses EVs that request a slot, 1 takes them
    leave: Each  # 0 stays, 1 + d takes the next exit and goes to depot d; always 0 on a road without exits


@dataclasses.dataclass(frozen=True)
class AgentActions:
    """Action spaces of an agent.

    Folded action 0 follows the rule: the MED waits at the depot, or serves at the fleet's speed, in the fleet's lane,
    and takes every EV that requests a slot. Actions 1 .. num_ramps enter from that ramp. Higher actions are for a MED
    that was sent; the last part, `leave`, varies fastest.
    """

    speeds: tuple[float, ...]  # m/s, service speeds to choose from
    lanes: tuple[int, ...]  # service lanes to choose from
    num_ramps: int
    exits: bool  # whether the road has exits, by which a MED may leave early
    usual: tuple[int, int] = (0, 0)  # indices of the fleet's own speed and lane
    depots: int = 1  # that a leaving MED may choose from

    @property
    def parts(self) -> Parts[Discrete]:
        """The `Discrete` space of each part."""
        leave = 1 + self.depots if self.exits else 1
        sizes = (1 + self.num_ramps, len(self.speeds), len(self.lanes), 2, leave)
        return Parts(*map(Discrete, sizes))

    @property
    def num_actions(self) -> int:
        """Number of folded actions."""
        enter, *others = self.parts
        return enter.n + math.prod(part.n for part in others)

    @property
    def num_logits(self) -> int:
        """Number of choices, summed over the parts."""
        return sum(part.n for part in self.parts)

    def fold_logits(self, logits: jax.Array) -> jax.Array:
        """Logits of the folded action, `(..., num_actions)`, from the parts' concatenated logits `(..., num_logits)`.

        Under the softmax of the result, the parts of a MED in service are independent.
        """
        sizes = itertools.accumulate(part.n for part in self.parts[:-1])
        enter, joint, *others = jnp.split(logits, list(sizes), axis=-1)
        for part in others:
            joint = (joint[..., :, None] + part[..., None, :]).reshape(*joint.shape[:-1], -1)
        return jnp.concatenate([enter, joint], axis=-1)

    def fold(self, parts: Parts[jax.Array], serves: jax.Array) -> jax.Array:
        """Folds choices into actions, `(A,)` int32; `serves` `(A,)` bool marks sent MEDs, whose `enter` is 0."""
        enter, *spaces = self.parts
        index = jnp.zeros_like(parts.speed)
        for space, choice in zip(spaces, parts[1:], strict=True):
            index = index * space.n + choice
        return jnp.where(serves, enter.n + index, parts.enter).astype(jnp.int32)

    def unfold(self, action: jax.Array, rule: Parts[jax.Array]) -> Parts[jax.Array]:
        """Choices `(A,)` of folded actions `(A,)`; parts that an action leaves open take the choice of `rule`."""
        enter, *spaces = self.parts
        serves = action >= enter.n
        index = jnp.maximum(action - enter.n, 0)
        choices = []
        for space, usual in zip(reversed(spaces), reversed(rule[1:]), strict=True):
            choices.append(jnp.where(serves, index % space.n, usual))
            index = index // space.n
        return Parts(jnp.where(serves, 0, action), *reversed(choices))

    def by_rule(self, state: EnvState, params: EnvParams) -> Parts[jax.Array]:
        """The rule's choices, `(A,)` each: the fleet's speed, and the lane nearest to the fleet's."""
        usual = params.fleet
        wait = jnp.zeros(state.meds.status.shape, jnp.int32)
        lane = jnp.where(_is_alone(state), usual.service_lane, state.meds.service_lane)
        return Parts(
            enter=wait,
            speed=wait + self.usual[0],
            lane=_nearest(self.lanes, lane),
            accept=wait + 1,
            leave=wait,
        )

    def masks(self, state: EnvState, config: EnvConfig, params: EnvParams) -> Parts[jax.Array]:
        """Allowed choices in each part, `(A, n)` bool.

        Only the first MED in a depot's queue may enter, from a ramp of that depot, once the cooldown is over. A MED
        that waits at a ramp or merges may refuse EVs. A MED in service keeps its lane while an EV is booked on it,
        because EVs beside it would be in its way. It may leave once, at an exit before its destination; that exit
        becomes its destination. It may change its depot while it can still take its exit, or until the road's end.
        """
        status = state.meds.status
        serves = (status == IN_SERVICE)[:, None]
        destination = state.vehicles.destination[config.med_slots]
        in_time = exit_in_time(state.vehicles, config, params)
        sooner = in_time < destination
        elsewhere = state.meds.depot[:, None] != jnp.arange(self.depots)
        may_leave = sooner[:, None] | (in_time == destination)[:, None] & elsewhere
        comes = ((status == QUEUED) | (status == MERGING))[:, None]
        here = _nearest(self.lanes, state.meds.service_lane)[:, None] == jnp.arange(len(self.lanes))
        usual_speed = jnp.arange(len(self.speeds)) == self.usual[0]
        everywhere = jnp.ones((status.shape[0], 2), bool)
        enters = next_to_be_sent(state.meds)[:, None] & own_ramps(state.meds, config)
        enters &= action_mask(state, config)[1:]
        leaves = jnp.concatenate([serves | comes, serves & may_leave], axis=1)
        return Parts(
            enter=jnp.concatenate([everywhere[:, :1], enters], axis=1),
            speed=serves | (comes & usual_speed),
            lane=(serves & (_is_alone(state)[:, None] | here)) | (comes & here),
            accept=(serves | comes) & everywhere,
            leave=leaves[:, : self.parts.leave.n],
        )

    def folded_mask(self, masks: Parts[jax.Array]) -> jax.Array:
        """Allowed folded actions, `(A, num_actions)` bool, from the masks of the parts; action 0 is always allowed."""
        combined = masks.speed
        for part in masks[2:]:
            combined = (combined[:, :, None] & part[:, None, :]).reshape(combined.shape[0], -1)
        return jnp.concatenate([masks.enter, combined], axis=1)


def _is_alone(state: EnvState) -> jax.Array:
    """MEDs without bookings, `(A,)` bool."""
    return ~jnp.any(state.evs.med[:, None] == jnp.arange(state.meds.status.shape[0]), axis=0)


def _nearest(choices: tuple[float, ...], value: jax.Array) -> jax.Array:
    """Index of the choice nearest to each value `(A,)`, int32."""
    apart = jnp.abs(jnp.asarray(choices, jnp.float32) - value[:, None])
    return jnp.argmin(apart, axis=1).astype(jnp.int32)


def allowed_parts(
    choices: Parts[jax.Array], masks: Parts[jax.Array], rule: Parts[jax.Array]
) -> tuple[Parts[jax.Array], jax.Array]:
    """Replaces masked choices `(A,)` by the rule's; also returns how many were replaced for each agent, `(A,)`."""
    kept, wrong = [], []
    for choice, mask, usual in zip(choices, masks, rule, strict=True):
        fine = is_allowed(choice, mask)
        kept.append(jnp.where(fine, choice, usual))
        wrong.append(jnp.asarray(~fine & (choice != usual), jnp.int32))
    return Parts(*kept), sum(wrong, jnp.zeros_like(wrong[0]))


def give_orders(
    state: EnvState,
    parts: Parts[jax.Array],
    actions: AgentActions,
    config: EnvConfig,
    params: EnvParams,
) -> tuple[EnvState, jax.Array]:
    """Gives the agents in service their orders, and derives the dispatcher's action.

    Args:
      parts: allowed choices `(A,)` of `actions`.

    Returns:
      (state, dispatcher's action () int32: 0, or the ramp of the agent that enters, counted from 1). Only one MED
      enters per decision: if agents of several depots enter, the one with the last ramp does.
    """
    vehicles, meds = state.vehicles, state.meds
    serves = meds.status == IN_SERVICE
    answers = serves | (meds.status == QUEUED) | (meds.status == MERGING)
    # The fleet's speed may have been replaced since the actions were made.
    speeds = jnp.asarray(actions.speeds, jnp.float32)
    speed = speeds.at[actions.usual[0]].set(params.fleet.service_speed)[parts.speed]
    lane = jnp.asarray(actions.lanes, jnp.int32)[parts.lane]
    if actions.exits:
        leaves = serves & (parts.leave > 0)
        vehicles = vehicles.replace(destination=leaving_early(vehicles, leaves, config, params))
        meds = meds.replace(depot=jnp.where(leaves, parts.leave - 1, meds.depot))
    meds = meds.replace(
        service_speed=jnp.where(serves, speed, meds.service_speed),
        service_lane=jnp.where(serves, lane, meds.service_lane),
        accepts=jnp.where(answers, parts.accept > 0, meds.accepts),
    )
    return state.replace(vehicles=vehicles, meds=meds), jnp.max(parts.enter, initial=0)
