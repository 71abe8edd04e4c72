"""A family proved over an interval of energies without a gap, and points on it where multipliers pass a value.

For every energy E(e) = E_m + e (E_b - E_a) / 2, |e| <= 1, of a piece [E_a, E_b] the orbit is sought in a box,
u = m(e) + y with |y| <= r, m a polynomial. With C(e) a polynomial near the inverse of DF

    K(Y) = -C(e) F(m(e), E(e)) + (1 - C(e) DF(m(e) + Y)) Y

is Krawczyk's operator for each e. F and DF are enclosed as polynomials in e with ball coefficients (`along`), so that
what cancels for each e does so in the enclosures. If K(Y) lies in the interior of Y for every e, then for each E there
is exactly one zero in the box; DF is regular there, so it is a C^1 function of E. Two pieces that share an energy have
the same orbit there if the first one's K(Y), moved to that energy, lies in the second one's box.
Source: A. Neumaier, Interval Methods for Systems of TheoremEquations (1990), section 5.1, with parameters.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.continuation.tests import index_levels
from orbitfinder.errors import InputError, plural
from orbitfinder.loops.symmetry import named
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model
from orbitfinder.proof.along import DEGREE, Along, along, bundle, ranged, ranges, table
from orbitfinder.proof.balls import (
    Vector,
    Versioned,
    arb,
    arb_mat,
    arb_poly,
    column,
    decimal,
    exact,
    identity,
    inside,
    precision,
    why_not,
)
from orbitfinder.proof.enclosure import TaylorSettings, integrate
from orbitfinder.proof.field import Programs, make_field, programs
from orbitfinder.proof.formulation import Formulation, approach
from orbitfinder.proof.krawczyk import (
    Arc,
    TheoremEquations,
    approximate_inverse,
    jacobian_rows,
    krawczyk,
    linearised,
    norm,
    residual,
    solve,
)
from orbitfinder.proof.record import DIGITS, MARGIN, bounding
from orbitfinder.proof.theorem import (
    CENTRE,
    UNPROVED,
    NotProved,
    Progress,
    Proving,
    check_graph,
    check_motion,
    chosen_symmetry,
    enclosed,
    make_equations,
    provable_model,
    refuse,
    silent,
    unknowns_at,
)
from orbitfinder.proof.trajectory import Trajectory, horizon, minimal_period, trajectory
from orbitfinder.records.codec import Codec
from orbitfinder.records.family import Family, load_family
from orbitfinder.records.reading import Table

ROUGH = TaylorSettings(order=12, bits=80, tolerance=1e-14)
"""How the centres of a branch's boxes are found"""
SHARP = TaylorSettings()
"""How the ends of a branch are enclosed"""
AGAIN = "prove the branch again"
SAID = ("stability_change",)
"""Events that say what others at the same place do to the stability, and have no multiplier of their own"""


@dataclass(frozen=True)
class BranchSettings:
    """How a branch is cut into pieces."""

    first: float = 2e-3
    """energies of the first piece that is tried, relative to those of the family"""
    radius: float = 1e-8
    """half width of a piece's box at least, beside its unknowns"""
    remainder: float = 1e-4
    """remainder of a step beside the half width of a piece's box"""
    wanted: float = 0.2
    """how much of its box the image of a piece is to fill"""
    farthest: float = 0.3
    """how far from the nearest point of the family the first orbit may be (rad, rad/s, s)"""
    narrowest: float = 1e-6
    """energies of the shortest piece that is tried, relative to those asked for"""


@dataclass(frozen=True)
class BranchPiece:
    """A piece of a branch: exactly one orbit for each energy from `low` to `high` in the box about its centre there.

    `centre` (exact floats) are the coefficients c_0, c_1, ... of each unknown in e, -1 at `low` and 1 at `high`,
    `radius` the box's half width in each.
    """

    low: float
    high: float
    centre: tuple[tuple[float, ...], ...]
    radius: tuple[float, ...]
    contraction: float = np.nan

    @property
    def energy(self) -> Along:
        """The energy as a function of e."""
        low, high = decimal(self.low), decimal(self.high)
        return Along(arb_poly([(low + high) / 2, (high - low) / 2]))

    @property
    def functions(self) -> list[Along]:
        """The centre as functions of e."""
        return [Along(arb_poly(list(coefficients))) for coefficients in self.centre]

    @property
    def spread(self) -> Vector:
        """The box about its centre."""
        return [arb(0, r) for r in self.radius]

    @property
    def box(self) -> Vector:
        """The box of unknowns that holds every orbit of the piece."""
        return [x + y for x, y in zip(ranges(self.functions), self.spread, strict=True)]

    def at(self, place: float) -> Vector:
        """The centre at a value of e."""
        return [function.whole(arb(place)) for function in self.functions]

    def around(self, place: float) -> Vector:
        """The box of unknowns at a value of e."""
        return [x + y for x, y in zip(self.at(place), self.spread, strict=True)]


