"""A family proved over an interval of energies without a gap, and points on it where multipliers pass a value.

For every energy E of a piece [E_a, E_b] the orbit is sought in a slanted box, u = m + t (E - E_m) + y with |y| <= r,
t near du/dE. With e = E - E_m, and X the box of all such u,

    K(Y) = -C (F(m, E_m) + (DF(X) t - dF) e) + (1 - C DF(X)) Y,    dF = (0, ..., 0, 1)

holds Krawczyk's operator of every E in the piece: the mean value theorem along t. If K(Y) lies in the interior of Y,
then for each E there is exactly one zero in the box, and it is a C^1 function of E. Two pieces that share an energy
have the same orbit there if the first one's K(Y), moved to that energy, lies in the second one's box.
Source: A. Neumaier, Interval Methods for Systems of Equations (1990), section 5.1, with parameters.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime import __version__
from orbitfinder.errors import ConvergenceError, InputError, IntegrationError
from orbitfinder.loops.symmetry import named
from orbitfinder.mechanics.catalogue import build_model
from orbitfinder.mechanics.model import Model
from orbitfinder.proof.balls import (
    FLINT,
    Vector,
    arb,
    arb_mat,
    between,
    column,
    decimal,
    exact,
    floats,
    identity,
    inside,
    precision,
)
from orbitfinder.proof.enclosure import Settings
from orbitfinder.proof.field import Programs, make_field, programs
from orbitfinder.proof.formulation import Formulation, approach
from orbitfinder.proof.krawczyk import (
    Arc,
    Equations,
    approximate_inverse,
    arcs_over,
    jacobian,
    linearised,
    norm,
    residual,
    solve,
)
from orbitfinder.proof.theorem import (
    CENTRE,
    NotProved,
    Progress,
    check_graph,
    chosen_symmetry,
    enclosed,
    make_equations,
    provable_model,
    unknowns_at,
)
from orbitfinder.proof.trajectory import Trajectory, horizon, minimal_period, moves, positive_mass, trajectory
from orbitfinder.records.family import Family, FamilyPoint, plain
from orbitfinder.records.reading import json_file, read_as

ROUGH = Settings(order=12, bits=80, tolerance=1e-14)
"""How the centres of a branch's boxes are found"""
SHARP = Settings()
"""How the ends of a branch are enclosed"""
FORMAT, VERSION, AGAIN = "orbitfinder/branch-proof", 1, "prove the branch again"
FIRST = 1e-4
"""Energies of the first piece that is tried, relative to those asked for where they are fewer (J)"""
SLACK = 0.3
"""r beside the half width of a piece along t, before it is known"""
REMAINDER = 1e-4
"""Remainder of a step beside the half width of a piece"""
EASY = 0.35
"""A piece whose image fills no more of its box is followed by a wider one"""
FARTHEST = 0.3
"""How far from the nearest point of the family the first orbit may be (rad, rad/s, s)"""
NARROWEST = 1e-6
"""Energies of the shortest piece that is tried, relative to those asked for"""


@dataclass(frozen=True)
class Piece:
    """A piece of a branch: exactly one orbit for each energy from `low` to `high` in its slanted box.

    `centre` (exact floats) is m at the middle energy, `tangent` t, `radius` r of each unknown.
    """

    low: float
    high: float
    centre: tuple[float, ...]
    tangent: tuple[float, ...]
    radius: tuple[float, ...]
    contraction: float = float("nan")

    @property
    def energies(self) -> Any:
        """The ball that holds every energy of the piece."""
        return between(decimal(self.low), decimal(self.high))

    @property
    def middle(self) -> float:
        """The energy of the centre, exact."""
        return 0.5 * (self.low + self.high)

    def along(self, energy: Any) -> Vector:
        """m + t (E - E_m) at an energy or over a ball of them."""
        ahead = energy - arb(self.middle)
        return [arb(m) + arb(t) * ahead for m, t in zip(self.centre, self.tangent, strict=True)]

    def box(self, energy: Any) -> Vector:
        """The box of unknowns at an energy or over a ball of them."""
        return [x + arb(0, r) for x, r in zip(self.along(energy), self.radius, strict=True)]


