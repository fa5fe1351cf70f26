"""Numerical tools independent of traffic: fast gathers, reproducible sums, batches of rows, devices."""
