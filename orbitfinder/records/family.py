"""What a family is made of, points, events and ends in plain numbers, and its files: a journal that survives
being killed, and family.json + family.npz made from it.

`family.jsonl` is a journal (see `records.journal`) of steps, each with everything that it added; a run resumes from the
last. family.json carries the digest of its own entries (`record`) and of the arrays beside it (`dense`). Files of
0.1.0 have no digests and are read without.
"""

from __future__ import annotations

import hashlib
import re
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np

from orbitfinder._runtime import notebook as display
from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder._runtime.rooms import loaded
from orbitfinder.errors import InputError, closest, plural, shortened
from orbitfinder.records.codec import Complexes, Filed, Unknown, check_format, entries_of, layout, plain, unsealed
from orbitfinder.records.ends import EndKind, end_kind, unknown_end
from orbitfinder.records.journal import append_line, read_lines
from orbitfinder.records.orbit import Orbit, incomputable, system_at
from orbitfinder.records.reading import (
    Entries,
    Table,
    arrays,
    content_digest,
    json_file,
    typed,
    write_json,
    write_npz,
)
from orbitfinder.records.table import Tabled

FORMAT, VERSION = "orbitfinder/family", 1
JOURNAL = "family.jsonl"
DENSE = {"nodes": "shooting_nodes", "mesh": "mesh", "tangent": "tangent"}
"""What goes into family.npz instead of family.json, and what it is called here."""
CLOSURE = 1e-11
"""Largest independent closure of an accepted point, relative to the motion, times what errors grow by."""
UNKNOWN = 1e10
"""Where errors grow more than this in a period, its closure and multipliers say nothing"""
METHODS = ("product", "periodic QR", "Hill")
"""How multipliers were computed: as eigenvalues of the state-transition matrices' product, factor by factor, or, as few
as it takes, of Hill's matrix."""
AGAIN = "continue the family again"
AVOIDED, BECOMES, DECIDED, UNCHANGING = (
    ("followed", "crossed"), ("becomes stable", "becomes unstable"), ("unstable", "asymptotically stable", "elliptic"),
    ("turn", "extremum", "resonance", "avoided_crossing"),
)  # fmt: skip
"""The details of an avoided crossing; of a change of stability, in the order in which a family is listed; verdicts that
say something; events at which they do not change"""
CURVE: Entries = {
    "cycles": int, "watch": Entries, "parameters": tuple[str, str], "test": Entries, "method": str,
    "form": str, "pace": float, "fixed": dict[str, float], "free": tuple[str, ...],
}  # fmt: skip
"""Entries of a family's curve that others than its solver read"""


def check_curve(curve: Table) -> None:
    """`ValueError` about an entry of a curve that is not of its kind."""
    for name in CURVE.keys() & curve.keys():
        typed(CURVE[name], curve[name], f"curve.{name}")
    if isinstance(test := curve.get("test"), Mapping):
        check_curve({name: entry for name, entry in test.items() if name == "parameters"})
    if curve.get("cycles", 1) < 1:
        raise ValueError(f"curve.cycles: expected 1 at least, got {curve['cycles']}")


def _check_place(member: Any) -> None:
    """`ValueError` unless a point or an event is an orbit whose nodes are on its mesh."""
    size, nodes, mesh = member.state.size, member.shooting_nodes, member.mesh
    if member.state.ndim != 1 or not size or not member.period > 0:
        raise ValueError(f"state: {plural(size, 'number')}, period {member.period}: no orbit")
    if fault := incomputable(member.state, member.period):
        raise ValueError(fault)
    if nodes.size and (nodes.shape[1:] != (size,) or not on_mesh(len(nodes), mesh)):
        raise ValueError("nodes: do not fit the state or the mesh")


def on_mesh(count: int, mesh: np.ndarray) -> bool:
    """Whether times grow, and so many nodes are at the starts of equal numbers of steps."""
    rising = mesh.ndim == 1 and mesh.size > count and bool(np.all(np.diff(mesh) > 0))
    return rising and (mesh.size - 1) % count == 0


