"""`python -m benchmarks.road`: see `benchmarks.verification.own_road.compare`."""

from benchmarks.verification.own_road.compare import main

if __name__ == "__main__":
    main()