@dataclass(frozen=True)
class Checked:
    """A piece with what was shown of it: K(Y) - m - t e (`image`), the norm, the segments over the whole box."""

    piece: Piece
    image: Vector
    contraction: float
    proved: bool
    arcs: list[Arc]

    def ends(self, energy: float) -> Vector:
        """Where the orbit of one energy of the piece is."""
        return [x + y for x, y in zip(self.piece.along(decimal(energy)), self.image, strict=True)]


def checked(equations: Equations, piece: Piece) -> Checked:
    """The operator on a piece, integrated as finely as its width asks for."""
    half = 0.5 * max(map(abs, piece.tangent)) * (piece.high - piece.low)
    settings = replace(ROUGH, tolerance=min(1e-7, max(1e-40, REMAINDER * half)))
    here, centre = replace(equations, energy=arb(piece.middle)), [arb(x) for x in piece.centre]
    tangent, ahead = [arb(t) for t in piece.tangent], piece.energies - arb(piece.middle)
    spread = [arb(0, r) for r in piece.radius]
    around = [x + y for x, y in zip(centre, spread, strict=True)]
    arcs = arcs_over(here, around, centre, settings, (tangent, ahead))
    values = residual(here, centre, [arc[0] for arc in arcs])
    slopes = jacobian(here, piece.box(piece.energies), [arc[1] for arc in arcs])
    inverse, last = exact(approximate_inverse(floats(slopes))), len(values) - 1
    along = (slopes * column(tangent)).entries()
    moved = [f + (a - int(k == last)) * ahead for k, (f, a) in enumerate(zip(values, along, strict=True))]
    defect = identity(len(values)) - inverse * slopes
    parts = zip((inverse * column(moved)).entries(), (defect * column(spread)).entries(), strict=True)
    image = [e - f for f, e in parts]
    return Checked(piece, image, norm(defect), inside(spread, image), arcs)


def fitted(equations: Equations, near: Vector, low: float, high: float) -> Checked:
    """A piece about the orbit at its middle energy, from unknowns near that; r is twice the image in a first box."""
    middle = 0.5 * (low + high)
    here = replace(equations, energy=arb(middle))
    centre = solve(here, near, ROUGH, 1e-13, FARTHEST)[0]
    tangent = linearised(here, centre, ROUGH)[1][:, -1]
    half = 0.5 * np.abs(tangent) * (high - low)
    radius = SLACK * (0.2 * half + half.max())
    places = tuple(float(x.mid()) for x in centre)
    piece = Piece(low, high, places, tuple(map(float, tangent)), tuple(map(float, radius)))
    found = checked(equations, piece)
    if found.proved or not fill(found) < 1e3:
        return found
    wide = zip(found.image, found.piece.radius, strict=True)
    wider = tuple(max(2 * float(abs(x).upper()), 0.2 * r) for x, r in wide)
    return checked(equations, replace(found.piece, radius=wider))


def fill(found: Checked) -> float:
    """How much of its box the image of a piece fills."""
    sizes = [abs(x).upper() for x in found.image]
    if not all(x.is_finite() for x in sizes):
        return float("inf")
    return max(float(x) / r for x, r in zip(sizes, found.piece.radius, strict=True))


def same_orbit(before: Checked, after: Piece) -> bool:
    """Whether the orbit of the energy that two pieces share is in the box of the second one as it is of the first."""
    return inside(after.box(decimal(before.piece.high)), before.ends(before.piece.high))


@dataclass(frozen=True)
class Passage:
    """A multiplier of the root map that passes exp(+-i angle), 2 cos(angle) = `level`, between the ends of a branch.

    `test` names the determinant whose sign is proved to be another at the two ends; `kept` the symmetry of the orbits
    that branch off, where their existence follows.
    """

    kind: str
    level: float
    test: str
    low: str
    high: str
    proved: bool
    kept: str = ""


