"""Command-line options that select an episode and its policies."""

import argparse
import dataclasses
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from medjax.commandline import add_set_option, as_path, parse_overrides, whole_number
from medjax.env.charging_env import ChargingEnv
from medjax.episodes.recording import Recording, record_episode, record_pieces
from medjax.episodes.runner import episode_decisions
from medjax.errors import InputError, shown
from medjax.numerics.memory import check_memory
from medjax.policies.given import FILE, as_policy, check_policy
from medjax.policies.policy import Policy
from medjax.policies.rules import BASELINES
from medjax.policies.saved import load_policy
from medjax.policies.team import rules_of
from medjax.scenarios import SCENARIOS, make, prepare
from medjax.world.params import EnvParams

# Per frame, for all copies: on the device, on the host, joined in time, and as table rows.
BYTES_OF_A_SLOT = 150
RULE = "forecast"  # default policy
POLICY = "policy.zip"  # trained policy in a run directory
EVALUATION = "evaluation.json"  # final evaluation in a run directory, if there was one


def add_episode_options(group: Any) -> None:
    """Adds the options to a parser's group. Values stay text, so that `requested_episode` reports all errors."""
    whose = (
        f"a rule ({', '.join(BASELINES)}), pretrained (shipped with medjax), module:function that builds a policy, or "
        "a .zip file"
    )
    group.add_argument("--policy", metavar="NAME", help=f"{whose} (default: {RULE})")
    group.add_argument(
        "--run-dir", metavar="DIR", help="play the policy that train.ppo trained in DIR instead"
    )
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

    file: Path | None  # of a trained policy; None if `policy` is not a file
    policy: str
    compare: str | None  # a rule to play beside it
    scenario: str | None  # None: that of the policy's training, or paper
    overrides: Mapping[str, Any]
    seed: int
    episode: int
    force: bool = False  # ignore the memory limit
    evaluation: Path | None = None  # of the run, if its policy plays in the world of its training

    def prepared(self) -> tuple[ChargingEnv, EnvParams]:
        """The environment and params of `policies`, without the coils' table, so that nothing compiles.

        Raises:
          InputError: as in `policies`.
        """
        if self.file is None:
            env, params, _ = prepare(self.scenario or "paper", **self.overrides)
            return env, params
        env, params = load_policy(self.file).make(self.scenario, self.overrides, prepare)
        return getattr(env, "env", env), params

    def policies(self) -> tuple[ChargingEnv, EnvParams, dict[str, Policy]]:
        """The environment, its parameters, and the policies to play, by name.

        Raises:
          InputError: the environment rejects a number, or the policy cannot be read.
        """
        if self.file is None:
            env, params = make(self.scenario or "paper", **self.overrides)
            chosen = {self.policy: as_policy(env, self.policy)}
        else:
            trained = load_policy(self.file)
            env, params = trained.make(self.scenario, self.overrides)
            chosen = {trained.about.name: trained.policy(env)}
        if self.compare:
            chosen[self.compare] = rules_of(env)[self.compare]
        return env, params, chosen

    def record(
        self, env: ChargingEnv, params: EnvParams, chosen: Mapping[str, Policy]
    ) -> list[Recording]:
        """Plays the episode once with each policy.

        Raises:
          InputError: the recordings do not fit into memory.
        """
        config, decisions = env.config, episode_decisions(params)
        slots = decisions * config.ticks_per_decision * config.num_vehicles * len(chosen)
        what = f"an episode of {decisions} decisions with {config.num_vehicles} vehicles"
        check_memory(what, slots * BYTES_OF_A_SLOT, self.force)
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
    for option, name, known in (
        ("compare", compare, BASELINES),
        ("scenario", given.scenario, SCENARIOS),
    ):
        if name is not None and name not in known:
            raise InputError(f"unknown {option} {shown(name)}: allowed {', '.join(known)}")
    policy = RULE if given.policy is None else given.policy
    if given.run_dir is None:
        check_policy(policy)
        if compare == policy:
            raise InputError(f"--compare {compare}: allowed another policy than --policy")
    overrides, file = parse_overrides(given.overrides), _file(given.run_dir, policy)
    as_trained = given.run_dir is not None and given.scenario is None and not overrides
    return EpisodeRequest(
        file=file,
        policy=policy,
        compare=compare,
        scenario=given.scenario,
        overrides=overrides,
        seed=whole_number("--seed", given.seed),
        episode=whole_number("--episode", given.episode),
        force=getattr(given, "force", False),
        evaluation=file.with_name(EVALUATION) if file and as_trained else None,
    )


def _file(run: str | None, policy: str) -> Path | None:
    """The file of the requested trained policy; None if the policy is not a file."""
    if run is None:
        return Path(policy) if policy.endswith(FILE) else None
    run_dir = as_path("--run-dir", run)
    if not run_dir.is_dir():
        raise InputError(
            f"--run-dir {run_dir} is not a directory; allowed one that train.ppo wrote"
        )
    if not (run_dir / POLICY).is_file():
        remedy = f"python -m train.export --run-dir {run_dir} writes it"
        raise InputError(f"--run-dir {run_dir}: holds no {POLICY}; {remedy}")
    return run_dir / POLICY
