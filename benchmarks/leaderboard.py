"""`python -m benchmarks.leaderboard`: see `benchmarks.studies.leaderboard`."""

from benchmarks.studies.leaderboard import main

if __name__ == "__main__":
    main()
