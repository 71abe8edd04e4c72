"""The problem file that `orbitfinder init` writes."""

from __future__ import annotations

from pathlib import Path

from pydantic_core import PydanticCustomError

from orbitfinder.errors import InputError
from orbitfinder.problemfile.schema import check_name

TEMPLATE = """# Every key is explained in docs/problem-file.md. SI units, angles in rad from the downward vertical.
name = "{name}"
title = "Triple pendulum, second normal mode"
source = "orbitfinder init"

[system]
kind = "chain"
links = 3
length = 1.0             # m; one number, or one per link: [1.0, 0.5, 1.0]
mass = 1.0               # kg
# inertia = 0.0833       # kg m^2 about the centre of mass; m l^2 / 12 when left out
# com = 0.5              # centre of mass as a fraction of the length
gravity = 9.8            # m/s^2

[guess]                  # one of three forms
mode = 2                 # linear normal mode of the hanging pendulum, the slowest is 1
amplitude = 0.2          # rad, the largest angle
# state = [0.1, 0.2, 0.3, 0.0, 0.0, 0.0]   # n angles, then n rates
# period = 2.9                              # s
# csv = "trajectory.csv"                    # columns t, angles, rates over one period

[find]
pin = {{ energy = -43.9 }} # J, zero at the fixed joint; or period, or a state such as theta1; left out: nearest
symmetry = "none"        # none | brake | reflection | reversal | brake+reflection
# segments = 4           # shooting segments; chosen automatically when left out

# [expected]             # the certificate fails when the orbit disagrees
# period = {{ value = 1.18, tolerance = 1e-9 }}
"""


def write_template(name: str) -> Path:
    """Write `name`.toml in the current folder; never over an existing file."""
    try:
        check_name(name)
    except PydanticCustomError as error:
        raise InputError(f"NAME: {error.message()}, got {name!r}; choose another") from error
    path = Path(f"{name}.toml")
    try:
        with path.open("x", encoding="utf-8") as stream:
            stream.write(TEMPLATE.format(name=name))
    except FileExistsError as error:
        raise InputError(f"NAME: {path} exists already and is left alone; choose another name") from error
    except OSError as error:
        raise InputError(f"NAME: cannot write {path} ({error}); change to a folder that you can write to") from error
    return path
