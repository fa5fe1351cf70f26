"""`python -m benchmarks.kernels`: see `benchmarks.speed.kernels`."""

from benchmarks.speed.kernels import main

if __name__ == "__main__":
    main()
