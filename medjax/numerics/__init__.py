"""Arithmetic that knows no vehicle: fast gathers, sums of the same bits everywhere, rows, devices."""
