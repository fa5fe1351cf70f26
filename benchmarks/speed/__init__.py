"""Benchmarks of speed: throughput, scaling, kernels, training."""
