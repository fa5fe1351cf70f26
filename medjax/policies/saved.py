"""A trained policy in one file: acts without the learner, its libraries or a JIT of the caller's.

`python -m train.export --run-dir DIR` writes the file. It is a ZIP of `policy.json`, which says what the policy was
trained for, and `network.bin`, the network with its weights as StableHLO (`jax.export`): any network, on CPUs, GPUs and
TPUs, readable by later versions of JAX. Nothing is unpickled.
"""

import dataclasses
import json
import math
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, get_origin, get_type_hints

import jax
import jax.numpy as jnp
import numpy as np
from jax import export

from medjax.agents import agents_of
from medjax.commandline import NOT_NUMBERS, as_path
from medjax.env.observation import OBSERVATIONS
from medjax.env.wrapper import check_environment
from medjax.errors import InputError, shown
from medjax.files import check_input, replacing
from medjax.numerics.gathers import with_rows
from medjax.policies.about import About
from medjax.policies.policy import Choice, Policy, every
from medjax.policies.rules import BASELINES
from medjax.policies.team import Dispatched
from medjax.scenarios import make
from medjax.world.params import EnvParams

FORMAT = 1
ABOUT, NETWORK = "policy.json", "network.bin"
AGENTS = {"speeds", "credit", "central"}  # what a file may say of them
MOST_BYTES = {ABOUT: 2**20, NETWORK: 2**29}  # unpacked


@dataclasses.dataclass(frozen=True)
class ExportedPolicy:
    """A policy that was read from a file.

    Attributes:
      about: what it was trained for.
      network: observations `(rows, num_features)` and masks `(rows, num_actions)` to the probabilities
        `(rows, num_actions)` of the actions and values `(rows,)`, in units of the learner's scaled reward.
    """

    about: About
    network: export.Exported

    def __repr__(self) -> str:
        about = self.about
        fits = f"{about.num_features} features, {about.num_actions} actions"
        return f"<{about.name}: trained on {about.scenario or 'an environment of its own'}, {fits}>"

    def make(
        self,
        scenario: str | None = None,
        overrides: Mapping[str, Any] | None = None,
        build: Callable[..., Any] | None = None,
    ) -> tuple[Any, EnvParams]:
        """The environment that it was trained in, or one that it sees alike, and its parameters.

        Args:
          scenario: preset; None: that of its training.
          overrides: numbers, over those of its training where the preset is the same.
          build: called as `medjax.make`, which is the default; `medjax.scenarios.prepare` computes nothing.

        Raises:
          InputError: it was somebody's own, or an override is no number of an environment.
        """
        about = self.about
        if not isinstance(overrides, Mapping | None):
            raise InputError(f"overrides are {shown(overrides)}, allowed: numbers by name")
        build = make if build is None else build
        if not about.scenario:
            raise InputError(
                "the policy was trained in an environment of somebody's own, allowed: that one, given from Python "
                "to ExportedPolicy.policy"
            )
        scenario = about.scenario if scenario is None else scenario
        kept = about.overrides if scenario == about.scenario else {}
        numbers: dict[str, Any] = {**kept, **(overrides or {})}
        if named := [name for name in NOT_NUMBERS if name in numbers]:
            raise InputError(f"overrides hold {named[0]}, allowed: numbers of the environment")
        if about.agents:
            if taken := about.agents.keys() & numbers.keys():
                raise InputError(
                    f"{min(taken)}: it is the policy's own, allowed {about.agents[min(taken)]}"
                )
            return agents_of(scenario, build=build, **about.agents, **numbers)
        env, params, *_ = build(scenario, observation=about.observation, **numbers)
        return env, params

    def probabilities(self, obs: Any, mask: Any) -> np.ndarray:
        """Probabilities of the actions.

        Args:
          obs: `(num_features,)` or `(rows, num_features)`, anything that NumPy takes.
          mask: `(num_actions,)` or `(rows, num_actions)` bool, allowed actions; an `info["action_mask"]`.

        Returns:
          `(num_actions,)` or `(rows, num_actions)` float32; 0 where the mask forbids.

        Raises:
          InputError: an array of another shape, or what is no finite number.
        """
        obs, mask = _numbers("obs", obs, np.float32), _numbers("mask", mask, bool)
        wanted = self.about.num_features, self.about.num_actions
        given = obs.shape[-1:] + mask.shape[-1:]
        if given != wanted or obs.shape[:-1] != mask.shape[:-1] or obs.ndim > 2:
            raise InputError(
                f"obs has shape {obs.shape} and mask {mask.shape}: allowed (..., {wanted[0]}) and "
                f"(..., {wanted[1]}), with or without an axis for rows"
            )
        if not mask.size:  # no row, which the network does not take
            return mask.astype(np.float32)
        rows, _ = self.network.call(obs.reshape(-1, wanted[0]), mask.reshape(-1, wanted[1]))
        return np.asarray(rows).reshape(mask.shape)

    def act(self, obs: Any, mask: Any) -> np.ndarray:
        """The most probable action, `()` or `(rows,)` int64; arguments are those of `probabilities`.

        To be asked at every `about.decide_every`-th decision; action 0 is to be taken in between.
        """
        return np.argmax(self.probabilities(obs, mask), axis=-1)

    def policy(self, env: Any) -> Policy:
        """Itself among the policies of an environment: its most probable action.

        It sees what the environment observes where that has its size, else the highway as it was trained to.

        Raises:
          InputError: an environment that it does not fit, or none.
        """
        check_environment(env)
        size = math.prod(env.observation_space(None).shape)
        own: Any = None if self.about.agents else OBSERVATIONS.get(self.about.observation)
        looks = own is not None and size != self.about.num_features and hasattr(env, "config")
        if looks:
            size = own.size(env.config)
        if (size, env.num_actions) != (self.about.num_features, self.about.num_actions):
            raise InputError(
                f"the environment has {size} features and {env.num_actions} actions: allowed "
                f"{self.about.num_features} and {self.about.num_actions}, as the policy was trained"
            )
        call, dispatcher = _batched(self.network), self.about.dispatcher
        by_rule = Dispatched(env, BASELINES[dispatcher](env.env)) if dispatcher else None
        acted_in = by_rule or env

        def act(weights: Any, key: jax.Array, obs: jax.Array, state: Any, params: Any) -> Choice:
            """See `Policy.act`; the weights are in the network."""
            mask = acted_in.action_mask(state, params)
            if looks:
                road, numbers = env.highway(state, params)
                obs = own(road, env.config, numbers)
            rows, _ = call(obs.reshape(-1, obs.shape[-1]), mask.reshape(-1, mask.shape[-1]))
            probabilities = rows.reshape(mask.shape)
            return Choice(jnp.argmax(probabilities, axis=-1).astype(jnp.int32), probabilities)

        policy = every(Policy(act), self.about.decide_every)
        return by_rule.whole(policy) if by_rule else policy


