"""The trained policy as one file, for `medjax.policies.saved.load_policy`."""

from pathlib import Path
from typing import Any

import jax
from jax import export

from medjax.policies.saved import About, save_policy
from train.algorithms.networks import PolicyWeights, apply_policy
from train.algorithms.registry import algorithm_of
from train.runs.policies import weights_by_name
from train.settings import TrainConfig

PLATFORMS = ("cpu", "cuda", "tpu")


def export_policy(path: Path, env: Any, config: TrainConfig, weights: PolicyWeights) -> None:
    """Writes a policy.

    Args:
        path: file to write, replaced.
        env: a single environment of the run.
        config: settings of the run.
        weights: of the run; of several seeds the first is taken.

    Raises:
        OSError: it cannot be written.
    """
    network = algorithm_of(config).build_network(env, config)
    own = jax.device_get(weights_by_name(config, weights)[config.algorithm])

    def act(obs: jax.Array, mask: jax.Array) -> tuple[jax.Array, jax.Array]:
        policy, value = apply_policy(network, own, obs, mask)
        return policy.probs, value

    about = _about(env, config, own.obs_stats.mean.shape[-1])
    rows = export.symbolic_shape("rows")[0]
    shapes = (
        jax.ShapeDtypeStruct((rows, about.num_features), "float32"),
        jax.ShapeDtypeStruct((rows, about.num_actions), "bool"),
    )
    save_policy(path, about, export.export(jax.jit(act), platforms=PLATFORMS)(*shapes))


def _about(env: Any, config: TrainConfig, num_features: int) -> About:
    """SEAM until there is medjax.policies.saved.about_of(env, params, decide_every), which knows how env was made."""
    return About(
        scenario=config.scenario,
        overrides=dict(config.overrides),
        observation=config.observation,
        decide_every=config.decide_every,
        num_features=num_features,
        num_actions=env.num_actions,
    )
