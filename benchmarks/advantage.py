"""`python -m benchmarks.advantage`: see `benchmarks.studies.advantage`."""

from benchmarks.studies.advantage import main

if __name__ == "__main__":
    main()
