"""`python -m benchmarks.scaling`: see `benchmarks.speed.scaling`."""

from benchmarks.speed.scaling import main

if __name__ == "__main__":
    main()
