"""`python -m benchmarks.ticks`: see `benchmarks.studies.ticks`."""

from benchmarks.studies.ticks import main

if __name__ == "__main__":
    main()
