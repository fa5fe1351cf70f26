"""`python -m benchmarks.motion`: see `benchmarks.studies.motion`."""

from benchmarks.studies.motion import main

if __name__ == "__main__":
    main()
