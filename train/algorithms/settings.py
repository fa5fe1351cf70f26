"""The settings of every algorithm; `train.algorithms.registry` has what learns. Nothing here waits for JAX."""

from train.algorithms.ppo.settings import PPOConfig
from train.settings import TrainConfig

# The first is that of files which name no algorithm.
SETTINGS: tuple[type[TrainConfig], ...] = (PPOConfig,)
