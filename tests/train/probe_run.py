"""`python -m tests.train.probe_run ...`: train.ppo on a probe, as a process of its own that can be killed."""

import sys

from tests.train.conftest import use_probes


def main() -> int:
    from train import ppo

    use_probes()
    return ppo.main(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
