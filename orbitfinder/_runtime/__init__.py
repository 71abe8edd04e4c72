"""What belongs to the process and not to a computation: streams, signals, locks, processes, the version."""

__version__ = "0.2.0"
PROCESSORS = "ORBITFINDER_PROCESSORS"
"""Environment variable: how many processors a process may keep busy; of ours 1 each"""