@dataclass(frozen=True)
class Checked:
    """A piece with what was shown of it: K(Y) less the centre (`image`), the norm, the segments over every energy."""

    piece: BranchPiece
    image: Vector
    contraction: float
    proved: bool
    arcs: list[Arc]

    def end(self, place: float) -> Vector:
        """Where the orbit of one end (-1 or 1) of the piece is."""
        return [x + y for x, y in zip(self.piece.at(place), self.image, strict=True)]


def inverse_along(slopes: np.ndarray) -> np.ndarray:
    """A polynomial in e near the inverse of a matrix of functions: C_0 = M_0^-1, C_k = -C_0 sum_{j>=1} M_j C_{k-j}."""
    flat = [slope.short for slope in along(slopes.ravel().tolist())]
    terms = [np.array([float(slope[k].mid()) for slope in flat]).reshape(slopes.shape) for k in range(DEGREE + 1)]
    powers = [approximate_inverse(terms[0])]
    for k in range(1, DEGREE + 1):
        powers.append(-powers[0] @ sum(terms[j] @ powers[k - j] for j in range(1, k + 1)))
    inverse = np.empty(slopes.shape, dtype=object)
    for i, j in np.ndindex(slopes.shape):
        inverse[i, j] = Along(arb_poly([float(matrix[i, j]) for matrix in powers]))
    return inverse


def guess(joined: Sequence[Checked], near: Vector, low: float, high: float) -> Callable[[float], Vector]:
    """Unknowns near the orbits of the next piece by e: the last one's polynomials carried on."""
    if not joined:
        return lambda place: near
    last = joined[-1].piece
    far = (high - low) / (last.high - last.low)
    return lambda place: last.at(1.0 + far * (place + 1.0))


def fill(shown: Checked) -> float:
    """How much of its box the image of a piece fills."""
    sizes = [abs(x).upper() for x in shown.image]
    if not all(x.is_finite() for x in sizes):
        return np.inf
    return max(float(x) / r for x, r in zip(sizes, shown.piece.radius, strict=True))


def same_orbit(before: Checked, after: BranchPiece) -> bool:
    """Whether the orbit of the energy that two pieces share is in the box of the second one as it is of the first."""
    return inside(after.around(-1.0), before.end(1.0))


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
class Record(Versioned):
    """A branch-proof.json."""

    _entries = (..., "wall_time", "versions", "pieces", "passages")

    name: str
    system: Mapping[str, Any]
    symmetry: str
    segments: int
    constants: tuple[int, ...]
    turns: tuple[int, ...]
    section: tuple[tuple[float, ...], tuple[float, ...]] | None
    low: float
    high: float
    proved: bool = False
    reason: str = ""
    pieces: tuple[BranchPiece, ...] = ()
    passages: tuple[Passage, ...] = ()
    wall_time: float = 0.0


@dataclass(frozen=True)
class ProvedBranch(Record):
    """What was proved of a family over energies from `low` to `high`, or why nothing was."""

    formulation: Formulation = field(kw_only=True)

    @property
    def words(self) -> list[tuple[str, str]]:
        """What is proved, line by line."""
        what = f"{self.formulation.symmetry.name} orbit" if self.formulation.symmetry.maps else "orbit"
        rows = [("branch", f"exactly one {what} for each energy from {self.low!r} to {self.high!r} J in the boxes of "
                           f"{plural(len(self.pieces), 'piece')}, without a gap")]  # fmt: skip
        for event in self.passages:
            verdict = "proved" if event.proved else "NOT PROVED, no change of sign"
            more = f"; {event.kept} orbits branch off" if event.kept else ""
            said = f"{event.kind.replace('_', ' ')}, nu + 1/nu = {event.level:.6g}"
            rows.append(("event", f"{said}: {event.test} from {event.low} to {event.high}: {verdict}{more}"))
        return rows