@dataclass(frozen=True, kw_only=True)
class FamilyPoint(Orbit):
    """An Orbit and its place on a family: the `index`-th point, at an `arclength` and a `value` of the parameter.

    `closure` is by the independent integrator and relative to the extent of the motion, `scale`
    what its allowed value 1e-11 is multiplied by: the largest multiplier, or what errors grow by until the
    end of the part that is integrated. Where that is more than
    1e-8, one turn says little, and the orbit is checked piece by piece as well: `defect` is the largest
    gap, as relative, between where the same integrator leaves a shooting node and the next
    node, of which 1e-11 times the growth over a piece is allowed; elsewhere it is the closure itself.
    `symmetry` is that of the formulation, which the orbit has at least. `indices` are the stability indices in
    the order that follows each curve along the family, of the map whose power `root` is the monodromy.
    `tangent` is d(x(0), T, free)/d(arclength); `shooting_nodes` and `mesh` (times over the period) rebuild the
    shooting unknowns. `role`: step | at | end.
    """

    __repr__ = brief("name", "value", "period", "energy", "closure", "stability", "role")
    _entries = (
        "state", "period", "energy", "action", "closure", "symmetry", "floquet_multipliers", "pair_defect", "stability",
        "unfolding", "shift", "index", "arclength", "value", "scale", "krein", "indices", "root", "free", "nodes",
        "mesh", "tangent", "step", "role", "wall_time", "defect", "multiplier_errors", "multiplier_method", "certified",
        "watch",
    )  # fmt: skip
    _called: ClassVar[Mapping[str, str]] = {"shooting_nodes": "nodes"}
    _sparse = ("shift", "multiplier_errors", "multiplier_method", "watch")

    index: int
    arclength: float
    value: float
    scale: float
    krein: tuple[int, ...]
    indices: Complexes
    root: int
    free: Mapping[str, float]
    shooting_nodes: np.ndarray
    mesh: np.ndarray
    tangent: np.ndarray
    step: float
    role: str = "step"
    wall_time: float = 0.0
    defect: float = 0.0
    multiplier_errors: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """estimated relative error of each multiplier, by errors of the state-transition matrices; none in older files"""
    multiplier_method: str = ""
    """of `METHODS`"""
    certified: bool = False
    """whether it has every check of a certificate and not only those of its closure"""
    watch: Mapping[str, float] = field(default_factory=dict)
    """the numbers that the user watches, by name"""
    curve: Table = field(default_factory=dict)
    """what rebuilds the equations of its family"""

    _check = _check_place


@dataclass(frozen=True)
class Reading:
    """What the check of an event read: a `value` that is 0 at such an event, its `error`, and whether it `passed`; and
    where that was told, whether the event is supercritical or subcritical, and the error bars of its parameter and
    period."""

    _sparse = ("criticality", "parameter_error", "period_error")

    value: float
    error: float
    passed: bool
    criticality: str = ""
    parameter_error: float | None = None
    period_error: float | None = None


