"""`python -m tests.train.probe_run ...`: train.ppo on a probe, as a process of its own that can be killed."""

import sys

from tests.train import conftest


def main() -> int:
    import medjax
    from train import ppo
    from train.runs import policies

    medjax.make = conftest.make_probe
    policies.BASELINES = {"none": conftest.never, "random": conftest.coin}
    return ppo.main(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
