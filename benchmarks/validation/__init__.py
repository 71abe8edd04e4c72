"""Numbers of others beside ours: `python -m benchmarks.validation` writes results/validation/README.md."""
