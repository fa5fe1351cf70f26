"""`python -m benchmarks.tune`: see `benchmarks.studies.tune`."""

from benchmarks.studies.tune import main

if __name__ == "__main__":
    main()
