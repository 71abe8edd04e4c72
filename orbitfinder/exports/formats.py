"""What orbits are written for: every format, and what writes it; a file that defines another puts it into `FORMATS`."""

from __future__ import annotations

from dataclasses import dataclass

from orbitfinder._runtime.arguments import Registry
from orbitfinder.records.registry import Answer


@dataclass(frozen=True)
class Format:
    """A format of files.

    Args:
        files: (source) -> the texts of an orbit's files by their names; of an `any_motion` (orbit, model) -> these.
        any_motion: whether orbits with events and controls have a place in it, which take no equations along.
        controlled: (orbit, model) -> the texts of a controlled orbit's files, where those are others.
    """

    files: Answer
    any_motion: bool = False
    controlled: Answer = ""


FORMATS = Registry(Format, {
    "csv": Format("exports.write:csv_file", any_motion=True),
    "auto": Format("exports.auto:auto_files"),
    "julia": Format("exports.julia:julia_files"),
    "c": Format("exports.c99:c_files", controlled="exports.feedforward:control_files"),
})  # fmt: skip
TABLES = ("csv", "parquet", "json")
"""What records of many points are written as, a row each"""
