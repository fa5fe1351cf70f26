"""`python -m benchmarks.device`: see `benchmarks.speed.device`."""

from benchmarks.speed.device import main

if __name__ == "__main__":
    main()
