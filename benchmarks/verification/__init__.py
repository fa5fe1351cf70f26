"""Verification of the simulator: invariants, independent bookkeeping and random worlds."""
