"""What the numbers were measured with, in words: processor, memory, versions."""

from __future__ import annotations

import os
import platform
import subprocess
from importlib import metadata
from pathlib import Path

import casadi as ca

from orbitfinder.integrate.compiled import available


def processor() -> str:
    """The processor's own name where the system tells it, the number of cores and the memory."""
    name, memory = platform.processor() or platform.machine(), ""
    cpu, info = Path("/proc/cpuinfo"), Path("/proc/meminfo")
    if cpu.exists():
        names = [line.partition(":")[2].strip() for line in cpu.read_text().splitlines() if "model name" in line]
        name = names[0] if names else name
    if info.exists():
        kilobytes = int(next(line for line in info.read_text().splitlines() if "MemTotal" in line).split()[1])
        memory = f", {kilobytes / 2**20:.0f} GB of memory"
    return f"{name} ({platform.machine()}), {os.cpu_count()} cores{memory}, {platform.system()}"


def package(name: str) -> str | None:
    """The installed version of a Python package."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def versions(*extra: str) -> str:
    """One line of versions, the compiler's included."""
    found = [f"Python {platform.python_version()}", f"casadi {ca.__version__}"]
    found += [f"{name} {package(name)}" for name in ("numpy", "scipy", *extra) if package(name)]
    return ", ".join([*found, available()[1] if available()[0] else "no C compiler"])


def said_by(*command: str) -> str:
    """The first line that a program prints about itself, empty when it does not run."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip().splitlines()[0] if done.stdout.strip() else ""


def load() -> str:
    """How busy the machine was."""
    return f"load average {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "load unknown"
