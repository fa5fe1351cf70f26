"""`python -m benchmarks.variance`: see `benchmarks.studies.variance`."""

from benchmarks.studies.variance import main

if __name__ == "__main__":
    main()