@dataclass(frozen=True)
class Branch:
    """What was proved of a family over energies from `low` to `high`, or why nothing was."""

    proved: bool
    reason: str
    name: str
    system: Mapping[str, Any]
    formulation: Formulation
    section: tuple[Sequence[float], Sequence[float]] | None
    low: float
    high: float
    wall_time: float
    pieces: tuple[Piece, ...] = ()
    passages: tuple[Passage, ...] = ()


def tests(found: Trajectory, level: float) -> dict[str, tuple[Any, str]]:
    """Determinants (balls) that change their sign where an odd number of pairs of multipliers of the root map N pass.

    Where the symmetry reverses time, N = R0 A^-1 R1 A: K = N + N^-1 leaves the fixed space of R0 to itself, and has
    each index nu + 1/nu once there. At -1 it is blocks of A: R0 x = x, R1 A x = -A x, or R0 x = -x, R1 A x = A x.
    """
    matrix, form = found.horizon_matrix, found.formulation
    n, size = form.size, form.dimension

    def chosen(rows: np.ndarray, columns: np.ndarray, of: Any) -> Any:
        return arb_mat([[of[int(i), int(j)] for j in columns] for i in rows])

    if not form.symmetry.reverses:
        if level != -2.0:
            return {}
        forward = form.symmetry.forward
        root = matrix if forward is None else exact(forward.matrix(n)) * matrix
        return {"det(N + 1)": ((root + identity(size)).det(), "")}
    first, last = (np.diag(one.matrix(n)) for one in form.symmetry.mirrors)
    plus, minus, over, under = (np.flatnonzero(one) for one in (first > 0, first < 0, last > 0, last < 0))
    if level == -2.0 and form.symmetry.forward is not None and plus.size == over.size:
        names = [one.name for one in form.symmetry.mirrors]
        return {
            "det A[R1 +, R0 +]": (chosen(over, plus, matrix).det(), names[0]),
            "det A[R1 -, R0 -]": (chosen(under, minus, matrix).det(), names[1]),
        }
    turned = matrix.solve(exact(np.diag(last)) * matrix, algorithm="precond")
    start = exact(np.diag(first))
    whole = start * turned + turned * start
    shifted = whole - arb(level) * identity(size) if level else whole
    return {"det(K - level)": (chosen(plus, plus, shifted).det(), "")}


def passage(kind: str, level: float, ends: Sequence[Trajectory]) -> Passage | None:
    """The passage of a level between two enclosed orbits; None where there is no test for it."""
    level = float(round(level)) if abs(level - round(level)) < 1e-9 else level
    found, (low, high) = None, (tests(one, level) for one in ends)
    for name, (value, kept) in low.items():
        other = high[name][0]
        proved = bool((value < 0 and other > 0) or (value > 0 and other < 0))
        one = Passage(kind, level, name, value.str(6), other.str(6), proved, kept if proved else "")
        found = one if found is None or proved else found
    return found


