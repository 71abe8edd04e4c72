"""A structure by its matrices, as finite-element programs write them, with nonlinear elements and a harmonic load."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from itertools import product
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from orbitfinder._runtime.arguments import checked
from orbitfinder.errors import InputError, closest, shortened
from orbitfinder.mechanics.kind import KINDS, SystemKind
from orbitfinder.mechanics.lagrange import Symbols, Terms, coordinate_names, detected_invariants, mechanical_model
from orbitfinder.mechanics.model import Model, finite_number
from orbitfinder.records.reading import Entries, Table, file_beside, file_bytes, npz_members

Matrix = Any
"""Dense, SciPy's sparse, the path of a Matrix Market (.mtx) or NumPy file (.npz), or Matrix Market text"""
LARGEST, MARKET, MATRICES, FORMATS = 50_000_000, "%%MatrixMarket", ("mass", "damping", "stiffness"), (
    ("matrix",), ("coordinate", "array"), ("real", "double", "integer"), ("general", "symmetric", "skew-symmetric"),
)  # fmt: skip
"""Bytes of a matrix's file; what Matrix Market text begins with; matrices of a structure; words after that beginning"""
SYMMETRIC, SINGULAR = 1e-9, 1e-13
"""Shares of the largest entry by which a symmetric matrix may differ from its transpose, and of the largest pivot
below which a pivot is none"""


@checked
def structure(
    mass: Matrix,
    damping: Matrix | None,
    stiffness: Matrix,
    elements: Mapping[str, Mapping[str, Any]] | None = None,
    forcing: Mapping[str, Any] | None = None,
    *,
    names: Sequence[str] = (),
    parameters: Mapping[str, float] | None = None,
) -> Model:
    """The Model of M q'' + C q' + K q + sum of elements = load cos(frequency t + phase), its matrices sparse.

    Elements act on d = q_at - q_to, of the ground 0. "cubic": the force stiffness d^3. "stop": stiffness s(d - gap),
    for d beyond the gap, or with side = -1 on the other side. "gap": both sides of a clearance, stiffness (s(d - gap) -
    s(-d - gap)). "friction": dry, limit tanh(d' / smoothing). What has a corner is smooth here: s(x) = (x + sqrt(x^2 +
    smoothing^2)) / 2 is max(0, x) to half the smoothing (m) at most, and friction is viscous below its smoothing (m/s):
    make it smaller until nothing changes. Each number is a physical parameter: `tip_stiffness` of an element `tip`,
    `amplitude` and `frequency` of the load; text names what several share. SI units, or any that go together.

    Args:
        mass: M (n x n), symmetric and positive definite; a matrix, SciPy's sparse too, the path of a Matrix Market
            (.mtx) or NumPy file (.npz), from a problem file in its folder or below, or Matrix Market text.
        damping: C (n x n), gyroscopic terms may be in it; none when left out.
        stiffness: K (n x n), symmetric.
        elements: by name, each {kind, at, to, stiffness, gap, side, limit, smoothing}.
        forcing: the load {at, amplitude, frequency, phase}, at a coordinate, or at several with their shares.
        names: of the coordinates (n), q1, q2, ... when left out.
        parameters: values of physical parameters, of shared ones and instead of others.

    Returns:
        A Model, which files describe by its matrices.

    Raises:
        InputError: naming the matrix, element or coordinate.

    Examples:
        >>> import numpy as np
        >>> two = of.structure(np.eye(2), 0.1 * np.eye(2), [[2.0, -1.0], [-1.0, 2.0]],
        ...     {"tip": {"kind": "cubic", "at": "q2", "stiffness": 0.5}},
        ...     {"at": "q1", "amplitude": 0.3, "frequency": 1.2})
        >>> two.parameter_names
        ('tip_stiffness', 'amplitude', 'frequency')
        >>> of.find_orbit(of.Problem(two, of.Guess([0.0] * 4, 2 * np.pi / 1.2))).certificate.passed
        True

    See Also:
        `of.mechanism` for rigid bodies, `of.lagrange` from energies.
    """
    m = _symmetric("mass", _matrix("mass", mass))
    size = m.shape[0]
    k = _symmetric("stiffness", _matrix("stiffness", stiffness, size))
    c = sparse.csc_matrix((size, size)) if damping is None else _matrix("damping", damping, size)
    written = _Written(size, names, parameters or {})
    for name, element in (elements or {}).items():
        written.add(name, element)
    if forcing is not None:
        written.drive(forcing)
    symbols, q, v = written.symbols(), written.q, written.v
    damped = written.outer - _times(c, v) if c.nnz else written.outer
    terms = Terms(
        ca.dot(v, _times(m, v)) / 2, ca.dot(q, _times(k, q)) / 2 + written.potential,
        forces=ca.densify(damped) if damped.nnz() else None,
    )  # fmt: skip
    right = ca.densify(damped - _times(k, q) - written.inner)
    motion = ca.Function("acceleration", symbols.arguments, [_solved(_factors(m, written.names), m, right)])
    loose = [not k[:, i].nnz and i not in written.held for i in range(size)]
    system = {
        "kind": "structure", "mass": market(m), "stiffness": market(k), "damping": market(c) if c.nnz else None,
        "elements": {name: dict(element) for name, element in (elements or {}).items()}, "names": list(names) or None,
        "forcing": None if forcing is None else dict(forcing), "parameters": dict(written.given),
    }  # fmt: skip
    return mechanical_model(
        motion, terms, symbols, written.names,
        invariants=detected_invariants(terms, written.names, symbols.arguments, loose),
        system={key: value for key, value in system.items() if value is not None}, angles=(False,) * size,
    )  # fmt: skip


