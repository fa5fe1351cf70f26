"""The trained policy as one file, for `medjax.policies.saved.load_policy`."""

from pathlib import Path
from typing import Any

import jax
from jax import export

from medjax.policies.saved import about_of, save_policy
from train.algorithms.networks import PolicyWeights, apply_policy
from train.algorithms.registry import algorithm_of
from train.runs.policies import weights_by_name
from train.settings import TrainConfig

PLATFORMS = ("cpu", "cuda", "tpu")


def export_policy(
    path: Path, env: Any, params: Any, config: TrainConfig, weights: PolicyWeights
) -> None:
    """Writes a policy.

    Args:
        path: file to write, replaced.
        env: a single environment of the run, as `medjax.make` gave it.
        params: its parameters.
        config: settings of the run.
        weights: of the run; of several seeds the first is taken.

    Raises:
        InputError: the file could not name the environment.
        OSError: it cannot be written.
    """
    about = about_of(env, params, config.decide_every, config.algorithm)
    network = algorithm_of(config).build_network(env, config)
    own = jax.device_get(weights_by_name(config, weights)[config.algorithm])

    def act(obs: jax.Array, mask: jax.Array) -> tuple[jax.Array, jax.Array]:
        policy, value = apply_policy(network, own, obs, mask)
        return policy.probs, value

    rows = export.symbolic_shape("rows")[0]
    shapes = (
        jax.ShapeDtypeStruct((rows, about.num_features), "float32"),
        jax.ShapeDtypeStruct((rows, about.num_actions), "bool"),
    )
    save_policy(path, about, export.export(jax.jit(act), platforms=PLATFORMS)(*shapes))
