"""The settings of every algorithm, without importing JAX; `train.algorithms.registry` has the algorithms."""

from train.algorithms.ppo.settings import PPOConfig
from train.settings import TrainConfig

# Files that name no algorithm belong to the first.
SETTINGS: tuple[type[TrainConfig], ...] = (PPOConfig,)