@dataclass(frozen=True)
class Event(Shown):
    """Something that happens between two points, located on the family.

    `kind`: fold | turn (of the period or of a momentum) | branch_point | avoided_crossing (`detail`: followed |
    crossed) | period_doubling | torus | resonance | collision | stability_change | extremum (of a watched number), of
    hybrid systems grazing | cycle_change | holds; along a curve of bifurcations in two parameters cusp | isola_centre |
    transcritical | strong_resonance | fold_doubling | fold_torus | doubling_torus | degenerate_doubling.
    `detail` says what exactly (of what the fold is, q of the resonance, what changed);
    `multiplier` is the critical multiplier of the root map, `order` the number of periods after which the branch
    closes.
    """

    __repr__ = brief("kind", "detail", "parameter", "error", "period", "index")
    _called = FamilyPoint._called
    _entries = (..., "criticality", "error", "period_error")
    _sparse = ("check", "watch", "criticality", "error", "period_error", "gap")

    kind: str
    index: int
    arclength: float
    parameter: float
    state: np.ndarray
    period: float
    energy: Unknown
    detail: str = ""
    order: int = 1
    multiplier: complex = 1.0 + 0.0j
    shooting_nodes: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    mesh: np.ndarray = field(default_factory=lambda: np.zeros(0))
    tangent: np.ndarray = field(default_factory=lambda: np.zeros(0))
    symmetry: str = "none"
    free: Mapping[str, float] = field(default_factory=dict)
    certified: bool = False
    check: Reading | None = None
    """by its definition (see `families.checks`); none in older files"""
    watch: Mapping[str, float] = field(default_factory=dict)
    gap: float | None = None
    """of an avoided crossing: how far apart the two families are where they are nearest, in sizes of the motion"""

    _check = _check_place

    @property
    def criticality(self) -> str:
        """supercritical or subcritical: of a doubling or a torus by what is born there, which is stable where the orbit
        is not, or unstable where it is stable; of a fold by where its orbits are, at larger or at smaller values of the
        parameter. "" where that is not told."""
        return self.check.criticality if self.check else ""

    @property
    def error(self) -> float | None:
        """The error bar of the parameter: how far along the family the event may be off, by what its test is known to,
        and across it, by how the independent integrator closes the orbit. None in older files, of hybrid cycles and
        along two parameters."""
        return self.check.parameter_error if self.check else None

    @property
    def period_error(self) -> float | None:
        """The same of the period."""
        return self.check.period_error if self.check else None

    @property
    def words(self) -> str:
        """What happens, as a noun: whether it is super- or subcritical, its kind and detail."""
        if self.detail in BECOMES:
            return f"{('gain', 'loss')[self.detail == BECOMES[1]]} of stability"
        detail = f"in {self.detail}" if self.detail in ("energy", "period", *self.free, *self.watch) else self.detail
        return f"{self.criticality} {self.kind.replace('_', ' ')} {detail}".strip()


@dataclass(frozen=True)
class End:
    """Why a family stopped in a direction: a short name and the sentence.

    Of what was solved for there, a Hopf point or a join, the family's parameter, the period and the error bar of the
    parameter; `joined` is the orbit of the family that is joined: state, period, symmetry, winding, free. Where the
    period grows without bound the parameter is that at an infinite one, `period` the last orbit's, and `saddles` are
    the equilibria that orbits come near, in the order and as often as they do: state and eigenvalues (1/s, as pairs of
    real and imaginary part).
    """

    _sparse = ("parameter", "period", "error", "joined", "saddles")

    kind: str
    reason: str
    parameter: float | None = None
    period: float | None = None
    error: float | None = None
    joined: Table | None = None
    saddles: tuple[Table, ...] | None = None

    def __repr__(self) -> str:
        """In a line: what it was solved for is in its fields."""
        return f"End(kind={self.kind!r}, reason={shortened(self.reason, 200)!r})"

    @property
    def facts(self) -> EndKind:
        """What is to be done at an end of its kind."""
        return end_kind(self.kind)


def reached(name: str, value: float) -> str:
    """The reason of an end at a value that was asked for."""
    return f"reached {name} = {float(value)!r}"


UNITS = {"energy": "J", "period": "s"}
"""Units of those parameters of a family that are no physical parameters"""


@dataclass(frozen=True)
class Standing:
    """What the next step begins with, to the last bit: where the orbit was marched, the family's tangent (both over
    w), the rows of what else vanishes along it (k x w)."""

    marched: np.ndarray
    tangent: np.ndarray
    rows: np.ndarray


def _members(kind: type[FamilyPoint] | type[Event]) -> Filed:
    def read(entries: Any, where: str) -> tuple[Any, ...]:
        told = typed(tuple[Table, ...], entries, where)
        return tuple(restored(kind, entry, f"{where}[{k}]") for k, entry in enumerate(told))

    return Filed(list, read)


