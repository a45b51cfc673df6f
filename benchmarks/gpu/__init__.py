"""`python -m benchmarks.gpu`: check a GPU in a few minutes, with results as JSON."""
