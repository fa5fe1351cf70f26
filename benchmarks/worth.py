"""`python -m benchmarks.worth`: see `benchmarks.studies.worth.command`."""

from benchmarks.studies.worth.command import main

if __name__ == "__main__":
    main()
