"""`python -m benchmarks.ablation`: see `benchmarks.studies.ablation.__main__`."""

from benchmarks.studies.ablation.__main__ import main

if __name__ == "__main__":
    main()
