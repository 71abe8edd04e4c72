"""The numbers of generated C as data, so that equations at other values of their parameters need no other library.

    code, numbers = apart(code)               # "a3=9.81;" has become "a3=CONSTANTS[0];"
    with holding(path, numbers) as own: ...   # a library that holds these

Whatever is written out by CasADi or in lanes has a constant for each number that a parameter enters, and the same text
but for those. A process loads a file as often as it is to hold other numbers, each time but the first by another name:
a library's memory is that of its file. The instructions are those of constants in the text, and so is every bit.
"""

from __future__ import annotations

import _ctypes
import contextlib
import ctypes
import os
import re
import shutil
import sys
import tempfile
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

_CONSTANT, _TABLE, _REMARK = (
    re.compile(
        r"\b([aw]\d+ ?= ?(?:all\()?|casadi_fill\(w\d+, \d+, )"
        r"(-?(?:0x[\da-f.]+p[+-]\d+|\d+\.(?:\d+e[+-]\d+)?))(?=\)?;)"
    ),
    re.compile(r"static const casadi_real (casadi_c\d+)\[(\d+)\] =\s*\{([-+.,\de\s]+)\};"),
    re.compile(r"/\* #\d+: .*?\*/", re.DOTALL),
)
"""What CasADi and `lanes.emit` write of a number, of several, and about them"""
_held: dict[Path, bytes] = {}
"""What the libraries of this process hold that were loaded by their own names"""


def apart(code: str) -> tuple[str, np.ndarray]:
    """C that takes its numbers by `hold`, and those; as it is where there are none."""
    numbers, tables = list[float](), list[str]()

    def constant(written: re.Match[str]) -> str:
        numbers.append(float.fromhex(written[2]) if "x" in written[2] else float(written[2]))
        return f"{written[1]}CONSTANTS[{len(numbers) - 1}]"

    def table(written: re.Match[str]) -> str:
        tables.append(f"  for (int i = 0; i < {written[2]}; i++) {written[1]}[i] = given[{len(numbers)} + i];")
        numbers.extend(map(float, written[3].split(",")))
        return f"static casadi_real {written[1]}[{written[2]}];"

    code = _CONSTANT.sub(constant, _REMARK.sub("", code))
    if count := len(numbers):
        tables.append(f"  for (int i = 0; i < {count}; i++) CONSTANTS[i] = given[i];")
        code = f"static double CONSTANTS[{count}];\n{code}"
    code = _TABLE.sub(table, code)
    if not numbers:
        return code, np.zeros(0)
    lines = ["", "#ifdef __cplusplus", 'extern "C"', "#endif", "#ifdef CASADI_SYMBOL_EXPORT", "CASADI_SYMBOL_EXPORT",
             "#endif", "void hold(const double *given) {"]  # fmt: skip
    return "\n".join([code, *lines, *tables, "}", ""]), np.array(numbers)


@contextlib.contextmanager
def holding(path: Path, numbers: np.ndarray) -> Iterator[Path]:
    """A name of the library, for the time that it is opened, by which it holds these numbers, apart from any that holds
    others. Raises `ValueError` for what is no such library."""
    if not numbers.size:
        yield path
    elif _held.setdefault(path, numbers.tobytes()) == numbers.tobytes():
        kept = _filled(path, numbers)
        yield path
        del kept
    else:
        handle, name = tempfile.mkstemp(prefix="making-", suffix=".so", dir=path.parent)
        os.close(handle)
        copy = Path(name)
        try:
            shutil.copy(path, copy)
            kept = _filled(copy, numbers)
            yield copy
            del kept
        finally:
            with contextlib.suppress(OSError):  # Windows keeps what is loaded, until it is stale
                copy.unlink()


def _filled(path: Path, numbers: np.ndarray) -> Shared:
    """A library that holds these numbers, for as long as it is open."""
    try:
        opened = Shared(path)
        hold = opened["hold"]
    except (OSError, AttributeError) as error:
        raise ValueError(f"the library cannot be loaded: {error}") from None
    hold.argtypes, hold.restype = [ctypes.c_void_p], None
    hold(numbers.ctypes.data)
    return opened


class Shared:
    """A shared library, closed when neither it nor a function of it, `opened["name"]`, is referred to.

    ctypes would keep it for good, 40 kB with each set of numbers, and its functions refer to themselves.
    """

    def __init__(self, path: Path) -> None:
        if sys.platform == "win32":  # which keeps what is loaded
            self._handle = ctypes.CDLL(str(path))._handle
        else:
            self._handle = _ctypes.dlopen(str(path), ctypes.DEFAULT_MODE)
            weakref.finalize(self, _ctypes.dlclose, self._handle).atexit = False

    def __getitem__(self, name: str) -> Any:
        """A function by its name, of integers and giving one until it is told otherwise. Raises `AttributeError`."""
        if sys.platform == "win32":
            return ctypes.CDLL(None, handle=self._handle)[name]
        try:
            function: Any = ctypes.CFUNCTYPE(ctypes.c_int)(_ctypes.dlsym(self._handle, name))
        except OSError as error:
            raise AttributeError(str(error)) from None
        function.library = self
        return function
