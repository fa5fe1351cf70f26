"""Command-line options that select an episode and its policies."""

import argparse
import dataclasses
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from medjax.commandline import add_set_option, parse_overrides, whole_number
from medjax.env.charging_env import ChargingEnv
from medjax.episodes.recording import Recording, record_episode, record_pieces
from medjax.episodes.runner import episode_decisions
from medjax.errors import InputError, shown
from medjax.numerics.memory import check_memory
from medjax.policies.given import ALLOWED, RUN, check_policy, file_of, named_policy
from medjax.policies.policy import Policy
from medjax.policies.saved import load_policy
from medjax.scenarios import SCENARIOS, make, prepare
from medjax.world.params import EnvParams

# Per frame, for all copies: on the device, on the host, joined in time, and as table rows.
BYTES_OF_A_SLOT = 150
RULE = "forecast"  # default policy
EVALUATION = "evaluation.json"  # final evaluation in a run directory, if there was one


def add_episode_options(group: Any) -> None:
    """Adds the options to a parser's group. Values stay text, so that `requested_episode` reports all errors."""
    group.add_argument("--policy", metavar="NAME", help=f"{ALLOWED} (default: {RULE})")
    group.add_argument("--run-dir", metavar="DIR", help=f"the same as --policy {RUN}DIR")
    scenario = "preset (default: that of the policy's training, or paper)"
    group.add_argument("--scenario", metavar="NAME", help=scenario)
    numbers = "set a parameter of the environment, in place of the training's value; repeatable"
    add_set_option(group, numbers)
    group.add_argument("--seed", metavar="N", default="0", help="seed of the episodes (default: 0)")
    which = "index of the episode for this seed, as in train.evaluate (default: 0)"
    group.add_argument("--episode", metavar="N", default="0", help=which)


@dataclasses.dataclass(frozen=True)
class EpisodeRequest:
    """A request to play an episode; its checks are those that need no environment."""

    policies: tuple[str, ...]  # as in `medjax.policies.given.check_policy`
    file: Path | None  # of the first trained policy, which sets the world; None if there is none
    scenario: str | None  # None: that of the policy's training, or paper
    overrides: Mapping[str, Any]
    seed: int
    episode: int
    force: bool = False  # ignore the memory limit
    evaluation: Path | None = None  # of the run, if its policy plays in the world of its training

    def prepared(self) -> tuple[ChargingEnv, EnvParams]:
        """The environment and params of `build`, without the coils' table, so that nothing compiles.

        Raises:
          InputError: as in `build`.
        """
        if self.file is None:
            env, params, _ = prepare(self.scenario or "paper", **self.overrides)
            return env, params
        env, params = load_policy(self.file).make(self.scenario, self.overrides, prepare)
        return getattr(env, "env", env), params

    def build(self) -> tuple[ChargingEnv, EnvParams, dict[str, Policy]]:
        """The environment, its parameters, and the policies to play, by name.

        Policies from files go by their own names, such as ppo, unless two have the same.

        Raises:
          InputError: the environment rejects a number, or the policy cannot be read.
        """
        if self.file is None:
            env, params = make(self.scenario or "paper", **self.overrides)
        else:
            env, params = load_policy(self.file).make(self.scenario, self.overrides)
        built = [named_policy(env, text) for text in self.policies]
        chosen = dict(built)
        if len(chosen) < len(built):
            chosen = {text: policy for text, (_, policy) in zip(self.policies, built, strict=True)}
        return env, params, chosen

    def check_memory(self, env: ChargingEnv, params: EnvParams, episodes: int = 1) -> None:
        """Raises InputError if recordings of so many episodes with all policies do not fit into memory."""
        config, decisions = env.config, episode_decisions(params)
        frames = decisions * config.ticks_per_decision * len(self.policies) * episodes
        slots = frames * config.num_vehicles
        what = f"an episode of {decisions} decisions with {config.num_vehicles} vehicles"
        check_memory(what, slots * BYTES_OF_A_SLOT, self.force)

    def record(
        self, env: ChargingEnv, params: EnvParams, chosen: Mapping[str, Policy]
    ) -> list[Recording]:
        """Plays the episode once with each policy."""
        print(f"compiling and playing an episode with {' and '.join(chosen)} ...", file=sys.stderr)
        return [
            record_episode(env, params, policy, name=name, seed=self.seed, episode=self.episode)
            for name, policy in chosen.items()
        ]

    def record_pieces(
        self, env: ChargingEnv, params: EnvParams, chosen: Mapping[str, Policy]
    ) -> Iterator[Recording]:
        """Plays the episode with the only policy, in pieces."""
        ((name, policy),) = chosen.items()
        return record_pieces(env, params, policy, name=name, seed=self.seed, episode=self.episode)


def requested_episode(given: argparse.Namespace) -> EpisodeRequest:
    """Reads and checks the options of `add_episode_options`, and `compare` if present.

    Raises:
      InputError: a name is unknown, the run does not exist, or options conflict.
    """
    compare = getattr(given, "compare", None)
    if given.run_dir is not None and given.policy:
        raise InputError("--run-dir with --policy: allowed one or the other")
    if given.scenario is not None and given.scenario not in SCENARIOS:
        allowed = ", ".join(SCENARIOS)
        raise InputError(f"unknown scenario {shown(given.scenario)}: allowed {allowed}")
    policy = RULE if given.policy is None else given.policy
    first = policy if given.run_dir is None else RUN + given.run_dir
    policies = (first,) if compare is None else (first, compare)
    for text in policies:
        check_policy(text)
    if compare == first:
        raise InputError(f"--compare {compare}: allowed another policy than --policy")
    overrides = parse_overrides(given.overrides)
    trained = [text for text in policies if file_of(text) is not None]
    file = file_of(trained[0]) if trained else None
    as_trained = file and trained[0].startswith(RUN) and given.scenario is None and not overrides
    return EpisodeRequest(
        policies=policies,
        file=file,
        scenario=given.scenario,
        overrides=overrides,
        seed=whole_number("--seed", given.seed),
        episode=whole_number("--episode", given.episode),
        force=getattr(given, "force", False),
        evaluation=file.with_name(EVALUATION) if file and as_trained else None,
    )