def tests(path: Trajectory, level: float) -> dict[str, tuple[Any, str]]:
    """Determinants (balls) that change their sign where an odd number of pairs of multipliers of the root map N pass.

    Where the symmetry reverses time, N = R0 A^-1 R1 A: K = N + N^-1 leaves the fixed space of R0 to itself, and has
    each index nu + 1/nu once there. At -1 it is blocks of A: R0 x = x, R1 A x = -A x, or R0 x = -x, R1 A x = A x.
    """
    matrix, form = path.horizon_matrix, path.formulation
    n, size = form.size, form.dimension

    def chosen(rows: np.ndarray, columns: np.ndarray, of: Any) -> Any:
        return arb_mat([[of[int(i), int(j)] for j in columns] for i in rows])

    if not form.symmetry.reverses:
        if level != -2.0:
            return {}
        forward = form.symmetry.forward
        root = matrix if forward is None else exact(forward.matrix(n)) * matrix
        return {"det(N + 1)": ((root + identity(size)).det(), "")}
    first, last = (np.diag(mirror.matrix(n)) for mirror in form.symmetry.mirrors)
    plus, minus, over, under = (np.flatnonzero(signs) for signs in (first > 0, first < 0, last > 0, last < 0))
    if level == -2.0 and form.symmetry.forward is not None and plus.size == over.size:
        names = [mirror.name for mirror in form.symmetry.mirrors]
        return {
            "det A[R1 +, R0 +]": (chosen(over, plus, matrix).det(), names[0]),
            "det A[R1 -, R0 -]": (chosen(under, minus, matrix).det(), names[1]),
        }
    turned = matrix.solve(exact(np.diag(last)) * matrix, algorithm="precond")
    start = exact(np.diag(first))
    whole = start * turned + turned * start
    shifted = whole - arb(level) * identity(size) if level else whole
    return {"det(K - level)": (chosen(plus, plus, shifted).det(), "")}


def passage(
    kind: str, level: float, ends: Sequence[Trajectory], margin: float = MARGIN, digits: int = 6
) -> Passage | None:
    """The passage of a level between two enclosed orbits; None where there is no test for it.

    It is not proved of a kind that does not happen there. Balls are written wider than they are by `margin`.
    """
    level = float(round(level)) if abs(level - round(level)) < 1e-9 else level
    best, (low, high) = None, (tests(end, level) for end in ends)
    root = 1 if ends[0].formulation.symmetry.forward is None else 2
    fits = any(name == kind and abs(place - level) < 1e-9 for place, name, *_ in index_levels(root, 100))
    for name, (value, kept) in low.items():
        other = high[name][0]
        proved = fits and bool((value < 0 and other > 0) or (value > 0 and other < 0))
        at_low, at_high = (arb(ball.mid(), margin * ball.rad()).str(digits) for ball in (value, other))
        tested = Passage(kind, level, name, at_low, at_high, proved, kept if proved else "")
        best = tested if best is None or proved else best
    return best


