"""`python -m benchmarks.generalization`: see `benchmarks.studies.generalization`."""

from benchmarks.studies.generalization import main

if __name__ == "__main__":
    main()