@dataclass
class _Run:
    """A branch being proved."""

    model: Model
    equations: Equations
    say: Progress

    def pieces(self, near: Vector, low: float, high: float) -> list[Checked]:
        """The pieces from one energy to another, from unknowns near the first orbit. Raises `NotProved`."""
        found: list[Checked] = []
        here, length = low, min(FIRST, high - low)
        while here < high:
            following = high if high - here < 1.5 * length else here + length
            try:
                one = fitted(self.equations, near, here, following)
                if not one.proved:
                    raise NotProved
                self.join(found, one)
            except (NotProved, IntegrationError, ConvergenceError, ZeroDivisionError) as error:
                length *= 0.5
                if length < NARROWEST * (high - low):
                    raise NotProved(f"no piece of the branch is short enough beyond {here!r} J: {error}") from error
                continue
            length *= 1.4 if fill(one) < EASY else 1.0 if fill(one) < 0.7 else 0.8
            near, here = one.piece.along(decimal(following)), following
        return found

    def again(self, pieces: Sequence[Piece]) -> list[Checked]:
        """Recorded pieces checked once more. Raises `NotProved`."""
        found: list[Checked] = []
        for piece in pieces:
            one = checked(self.equations, piece)
            if not one.proved:
                raise NotProved(f"from {piece.low!r} to {piece.high!r} J the operator does not map the box into itself")
            self.join(found, one)
        return found

    def join(self, found: list[Checked], one: Checked) -> None:
        """Add a piece. `NotProved` unless it goes on where the last one ends, and all in it are orbits."""
        if found and not (found[-1].piece.high == one.piece.low and same_orbit(found[-1], one.piece)):
            raise NotProved(f"the pieces that meet at {one.piece.low!r} J could not be shown to have one orbit there")
        path = horizon(self.equations, one.piece.box(one.piece.energies), one.arcs)
        if not moves(path):
            raise NotProved("a state of the branch could be an equilibrium")
        if path.formulation.unfolded and not self.model.hamiltonian and not positive_mass(path):
            raise NotProved("the mass matrix could not be shown to be positive definite along the branch")
        minimal, _, reason = minimal_period(path, self.model.angles)
        if not minimal:
            raise NotProved(f"the period could be a multiple of the minimal one on a piece of the branch: {reason}")
        found.append(one)
        self.say(f"{one.piece.low!r} to {one.piece.high!r} J: one orbit for each energy, {fill(one):.0%} of the box")

    def end(self, one: Checked, energy: float) -> Trajectory:
        """The orbit at an end of the branch, enclosed to many digits, which is shown to be that of the piece there."""
        with precision(SHARP.bits):
            here = replace(self.equations, field=make_field(self.model), energy=decimal(energy))
            centre = solve(here, one.ends(energy), SHARP, CENTRE)[0]
            found = enclosed(here, centre, SHARP, lambda line: None)
            if not inside(one.piece.box(decimal(energy)), found.image):
                raise NotProved(f"the orbit at {energy!r} J could not be shown to be on the branch")
            return trajectory(here, found.image, SHARP)


def prove_branch(
    family: Family, low: float, high: float, model: Model | None = None, progress: Progress | None = None,
    symmetry: str | None = None,
) -> Branch:  # fmt: skip
    """The proof of a family's part between two energies (J), with its events there. Raises `InputError`."""
    origin, say = _nearest(family, low, high), progress or (lambda line: None)
    with precision(ROUGH.bits):
        model = model or provable_model(origin)
        codes = programs(model)
        if codes.energy is None:
            raise InputError("system: it conserves no energy; a branch is proved over an interval of energies")
        start = approach(model, origin, chosen_symmetry(origin, model, codes, symmetry), 1)
        equations = make_equations(model, codes, start, arb(origin.energy))
        inner = [one for one in family.events if low < one.energy < high and one.kind != "stability_change"]
        asked = [(one.kind, 2.0 * float(complex(one.multiplier).real)) for one in inner]
        empty = Branch(False, "", family.name, model.system, start.formulation, equations.section, low, high, 0.0)
        run = _Run(model, equations, say)
        return _concluded(empty, run, codes, asked, lambda: run.pieces(unknowns_at(start), low, high))


def branch_model(branch: Branch, trusted: Path | None = None) -> Model:
    """The Model of a recorded branch."""
    return build_model(dict(branch.system), trusted)


def replayed(branch: Branch, model: Model | None = None, progress: Progress | None = None) -> Branch:
    """A recorded proof of a branch done again, from its pieces. Raises `InputError`."""
    with precision(ROUGH.bits):
        model = model or branch_model(branch)
        codes = programs(model)
        equations = Equations(make_field(model, codes), branch.formulation, None, branch.section)
        run = _Run(model, equations, progress or (lambda line: None))
        asked = [(one.kind, one.level) for one in branch.passages]
        ends = [branch.pieces[0].low, branch.pieces[-1].high] if branch.pieces else []
        if ends != [branch.low, branch.high]:
            return replace(branch, proved=False, reason="the pieces do not reach from one end to the other")
        return _concluded(branch, run, codes, asked, lambda: run.again(branch.pieces))


