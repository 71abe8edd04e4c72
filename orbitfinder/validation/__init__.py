"""Numbers of others beside ours: `python -m orbitfinder.validation` writes results/validation/README.md."""
