"""`python -m benchmarks.prices`: see `benchmarks.studies.prices`."""

from benchmarks.studies.prices import main

if __name__ == "__main__":
    main()
