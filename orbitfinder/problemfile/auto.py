"""Runs of AUTO-07p: orbits as starts, branches for a picture.

A solution file s.NAME has, for each label, a head of whole numbers (branch, point, type, label, free parameters, ISW,
points, numbers a point, lines to the next head, intervals, collocation points, parameters, ...), a line (t, U) a point
with t from 0 to 1, indices of free parameters, directions, and PAR at the end; PAR(11) is the period. b.NAME has for
each branch lines that begin with 0, the last with the names of its columns, then a line a point: branch, point
(negative where stable), type, label, columns. c.NAME has `KEY = value`. Source: E. J. Doedel, B. E. Oldeman, AUTO-07P
manual (2012), sections "Description of the output-files" and "Description of AUTO-constants".
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from orbitfinder.errors import InputError, closest, shortened
from orbitfinder.loops.problem import Guess
from orbitfinder.records.reading import file_bytes

PERIOD, LABEL, POINTS, WIDTH, ROWS, PARAMETERS = 11, 3, 6, 7, 8, 11
"""The period's place in PAR; places in the head of a solution"""


def from_auto(path: str | Path, label: int | None = None, parameters: Mapping[str, int] | Sequence[str] = ()) -> Guess:
    """A periodic solution that AUTO-07p has written, as a Guess: profile, period, and values of parameters.

    The equations are the user's own; states are in AUTO's order. Of c.NAME `parnames` and ICP are read, as text:
    nothing is executed. NTST and DS are not used: a solution has its own mesh, our families measure steps otherwise.

    Args:
        path: s.NAME (or fort.8), the b.NAME or c.NAME beside it, or the folder of a run; NAME.dat of columns t, U(1),
            ... over a period.
        label: of the solution; the last cycle when left out.
        parameters: whose values are wanted as `guess.free`: names that `parnames` of b.NAME or c.NAME has, or places in
            PAR by name, {"I": 1}. ["ICP"]: those that ICP of c.NAME lists besides the period, outputs too; without
            c.NAME those that b.NAME calls active. Left out: none, as `Problem` refuses values of what is not free.

    Returns:
        A Guess. `Problem(model, guess, free=["I"], pin=pin(I=guess.free["I"]))` is at AUTO's value.

    Raises:
        InputError: for a file that is none, a label that is missing or an equilibrium, a parameter without a place.

    Examples:
        >>> from pathlib import Path
        >>> _ = Path("swing.dat").write_text("0 0.3 0.0\\n0.5 0.0 -0.9\\n1 -0.3 0.0\\n1.5 0.0 0.9\\n2 0.3 0.0\\n")
        >>> of.from_auto("swing.dat").period
        2.0
    """
    source = _source(Path(path))
    lines = _lines(source)
    if source.suffix == ".dat":
        if parameters or label is not None:
            raise InputError(f"{source}: a .dat file has no labels and no parameters; give s.NAME")
        return _guess(source, _numbers(source, lines), len(lines), 1.0, {})
    heads = _heads(source, lines)
    cycles = [name for name, (_, head) in heads.items() if head[POINTS] > 1]
    chosen = label if label is not None else cycles[-1] if cycles else next(iter(heads))
    if chosen not in heads:
        raise InputError(f"label: {chosen} is not in {source}; it has {shortened(', '.join(map(str, heads)), 200)}")
    at, head = heads[chosen]
    numbers = _numbers(source, lines[at + 1 : at + 1 + head[ROWS]])
    rows, par = numbers[: head[POINTS] * head[WIDTH]], numbers[-head[PARAMETERS] :]
    if at + head[ROWS] >= len(lines) or min(rows.size - head[POINTS] * head[WIDTH], par.size - PERIOD) < 0:
        raise InputError(f"{source}: line {at + 1}: label {chosen} is cut off; copy the file again")
    if head[POINTS] < 2:
        where = ", ".join(f"{value:.6g}" for value in rows[1:])
        raise InputError(f"label: {chosen} is an equilibrium; give follow_equilibria the state [{where}], or a label "
                         f"of a cycle ({shortened(', '.join(map(str, cycles))) or 'there is none'})")  # fmt: skip
    return _guess(source, rows, head[POINTS], float(par[PERIOD - 1]), _values(source, parameters, par))


def _source(path: Path) -> Path:
    """The file that is meant: of a folder the only s.NAME in it, else the only NAME.dat; of b. and c.NAME s.NAME."""
    if not path.is_dir():
        return path.with_name(f"s.{path.name[2:]}") if path.name.startswith(("b.", "c.")) else path
    files = sorted(path.glob("s.*")) or sorted(path.glob("fort.8")) or sorted(path.glob("*.dat"))
    if len(files) != 1:
        listed = shortened(", ".join(file.name for file in files)) or "none"
        raise InputError(f"path: {path} has {listed}; give a single file s.NAME of AUTO-07p")
    return files[0]


def _lines(source: Path) -> list[str]:
    try:
        return file_bytes(source, "file of AUTO").decode().rstrip().splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"{source}: no file of AUTO's, which are plain text in UTF-8; give s.NAME") from error


