"""`python -m train.export --run-dir DIR`: the trained policy as one file, for `medjax.policies.saved.load_policy`."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from medjax.commandline import OneLineParser, as_path, fail
from medjax.errors import InputError
from medjax.files import check_output
from train.runs.run_directory import RunDir
from train.runs.trained_run import load_weights
from train.settings import TrainConfig

PLATFORMS = ("cpu", "cuda", "tpu")


def build_parser() -> OneLineParser:
    """The command line."""
    parser = OneLineParser(
        prog="python -m train.export",
        description="Writes the trained policy of a run as one file, for medjax.policies.saved.load_policy.",
    )
    parser.add_argument(
        "--run-dir", required=True, metavar="DIR", help="directory that train.ppo wrote"
    )
    parser.add_argument(
        "--out", metavar="FILE", help="file to write (default: policy.zip in DIR), replaced"
    )
    return parser


def export_policy(path: Path, env: Any, params: Any, config: TrainConfig, weights: Any) -> None:
    """Writes a policy.

    Args:
        path: file to write, replaced.
        env: a single environment of the run, as `medjax.make` gave it.
        params: its parameters.
        config: settings of the run.
        weights: `train.algorithms.networks.PolicyWeights`; of the first seed if there were several.

    Raises:
        InputError: the file could not name the environment.
        OSError: it cannot be written.
    """
    import jax
    from jax import export

    from medjax.policies.saved import about_of, save_policy
    from train.algorithms.networks import apply_policy, build_network

    about = about_of(env, params, config.decide_every)
    network = build_network(env, config)
    if config.num_seeds > 1:
        weights = jax.tree.map(lambda leaf: leaf[0], weights)
    weights = jax.device_get(weights)

    def act(obs: jax.Array, mask: jax.Array) -> tuple[jax.Array, jax.Array]:
        policy, value = apply_policy(network, weights, obs, mask)
        return policy.probs, value

    rows = export.symbolic_shape("rows")[0]
    shapes = (
        jax.ShapeDtypeStruct((rows, about.num_features), "float32"),
        jax.ShapeDtypeStruct((rows, about.num_actions), "bool"),
    )
    save_policy(path, about, export.export(jax.jit(act), platforms=PLATFORMS)(*shapes))


def main(argv: Sequence[str] | None = None) -> int:
    """Exports as the command line says.

    Args:
        argv: arguments; None takes those of the process.

    Returns:
        The exit code.
    """
    given = build_parser().parse_args(argv)
    try:
        run_dir = RunDir(as_path("--run-dir", given.run_dir))
        target = run_dir.policy if given.out is None else as_path("--out", given.out)
        config = run_dir.load_config()
        check_output("--out", target)
        env, params, weights = load_weights(run_dir.path, config)
    except InputError as error:
        return fail("python -m train.export", error)
    export_policy(target, env, params, config, weights)
    print(target)
    return 0


if __name__ == "__main__":
    sys.exit(main())
