"""`python -m benchmarks.pairs`: see `benchmarks.speed.pairs`."""

from benchmarks.speed.pairs import main

if __name__ == "__main__":
    main()