Points = Annotated[tuple[FamilyPoint, ...], _members(FamilyPoint)]
Events = Annotated[tuple[Event, ...], _members(Event)]


@dataclass(frozen=True)
class Batch:
    """Everything a step adds; written to the journal as a line, so that it is kept or lost as a whole."""

    __repr__ = brief("direction", "points", "events", "end")
    _sparse = ("undecided",)

    direction: int
    points: Points = ()
    events: Events = ()
    end: End | None = None
    standing: Standing | None = None
    undecided: tuple[str, ...] = ()
    """what was seen of which no check says whether it is an event, a sentence each"""


@dataclass(frozen=True)
class Family(Tabled):
    """Orbits joined by arclength, ordered along the curve, with events and the reason of each end.

    `values(name)` is a number of every point (of a parameter by its name, a watched number too), `table()` all of them
    as a table, `family[k]` the k-th orbit with its samples, `places` what varies at every point and then at every
    event, `counts` how many are closed and certified. A curve of bifurcations has two `parameters`, of which the first
    is its `parameter`.

    Args:
        name: a word for files.
        system: plain description that rebuilds the model.
        parameter: what it was followed in.
        points: orbits in order, each an Orbit.
        events: folds, branch points, doublings, ... with place, kind and detail.
        ends: kind and reason of both ends.
        curve: what rebuilds the equations, and of a curve of bifurcations the test that it keeps.
        source: what the family was started from.
        undecided: what was seen of which no check says whether it is an event, a sentence each.

    Examples:
        >>> family.parameter, [end.kind for end in family.ends]
        ('energy', ['target'])
        >>> round(float(family.values("period").min()), 6)
        1.119341
        >>> family.table().dtype.names[:6]
        ('index', 'energy', 'period', 'action', 'amplitude_theta1', 'min_theta1')

    See Also:
        `of.save_figures` draws it, `of.load_family` reads it.
    """

    __repr__ = brief("name", "parameter", "points", "events", "ends")
    _sparse = ("undecided",)
    _tables = "families.table:family_tables"

    name: str
    system: Table
    parameter: str
    points: Points
    events: Events
    ends: tuple[End, ...]
    curve: Table = field(default_factory=dict)
    source: Table = field(default_factory=dict)
    undecided: tuple[str, ...] = ()

    def _check(self) -> None:
        if not self.points:
            raise ValueError("points: none")
        check_curve(self.curve)
        members: tuple[FamilyPoint | Event, ...] = (*self.points, *self.events)
        if len({member.state.size for member in members}) > 1:
            raise ValueError("state: not of one size in all points and events")
        if len({tuple(member.free) for member in members}) > 1:
            raise ValueError("free: not of the same parameters in all points and events")

    @property
    def unknown(self) -> tuple[str, ...]:
        """What is `undecided`, and between which points the stability changes and no certified event says how, a
        sentence each."""
        known = [(k, point) for k, point in enumerate(self.points) if point.stability in DECIDED]
        return self.undecided + tuple(
            f"unknown: {before.stability} at {self.parameter} {before.value:.12g} and {after.stability} at "
            f"{after.value:.12g}, with no certified event between; take shorter steps or another --method"
            for (i, before), (j, after) in pairwise(known)
            if (before.stability == "unstable") != (after.stability == "unstable")
            and not any(i <= event.index < j and event.kind not in UNCHANGING for event in self.events)
        )

    def values(self, name: str) -> np.ndarray:
        """One number of every point as an array, in order along the family: of a parameter, a watched number, of its
        orbit (period, energy, closure, ...) or an extent of its table (amplitude_C, min_C, max_C, largest_multiplier).
        Raises `InputError` for others."""
        try:
            return np.asarray([self.value(point, name) for point in self.points])
        except InputError:
            if re.match("(amplitude|min|max|largest)_", name) and name in (columns := self.tables()["points"]):
                return np.asarray(columns[name])
            raise

    def value(self, member: FamilyPoint | Event, name: str) -> Any:
        """The same of a point or an event."""
        if name in (*self.parameters, *member.free):
            return number_of(member, name)
        if name not in member.watch and not hasattr(member, name):
            own = [each.name for each in fields(member) if isinstance(getattr(member, each.name), (int, float, str))]
            known = [*self.parameters, *member.free, *member.watch, *own]
            raise InputError(f"name: unknown {name!r}{closest(name, known)}; give one of {', '.join(known)}")
        return value_of(member, name)

    def __len__(self) -> int:
        return len(self.points)

    def __iter__(self) -> Iterator[FamilyPoint]:
        return iter(self.points)

    def __getitem__(self, k: int | slice) -> Any:
        """The k-th point with times and samples over its period, or those of a slice, a list. Raises `InputError` where
        no file describes its system."""
        if isinstance(k, slice):
            return [self[number] for number in range(len(self))[k]]
        point: FamilyPoint = loaded("families.members:sampled_point")(self.points[k])
        return point

    @property
    def unit(self) -> str:
        """The unit of its parameter, where that is no physical parameter of the system."""
        return UNITS.get(self.parameter, "")

    @property
    def by_energy(self) -> bool:
        """Whether the energy is an axis to draw it over: it changes, or nothing but it and the period does."""
        energies = self.values("energy")
        alike = np.ptp(energies) <= 1e-6 * np.abs(energies).max()
        return bool(self.unit) or (bool(np.isfinite(energies).all()) and not alike)

    @property
    def parameters(self) -> tuple[str, ...]:
        """What varies along it: a parameter, or the two of a curve of bifurcations."""
        test = self.curve.get("test")
        return tuple(map(str, test["parameters"])) if isinstance(test, Mapping) else (self.parameter,)

    @property
    def members(self) -> tuple[FamilyPoint | Event, ...]:
        """Its points and then its events."""
        return (*self.points, *self.events)

    @cached_property
    def sides(self) -> tuple[tuple[str, str], ...]:
        """The verdicts before and after each event, in the order of the points, "" where nothing decides.

        They are those of the points about it, between which changes of stability alone change them; where these are not
        recorded, the events there.
        """
        return tuple(map(self.beside, self.events))

    def beside(self, event: Event) -> tuple[str, str]:
        """The same of an event."""
        ends = [self.points[min(max(k, 0), len(self) - 1)].stability for k in (event.index, event.index + 1)]
        mates = [each for each in self.events if each.index == event.index]
        turns = {each.arclength: each.detail for each in mates if each.detail in BECOMES}
        loses, unstable = [detail == BECOMES[1] for detail in turns.values()], [end == "unstable" for end in ends]
        if turns and len(turns) % 2 != sum(unstable) % 2:  # beside a fold the verdicts of points may not show it
            unstable = [not loses[0], loses[-1]]
            ends = ["unstable" if each else "stable" for each in unstable]
        marks = sorted(turns or ({each.arclength for each in mates} if ends[0] != ends[1] else ()))
        words = [("stable", "unstable")[unstable[0] != k % 2] if turns else "" for k in range(1, len(marks))]
        states = [*ends[:1], *words, *ends[1:]]
        return states[bisect_left(marks, event.arclength)], states[bisect_right(marks, event.arclength)]

    @property
    def places(self) -> np.ndarray:
        """The values (k x 1 or k x 2) of what varies at every point and then at every event."""
        rows = [[number_of(member, name) for name in self.parameters] for member in self.members]
        return np.array(rows, float).reshape(-1, len(self.parameters))

    @property
    def counts(self) -> str:
        """How many orbits are closed and how many of them certified, in words."""
        known = [point for point in self.points if point.scale <= UNKNOWN]
        sure = [sum(member.certified for member in some) for some in (known, self.events)]
        left = len(self.points) - len(known)
        return (
            f"{plural(len(known), 'closed orbit')}{f' (and {left} too unstable to say)' * bool(left)}, "
            f"{sure[0]} of them certified; "
            f"{plural(len(self.events), 'event')}, {sure[1]} of them at certified orbits"
        )

    def widget(self) -> Any:
        """The family on a stage, with a slider along it, play and the numbers of each orbit, for Jupyter, VS Code and
        marimo. Raises `InputError` without the extra [notebook]."""
        return display.stage(self)