@dataclass
class _BranchProof:
    """A branch being proved."""

    model: Model
    equations: TheoremEquations
    say: Progress
    settings: BranchSettings = BranchSettings()

    def checked(self, piece: BranchPiece) -> Checked:
        """The operator on a piece, every energy of it at once."""
        settings = replace(ROUGH, tolerance=self.settings.remainder * min(piece.radius))
        here, centre = replace(self.equations, energy=piece.energy), piece.functions
        nodes = here.formulation.nodes
        still = nodes([arb(0)] * len(centre))
        starts = [[x - y for x, y in zip(*pair, strict=True)] for pair in zip(nodes(piece.spread), still, strict=True)]
        clouds = [integrate(here.field, bundle(*pair), settings) for pair in zip(nodes(centre), starts, strict=True)]
        values = np.array(residual(here, centre, [end.point for end, _ in clouds]), dtype=object)
        around = [x + y for x, y in zip(centre, piece.spread, strict=True)]
        rows = jacobian_rows(here, around, [end.derivatives.ravel().tolist() for end, _ in clouds])
        slopes = np.array(rows, dtype=object)
        inverse = inverse_along(slopes)
        defect = ranged(table(identity(len(centre))) - inverse @ slopes)
        parts = zip(ranges(inverse @ values), (defect * column(piece.spread)).entries(), strict=True)
        image = [e - f for f, e in parts]
        arcs = [(ranges(end.point), ranged(end.derivatives), ranges(end.hull), steps) for end, steps in clouds]
        return Checked(piece, image, norm(defect), inside(piece.spread, image), arcs)

    def fitted(self, near: Callable[[float], Vector], low: float, high: float) -> Checked:
        """A piece through orbits at Chebyshev's points between two energies, from unknowns near those at an e."""
        places = np.polynomial.chebyshev.chebpts1(DEGREE + 1)
        rows, middle, half = [], 0.5 * (low + high), 0.5 * (high - low)
        inverse = linearised(replace(self.equations, energy=arb(middle)), near(0.0), ROUGH)
        for place in places.tolist():
            here = replace(self.equations, energy=arb(middle) + arb(half) * arb(place))
            rows.append([float(x) for x in solve(here, near(place), ROUGH, 1e-13, self.settings.farthest, inverse)[0]])
        bends = np.polynomial.chebyshev.chebfit(places, np.array(rows), DEGREE)
        powers = np.zeros((bends.shape[1], DEGREE + 1))
        for k, bend in enumerate(bends.T):
            terms = np.polynomial.chebyshev.cheb2poly(bend)  # without the zeros that it ends with
            powers[k, : len(terms)] = terms
        radius = np.full(len(powers), self.settings.radius * np.abs(powers).max())
        piece = BranchPiece(low, high, tuple(tuple(map(float, terms)) for terms in powers), tuple(map(float, radius)))
        return self.checked(piece)

    def scaled(self, shown: Checked | None) -> float:
        """How much wider (or narrower) than a piece the next one may be: what is left out grows with e to the D + 1."""
        if shown is None:
            return 0.4
        wanted = (self.settings.wanted / nonzero(fill(shown))) ** (1.0 / (DEGREE + 1))
        return float(np.clip(wanted, 0.3, 2.0 if shown.proved else 0.8))

    def pieces(self, near: Vector, low: float, high: float, first: float) -> list[Checked]:
        """The pieces from one energy to another, from unknowns near the first orbit. Raises `NotProved`."""
        joined: list[Checked] = []
        here, length = low, min(first, high - low)
        while here < high:
            following = high if high - here < 1.3 * length else here + length
            shown, why = None, "the operator does not map the box into itself"
            try:
                shown = self.fitted(guess(joined, near, here, following), here, following)
                if shown.proved:
                    self.join(joined, shown)
            except UNPROVED as error:
                shown, why = None, why_not(error)
            length = (following - here) * self.scaled(shown)
            if shown is not None and shown.proved:
                here = following
            elif length < self.settings.narrowest * (high - low):
                raise NotProved(f"no piece of the branch is short enough beyond {here!r} J: {why}")
        return joined

    def again(self, pieces: Sequence[BranchPiece]) -> list[Checked]:
        """Recorded pieces checked once more. Raises `NotProved`."""
        joined: list[Checked] = []
        for piece in pieces:
            shown = self.checked(piece)
            if not shown.proved:
                raise NotProved(f"from {piece.low!r} to {piece.high!r} J the operator does not map the box into itself")
            self.join(joined, shown)
        return joined

    def join(self, joined: list[Checked], shown: Checked) -> None:
        """Add a piece. `NotProved` unless it goes on where the last one ends, and all in it are orbits."""
        if joined and not (joined[-1].piece.high == shown.piece.low and same_orbit(joined[-1], shown.piece)):
            raise NotProved(f"the pieces that meet at {shown.piece.low!r} J could not be shown to have one orbit there")
        path = horizon(self.equations, shown.piece.box, shown.arcs)
        check_motion(path, self.model, "a state of the branch", "the branch")
        minimal, _, reason = minimal_period(path, self.model.angles)
        if not minimal:
            raise NotProved(f"the period could be a multiple of the minimal one on a piece of the branch: {reason}")
        joined.append(shown)
        low, high = shown.piece.low, shown.piece.high
        self.say(f"{low!r} to {high!r} J: one orbit for each energy, {fill(shown):.0%} of the box")

    def end(self, shown: Checked, place: float) -> Trajectory:
        """The orbit at an end of the branch, enclosed to many digits, which is shown to be that of the piece there."""
        with precision(SHARP.bits):
            energy = shown.piece.low if place < 0 else shown.piece.high
            here = replace(self.equations, field=make_field(self.model), energy=decimal(energy))
            centre = solve(here, shown.end(place), SHARP, CENTRE)[0]
            contracted = enclosed(lambda box: krawczyk(here, box, SHARP), centre, lambda line: None)
            if not inside(shown.piece.around(place), contracted.image):
                raise NotProved(f"the orbit at {energy!r} J could not be shown to be on the branch")
            return trajectory(here, contracted.image, SHARP)