def market(matrix: Any) -> str:
    """A matrix as Matrix Market text, every number to the last bit."""
    full = sparse.coo_matrix(matrix)
    full.sum_duplicates()
    alike = (abs(full - full.T)).nnz == 0
    kept = sparse.coo_matrix(sparse.tril(full)) if alike else full
    lines = [
        f"{MARKET} matrix coordinate real {'symmetric' if alike else 'general'}",
        f"{full.shape[0]} {full.shape[1]} {kept.nnz}",
    ]
    lines += [f"{i + 1} {j + 1} {float(x)!r}" for i, j, x in zip(kept.row, kept.col, kept.data, strict=True)]
    return "\n".join([*lines, ""])


def _is_text(given: str) -> bool:
    """Whether it is a matrix, and not a file's name."""
    return given.lstrip()[: len(MARKET)].lower() == MARKET.lower()


def _matrix(name: str, given: Matrix, size: int | None = None) -> Any:
    """A matrix as SciPy's sparse columns, of the mass's `size`, or `InputError`; compiled code gets no others."""
    if isinstance(given, (str, Path)):
        text = str(given)
        given = _read(name, "text", text.encode()) if _is_text(text) else _read(name, *_file(name, Path(text)))
    try:
        given = given if sparse.issparse(given) else np.asarray(given)
        if given.dtype.kind not in "buif":
            raise ValueError(f"{given.dtype} entries" + ": make damping viscous" * (given.dtype.kind == "c"))
        if hasattr(given, "check_format"):
            given.check_format(full_check=True)
        if given.ndim != 2 or given.shape[0] != given.shape[1] or not given.shape[0]:
            raise InputError(f"{name}: shape {given.shape}; a square matrix is wanted, n x n")
        if given.shape[0] != (size or given.shape[0]):
            raise InputError(f"{name}: shape {given.shape}, but mass is {size} x {size}; give them one size")
        if size is None and (entries := given.nnz if sparse.issparse(given) else given.size) < given.shape[0]:
            raise InputError(f"{name}: shape {given.shape} with {entries} entries; every coordinate needs its own "
                             "mass, give a matrix with a diagonal")  # fmt: skip
        columns = sparse.csc_matrix(given, dtype=float)
    except InputError:
        raise
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: no matrix of numbers ({shortened(error, 80)}); give n x n real numbers") from error
    if not np.isfinite(columns.data).all():
        raise InputError(f"{name}: has entries that are not finite; write it anew")
    columns.sum_duplicates()
    columns.eliminate_zeros()
    return columns


