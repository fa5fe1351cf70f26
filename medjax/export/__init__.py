"""Recorded episodes as files that other tools read: Parquet, CSV, and SUMO's floating-car data."""

from medjax.export.files import FORMATS, check_target, write_trajectories
from medjax.export.table import vehicle_table

__all__ = ["FORMATS", "check_target", "vehicle_table", "write_trajectories"]