def value_of(member: FamilyPoint | Event, name: str) -> Any:
    """A watched number, or any other entry, of a point or event."""
    return member.watch[name] if name in member.watch else getattr(member, name)


def number_of(member: FamilyPoint | Event, name: str) -> float:
    """A watched number or the value of a freed parameter, or else the energy or the period, of a point or event; of
    another its value."""
    if name in member.free:
        return float(member.free[name])
    if name in (*member.watch, "energy", "period"):
        return float(value_of(member, name))
    return member.value if isinstance(member, FamilyPoint) else member.parameter


@dataclass(frozen=True)
class Journal:
    """What a journal says: its header and the complete batches, in the order they were computed."""

    header: Table
    batches: tuple[Batch, ...]
    sealed: bool = True
    """False when it was written without digests"""

    @cached_property
    def origin(self) -> FamilyPoint:
        """The point that the family begins with."""
        point: FamilyPoint = restored(FamilyPoint, self.header["origin"])
        return point

    def steps(self, direction: int) -> list[tuple[FamilyPoint, Standing | None]]:
        """The steps already taken in a direction, and what the next one begins with."""
        batches = [batch for batch in self.batches if batch.direction == direction]
        return [(point, batch.standing) for batch in batches for point in batch.points if point.role == "step"]

    def end(self, direction: int) -> End | None:
        """The last reason for ending in a direction."""
        ends = [batch.end for batch in self.batches if batch.direction == direction and batch.end is not None]
        return ends[-1] if ends else None


