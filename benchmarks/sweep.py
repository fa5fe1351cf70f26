"""`python -m benchmarks.sweep`: see `benchmarks.studies.sweep`."""

from benchmarks.studies.sweep import main

if __name__ == "__main__":
    main()
