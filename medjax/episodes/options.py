"""The options of commands that play an episode: which one, with whom, and the recordings of it."""

import argparse
import dataclasses
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from medjax.commandline import add_set_option, as_path, parse_overrides, whole_number
from medjax.env.charging_env import ChargingEnv
from medjax.episodes.player import episode_decisions
from medjax.episodes.recording import Recording, record_episode, record_pieces
from medjax.errors import InputError, shown
from medjax.numerics.memory import check_memory
from medjax.policies.given import FILE, as_policy, check_policy
from medjax.policies.policy import Policy
from medjax.policies.rules import BASELINES
from medjax.policies.saved import load_policy
from medjax.policies.team import rules_of
from medjax.scenarios import SCENARIOS, make, prepare
from medjax.world.params import EnvParams

BYTES_OF_A_SLOT = 150  # of a frame: on the device, on the host, in the order of time, and as rows
RULE = "forecast"  # unless another policy is asked for
POLICY = "policy.zip"  # file of a trained policy in the directory of a run
EVALUATION = "evaluation.json"  # and that of its closing evaluation, where there was one


def add_episode_options(group: Any) -> None:
    """Adds the options to a group of a parser; values stay text, so that all errors are worded in one place."""
    whose = (
        f"a rule ({', '.join(BASELINES)}), pretrained (the policy that comes with medjax), module:function that builds "
        "one, or a file that ends in .zip"
    )
    group.add_argument("--policy", metavar="NAME", help=f"{whose} (default: {RULE})")
    group.add_argument(
        "--run-dir", metavar="DIR", help="instead: the policy that train.ppo left in DIR"
    )
    scenario = "preset (default: that of the trained policy, or paper)"
    group.add_argument("--scenario", metavar="NAME", help=scenario)
    numbers = "set a number of the environment, over those of the training; repeatable"
    add_set_option(group, numbers)
    group.add_argument("--seed", metavar="N", default="0", help="whose episodes (default: 0)")
    which = "which of them, as in train.evaluate (default: 0)"
    group.add_argument("--episode", metavar="N", default="0", help=which)


@dataclasses.dataclass(frozen=True)
class EpisodeRequest:
    """What to play; checked as far as that needs no environment."""

    file: Path | None  # of a trained policy; None: `policy` is none
    policy: str
    compare: str | None  # a rule beside it
    scenario: str | None  # None: that of the trained policy's training, or paper
    overrides: Mapping[str, Any]
    seed: int
    episode: int
    force: bool = False  # whatever memory it takes
    evaluation: Path | None = None  # of the run whose policy is played as it was trained

    def prepared(self) -> tuple[ChargingEnv, EnvParams]:
        """The environment and its numbers as `policies` makes them, but for the coils; nothing is compiled.

        Raises:
          InputError: as `policies`.
        """
        env: Any = None
        if self.file is None:
            env, params, _ = prepare(self.scenario or "paper", **self.overrides)
            return env, params
        env, params = load_policy(self.file).make(self.scenario, self.overrides, prepare)
        return getattr(env, "env", env), params

    def policies(self) -> tuple[ChargingEnv, EnvParams, dict[str, Policy]]:
        """The environment, its parameters, and what is played in it, by name.

        Raises:
          InputError: one line; numbers that the environment does not take, or a policy that cannot be read.
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
        """Plays the episode, once a policy.

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
        """Plays the episode with the only policy, piece by piece."""
        ((name, policy),) = chosen.items()
        return record_pieces(env, params, policy, name=name, seed=self.seed, episode=self.episode)


def requested_episode(given: argparse.Namespace) -> EpisodeRequest:
    """What the options of `add_episode_options`, and `compare` where there is one, ask for.

    Raises:
      InputError: an unknown name, a run that is not there, or options that do not go together.
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
            raise InputError(f"--compare {compare}: allowed another one than --policy")
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
    """The file of the trained policy that is asked for, which is there; None if it is none that is."""
    if run is None:
        return Path(policy) if policy.endswith(FILE) else None
    run_dir = as_path("--run-dir", run)
    if not run_dir.is_dir():
        raise InputError(f"--run-dir {run_dir}: is no directory; allowed one that train.ppo wrote")
    if not (run_dir / POLICY).is_file():
        remedy = f"python -m train.export --run-dir {run_dir} writes it"
        raise InputError(f"--run-dir {run_dir}: holds no {POLICY}; {remedy}")
    return run_dir / POLICY
