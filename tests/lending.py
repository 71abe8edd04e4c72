"""Folders that several tests read: filled once per state of the package, by whichever process asks first.

A folder is addressed by its name and by the digest of the package, of the problem files and of the file of tests that
fills it, so that it is never that of another state. Two processes of a run do not fill it both: the second waits. Who
borrows it only reads: what was changed fails the run.
"""

import hashlib
import os
import shutil
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

from orbitfinder._runtime.locks import held

ROOT = Path(__file__).parents[1]
PATIENCE = 600.0
"""s that a process waits for another one that fills the same folder"""


@cache
def digest(own: Path) -> str:
    """Of every file that decides what is made, and of the Python that makes it."""
    seen = hashlib.sha256(repr((sys.version, os.environ.get("OPENBLAS_CORETYPE"))).encode())
    for folder, pattern in ((ROOT / "orbitfinder", "*.[pc]*"), (ROOT / "problems", "*.toml")):
        for file in sorted(
            path for path in folder.rglob(pattern) if "__pycache__" not in path.parts and path.is_file()
        ):
            seen.update(f"{file.relative_to(ROOT)} {file.stat().st_size}".encode() + file.read_bytes())
    seen.update(Path(__file__).with_name("conftest.py").read_bytes() + own.read_bytes())
    return seen.hexdigest()[:16]


def state(folder: Path) -> dict[str, tuple[int, int]]:
    """Sizes and times of change of the files of a folder; not those that SQLite keeps while somebody reads."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and not path.name.endswith(("-shm", "-wal")))
    return {str(path.relative_to(folder)): (path.stat().st_size, path.stat().st_mtime_ns) for path in files}


class Lender:
    """Lends folders of a cache."""

    def __init__(self, cache: Path) -> None:
        self.cache = cache
        self.lent: dict[Path, dict[str, tuple[int, int]]] = {}

    def __call__(self, name: str, make: Callable[[Path], object], own: str) -> Path:
        """The folder of this name, filled by `make(folder)`; `own` is the file of tests that says how."""
        self.cache.mkdir(parents=True, exist_ok=True)
        place = self.cache / f"{name}-{digest(Path(own))}"
        with held(self.cache / f"{name}.lock", PATIENCE) as alone:
            assert alone, f"{name}: another process has filled it for {PATIENCE:.0f} s"
            if not place.exists():
                for old in self.cache.glob(f"{name}-{'?' * 16}"):
                    shutil.rmtree(old, ignore_errors=True)
                scratch = Path(tempfile.mkdtemp(dir=self.cache)) / "folder"
                scratch.mkdir()
                make(scratch)
                scratch.rename(place)
                scratch.parent.rmdir()
        self.lent.setdefault(place, state(place))
        return place

    def check(self) -> None:
        """Raise where a borrower wrote into a folder; it is made again by the next run."""
        for place, before in self.lent.items():
            if place.exists() and state(place) != before:
                shutil.rmtree(place)
                raise AssertionError(f"{place.name}: a test changed what others read; copy what is to be changed")
