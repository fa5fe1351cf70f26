"""`python -m benchmarks.training`: see `benchmarks.speed.training`."""

import sys

from benchmarks.speed.training import main

if __name__ == "__main__":
    sys.exit(main())
