"""Settings of a training run: their defaults, their checks on the host, and their file."""

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

Override = bool | int | float | str | tuple[Any, ...]


class SettingError(ValueError):
    """A setting out of its range; the message is one line that names field, value and what is allowed."""


def option(
    default: Any,
    group: str,
    text: str,
    *,
    flags: tuple[str, ...] = (),
    choices: tuple[str, ...] = (),
    metavar: str | None = None,
    low: float | None = None,
    high: float | None = None,
    above: float | None = None,
) -> Any:
    """A dataclass field with what the command line and the checks need to know about it.

    Args:
        default: value when nothing is said.
        group: heading in --help.
        text: help, with the unit.
        flags: further names of the option.
        choices: allowed values.
        metavar: placeholder in --help.
        low: smallest allowed value.
        high: largest allowed value.
        above: bound that a value must exceed.
    """
    metadata: dict[str, Any] = {
        "group": group,
        "help": text,
        "flags": flags,
        "choices": choices,
        "metavar": metavar,
    }
    metadata |= {"low": low, "high": high, "above": above}
    return dataclasses.field(default=default, metadata=metadata)


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """Everything that determines the result of a run, and a few choices of its conduct.

    Raises:
        SettingError: a value out of its range, or values that do not go together.
    """

    scenario: str = option("paper", "environment", "preset to train on", metavar="NAME")
    overrides: Mapping[str, Override] = option(
        None, "environment", "set a number of the environment, e.g. --set cooldown_s=30; repeatable"
    )
    observation: str = option(
        "profile", "environment", "what the policy sees: profile or flat", metavar="NAME"
    )
    demand_range: tuple[float, ...] = option(
        (1.0, 1.0),
        "environment",
        "in training, each episode has the demand of the preset times a factor, drawn between these two",
        metavar="X",
        low=0,
        high=4,  # four lanes do not carry more
    )
    num_envs: int = option(256, "environment", "environments run side by side", low=1)
    decide_every: int = option(
        8, "environment", "decisions from one choice of the policy to the next", low=1
    )
    stagger: bool = option(
        True, "environment", "spread the ends of the first episodes, so that not all end together"
    )
    total_timesteps: int = option(
        6_000_000, "run", "decisions per seed over all environments, rounded up to updates", low=1
    )
    seed: int = option(0, "run", "of all randomness", low=0, high=2**32 - 1)
    num_seeds: int = option(1, "run", "independent learners trained side by side", low=1)
    num_devices: int = option(
        0, "run", "devices, or CPU cores, that share the environments; 0: all", low=0
    )
    checkpoint_interval: int = option(
        10, "run", "updates between checkpoints; 0: at the end only", low=0
    )
    keep_checkpoints: int = option(3, "run", "newest checkpoints kept", low=1)
    updates_per_call: int = option(
        16, "run", "most updates in one call of the compiled program", low=1
    )
    eval_episodes: int = option(64, "run", "episodes of the closing evaluation; 0: none", low=0)

    rollout_length: int = option(16, "PPO", "choices per environment and update", low=1)
    num_minibatches: int = option(32, "PPO", "minibatches per epoch; must divide num_envs", low=1)
    num_epochs: int = option(8, "PPO", "passes over each rollout", low=1)
    learning_rate: float = option(1e-3, "PPO", "of Adam, at the start", flags=("--lr",), above=0)
    anneal: bool = option(True, "PPO", "let the learning rate fall linearly to 0")
    gamma: float = option(0.996, "PPO", "discount per choice", low=0, high=1)
    gae_lambda: float = option(
        0.95, "PPO", "decay of the advantage trace per choice", low=0, high=1
    )
    bootstrap_timeouts: bool = option(
        False,
        "PPO",
        "value what would follow after the time limit; for observations without a clock",
    )
    clip_epsilon: float = option(
        0.2, "PPO", "clip of the ratio, eq. (9)", flags=("--clip",), above=0
    )
    clip_value: bool = option(False, "PPO", "clip the value loss as well")
    entropy_coef: float = option(
        0.0, "PPO", "weight of the entropy bonus", flags=("--entropy",), low=0
    )
    value_coef: float = option(0.5, "PPO", "weight of the value loss", low=0)
    max_grad_norm: float = option(0.5, "PPO", "global norm at which gradients are clipped", above=0)
    normalize_observations: bool = option(False, "PPO", "shift and scale by running moments")
    normalize_rewards: bool = option(True, "PPO", "scale by the spread of the discounted return")

    network: str = option(
        "mlp",
        "network",
        "architecture: mlp, or sets (of MEDs and EVs) with --observation flat",
        metavar="NAME",
    )
    hidden: tuple[int, ...] = option(
        (128, 128), "network", "widths of the hidden layers of actor and critic", metavar="N", low=1
    )
    encoder: tuple[int, ...] = option(
        (64, 64),
        "network",
        "widths of the layers of sets that every vehicle goes through",
        metavar="N",
        low=1,
    )
    activation: str = option("silu", "network", "between layers", choices=("tanh", "relu", "silu"))
    initial_wait: float = option(
        0.8, "network", "probability of action 0 before training", above=0, high=0.999
    )
    compute_dtype: str = option(
        "float32",
        "network",
        "type of the hidden layers' arithmetic",
        choices=("float32", "bfloat16"),
    )

    def __post_init__(self) -> None:
        """Checks every field, then what must go together."""
        object.__setattr__(self, "overrides", dict(self.overrides or {}))
        for name in ("demand_range", "hidden", "encoder"):
            object.__setattr__(self, name, _as_tuple(name, getattr(self, name)))
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            for item in value if isinstance(field.default, tuple) else (value,):
                _check(field, item)
        if self.num_envs % self.num_minibatches:
            raise SettingError(
                f"num_envs is {self.num_envs}, which num_minibatches = {self.num_minibatches} does not divide; "
                f"allowed: a multiple of {self.num_minibatches}"
            )
        if len(self.demand_range) != 2 or self.demand_range[0] > self.demand_range[1]:
            given = " ".join(map(str, self.demand_range))
            raise SettingError(
                f"demand_range is {given}, allowed: two numbers, the lower one first"
            )
        for name in ("hidden", "encoder"):
            if not getattr(self, name):
                raise SettingError(f"{name} is empty, allowed: at least one width")
        if self.eval_episodes == 1:
            raise SettingError("eval_episodes is 1, allowed: 0, or at least 2")

    @property
    def steps_per_update(self) -> int:
        """Decisions per update and seed."""
        return self.num_envs * self.rollout_length * self.decide_every

    @property
    def num_updates(self) -> int:
        """Updates of the whole run."""
        return -(-self.total_timesteps // self.steps_per_update)


def _as_tuple(name: str, value: Any) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise SettingError(f"{name} is {value!r}, allowed: a list")
    return tuple(value)


def _check(field: dataclasses.Field[Any], value: Any) -> None:
    """Type and range of one value."""
    name, meta, default = field.name, field.metadata, field.default
    if name == "overrides":
        return
    kind: Any = type(default[0] if isinstance(default, tuple) else default)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not kind:
        words = {bool: "true or false", int: "a whole number", float: "a number", str: "a name"}
        raise SettingError(f"{name} is {value!r}, allowed: {words[kind]}")
    if meta["choices"] and value not in meta["choices"]:
        raise SettingError(f"{name} is {value!r}, allowed: {', '.join(meta['choices'])}")
    if isinstance(value, bool | str):
        return
    low, high, above = meta["low"], meta["high"], meta["above"]
    inside = (
        math.isfinite(value)
        and (low is None or value >= low)
        and (high is None or value <= high)
        and (above is None or value > above)
    )
    if not inside:
        parts = [f"at least {low}"] if low is not None else []
        parts += [f"more than {above}"] if above is not None else []
        parts += [f"at most {high}"] if high is not None else []
        parts += ["finite"] if kind is float and high is None else []
        raise SettingError(f"{name} is {value}, allowed: {', '.join(parts)}")


def to_json(config: TrainConfig) -> dict[str, Any]:
    """The settings as a dict of JSON values."""
    return dataclasses.asdict(config)


def from_json(data: Any) -> TrainConfig:
    """The settings from a dict of JSON values; fields that are missing keep their defaults.

    Raises:
        SettingError: not a dict, an unknown field, or a value out of its range.
    """
    if not isinstance(data, dict):
        raise SettingError(
            f"settings are {type(data).__name__}, allowed: an object of named values"
        )
    known = {field.name for field in dataclasses.fields(TrainConfig)}
    for name in data:
        if name not in known:
            raise SettingError(f"{name!r} is not a setting of this version")
    return TrainConfig(**data)


def load_config(path: Path) -> TrainConfig:
    """Reads the config.json of a run, or settings alone; JSON, or YAML by the name's ending.

    Raises:
        SettingError: the file is missing, cannot be read, or holds something out of range.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise SettingError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise SettingError(f"{path} is not a text file") from None
    try:
        data = yaml.safe_load(text) if path.suffix in (".yaml", ".yml") else json.loads(text)
    except yaml.YAMLError:
        raise SettingError(f"{path} is not a YAML file") from None
    except ValueError:
        raise SettingError(f"{path} is not a JSON file") from None
    try:
        return from_json(data.get("config", data) if isinstance(data, dict) else data)
    except SettingError as error:
        raise SettingError(f"{path}: {error}") from None