def _heads(source: Path, lines: Sequence[str]) -> dict[int, tuple[int, list[int]]]:
    """Where each label's solution begins, and its head."""
    heads, at = dict[int, tuple[int, list[int]]](), 0
    while at < len(lines):
        words = lines[at].split()
        whole = len(words) in (12, 16) and all(re.fullmatch(r"[+-]?\d{1,9}", word) for word in words)
        head = [int(word) for word in words] if whole else [0] * 12
        if min(head[POINTS], head[WIDTH] - 1, head[ROWS], head[PARAMETERS]) < 1:
            raise InputError(f"{source}: line {at + 1}: {shortened(repr(lines[at]))} is no head of a solution (12 or "
                             "16 whole numbers); give s.NAME or fort.8 of AUTO-07p")  # fmt: skip
        heads[head[LABEL]] = (at, head)
        at += 1 + head[ROWS]
    if not heads:
        raise InputError(f"{source}: is empty; give s.NAME or fort.8 of AUTO-07p")
    return heads


def _numbers(source: Path, lines: Sequence[str]) -> np.ndarray:
    """All numbers of some lines; Fortran leaves out the E of exponents of three digits, and writes D."""
    text = re.sub(r"(?<=\d)[dD]?([+-]\d{3})\b", r"E\1", " ".join(lines)).replace("D", "E")
    try:
        numbers = np.fromiter((float(word[0]) for word in re.finditer(r"\S++", text)), float)
    except ValueError as error:
        raise InputError(f"{source}: {error}; give s.NAME, fort.8 or NAME.dat of AUTO-07p") from error
    return numbers


def _guess(source: Path, numbers: np.ndarray, count: int, period: float, free: dict[str, float]) -> Guess:
    """A Guess of rows (t, U), t in units of a period."""
    if count < 2 or numbers.size % count or numbers.size < 2 * count or not np.isfinite(numbers).all():
        raise InputError(f"{source}: no rows t, U(1), ... of finite numbers over a period; give s.NAME or NAME.dat")
    rows = numbers.reshape(count, -1)
    times = (rows[:, 0] - rows[0, 0]) * period
    if not np.all(np.diff(times) > 0):
        raise InputError(f"{source}: times do not increase, or PAR({PERIOD}) = {period:g} is no period; give a cycle "
                         "of a run with IPS = 2, or with PAR(11) as its period")  # fmt: skip
    return Guess(rows[0, 1:].copy(), float(times[-1]), times, rows[:, 1:].copy(), free)


def _names(text: str) -> dict[str, int]:
    """Places in PAR by name."""
    said = ",".join(re.findall(r"\bparnames\s*=\s*\{([^{}]*)\}", text))
    pair = r"""(\d{1,6})\s*+:\s*+['"]?+([^'",\s][^'",]*)"""
    return {"PERIOD": PERIOD} | {name.strip(): int(place) for place, name in re.findall(pair, said)}


def _values(source: Path, wanted: Mapping[str, int] | Sequence[str], par: np.ndarray) -> dict[str, float]:
    """Values of parameters by name: places in PAR are given, or b.NAME and c.NAME beside name them."""
    files = ("fort.7", "fort.2") if source.name == "fort.8" else (f"b{source.name[1:]}", f"c{source.name[1:]}")
    lines = (line for file in map(source.with_name, files) if wanted and file.is_file() for line in _lines(file))
    text = re.sub(r"(?<!\S)[#!].*", "", "\n".join(lines))
    known = _names(text)
    said = re.findall(r"\bICP\s*=\s*\[([^][]*)\]|Active continuation parameters?:(.*)", text)
    if said and wanted in (["ICP"], ("ICP",)):
        by_place = {str(place): name for name, place in known.items()}
        words = [by_place.get(word, word) for word in re.findall(r"""[^\s,'"]+""", "".join(said[-1]))]
        wanted = [word for word in words if known.get(word) != PERIOD]
    places = wanted if isinstance(wanted, Mapping) else {name: known.get(name, 0) for name in wanted}
    for name, place in places.items():
        if not 1 <= place <= par.size:
            raise InputError(f"parameters.{name}: no place in PAR(1) to PAR({par.size}){closest(name, known)}; "
                             f"parnames and ICP of {' and '.join(files)} name {shortened(', '.join(known), 200)}; "
                             "write them there as KEY = value, or give the place, {'I': 1}")  # fmt: skip
    return {name: float(par[place - 1]) for name, place in places.items()}


def branches(path: Path, names: Sequence[str]) -> np.ndarray:
    """Columns of b.NAME by our names (rows x names), of the branches that have them all.

    `period` is PAR(11), min_C and max_C are MIN C and MAX C; PT is negative where stable. Numbers of 1e99 and more are
    nan. Raises `InputError`.
    """
    lines, heads, rows = _lines(path), list[str](), []
    known = _names("\n".join(lines))
    for line in lines:
        if " PT " in line:
            words = re.split(" {2,}", line.strip().replace("MAX ", "max_").replace("MIN ", "min_"))
            heads = ["period" if known.get(word) == PERIOD else word for word in words]
        elif heads and line.split()[:1] != ["0"]:
            point = dict(zip(heads, _numbers(path, [line]), strict=False))
            if point.keys() >= set(names):
                rows.append([point[name] for name in names])
    if not rows:
        raise InputError(f"{path}: no branch has {', '.join(names)}; the last has "
                         f"{shortened(', '.join(heads[4:]), 200) or 'none'}; "
                         "AUTO names them by parnames and unames of c.NAME")  # fmt: skip
    return np.where(np.abs(rows) < 1e99, rows, np.nan)
