"""All algorithms by name."""

from train.algorithms.algorithm import Algorithm
from train.algorithms.ppo.learner import PPO
from train.settings import TrainConfig

ALGORITHMS: dict[str, Algorithm] = {each.settings.algorithm: each for each in (PPO,)}


def algorithm_of(config: TrainConfig) -> Algorithm:
    """The algorithm that the settings belong to."""
    return ALGORITHMS[config.algorithm]
