"""Settings of a training run: their defaults, their checks on the host, and their file."""

import dataclasses
import math
import numbers
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from medjax.commandline import NOT_NUMBERS, read_json
from medjax.errors import InputError, shown
from train.yaml_file import read_yaml

Override = bool | int | float | str | tuple[Any, ...] | dict[str, Any]

MOST_COUNTED = 2**31 - 1  # indices and counters are int32
MOST_PER_CALL = 1024  # updates in one call of the compiled program
MOST_ITEMS = 32  # of a list; a deeper network would take hours to compile
MOST_BYTES = 2**16  # of a file of settings


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
    """
    metadata: dict[str, Any] = {
        "group": group,
        "help": text,
        "flags": flags,
        "choices": choices,
        "metavar": metavar,
    }
    metadata |= {"low": low, "high": high}
    return dataclasses.field(default=default, metadata=metadata)


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """Everything that determines the result of a run, and a few choices of its conduct.

    Raises:
        InputError: a value out of its range, or values that do not go together.
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
    num_envs: int = option(256, "environment", "environments run side by side", low=1, high=2**20)
    decide_every: int = option(
        8,
        "environment",
        "decisions from one choice of the policy to the next",
        low=1,
        high=10**6,
    )
    stagger: bool = option(
        True, "environment", "spread the ends of the first episodes, so that not all end together"
    )
    total_timesteps: int = option(
        6_000_000,
        "run",
        "decisions per seed over all environments, rounded up to updates",
        low=1,
        high=10**15,
    )
    seed: int = option(0, "run", "of all randomness", low=0, high=2**32 - 1)
    num_seeds: int = option(1, "run", "independent learners trained side by side", low=1, high=1024)
    num_devices: int = option(
        0, "run", "devices, or CPU cores, that share the environments; 0: all", low=0, high=2**16
    )
    checkpoint_interval: int = option(
        10, "run", "updates between checkpoints; 0: at the end only", low=0, high=10**9
    )
    keep_checkpoints: int = option(3, "run", "newest checkpoints kept", low=1, high=10**6)
    updates_per_call: int = option(
        16, "run", "most updates in one call of the compiled program", low=1, high=MOST_PER_CALL
    )
    eval_episodes: int = option(
        64, "run", "episodes of the closing evaluation; 0: none", low=0, high=10**7
    )

    rollout_length: int = option(16, "PPO", "choices per environment and update", low=1, high=2**16)
    num_minibatches: int = option(
        32, "PPO", "minibatches per epoch; must divide num_envs", low=1, high=2**20
    )
    num_epochs: int = option(8, "PPO", "passes over each rollout", low=1, high=1000)
    learning_rate: float = option(
        1e-3, "PPO", "of Adam, at the start", flags=("--lr",), low=1e-12, high=10
    )
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
        0.2, "PPO", "clip of the ratio, eq. (9)", flags=("--clip",), low=1e-6, high=1e6
    )
    clip_value: bool = option(False, "PPO", "clip the value loss as well")
    entropy_coef: float = option(
        0.0, "PPO", "weight of the entropy bonus", flags=("--entropy",), low=0, high=1e6
    )
    value_coef: float = option(0.5, "PPO", "weight of the value loss", low=0, high=1e6)
    max_grad_norm: float = option(
        0.5, "PPO", "global norm at which gradients are clipped", low=1e-6, high=1e9
    )
    normalize_observations: bool = option(False, "PPO", "shift and scale by running moments")
    normalize_rewards: bool = option(True, "PPO", "scale by the spread of the discounted return")

    network: str = option(
        "mlp",
        "network",
        "architecture: mlp, or sets (of MEDs and EVs) with --observation flat",
        metavar="NAME",
    )
    hidden: tuple[int, ...] = option(
        (128, 128),
        "network",
        "widths of the hidden layers of actor and critic",
        metavar="N",
        low=1,
        high=2**16,
    )
    encoder: tuple[int, ...] = option(
        (64, 64),
        "network",
        "widths of the layers of sets that every vehicle goes through",
        metavar="N",
        low=1,
        high=2**16,
    )
    activation: str = option("silu", "network", "between layers", choices=("tanh", "relu", "silu"))
    initial_wait: float = option(
        0.8, "network", "probability of action 0 before training", low=0.001, high=0.999
    )
    compute_dtype: str = option(
        "float32",
        "network",
        "type of the hidden layers' arithmetic",
        choices=("float32", "bfloat16"),
    )

    def __post_init__(self) -> None:
        """Checks every field and keeps it as a value of Python, then checks what must go together."""
        for field in dataclasses.fields(self):
            object.__setattr__(self, field.name, _read(field, getattr(self, field.name)))
        if self.num_envs % self.num_minibatches:
            raise InputError(
                f"num_envs is {self.num_envs}, which num_minibatches = {self.num_minibatches} does not divide; "
                f"allowed: a multiple of {self.num_minibatches}"
            )
        if len(self.demand_range) != 2 or self.demand_range[0] > self.demand_range[1]:
            given = " ".join(map(str, self.demand_range))
            raise InputError(f"demand_range is {given}, allowed: two numbers, the lower one first")
        for name in ("hidden", "encoder"):
            if not getattr(self, name):
                raise InputError(f"{name} is empty, allowed: at least one width")
        if self.eval_episodes == 1:
            raise InputError("eval_episodes is 1, allowed: 0, or at least 2")
        choices = self.num_envs * self.rollout_length * self.num_seeds
        if choices > MOST_COUNTED:
            raise InputError(
                f"num_envs x rollout_length x num_seeds is {choices}, allowed: at most {MOST_COUNTED}"
            )
        if self.num_updates > MOST_COUNTED:
            raise InputError(
                f"total_timesteps is {self.total_timesteps}, allowed: at most {MOST_COUNTED} updates, "
                f"{MOST_COUNTED * self.steps_per_update}"
            )

    @property
    def steps_per_update(self) -> int:
        """Decisions per update and seed."""
        return self.num_envs * self.rollout_length * self.decide_every

    @property
    def num_updates(self) -> int:
        """Updates of the whole run."""
        return -(-self.total_timesteps // self.steps_per_update)


def _read(field: dataclasses.Field[Any], value: Any) -> Any:
    """The value of a setting, checked, as Python's own type."""
    if field.name == "overrides":
        return _read_overrides(value)
    if not isinstance(field.default, tuple):
        return _read_one(field, type(field.default), value)
    if not isinstance(value, list | tuple) or len(value) > MOST_ITEMS:
        raise InputError(f"{field.name} is {shown(value)}, allowed: a list of at most {MOST_ITEMS}")
    return tuple(_read_one(field, type(field.default[0]), item) for item in value)


def _read_one(field: dataclasses.Field[Any], kind: type, given: Any) -> Any:
    """Type and range of one value."""
    name, meta = field.name, field.metadata
    value = _as_kind(kind, given)
    if value is None:
        words = {bool: "true or false", int: "a whole number", float: "a number", str: "a name"}
        raise InputError(f"{name} is {shown(given)}, allowed: {words[kind]}")
    if meta["choices"] and value not in meta["choices"]:
        raise InputError(f"{name} is {shown(given)}, allowed: {', '.join(meta['choices'])}")
    if kind in (int, float) and not meta["low"] <= value <= meta["high"]:
        raise InputError(
            f"{name} is {shown(value)}, allowed: at least {meta['low']}, at most {meta['high']}"
        )
    return value


def _as_kind(kind: type, value: Any) -> Any:
    """The value as `kind`, None if it is none; NumPy's numbers are numbers too."""
    if kind in (bool, str) or isinstance(value, bool):
        return value if type(value) is kind else None
    if kind is int and isinstance(value, numbers.Integral):
        return int(value)
    if kind is float and isinstance(value, numbers.Real):
        try:
            return float(value)
        except OverflowError:  # a whole number that no float holds
            return math.inf
    return None


def _read_overrides(given: Any) -> dict[str, Override]:
    """Numbers of the environment as far as they can be checked without it."""
    given = {} if given is None else given
    if not isinstance(given, Mapping):
        raise InputError(f"overrides are {shown(given)}, allowed: values by name")
    overrides = {}
    for name, value in given.items():
        if not isinstance(name, str) or not name or name in NOT_NUMBERS:
            raise InputError(
                f"overrides hold {shown(name)}, allowed: names of numbers of the environment"
            )
        overrides[name] = _plain(name, value)
    return overrides


def _plain(name: str, value: Any, nested: bool = False) -> Any:
    """A value that JSON can hold: a number, text, or a list or a mapping of them."""
    if isinstance(value, bool | str):
        return value
    number = _as_kind(int if isinstance(value, numbers.Integral) else float, value)
    if number is not None:
        return number
    if not nested and isinstance(value, list | tuple):
        return tuple(_plain(name, item, nested=True) for item in value)
    if not nested and isinstance(value, Mapping):
        return {str(key): _plain(name, item, nested=True) for key, item in value.items()}
    raise InputError(f"{name} is {shown(value)}, allowed: a number or a list of numbers")


def to_json(config: TrainConfig) -> dict[str, Any]:
    """The settings as a dict of JSON values."""
    return dataclasses.asdict(config)


def from_json(data: Any) -> TrainConfig:
    """The settings from a dict of JSON values; fields that are missing keep their defaults.

    Raises:
        InputError: not a dict, an unknown field, or a value out of its range.
    """
    if not isinstance(data, dict):
        raise InputError(f"settings are {type(data).__name__}, allowed: an object of named values")
    known = {field.name for field in dataclasses.fields(TrainConfig)}
    for name in data:
        if name not in known:
            raise InputError(f"{shown(name)} is not a setting of this version")
    return TrainConfig(**data)


def load_config(path: Path) -> TrainConfig:
    """Reads the config.json of a run, or settings alone; JSON, or YAML by the name's ending.

    Raises:
        InputError: the file is missing, cannot be read, or holds something out of range.
    """
    try:
        # Nothing that gives no end of bytes, or none until somebody writes them.
        if path.exists() and not path.is_file():
            raise InputError(f"cannot read {path}: not a file")
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None
    if len(content) > MOST_BYTES:
        raise InputError(f"{path} is too long, allowed: at most {MOST_BYTES} bytes")
    is_yaml = path.suffix in (".yaml", ".yml")
    try:
        data = read_yaml(content.decode()) if is_yaml else read_json(content.decode())
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file") from None
    except (ValueError, RecursionError):
        raise InputError(f"{path} is not a {'YAML' if is_yaml else 'JSON'} file") from None
    try:
        return from_json(data.get("config", data) if isinstance(data, dict) else data)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