def _file(name: str, path: Path) -> tuple[str, bytes]:
    try:
        return path.name, file_bytes(path, "file of a matrix", LARGEST)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def _read(name: str, file: str, data: bytes) -> Any:
    """The matrix in a file's bytes, by what they begin with."""
    try:
        if data.startswith(b"PK"):
            return _packed(data)
        if not _is_text(text := data.decode(errors="replace")):
            raise ValueError(f"it begins with neither {MARKET} nor as .npz does")
        return _parsed(text)
    except (ValueError, TypeError, LookupError, OverflowError, NotImplementedError) as error:  # of SciPy and NumPy too
        why = shortened(error, 120)
        raise InputError(f"{name}: {file} is not a matrix ({why}); give a Matrix Market or .npz file") from error


def _packed(data: bytes) -> Any:
    """The matrix in a .npz file, dense or sparse as SciPy writes it. Raises `ValueError`."""
    members = npz_members(data, (), 2 * LARGEST, "fiubcSU")
    if "format" not in members:
        if len(members) != 1:
            raise ValueError(f"it has {len(members)} arrays, a single array is wanted")
        return next(iter(members.values()))
    for name in {"indices", "indptr", "row", "col", "offsets", "shape"} & members.keys():
        if members[name].dtype.kind != "i":
            raise ValueError(f"{name} are not whole numbers")
    if members["format"].size != 1 or members["format"].dtype.kind not in "SU":
        raise ValueError("its format is not a word")
    return sparse.load_npz(BytesIO(data))  # whose indices are checked before anything goes by them


