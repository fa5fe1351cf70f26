"""`python -m benchmarks.agents`: see `benchmarks.studies.agents`."""

from benchmarks.studies.agents import main

if __name__ == "__main__":
    main()