def prove_branch(
    family: Family, low: float, high: float, model: Model | None = None, progress: Progress | None = None,
    symmetry: str | None = None,
) -> ProvedBranch:  # fmt: skip
    """The proof of a family's part between two energies (J), with its events there. Raises `InputError`."""
    say = progress or silent
    with precision(ROUGH.bits):
        model = model or provable_model(family.points[0])
        codes = programs(model)
        if codes.energy is None:
            raise InputError("system: it conserves no energy; a branch is proved over an interval of energies")
        energies = family.values("energy")
        for name, value in (("from", low), ("to", high)):
            if not energies.min() <= value <= energies.max():
                there = f"{energies.min():.12g} to {energies.max():.12g}"
                raise InputError(f"{name}: {value!r} J is not among the family's energies, {there}; give one of these")
        if not low < high:
            raise InputError(f"to: must be above from, got {low!r} to {high!r}")
        origin = family.points[int(np.abs(energies - low).argmin())]  # the nearest to its lower end
        start = approach(model, origin, chosen_symmetry(origin, model, codes, symmetry), 1)
        equations = make_equations(model, codes, start, arb(origin.energy))
        inner = [event for event in family.events if low < event.energy < high and event.kind not in SAID]
        asked = [(event.kind, 2.0 * float(complex(event.multiplier).real)) for event in inner]
        form = start.formulation
        section = next(((tuple(anchor), tuple(normal)) for anchor, normal in equations.sections), None)
        stated = form.symmetry.name, form.segments, form.constants, form.turns, section
        empty = ProvedBranch(family.name, model.system, *stated, low, high, formulation=form)
        run = _BranchProof(model, equations, say)
        first = run.settings.first * float(np.ptp(family.values("energy")))
        return _concluded(empty, run, codes, asked, lambda: run.pieces(unknowns_at(start), low, high, first))


def proving(asked: Table) -> Proving:
    """How the part of a family is proved that is asked for. Raises `InputError`."""
    low, high = asked["from"], asked["to"]
    alone = "--from, --to: give both, and one FAMILY.json"
    if low is None or high is None:
        raise InputError(alone)
    refuse(asked, "is for single orbits; a branch chooses its own", "symmetry", "from", "to", "event")

    def check(path: Path) -> None:
        """`InputError` where a proof of more than this is there."""
        try:
            known = read_branch(path)
        except InputError:  # damaged, of an older version, or none
            return
        if known.proved and not low <= known.low <= known.high <= high:
            raise InputError(f"{path}: from: {known.low!r} to {known.high!r} is proved there, and {low!r} to {high!r} "
                             "asked for; that is not written over: give a wider range, --no-record, or move that file"
                             )  # fmt: skip

    return Proving(
        lambda family, model, say: prove_branch(family, low, high, model, say, asked["symmetry"]),
        lambda branch: {"passed": branch.proved and all(event.proved for event in branch.passages)}
        | branch_document(branch),
        RECORDS, alone, load_family, "branch-proof.json", check=check,
    )  # fmt: skip


def replayed(branch: ProvedBranch, model: Model | None = None, progress: Progress | None = None) -> ProvedBranch:
    """A recorded proof of a branch done again, from its pieces. Raises `InputError`."""
    with precision(ROUGH.bits):
        model = model or build_model(dict(branch.system))
        codes = programs(model)
        sections = [branch.section] if branch.section else []
        equations = TheoremEquations(make_field(model, codes), branch.formulation, None, sections)
        run = _BranchProof(model, equations, progress or silent)
        asked = [(event.kind, event.level) for event in branch.passages]
        ends = [branch.pieces[0].low, branch.pieces[-1].high] if branch.pieces else []
        if ends != [branch.low, branch.high]:
            return replace(branch, proved=False, reason="the pieces do not reach from one end to the other")
        return _concluded(branch, run, codes, asked, lambda: run.again(branch.pieces), 1.0, 2 * DIGITS)


