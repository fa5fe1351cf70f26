"""`python -m benchmarks.planner`: see `benchmarks.studies.planner`."""

from benchmarks.studies.planner import main

if __name__ == "__main__":
    main()
