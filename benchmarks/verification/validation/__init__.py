"""Traffic held against published ranges, medjax beside SUMO on the same road: `python -m benchmarks.validation`.

Both are measured from trajectories alone (`trajectories`), by the same functions of NumPy (`sections`, `merging`,
`lanes`, `measures`).
"""