def contradictions(recorded: ProvedBranch, fresh: ProvedBranch) -> list[str]:
    """Every claim of a recorded branch that the proof done again, its balls written as found, does not prove."""
    wrong = [
        f"contraction from {old.low!r} J: recorded {old.contraction:.3g}, found {new.contraction:.3g}"
        for old, new in zip(recorded.pieces, fresh.pieces, strict=True)
        if not bounding(old.contraction, new.contraction)
    ]
    if len(recorded.passages) != len(fresh.passages):
        return [*wrong, f"events: {len(recorded.passages)} recorded, {len(fresh.passages)} can be tested"]
    return wrong + [
        f"event: recorded {old}, found {new}"
        for old, new in zip(recorded.passages, fresh.passages, strict=True) if not _borne(old, new)
    ]  # fmt: skip


def _borne(recorded: Passage, fresh: Passage) -> bool:
    """Whether a passage found again bears a recorded one out: all its words, and its balls inside the recorded ones."""
    try:
        (low, high), narrower = ([arb(event.low), arb(event.high)] for event in (recorded, fresh))
    except ValueError:
        return False
    inner = all(ball.is_finite() and ball.contains(narrow) for ball, narrow in zip((low, high), narrower, strict=True))
    apart = not recorded.proved or bool((low < 0 and high > 0) or (low > 0 and high < 0))
    return inner and apart and replace(fresh, low=recorded.low, high=recorded.high) == recorded


def _concluded(
    about: ProvedBranch, run: _BranchProof, codes: Programs, asked: Sequence[tuple[str, float]],
    pieces: Callable[[], list[Checked]], *written: Any,
) -> ProvedBranch:  # fmt: skip
    """What pieces and their ends say, balls as `written` (see `passage`)."""
    began, passed = time.perf_counter(), []

    def spent() -> float:
        return round(time.perf_counter() - began, 1)

    try:
        check_graph(codes, about.formulation, run.model)
        joined = pieces()
        if asked:
            ends = [run.end(joined[0], -1.0), run.end(joined[-1], 1.0)]
            with precision(SHARP.bits):
                each = (passage(kind, level, ends, *written) for kind, level in asked)
                passed = [event for event in each if event is not None]
    except UNPROVED as error:
        return replace(about, proved=False, reason=why_not(error), wall_time=spent())
    kept = tuple(replace(shown.piece, contraction=shown.contraction) for shown in joined)
    return replace(about, proved=True, reason="", pieces=kept, passages=tuple(passed), wall_time=spent())


RECORDS = Codec(Record, "branch-proof", "`orbitfinder prove`", AGAIN, version=2, sealed=True)
branch_document = RECORDS.document


def read_branch(path: Path) -> ProvedBranch:
    """A branch-proof.json. Raises `InputError`."""
    record = RECORDS.load(path)
    model = build_model(dict(record.system))
    symmetry = named(record.symmetry, model)
    size = model.degrees_of_freedom
    form = Formulation(symmetry, size, record.segments, record.constants, record.turns, bool(model.invariants))
    sizes = {len(numbers) for piece in record.pieces for numbers in (piece.centre, piece.radius)}
    fits = (len(form.constants), len(form.turns)) == (form.dimension, size) and sizes <= {form.unknowns}
    positive = all(r > 0 and np.isfinite(r) for piece in record.pieces for r in piece.radius)
    if not (fits and positive and record.segments > 0):
        raise InputError(f"{path}: pieces: do not fit the system or its symmetry; {AGAIN}")
    return ProvedBranch(**vars(record), formulation=form)


def replay(path: Path, trusted: Path | None, progress: Progress) -> tuple[ProvedBranch, list[str], str]:
    """The proof in a branch-proof.json done again (see `Kind.replay`)."""
    recorded = read_branch(path)
    fresh = replayed(recorded, build_model(dict(recorded.system), trusted), progress)
    wrong = contradictions(recorded, fresh) if fresh.proved else [fresh.reason]
    events = sum(passage.proved for passage in fresh.passages)
    return fresh, wrong, f"{plural(len(fresh.pieces), 'piece')}, {plural(events, 'event')}"
