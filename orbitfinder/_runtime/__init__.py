"""What belongs to the process and not to a computation: streams, signals, locks, processes, the version."""

__version__ = "0.1.0"
