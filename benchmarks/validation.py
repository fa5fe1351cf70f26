"""`python -m benchmarks.validation`: see `benchmarks.verification.validation.compare`."""

from benchmarks.verification.validation.compare import main

if __name__ == "__main__":
    main()
