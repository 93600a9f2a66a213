"""The CUDA engine: kernels compiled on first use, the driver behind them, and what they are told."""
