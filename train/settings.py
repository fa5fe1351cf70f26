"""Settings of a training run: defaults, checks, and their file."""

import abc
import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

from medjax.errors import InputError, shown
from train.option import (
    SHARP_RULE,
    SOFT_RULE,
    Override,
    checked,
    current_names,
    filled,
    of_a_run,
    option,
    say_renamed,
)
from train.settings_file import read_file

MOST_COUNTED = 2**31 - 1  # indices and counters are int32
MOST_PER_CALL = 1024  # updates in one call of the compiled program
GIVEN = "given from Python"  # marks the file of a run whose settings do not rebuild its environment
# The deterministic rules of medjax.BASELINES that do not change how vehicles drive.
DISPATCHERS = ("periodic", "paced", "greedy", "forecast", "budgeted")
# Settings that must keep their defaults: those of agents where there are none, and those that agents do not have.
NEED_AGENTS = ("credit", "dispatcher")
WITHOUT_AGENTS = (
    "wrapper",
    "observation",
    "decide_every",
)  # between choices, action 0 would cancel an agent's orders


@dataclasses.dataclass(frozen=True)
class TrainConfig(abc.ABC):
    """Everything that determines the result of a run, and some options of how it runs.

    An algorithm adds its own fields in a subclass, see `train.algorithms.settings.SETTINGS`.

    Raises:
        InputError: a value out of its range, or values that do not go together.
    """

    algorithm: ClassVar[str]  # name of the algorithm, and of the policy that it learns
    # With num_envs these fix the decisions and gradient steps of an update, so a resumed run may not change them.
    of_an_update: ClassVar[tuple[str, ...]] = ("decide_every",)

    scenario: str = option("paper", "environment", "preset to train on")
    overrides: Mapping[str, Override] = option(
        None, "environment", "set a number of the environment, e.g. --set cooldown_s=30; repeatable"
    )
    reward: str = option(
        "preset",
        "environment",
        "the reward: preset (its own), paper, money, or module:function of a term of your own, several with commas, "
        "in addition to the preset's",
    )
    wrapper: str = option(
        "none", "environment", "module:function that wraps the environment in one of your own"
    )
    observation: str = option("profile", "environment", "what a dispatcher sees: profile or flat")
    agents: str = option(
        "none",
        "environment",
        "who decides: none, a dispatcher; or every MED, by one shared policy (docs/agents.md): ippo, whose critic "
        "sees what a MED sees; mappo, whose critic sees the whole road as well",
        choices=("none", "ippo", "mappo"),
    )
    credit: str = option(
        "team",
        "environment",
        "reward of each agent: the team's, or the gain of its own EVs",
        choices=("team", "own"),
    )
    dispatcher: str = option(
        "agents",
        "environment",
        "who dispatches the agents: they themselves, or a rule",
        choices=("agents", *DISPATCHERS),
    )
    demand_range: tuple[float, ...] = option(
        (1.0, 1.0),
        "environment",
        "in training, scale each episode's demand by a factor drawn between these two",
        limits=(0, 4),  # four lanes do not carry more
    )
    num_envs: int = option(
        None,
        "environment",
        "environments side by side; by default a power of two from 32 to 1024 that leaves 16 updates, with --agents 32",
        limits=(1, 2**20),
    )
    decide_every: int = option(
        1, "environment", "decisions per choice of the policy", limits=(1, 10**6)
    )
    stagger: bool = option(
        False, "environment", "spread the ends of the first episodes, so that not all end together"
    )
    total_timesteps: int = option(
        None,
        "run",
        "decisions per seed over all environments, rounded up to updates; by default 10 million, 500,000 with --agents",
        limits=(1, 10**15),
    )
    seed: int = option(0, "run", "seed of all randomness", limits=(0, 2**32 - 1))
    num_seeds: int = option(
        1,
        "run",
        "independent learners, trained in one program, in turn",
        flags=("--seeds",),
        limits=(1, 1024),
    )
    num_devices: int = option(
        0, "run", "devices, or CPU cores, that share the environments; 0: all", limits=(0, 2**16)
    )
    checkpoint_interval: int = option(
        5, "run", "updates between checkpoints; 0: at the end only", limits=(0, 10**9)
    )
    keep_checkpoints: int = option(3, "run", "newest checkpoints kept", limits=(1, 10**6))
    updates_per_call: int = option(
        16, "run", "most updates in one call of the compiled program", limits=(1, MOST_PER_CALL)
    )
    eval_episodes: int = option(
        64, "run", "episodes of the closing evaluation; 0: none", limits=(0, 10**7)
    )

    force: bool = option(False, "run", "start even if the run needs more memory than there is")

    network: str = option(
        "ramps",
        "network",
        "architecture: mlp; ramps, which adds a network that all ramps share, where the observation is a profile; "
        "or sets (of MEDs and EVs) with --observation flat",
    )
    hidden: tuple[int, ...] = option(
        (64, 64), "network", "widths of the hidden layers of actor and critic", limits=(1, 2**16)
    )
    encoder: tuple[int, ...] = option(
        (64, 64),
        "network",
        "widths of the layers that encode a vehicle, with --network sets",
        limits=(1, 2**16),
    )
    activation: str = option(
        "silu", "network", "activation of the hidden layers", choices=("tanh", "relu", "silu")
    )
    policy_prior: str = option(
        "rule",
        "network",
        "the policy that training starts from: the rule budgeted, which needs --observation profile; or wait",
        choices=("rule", "wait"),
    )
    rule_sharpness: float = option(
        None,
        "network",
        "how sharp the rule is that training starts from, in logits per EV; a lower number explores more; by default 1 "
        "for a dispatcher that trains on 5000 episodes or more, else 4",
        limits=(0.001, 1000),
    )
    initial_wait: float = option(
        0.8,
        "network",
        "initial probability of action 0, unless training starts from a rule; for agents also of their usual lane, "
        "and of taking EVs",
        limits=(0.001, 0.999),
    )
    compute_dtype: str = option(
        "float32",
        "network",
        "type of the hidden layers' arithmetic",
        choices=("float32", "bfloat16"),
    )

    def __post_init__(self) -> None:
        """Checks every field and stores it as a built-in type, then checks combinations."""
        for field in dataclasses.fields(self):
            object.__setattr__(self, field.name, checked(field, getattr(self, field.name)))
        if len(self.demand_range) != 2 or self.demand_range[0] > self.demand_range[1]:
            given = " ".join(map(str, self.demand_range))
            raise InputError(f"demand_range is {given}, allowed: two numbers, the lower one first")
        for name in ("hidden", "encoder"):
            if not getattr(self, name):
                raise InputError(f"{name} is empty, allowed: at least one width")
        for name in NEED_AGENTS if self.agents == "none" else WITHOUT_AGENTS:
            if (value := getattr(self, name)) != (usual := getattr(TrainConfig, name)):
                given = f"agents is {self.agents!r} and {name} is {shown(value)}"
                raise InputError(f"{given}, allowed: {usual}")
        if self.eval_episodes == 1:
            raise InputError("eval_episodes is 1, allowed: 0, or at least 2")
        if self.num_envs and self.total_timesteps and self.num_updates > MOST_COUNTED:
            most = f"{MOST_COUNTED} updates, {MOST_COUNTED * self.steps_per_update}"
            raise InputError(f"total_timesteps is {self.total_timesteps}, allowed: at most {most}")

    @property
    def changes(self) -> dict[str, Any]:
        """How its episodes differ from the preset's, for display: overrides, and a user's own wrapper."""
        return {**self.overrides, **({} if self.wrapper == "none" else {"wrapper": self.wrapper})}

    @property
    @abc.abstractmethod
    def choices_per_update(self) -> int:
        """Choices per environment and update."""

    def for_episodes(self, decisions: int) -> Self:
        """Fills in settings that follow others, and the length of an episode, in decisions."""
        agents = self.agents != "none"  # an episode holds far more choices of theirs
        total = self.total_timesteps or (500_000 if agents else 10_000_000)
        most = total // (16 * self.choices_per_update * self.decide_every)  # they leave 16 updates
        num_envs = 32 if agents else 2 ** min(max(most.bit_length() - 1, 5), 10)  # 32 to 1024
        # A softer rule plays worse at first. On `paper` dispatchers gain from it in 5000 episodes; in 2500 no gain can
        # be seen.
        soft = not agents and 0 < 5000 * decisions <= total
        sharpness = SOFT_RULE if soft else SHARP_RULE
        return filled(self, total_timesteps=total, num_envs=num_envs, rule_sharpness=sharpness)

    @property
    def device_groups(self) -> int:
        """Number of groups of environments; a device holds whole groups."""
        return self.num_envs // self.group_size

    @property
    def group_size(self) -> int:
        """Environments in a group, which meet the same episodes. The default is 1."""
        return 1

    @property
    def steps_per_update(self) -> int:
        """Decisions per update and seed."""
        return self.num_envs * self.choices_per_update * self.decide_every

    @property
    def num_updates(self) -> int:
        """Updates of the whole run."""
        return -(-self.total_timesteps // self.steps_per_update)


Config = TypeVar("Config", bound=TrainConfig)


def to_json(config: TrainConfig) -> dict[str, Any]:
    """The settings as a dict of JSON values, the algorithm's name first."""
    return {"algorithm": config.algorithm, **dataclasses.asdict(config)}


def from_json(data: Any, *kinds: type[Config]) -> Config:
    """The settings from a dict of JSON values; fields that are missing keep their defaults.

    Args:
        data: the values, and `algorithm`, which defaults to that of the first of `kinds`.
        kinds: allowed classes of settings.

    Raises:
        InputError: not a dict, another algorithm, an unknown field, or a value out of its range.
    """
    if not isinstance(data, dict):
        raise InputError(f"settings are {type(data).__name__}, allowed: an object of named values")
    values = current_names(data)
    by_name = {kind.algorithm: kind for kind in kinds}
    given = values.pop("algorithm", kinds[0].algorithm)
    if not isinstance(given, str) or given not in by_name:
        raise InputError(f"algorithm is {shown(given)}, allowed: {', '.join(by_name)}")
    known = [field.name for field in dataclasses.fields(by_name[given])]
    if foreign := [name for name in values if name not in known]:
        raise InputError(f"{shown(foreign[0])} is not a setting of this version")
    config = by_name[given](**values)
    say_renamed(data)
    return config


def load_config(path: Path, *kinds: type[Config], given: bool = False) -> Config:
    """Reads the config.json of a run (see `of_a_run`), or a file of settings; the suffix tells JSON from YAML.

    Args:
        path: file to read.
        kinds: allowed classes of settings, see `from_json`.
        given: `train.api` supplies the environment, so that the settings need not describe it.

    Raises:
        InputError: the file is missing, cannot be read, holds a value out of range, or does not describe the
            environment.
    """
    data = read_file(path)
    is_file_of_run = isinstance(data, dict) and "config" in data
    if is_file_of_run and data.get("environment") == GIVEN and not given:
        raise InputError(
            f"{path} is of an environment that was given from Python, which settings alone do not rebuild; "
            "allowed: train.api.train and evaluate, with that environment"
        )
    try:
        return from_json(of_a_run(data["config"]) if is_file_of_run else data, *kinds)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
