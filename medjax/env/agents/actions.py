"""What an agent may do: parts, each a space of its own, and the one discrete action that all of them fold into."""

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
    """Something for each part of an agent's action: spaces, choices `(A,)` int32, or masks `(A, n)` bool."""

    enter: Each  # 0 waits at the depot, r enters from ramp r
    speed: Each  # of `AgentActions.speeds`
    lane: Each  # of `AgentActions.lanes`
    accept: Each  # 0 takes no EV that asks, 1 takes them
    leave: Each  # 1 + d makes for the next exit, and for depot d; a road without exits has only 0


@dataclasses.dataclass(frozen=True)
class AgentActions:
    """The spaces of an agent's action.

    Folded, action 0 does as the rule does: waits at the depot, or serves at the fleet's speed, in the fleet's lane,
    and takes who asks. Actions 1 .. num_ramps enter from that ramp. Those beyond are what a MED that was sent may do,
    the last part, `leave`, counting fastest.

    Attributes:
      speeds: m/s, that a MED in service may be told to drive.
      lanes: that it may be told to serve in.
      num_ramps: on-ramps of the road.
      exits: whether the road has any, by which it may leave early.
      depots: that it may go to then.
      usual: places in `speeds` and `lanes` of the preset's own.
    """

    speeds: tuple[float, ...]
    lanes: tuple[int, ...]
    num_ramps: int
    exits: bool
    usual: tuple[int, int] = (0, 0)
    depots: int = 1

    @property
    def parts(self) -> Parts[Discrete]:
        """A `Discrete` each."""
        leave = 1 + self.depots if self.exits else 1
        sizes = (1 + self.num_ramps, len(self.speeds), len(self.lanes), 2, leave)
        return Parts(*map(Discrete, sizes))

    @property
    def num_actions(self) -> int:
        """Of the folded action."""
        enter, *others = self.parts
        return enter.n + math.prod(part.n for part in others)

    @property
    def num_logits(self) -> int:
        """Choices of all parts together."""
        return sum(part.n for part in self.parts)

    def fold_logits(self, logits: jax.Array) -> jax.Array:
        """Of the folded action, `(..., num_actions)`, from those of its parts one after the other `(..., num_logits)`.

        By their softmax the parts of one in service are drawn each by itself.
        """
        sizes = itertools.accumulate(part.n for part in self.parts[:-1])
        enter, joint, *others = jnp.split(logits, list(sizes), axis=-1)
        for part in others:
            joint = (joint[..., :, None] + part[..., None, :]).reshape(*joint.shape[:-1], -1)
        return jnp.concatenate([enter, joint], axis=-1)

    def fold(self, parts: Parts[jax.Array], serves: jax.Array) -> jax.Array:
        """The folded action, `(A,)` int32, of choices; `serves` `(A,)` bool: one that was sent, whose `enter` is 0."""
        enter, *spaces = self.parts
        place = jnp.zeros_like(parts.speed)
        for space, choice in zip(spaces, parts[1:], strict=True):
            place = place * space.n + choice
        return jnp.where(serves, enter.n + place, parts.enter).astype(jnp.int32)

    def unfold(self, action: jax.Array, rule: Parts[jax.Array]) -> Parts[jax.Array]:
        """The choices `(A,)` of folded actions `(A,)`; where these say nothing of a part, those of `rule`."""
        enter, *spaces = self.parts
        serves = action >= enter.n
        place = jnp.maximum(action - enter.n, 0)
        choices = []
        for space, usual in zip(reversed(spaces), reversed(rule[1:]), strict=True):
            choices.append(jnp.where(serves, place % space.n, usual))
            place = place // space.n
        return Parts(jnp.where(serves, 0, action), *reversed(choices))

    def by_rule(self, state: EnvState, params: EnvParams) -> Parts[jax.Array]:
        """What the rule would choose, `(A,)` each: of the speeds and lanes those that come nearest to the fleet's."""
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
        """Which choices an agent has in each part, `(A, n)` bool.

        Only the first of a depot's line may enter, from a ramp of that depot, once the cooldown is over. One that waits
        at a ramp or merges may refuse EVs. A MED in service keeps its lane while an EV is booked on it: those beside it
        would be in its way. It may leave at an exit that comes before its destination, and once: that is its
        destination then. Until it is too late for its exit, or to the road's end, it may choose another depot.
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
        """Which folded actions are allowed, `(A, num_actions)` bool, by the masks of the parts; action 0 always is."""
        combined = masks.speed
        for part in masks[2:]:
            combined = (combined[:, :, None] & part[:, None, :]).reshape(combined.shape[0], -1)
        return jnp.concatenate([masks.enter, combined], axis=1)


def _is_alone(state: EnvState) -> jax.Array:
    """MEDs on which nobody is booked, `(A,)` bool."""
    return ~jnp.any(state.evs.med[:, None] == jnp.arange(state.meds.status.shape[0]), axis=0)


def _nearest(choices: tuple[float, ...], value: jax.Array) -> jax.Array:
    """The place of the choice that comes nearest to each value, int32 of its shape."""
    apart = jnp.abs(jnp.asarray(choices, jnp.float32) - value[:, None])
    return jnp.argmin(apart, axis=1).astype(jnp.int32)
