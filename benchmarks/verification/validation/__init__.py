"""Compares traffic of medjax and SUMO on the same road with published ranges: `python -m benchmarks.validation`.

The same NumPy functions (`sections`, `merging`, `measures`) measure both simulators, from trajectories alone
(`trajectories`).
"""