def restored(kind: type[FamilyPoint] | type[Event], document: Table, where: str = "") -> Any:
    """A FamilyPoint or an Event out of what `plain` made of it; `ValueError` names the entry that is wrong."""
    entries = {entry.field: document[entry.name] for entry in layout(kind) if entry.name in document}  # type: ignore[arg-type]
    if kind is FamilyPoint:  # what only its family knows (see `situated`), and what is left out
        entries |= {"name": "", "system": {}, "winding": (), "nodes": [entries.get("state")], "times": np.zeros(0),
                    "samples": np.zeros(0), "tolerance": CLOSURE}  # fmt: skip
    member = typed(kind, entries, where)
    if isinstance(member, Event) and member.kind == "fold" and member.detail not in ("energy", *member.free):
        member = replace(member, kind="turn")  # as older files call it too
    return member


def situated(point: FamilyPoint, index: int, name: str, system: Table, curve: Table) -> Any:
    """A point with what its family knows: its number, its name, its system at the freed parameters, its turns."""
    return replace(
        point, index=index, name=f"{name}-{index}", system=system_at(system, point.free),
        winding=_turns(curve, point.state.size), samples=np.zeros((0, point.state.size)), curve=curve,
    )  # fmt: skip


def _turns(curve: Table, size: int) -> tuple[int, ...]:
    """Whole turns of each coordinate of a state (d) in a period: d of them in a first-order system, else half.

    Older files say them by the boundary's constants only.
    """
    n = size // 2
    if "winding" in curve:
        alone = isinstance(curve["winding"], list) and len(curve["winding"]) == size
        return tuple(typed(tuple[(int,) * (size if alone else n)], curve["winding"], "curve.winding"))  # type: ignore[misc]
    symmetry, constant = curve.get("symmetry"), np.asarray(curve.get("constant", ()), float)
    if constant.shape != (2 * n,) or symmetry not in ("none", "reversal"):
        return (0,) * n
    turned = constant[:n] / (2 * np.pi) if symmetry == "none" else (constant[n:] - constant[:n]) / np.pi
    return tuple(np.round(turned).astype(int).tolist())