def _concluded(
    about: Branch, run: _Run, codes: Programs, asked: Sequence[tuple[str, float]], pieces: Callable[[], list[Checked]]
) -> Branch:
    """What pieces and their ends say."""
    began, passed = time.perf_counter(), []
    try:
        check_graph(codes, about.formulation, run.model)
        found = pieces()
        if asked:
            ends = [run.end(found[0], about.low), run.end(found[-1], about.high)]
            with precision(SHARP.bits):
                each = (passage(kind, level, ends) for kind, level in asked)
                passed = [one for one in each if one is not None]
    except (NotProved, IntegrationError, ConvergenceError, ZeroDivisionError) as error:
        return replace(about, proved=False, reason=str(error), wall_time=time.perf_counter() - began)
    kept = tuple(replace(one.piece, contraction=one.contraction) for one in found)
    return replace(
        about, proved=True, reason="", pieces=kept, passages=tuple(passed), wall_time=time.perf_counter() - began
    )


def _nearest(family: Family, low: float, high: float) -> FamilyPoint:
    """The point of a family from which the branch is found: the nearest to its lower end."""
    energies = family.values("energy")
    for name, value in (("from", low), ("to", high)):
        if not energies.min() <= value <= energies.max():
            there = f"{energies.min():.12g} to {energies.max():.12g}"
            raise InputError(f"{name}: {value!r} J is not among the family's energies, {there}; give one of these")
    if not low < high:
        raise InputError(f"to: must be above from, got {low!r} to {high!r}")
    return family.points[int(np.abs(energies - low).argmin())]


# --------------------------------------------------------------------------------------------------
# The record of a branch, and reading it back.


@dataclass(frozen=True)
class Record:
    """A branch-proof.json."""

    name: str
    system: Mapping[str, Any]
    symmetry: str
    segments: int
    constants: tuple[int, ...]
    turns: tuple[int, ...]
    section: tuple[tuple[float, ...], tuple[float, ...]] | None
    low: float
    high: float
    proved: bool
    reason: str
    pieces: tuple[Piece, ...]
    passages: tuple[Passage, ...]
    wall_time: float = 0.0


def branch_document(branch: Branch) -> dict[str, Any]:
    """The JSON form of a branch."""
    form = branch.formulation
    return {
        "format": FORMAT, "version": VERSION, "name": branch.name, "system": plain(branch.system),
        "symmetry": form.symmetry.name, "segments": form.segments, "constants": list(form.constants),
        "turns": list(form.turns), "section": plain(branch.section), "low": branch.low, "high": branch.high,
        "proved": branch.proved, "reason": branch.reason, "wall_time": round(branch.wall_time, 1),
        "versions": {"orbitfinder": __version__, "python-flint": FLINT},
        "pieces": plain(branch.pieces), "passages": plain(branch.passages),
    }  # fmt: skip


def read_branch(path: Path) -> Branch:
    """A branch-proof.json. Raises `InputError`."""
    document = json_file(path, "branch-proof.json", AGAIN)
    if not isinstance(document, dict) or document.get("format") != FORMAT or document.get("version") != VERSION:
        raise InputError(f"{path}: format: expected {FORMAT!r} version {VERSION}; {AGAIN}")
    found = read_as(Record, document, str(path), AGAIN)
    model = build_model(dict(found.system))
    symmetry = named(found.symmetry, model)
    size = model.degrees_of_freedom
    form = Formulation(symmetry, size, found.segments, found.constants, found.turns, bool(model.invariants))
    sizes = {len(one) for piece in found.pieces for one in (piece.centre, piece.tangent, piece.radius)}
    fits = (len(form.constants), len(form.turns)) == (form.dimension, size) and sizes <= {form.unknowns}
    positive = all(r > 0 and np.isfinite(r) for piece in found.pieces for r in piece.radius)
    if not (fits and positive and found.segments > 0):
        raise InputError(f"{path}: pieces: do not fit the system or its symmetry; {AGAIN}")
    return Branch(
        found.proved, found.reason, found.name, found.system, form, found.section, found.low, found.high,
        found.wall_time, found.pieces, found.passages,
    )  # fmt: skip
