"""An agent's action: several discrete parts, and the single discrete action that they fold into."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from medjax.env.depots import next_to_be_sent, own_ramps
from medjax.env.dispatch import action_mask
from medjax.env.spaces import Discrete
from medjax.env.trips import exit_in_time
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

    Attributes:
      speeds: service speeds to choose from, m/s.
      lanes: service lanes to choose from.
      num_ramps: on-ramps of the road.
      exits: whether the road has exits, by which a MED may leave early.
      depots: number of depots that a leaving MED may choose from.
      usual: indices of the preset's own speed and lane in `speeds` and `lanes`.
    """

    speeds: tuple[float, ...]
    lanes: tuple[int, ...]
    num_ramps: int
    exits: bool
    usual: tuple[int, int] = (0, 0)
    depots: int = 1

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
        place = jnp.zeros_like(parts.speed)
        for space, choice in zip(spaces, parts[1:], strict=True):
            place = place * space.n + choice
        return jnp.where(serves, enter.n + place, parts.enter).astype(jnp.int32)

    def unfold(self, action: jax.Array, rule: Parts[jax.Array]) -> Parts[jax.Array]:
        """Choices `(A,)` of folded actions `(A,)`; parts that an action leaves open take the choice of `rule`."""
        enter, *spaces = self.parts
        serves = action >= enter.n
        place = jnp.maximum(action - enter.n, 0)
        choices = []
        for space, usual in zip(reversed(spaces), reversed(rule[1:]), strict=True):
            choices.append(jnp.where(serves, place % space.n, usual))
            place = place // space.n
        return Parts(jnp.where(serves, 0, action), *reversed(choices))

    def by_rule(self, state: EnvState, params: EnvParams) -> Parts[jax.Array]:
        """The rule's choices, `(A,)` each: the speeds and lanes nearest to the fleet's."""
        usual = params.fleet
        wait = jnp.zeros(state.meds.status.shape, jnp.int32)
        lane = jnp.where(_is_alone(state), usual.service_lane, state.meds.service_lane)
        return Parts(
            enter=wait,
            speed=_nearest(self.speeds, wait + usual.service_speed),
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
        in_service = status == IN_SERVICE
        serves = in_service[:, None]
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
        return Parts(
            enter=jnp.concatenate([everywhere[:, :1], enters], axis=1),
            speed=serves | (comes & usual_speed),
            lane=(serves & (_is_alone(state)[:, None] | here)) | (comes & here),
            accept=(serves | comes) & everywhere,
            leave=jnp.concatenate([serves | comes, serves & may_leave], axis=1)[
                :, : self.parts.leave.n
            ],
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