def reverted(event: Event) -> Event:
    """An event in the order of the points, if it is in that in which a family was followed, and back: before its start
    they differ."""
    changes = event.arclength < 0 and event.detail in BECOMES
    return replace(event, detail=BECOMES[event.detail == BECOMES[0]]) if changes else event


@dataclass(frozen=True)
class _Header:
    """The first line of a journal."""

    name: str
    system: Table
    parameter: str
    origin: Table
    curve: Table
    source: Table = field(default_factory=dict)
    request: Table = field(default_factory=dict)
    away: int = 1


def append(folder: Path, batch: Batch) -> None:
    """A batch as a line, on the disk when this returns."""
    append_line(folder / JOURNAL, plain(batch))


def read_journal(folder: Path) -> Journal | None:
    """The journal of a folder, a damaged last line cut off the file; None when there is none to read.

    Raises `InputError` about any other line that is not as it was written.
    """
    path = folder / JOURNAL
    entries, sealed = read_lines(path, JOURNAL) or ([], True)
    if not entries:
        return None
    header, batches = entries[0], []
    anew = "delete the file to start again"
    check_format(header, FORMAT, VERSION, str(path), anew, anew)
    for number, entry in enumerate(entries, start=1):
        try:
            if number == 1:
                about = typed(_Header, header, "")
                situated(restored(FamilyPoint, about.origin, "origin"), 0, about.name, about.system, about.curve)
            else:
                batches.append(typed(Batch, entry, ""))
        except ValueError as error:
            raise InputError(f"{path}: line {number}: {error}; {anew}") from error
    return Journal(header, tuple(batches), sealed)


def assemble(journal: Journal) -> Family:
    """The family in order along the curve, points numbered from end to end."""
    points = [journal.origin, *(point for batch in journal.batches for point in batch.points)]
    points.sort(key=attrgetter("arclength"))
    header = journal.header
    about = header["name"], header["system"], header["curve"]
    numbered = tuple(situated(point, k, *about) for k, point in enumerate(points))
    places = np.array([point.arclength for point in numbered])
    listed = (reverted(event) for batch in journal.batches for event in batch.events)
    events = sorted(listed, key=attrgetter("arclength"))
    indexed = tuple(replace(event, index=int(np.searchsorted(places, event.arclength)) - 1) for event in events)
    ends = tuple(end for end in (journal.end(-1), journal.end(1)) if end is not None)
    undecided = tuple(sentence for batch in journal.batches for sentence in batch.undecided)
    more = header["curve"], header.get("source", {}), undecided
    return Family(header["name"], header["system"], header["parameter"], numbered, indexed, ends, *more)


def family_to_document(family: Family) -> Entries:
    """The contract of family.json; floats round-trip exactly."""
    points = []
    for point in family.points:
        entry = {key: value for key, value in plain(point).items() if key not in DENSE}
        also = {family.parameter: point.value} | dict(point.free)
        points.append(entry | {key: value for key, value in also.items() if key not in entry})
    events = [{k: v for k, v in plain(event).items() if k not in DENSE} for event in family.events]
    rest = entries_of(replace(family, points=(), events=()))
    return {"format": FORMAT, "version": VERSION, **rest, "points": points, "events": events}


def save_family(family: Family, folder: Path) -> Path:
    """Write family.json and family.npz whole or not at all; returns the JSON's path."""
    folder.mkdir(parents=True, exist_ok=True)
    dense = {}
    for kind, members in (("point", family.points), ("event", family.events)):
        for name, here in DENSE.items():
            pieces = [np.asarray(getattr(member, here), float).ravel() for member in members]
            dense[f"{kind}_{name}"] = np.concatenate(pieces) if pieces else np.zeros(0)
            dense[f"{kind}_{name}_sizes"] = np.array([piece.size for piece in pieces], int)
    write_npz(folder / "family.npz", dense)
    document = family_to_document(family) | {"dense": _dense_digest(dense)}
    document["record"] = content_digest(document)
    return write_json(folder / "family.json", document)


