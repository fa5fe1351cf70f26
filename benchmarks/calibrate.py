"""`python -m benchmarks.calibrate`: see `benchmarks.studies.calibrate`."""

from benchmarks.studies.calibrate import main

if __name__ == "__main__":
    main()