def _parsed(text: str) -> Any:
    """The matrix in Matrix Market text, strictly. SciPy's reader takes Fortran's 2.0D3 for 2, adds up both triangles of
    what is said to be symmetric, and reads ones where there are no numbers. Raises `ValueError`."""
    header, _, body = text.strip().partition("\n")
    kind = tuple(header.lower().split()[1:])
    if kind not in set(product(*FORMATS)):
        raise ValueError(f"its header {header!r} is not {' '.join('|'.join(words) for words in FORMATS)}")
    lines = (line.lower().replace("d", "e").split() for line in body.splitlines() if line.strip()[:1] not in ("", "%"))
    high, wide, *count = map(float, next(lines, ()))
    shape, dense = (int(high), int(wide)), kind[1] == "array"
    x = np.fromiter(_numbers(lines, None if dense else 3), float)
    if dense:
        side = {"general": wide, "symmetric": (wide + 1) / 2}.get(kind[3], (wide - 1) / 2)
        count = [high * side]
        if kind[3] != "general" and high != wide:
            raise ValueError(f"{kind[3]} of shape {shape}")
    if [x.size if dense else x.size // 3] != count:
        raise ValueError(f"it has {x.size if dense else x.size // 3} entries, not "
                         f"{' '.join(f'{number:g}' for number in count)}")  # fmt: skip
    if dense:
        j, i = np.nonzero(np.tri(*shape, {"general": shape[1], "symmetric": 0}.get(kind[3], -1), bool).T)
    else:
        row, column, x = x.reshape(-1, 3).T
        if not np.all((row >= 1) & (row <= high) & (column >= 1) & (column <= wide)):
            raise ValueError(f"an entry lies outside {shape[0]} x {shape[1]}; rows and columns count from 1")
        i, j = row.astype(int) - 1, column.astype(int) - 1
    off = i != j
    if kind[3] == "general":
        return sparse.coo_matrix((x, (i, j)), shape)
    pairs = set(zip(i[off].tolist(), j[off].tolist(), strict=True))
    if both := sorted(pairs & {(b, a) for a, b in pairs}):
        a, b = both[0][0] + 1, both[0][1] + 1
        raise ValueError(f"{kind[3]}, yet it has {a},{b} and {b},{a}: keep a triangle, or call it general")
    mirrored = x[off] if kind[3] == "symmetric" else -x[off]
    return sparse.coo_matrix((np.append(x, mirrored), (np.append(i, j[off]), np.append(j, i[off]))), shape)


def _numbers(lines: Iterable[Sequence[str]], width: int | None) -> Iterator[float]:
    for line in lines:
        if len(line) != (width or len(line)):
            raise ValueError("a line of it is not a row, a column and a number")
        yield from map(float, line)


def _symmetric(name: str, matrix: Any) -> Any:
    """Its symmetric part, or `InputError` where that is not all of it."""
    apart = abs(matrix - matrix.T).tocoo()
    size = float(abs(matrix).max()) if matrix.nnz else 0.0
    if apart.nnz and apart.max() > SYMMETRIC * size:
        worst = int(np.argmax(apart.data))
        i, j = apart.row[worst], apart.col[worst]
        raise InputError(
            f"{name}: not symmetric: entries {i + 1},{j + 1} and {j + 1},{i + 1} are {matrix[i, j]:.6g} and "
            f"{matrix[j, i]:.6g}; give the whole matrix, not a triangle (of Matrix Market, its header says symmetric); "
            "gyroscopic terms belong to damping"
        )
    return sparse.csc_matrix((matrix + matrix.T) / 2)


def _factors(mass: Any, names: Sequence[str]) -> SuperLU | None:
    """M = L U without pivots, once for all; None of a diagonal. `InputError` unless it is positive definite."""
    lean = [name for name, x in zip(names, mass.diagonal(), strict=True) if not x > 0]
    if lean:
        raise InputError(f"mass: no mass moves with {', '.join(lean[:5])}{', ...' * (len(lean) > 5)}; every coordinate "
                         "needs its own, condense those without (Guyan's reduction)")  # fmt: skip
    if mass.nnz == mass.shape[0]:
        return None
    try:
        factors = splu(mass, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        pivots = factors.U.diagonal()
    except RuntimeError:
        pivots = np.zeros(1)
    if not pivots.min() > SINGULAR * pivots.max() or not np.array_equal(factors.perm_r, factors.perm_c):
        raise InputError(f"mass: not positive definite (pivots from {pivots.min():.3g} to {pivots.max():.3g}); a "
                         "combination of coordinates moves no mass, or its sign is wrong")  # fmt: skip
    return factors


def _solved(factors: SuperLU | None, mass: Any, right: Any) -> Any:
    """M^-1 times an expression (n): by substitution, as sparse as the factors are."""
    if factors is None:
        return right / ca.DM(mass.diagonal())
    lower, upper = _constant(factors.L), _constant(factors.U)
    inside = ca.solve(upper, ca.solve(lower, right[np.argsort(factors.perm_r).tolist()]))
    return ca.densify(inside[factors.perm_c.tolist()])


def _constant(matrix: Any) -> Any:
    """A sparse matrix as CasADi's."""
    columns = matrix.tocsc()
    columns.sort_indices()
    return ca.SX(ca.DM(columns))


def _times(matrix: Any, column: Any) -> Any:
    return ca.mtimes(_constant(matrix), column)


def _ramp(x: Any, w: Any) -> Any:
    """max(0, x), smooth over w."""
    return (x + ca.sqrt(x**2 + w**2)) / 2


def _ramped(x: Any, w: Any) -> Any:
    """The integral of `_ramp` over x."""
    return (x**2 + x * ca.sqrt(x**2 + w**2) + w**2 * ca.asinh(x / w)) / 4


@dataclass(frozen=True)
class Element:
    """A kind of element: its numbers, its force on d (of friction on d'), what that is the slope of, and the
    numbers that are not negative."""

    numbers: tuple[str, ...]
    force: Callable[..., Any]
    potential: Callable[..., Any] | None = None
    sided: bool = False
    signed: tuple[str, ...] = ()


ELEMENTS = {
    "cubic": Element(("stiffness",), lambda d, k: k * d**3, lambda d, k: k * d**4 / 4),
    "stop": Element(
        ("stiffness", "gap", "smoothing"), lambda d, k, g, w: k * _ramp(d - g, w),
        lambda d, k, g, w: k * _ramped(d - g, w), sided=True,
        signed=("stiffness",),
    ),
    "gap": Element(
        ("stiffness", "gap", "smoothing"), lambda d, k, g, w: k * (_ramp(d - g, w) - _ramp(-d - g, w)),
        lambda d, k, g, w: k * (_ramped(d - g, w) + _ramped(-d - g, w)), signed=("stiffness",),
    ),
    "friction": Element(("limit", "smoothing"), lambda d, f, w: f * ca.tanh(d / w), signed=("limit",)),
}  # fmt: skip
"""The kinds of elements by name"""


class _Written:
    """A structure's symbols, its parameters in the order in which they are met, its elements' potential, what they pull
    (`inner`, n) and what else acts (`outer`, n)."""

    def __init__(self, size: int, names: Sequence[str], given: Mapping[str, float]) -> None:
        self.t, self.q, self.v = ca.SX.sym("t"), ca.SX.sym("q", size), ca.SX.sym("v", size)
        self.names = coordinate_names(tuple(names) or None, Symbols(self.q, self.v))
        self.given = {name: finite_number(f"parameters.{name}", value) for name, value in given.items()}
        self.values, self.numbers, self.held = dict[str, float](), Entries(), set[int]()
        self.potential, self.inner, self.outer = ca.SX(0), ca.SX(size, 1), ca.SX(size, 1)
        self.clock: Any = None

    def add(self, name: str, given: Table) -> None:
        """One element. Raises `InputError`."""
        where, kind = f"elements.{name}", given.get("kind")
        if not str(name).isidentifier():
            raise InputError(f"{where}: no name; use letters, digits and _")
        if not isinstance(kind, str) or kind not in ELEMENTS:
            raise InputError(f"{where}.kind: unknown {kind!r}{closest(str(kind), ELEMENTS)}; use {', '.join(ELEMENTS)}")
        element = ELEMENTS[kind]
        taken = ("kind", "at", "to", *element.numbers, *(("side",) if element.sided else ()))
        if unknown := [key for key in given if key not in taken]:
            raise InputError(f"{where}.{unknown[0]}: a {kind} element takes {', '.join(taken[1:])}; leave it out")
        side = given.get("side", 1)
        if side not in (1, -1):
            raise InputError(f"{where}.side: must be 1 or -1, got {side!r}; 1 stops motion towards positive values")
        numbers = [self._parameter(where, f"{name}_{key}", given.get(key), key) for key in element.numbers]
        for key in element.signed:
            if (number := self.values[given[key] if isinstance(given[key], str) else f"{name}_{key}"]) < 0:
                raise InputError(f"{where}.{key}: must not be negative, got {number}; a {kind} element only resists")
        ends = [(self._place(f"{where}.at", given.get("at")), side)]
        ends += [(self._place(f"{where}.to", given["to"]), -side)] if "to" in given else []
        if len(ends) == 2 and ends[0][0] == ends[1][0]:
            raise InputError(f"{where}.to: {given['to']!r} at both ends; leave it out where the other is the ground")
        self.held |= {i for i, _ in ends}
        column = self.q if element.potential else self.v
        force = element.force(d := sum(sign * column[i] for i, sign in ends), *numbers)
        for i, sign in ends:
            if element.potential:
                self.inner[i] += sign * force
            else:
                self.outer[i] -= sign * force
        self.potential += element.potential(d, *numbers) if element.potential else 0

    def drive(self, given: Table) -> None:
        """The harmonic load. Raises `InputError`."""
        if unknown := [key for key in given if key not in ("at", "amplitude", "frequency", "phase")]:
            raise InputError(f"forcing.{unknown[0]}: unknown; give at, amplitude, frequency and phase")
        amplitude, omega = (
            self._parameter("forcing", name, given.get(name), name) for name in ("amplitude", "frequency")
        )
        self.clock = omega
        if not (number := self.values[omega.name()]) > 0:
            raise InputError(f"forcing.frequency: must be positive, got {number}; give rad/s")
        load = amplitude * ca.cos(omega * self.t + finite_number("forcing.phase", given.get("phase", 0.0)))
        at = given.get("at")
        for name, share in at.items() if isinstance(at, Mapping) and at else [(at, 1.0)]:
            self.outer[self._place("forcing.at", name)] += finite_number(f"forcing.at.{name}", share) * load

    def _parameter(self, where: str, name: str, value: Any, key: str) -> Any:
        """The symbol of a number, or of what a text names."""
        if isinstance(value, str):
            if value not in self.given:
                hint = closest(value, self.given)
                raise InputError(
                    f"{where}.{key}: {value!r} is no shared parameter{hint}; give a number, or the value of {value} in "
                    "parameters"
                )
            name = value
        elif value is None:
            raise InputError(f"{where}.{key}: missing; give a number")
        number = self.given[name] if name in self.given else finite_number(f"{where}.{key}", value)
        if key == "smoothing" and not number > 0:
            raise InputError(f"{where}.smoothing: must be positive, got {number}; corners are smooth over so much")
        self.values[name] = number
        return self.numbers.setdefault(name, ca.SX.sym(name))

    def _place(self, where: str, name: Any) -> int:
        if name not in self.names:
            some = ", ".join(self.names[:6]) + ", ..." * (len(self.names) > 6)
            hint = closest(str(name), self.names)
            raise InputError(f"{where}: {name!r} is no coordinate{hint}; there are {some}")
        return self.names.index(name)

    def symbols(self) -> Symbols:
        """As Models take them; `InputError` for values of parameters that there are not."""
        if unknown := [name for name in self.given if name not in self.numbers]:
            some = ", ".join([*self.numbers][:12]) or "none"
            raise InputError(
                f"parameters: nothing uses {unknown[0]!r}{closest(unknown[0], self.numbers)}; there are {some}"
            )
        forced = self.clock is not None and ca.depends_on(self.outer, self.t)
        symbols = Symbols(
            self.q, self.v, ca.vertcat(*self.numbers.values()) if self.numbers else None, tuple(self.numbers),
            tuple(self.values.values()), self.t if forced else None, 2 * np.pi / self.clock if forced else None,
        )  # fmt: skip
        coordinate_names(self.names, symbols)
        return symbols


def _files(system: Table) -> dict[str, str]:
    """The files that matrices of a description are in, by name."""
    given = {name: system.get(name) for name in MATRICES}
    return {name: text for name, text in given.items() if isinstance(text, str) and not _is_text(text)}


def _built(system: Table, _: Path | None) -> Model:
    for name, file in _files(system).items():
        raise InputError(f"{name}: {file!r} is a file, and a record has its content; read the problem file")
    return structure(**{"damping": None} | {key: value for key, value in system.items() if key != "kind"})


def _with_content(system: Table, folder: Path) -> Entries:
    """The description of a problem file in a folder, with the matrices that its files hold."""
    beside = {name: file_beside(folder, file, name) for name, file in _files(system).items()}
    return {**system, **{name: market(_matrix(name, path)) for name, path in beside.items()}}


KINDS["structure"] = SystemKind(_built, lambda system: "structure", takes=structure, with_content=_with_content)
