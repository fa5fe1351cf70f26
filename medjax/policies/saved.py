"""Trained policies in files, which act without the learner, its libraries or a caller's `jax.jit`.

`python -m train.export --run-dir DIR` writes the file, a ZIP. `policy.json` says what the policy was trained for;
`network.bin` is the network with its weights as StableHLO (`jax.export`), for any architecture, on CPUs, GPUs and
TPUs, and readable by later versions of JAX. Loading unpickles nothing.
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
AGENTS = {"speeds", "credit", "central"}  # allowed keys of `About.agents` in a file
MOST_BYTES = {ABOUT: 2**20, NETWORK: 2**29}  # unpacked


@dataclasses.dataclass(frozen=True)
class ExportedPolicy:
    """A policy that was read from a file.

    Attributes:
      about: what it was trained for.
      network: maps observations `(rows, num_features)` and masks `(rows, num_actions)` to action probabilities
        `(rows, num_actions)` and values `(rows,)` in units of the learner's scaled reward.
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
        """Builds the policy's training environment, or another with the same observation, and its parameters.

        Args:
          scenario: preset; None: that of the training.
          overrides: numbers by name; for the training preset, they override those of the training.
          build: called like `medjax.make`, the default; `medjax.scenarios.prepare` computes nothing.

        Raises:
          InputError: the policy was trained in a custom environment, or an override is not a number.
        """
        about = self.about
        if not isinstance(overrides, Mapping | None):
            raise InputError(f"overrides are {shown(overrides)}, allowed: numbers by name")
        build = make if build is None else build
        if not about.scenario:
            raise InputError(
                "the policy was trained in a custom environment: allowed that one, passed in Python to "
                "ExportedPolicy.policy"
            )
        scenario = about.scenario if scenario is None else scenario
        kept = about.overrides if scenario == about.scenario else {}
        numbers: dict[str, Any] = {**kept, **(overrides or {})}
        if named := [name for name in NOT_NUMBERS if name in numbers]:
            raise InputError(f"overrides hold {named[0]}, allowed: numbers of the environment")
        if about.agents:
            if taken := about.agents.keys() & numbers.keys():
                raise InputError(
                    f"{min(taken)} is fixed by the policy, allowed {about.agents[min(taken)]}"
                )
            return agents_of(scenario, build=build, **about.agents, **numbers)
        env, params, *_ = build(scenario, observation=about.observation, **numbers)
        return env, params

    def probabilities(self, obs: Any, mask: Any) -> np.ndarray:
        """Probabilities of the actions.

        Args:
          obs: `(num_features,)` or `(rows, num_features)`, any array-like.
          mask: `(num_actions,)` or `(rows, num_actions)` bool, allowed actions, such as `info["action_mask"]`.

        Returns:
          `(num_actions,)` or `(rows, num_actions)` float32; 0 for masked actions.

        Raises:
          InputError: a wrong shape, or a value that is not a finite number.
        """
        obs, mask = _numbers("obs", obs, np.float32), _numbers("mask", mask, bool)
        wanted = self.about.num_features, self.about.num_actions
        given = obs.shape[-1:] + mask.shape[-1:]
        if given != wanted or obs.shape[:-1] != mask.shape[:-1] or obs.ndim > 2:
            raise InputError(
                f"obs has shape {obs.shape} and mask {mask.shape}: allowed (..., {wanted[0]}) and "
                f"(..., {wanted[1]}), with or without an axis for rows"
            )
        if not mask.size:  # the network does not accept zero rows
            return mask.astype(np.float32)
        rows, _ = self.network.call(obs.reshape(-1, wanted[0]), mask.reshape(-1, wanted[1]))
        return np.asarray(rows).reshape(mask.shape)

    def act(self, obs: Any, mask: Any) -> np.ndarray:
        """The most probable action, `()` or `(rows,)` int64; arguments as in `probabilities`.

        Call it at every `about.decide_every`-th decision and take action 0 in between.
        """
        return np.argmax(self.probabilities(obs, mask), axis=-1)

    def policy(self, env: Any) -> Policy:
        """A `Policy` for an environment that takes the most probable action.

        It uses the environment's observation if the size fits; otherwise it observes the highway as in its training.

        Raises:
          InputError: env is not an environment, or the policy does not fit it.
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
            """The most probable of the allowed actions; the network holds the weights. See `Policy.act`."""
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
    """Converts value to an array of finite numbers; raises InputError for anything else."""
    try:
        array = np.asarray(value, dtype)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    if not np.isfinite(array).all():
        raise InputError(f"{name} = {shown(value)}: allowed finite numbers")
    return array


def _batched(network: export.Exported) -> Callable[[jax.Array, jax.Array], Any]:
    """Makes the network work under `jax.vmap`, which has no rule for exported functions, by merging axes into rows."""

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
    """Writes the file atomically.

    Raises:
      OSError: the file cannot be written.
    """
    with replacing(path) as partial, zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as file:
        text = json.dumps({"format": FORMAT, **dataclasses.asdict(about)}, indent=2)
        file.writestr(ABOUT, text + "\n")
        file.writestr(NETWORK, network.serialize())


def load_policy(path: Path | str) -> ExportedPolicy:
    """Reads a policy from a file.

    Raises:
      InputError: the file does not exist, or `save_policy` did not write it.
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
    except Exception:  # zipfile, zlib and JSON raise many types for corrupt bytes
        raise InputError(f"policy {path} cannot be read, {allowed}") from None
    try:
        network = export.deserialize(content)
        network.mlir_module()  # parses the code that a call would compile
        fits = _fits(about, network)
    except Exception:  # FlatBuffers and MLIR raise many types for corrupt bytes
        fits = False
    if not fits:
        raise InputError(f"policy {path} holds a network that cannot be read, {allowed}")
    return ExportedPolicy(about, network)


def _about(given: Mapping[str, Any]) -> About:
    """Parses a file's metadata; raises ValueError or TypeError if it is invalid."""
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
    """Reads a member of the ZIP; raises InputError if it is too large to be genuine."""
    size, most = file.getinfo(name).file_size, MOST_BYTES[name]
    if size > most:
        raise InputError(f"policy {path} holds a {name} of {size} bytes: at most {most}")
    return file.read(name)


def _fits(about: About, network: export.Exported) -> bool:
    """Whether the network's input and output shapes match the metadata."""
    obs, mask = (aval.shape[-1] for aval in network.in_avals)
    probabilities, _ = (aval.shape for aval in network.out_avals)
    features, actions = about.num_features, about.num_actions
    return (obs, mask, probabilities[-1]) == (features, actions, actions)