def _dense_digest(dense: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of the numbers of family.npz."""
    sha = hashlib.sha256()
    for name in _dense_names():
        sha.update(f"{name} {dense[name].size} ".encode() + np.ascontiguousarray(dense[name], "<f8").tobytes())
    return sha.hexdigest()


def _dense_names() -> list[str]:
    return [f"{kind}_{name}{part}" for kind in ("point", "event") for name in DENSE for part in ("", "_sizes")]


def load_family(path: str | Path) -> Family:
    """Read a family.json, and family.npz beside it.

    Args:
        path: of the family.json.

    Returns:
        A Family.

    Raises:
        InputError: on anything unreadable, edited or damaged.

    Examples:
        >>> _ = of.follow_family(orbit, until=-17.8, out=".", name="short")
        >>> of.load_family("short/family.json").name
        'short'
    """
    source = Path(path)
    content = json_file(source, "family.json", AGAIN)
    document = check_format(content, FORMAT, VERSION, str(source), "give a family.json", AGAIN)
    unsealed(document, str(source), AGAIN, "dense" in document)
    beside, dense = source.with_suffix(".npz"), dict[str, np.ndarray]()
    if beside.exists():  # without it an orbit is its state and period
        dense = arrays(beside, _dense_names(), AGAIN)
        if document.get("dense", "") not in ("", _dense_digest(dense)):
            raise InputError(f"{beside}: its digest is not that in family.json, edited or damaged; {AGAIN}")
    try:
        for kind in ("point", "event"):
            if f"{kind}s" in document:
                _put_back(dense, kind, document)
        family: Family = typed(Family, document, "")
    except ValueError as error:
        raise InputError(f"{source}: {error}; {AGAIN}") from error
    for k, end in enumerate(family.ends):
        if fault := unknown_end(end.kind, {event.kind for event in family.events}):
            raise InputError(f"{source}: ends[{k}].{fault}; {AGAIN}")
    about = family.name, family.system, family.curve
    try:
        # older files say of the changes of stability before the start how the family was followed there, away from it
        backwards = [
            event.arclength < 0 and event.detail in BECOMES and (after == "unstable") != (event.detail == BECOMES[1])
            for event, (_, after) in zip(family.events, family.sides, strict=True)
        ]
        events = tuple(map(reverted, family.events)) if any(backwards) else family.events
        points = tuple(situated(point, k, *about) for k, point in enumerate(family.points))
        return replace(family, events=events, points=points)
    except (TypeError, ValueError, IndexError, OverflowError) as error:
        raise InputError(f"{source}: curve or system: {error}; {AGAIN}") from error


def _put_back(dense: Mapping[str, np.ndarray], kind: str, document: Entries) -> None:
    """Give the points or events of a document the arrays of family.npz."""
    entries = document[f"{kind}s"] = list(typed(tuple[Entries, ...], document[f"{kind}s"], f"{kind}s"))
    split = {name: _pieces(dense, f"{kind}_{name}", len(entries)) for name in DENSE}
    for k, entry in enumerate(entries):
        size = len(entry["state"]) if isinstance(entry.get("state"), list) else 0
        if not size or split["nodes"][k].size % size:
            raise ValueError(f"{kind}s[{k}].state: missing, or its size does not divide the nodes")
        entry |= {name: pieces[k] for name, pieces in split.items()} | {"nodes": split["nodes"][k].reshape(-1, size)}


def _pieces(dense: Mapping[str, np.ndarray], name: str, count: int) -> list[np.ndarray]:
    """One array for each of `count` members; empty ones where there is no file."""
    if not dense:
        return [np.zeros(0)] * count
    flat, sizes = dense[name], dense[f"{name}_sizes"]
    counts = np.issubdtype(sizes.dtype, np.integer) and sizes.shape == (count,) and bool(np.all(sizes >= 0))
    if flat.ndim != 1 or not counts or sizes.sum() != flat.size:
        raise ValueError(f"family.npz: {name}: does not fit the {count} entries of family.json")
    return np.split(flat, np.cumsum(sizes)[:-1]) if count else []
