"""`python -m benchmarks.cost`: see `benchmarks.speed.cost`."""

from benchmarks.speed.cost import main

if __name__ == "__main__":
    main()
