"""Settings of PPO."""

import dataclasses
import math
from typing import ClassVar, Self

from medjax.errors import InputError, shown
from train.option import filled, option, takes_former_names
from train.settings import MOST_COUNTED, TrainConfig

ENVS_OF_A_MINIBATCH, MOST_MINIBATCHES = 4, 64  # unless num_minibatches says otherwise
# Environments that meet the same episodes: more would leave an update too few different ones.
MOST_IN_GROUP = 8


@takes_former_names
@dataclasses.dataclass(frozen=True)
class PPOConfig(TrainConfig):
    """Settings of a run that learns with PPO.

    Raises:
        InputError: a value out of its range, or values that do not go together.
    """

    algorithm: ClassVar[str] = "ppo"
    of_an_update = (
        *TrainConfig.of_an_update,
        "rollout_length",
        "num_minibatches",
        "num_epochs",
        "normalize_observations",  # its moments grow with every update, and the weights read what they give
    )

    rollout_length: int = option(
        0,
        "PPO",
        "choices per environment and update; 0: a whole episode",
        limits=(0, 2**16),
    )
    num_minibatches: int = option(
        0,
        "PPO",
        "minibatches per epoch, which must divide num_envs; 0: of 4 environments each, or larger ones so that there "
        "are at most 64; with a multiple of 8, eight environments share each demand as a baseline",
        limits=(0, 2**20),
    )
    num_epochs: int = option(4, "PPO", "passes over each rollout", limits=(1, 1000))
    learning_rate: float = option(
        None,
        "PPO",
        "initial learning rate of Adam; by default it follows num_envs, 5e-4 up to 32 and 1e-3 from 1024 on, and is "
        "lower in runs of more than ten million decisions",
        flags=("--lr",),
        limits=(1e-12, 10),
    )
    anneal: bool = option(True, "PPO", "let the learning rate fall linearly to 0")
    gamma: float = option(1.0, "PPO", "discount per choice", limits=(0, 1))
    gae_lambda: float = option(1.0, "PPO", "decay of the advantage trace per choice", limits=(0, 1))
    bootstrap_timeouts: bool = option(
        False,
        "PPO",
        "bootstrap the value at the time limit; for observations without a clock",
    )
    clip_epsilon: float = option(
        None,
        "PPO",
        "clip of the ratio, eq. (9); by default it follows num_envs: 0.2 up to 32, 1 from 1024 on",
        flags=("--clip",),
        limits=(1e-6, 1e6),
    )
    clip_value: bool = option(False, "PPO", "clip the value loss as well")
    entropy_coef: float = option(
        0.0, "PPO", "weight of the entropy bonus", flags=("--entropy",), limits=(0, 1e6)
    )
    value_coef: float = option(0.5, "PPO", "weight of the value loss", limits=(0, 1e6))
    max_grad_norm: float = option(
        0.5, "PPO", "global norm at which gradients are clipped", limits=(1e-6, 1e9)
    )
    sharpening: float = option(
        8.0,
        "PPO",
        "factor by which the policy's logits grow during training, by at most 4 percent an update, so that its samples "
        "come to agree with its most probable actions",
        limits=(1, 1000),
    )
    normalize_observations: bool = option(False, "PPO", "standardise by running moments")
    normalize_rewards: bool = option(True, "PPO", "scale by the spread of the discounted return")

    def __post_init__(self) -> None:
        """Checks as `TrainConfig` does, then combinations with PPO's own settings."""
        super().__post_init__()
        if self.num_envs is not None:
            self._check_sizes()
        if self.network == "sets" and self.normalize_observations:
            # A row of zeros marks an empty slot, and normalisation would change it.
            raise InputError("network is 'sets' and normalize_observations is True, allowed: False")
        if self.agents != "none" and self.normalize_observations:
            # The initial policy reads an agent's status from the raw observation.
            given = f"agents is {self.agents!r} and normalize_observations is True"
            raise InputError(f"{given}, allowed: False")
        if self.encoder != (widths := PPOConfig.encoder) and self.network != "sets":
            given = f"network is {shown(self.network)} and encoder is {shown(self.encoder)}"
            raise InputError(f"{given}, allowed: {' '.join(map(str, widths))}")
        by_rule = self.policy_prior == "rule" and self.observation == "profile"
        if self.normalize_observations and by_rule:
            # The rule needs numbers of EVs and packs, not deviations from their means.
            given = "policy_prior is 'rule' and normalize_observations is True"
            raise InputError(f"{given}, allowed: wait")

    def _check_sizes(self) -> None:
        """Checks how environments, minibatches and seeds go together."""
        if self.num_minibatches and self.num_envs % self.num_minibatches:
            raise InputError(
                f"num_envs is {self.num_envs}, which num_minibatches = {self.num_minibatches} does not divide; "
                f"allowed: a multiple of {self.num_minibatches}"
            )
        choices = self.num_envs * self.choices_per_update * self.num_seeds
        if choices > MOST_COUNTED:
            raise InputError(
                f"num_envs x rollout_length x num_seeds is {choices}, allowed: at most {MOST_COUNTED}"
            )

    def for_episodes(self, decisions: int) -> Self:
        """Fills in settings that follow others, and the length of an episode, in decisions."""
        # Without an episode's length, a rollout is as long as an episode of `paper`.
        episode = -(-decisions // self.decide_every) or self.choices_per_update
        whole = self if self.rollout_length else dataclasses.replace(self, rollout_length=episode)
        sized = TrainConfig.for_episodes(whole, decisions)
        # More environments leave fewer updates, so each must go further. Both numbers were tried with 32 and with 1024
        # environments; between these they follow a power of the number of environments.
        part = min(max(math.log(sized.num_envs / 32) / math.log(1024 / 32), 0.0), 1.0)
        # Sixty million decisions get 3e-4 with 1024 environments. With 1e-3 the policy fell below its start.
        slower = max(sized.total_timesteps / 10_000_000, 1.0) ** (2 / 3)
        return filled(sized, learning_rate=5e-4 * 2**part / slower, clip_epsilon=0.2 * 5**part)

    @property
    def choices_per_update(self) -> int:
        """Choices per environment and update; before `for_episodes`, 0 means an episode of `paper`."""
        episode_of_paper = 600 if self.agents == "none" else 150
        return self.rollout_length or episode_of_paper

    @property
    def minibatches(self) -> int:
        """Minibatches per epoch."""
        if self.num_minibatches:
            return self.num_minibatches
        most = min(max(self.num_envs // ENVS_OF_A_MINIBATCH, 1), MOST_MINIBATCHES)
        return max(count for count in range(1, most + 1) if self.num_envs % count == 0)

    @property
    def device_groups(self) -> int:
        """Number of groups of environments; each group has one environment in every minibatch."""
        return self.num_envs // self.minibatches

    @property
    def group_size(self) -> int:
        """Neighbours that meet the same episodes. No two of them are in the same minibatch."""
        return math.gcd(self.minibatches, MOST_IN_GROUP)
