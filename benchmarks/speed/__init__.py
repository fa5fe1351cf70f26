"""How fast: throughput, scaling, kernels, training."""
