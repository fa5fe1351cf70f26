"""`python -m benchmarks.soak`: see `benchmarks.verification.soak`."""

from benchmarks.verification.soak import main

if __name__ == "__main__":
    main()