def _numbers(name: str, value: Any, dtype: Any) -> np.ndarray:
    """The value as an array of finite numbers; InputError for anything else."""
    try:
        array = np.asarray(value, dtype)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    if not np.isfinite(array).all():
        raise InputError(f"{name} = {shown(value)}: allowed finite numbers")
    return array


def _batched(network: export.Exported) -> Callable[[jax.Array, jax.Array], Any]:
    """The network on rows, for `jax.vmap` too, which JAX has no rule for: further axes are merged into the rows."""

    @jax.custom_batching.custom_vmap
    def call(obs: jax.Array, mask: jax.Array) -> tuple[jax.Array, ...]:
        return tuple(network.call(obs, mask))

    @call.def_vmap
    def _call_all(size: int, batched: Sequence[bool], *leaves: jax.Array) -> Any:
        full = with_rows(size, leaves, tuple(batched))
        merged = call(*(leaf.reshape(-1, leaf.shape[-1]) for leaf in full))
        split = [leaf.reshape(size, -1, *leaf.shape[1:]) for leaf in merged]
        return tuple(split), (True, True)

    return call


def save_policy(path: Path, about: About, network: export.Exported) -> None:
    """Writes the file, in full or not at all.

    Raises:
      OSError: it cannot be written.
    """
    with replacing(path) as partial, zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as file:
        text = json.dumps({"format": FORMAT, **dataclasses.asdict(about)}, indent=2)
        file.writestr(ABOUT, text + "\n")
        file.writestr(NETWORK, network.serialize())


def load_policy(path: Path | str) -> ExportedPolicy:
    """Reads a policy.

    Raises:
      InputError: no such file, or not one that `save_policy` wrote.
    """
    path, allowed = (
        as_path("policy", path),
        "allowed: a policy that train.ppo or train.export wrote",
    )
    check_input("policy", path)
    try:
        with zipfile.ZipFile(path) as file:
            given = json.loads(_member(path, file, ABOUT))
            found = given.pop("format")
            if found != FORMAT:
                raise InputError(f"policy {path} has format {shown(found)}, allowed: {FORMAT}")
            about, content = _about(given), bytearray(_member(path, file, NETWORK))
    except OSError as error:
        raise InputError(f"policy {path}: {error.strerror or error}, {allowed}") from None
    except InputError:
        raise
    except Exception:  # whatever zipfile, zlib and JSON say of bytes that were changed
        raise InputError(f"policy {path} cannot be read, {allowed}") from None
    try:
        network = export.deserialize(content)
        network.mlir_module()  # reads what a call would compile
        fits = _fits(about, network)
    except Exception:  # whatever FlatBuffers and MLIR say of bytes that were changed
        fits = False
    if not fits:
        raise InputError(f"policy {path} holds a network that cannot be read, {allowed}")
    return ExportedPolicy(about, network)


def _about(given: Mapping[str, Any]) -> About:
    """What a file says of its policy; raises ValueError or TypeError where nobody wrote that."""
    about = About(**given)
    for name, kind in get_type_hints(About).items():
        value = getattr(about, name)
        if not isinstance(value, get_origin(kind) or kind) or isinstance(value, bool):
            raise TypeError(name)
    known = about.dispatcher in ("", *BASELINES) and set(about.agents) <= AGENTS
    if not (known and about.decide_every >= 1 and about.name.isprintable() and about.name):
        raise ValueError
    return about


def _member(path: Path, file: zipfile.ZipFile, name: str) -> bytes:
    """A part of the file, if it is not too large to be one."""
    size, most = file.getinfo(name).file_size, MOST_BYTES[name]
    if size > most:
        raise InputError(f"policy {path} holds a {name} of {size} bytes: at most {most}")
    return file.read(name)


def _fits(about: About, network: export.Exported) -> bool:
    """Whether a network takes and gives arrays of the shapes that the policy says."""
    obs, mask = (aval.shape[-1] for aval in network.in_avals)
    probabilities, _ = (aval.shape for aval in network.out_avals)
    features, actions = about.num_features, about.num_actions
    return (obs, mask, probabilities[-1]) == (features, actions, actions)
