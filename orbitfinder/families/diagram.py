"""The whole bifurcation diagram along a parameter: equilibria, what leaves them, what leaves that, as one tree."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime import locks, tasks
from orbitfinder._runtime.cluster import home, scheduler_at
from orbitfinder._runtime.keeping import kept
from orbitfinder._runtime.limit import limited
from orbitfinder._runtime.notebook import brief
from orbitfinder._runtime.rooms import loaded
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import UNSOLVED, ConvergenceError, InputError, LimitError, closest, plural
from orbitfinder.families.branches import branches, rest_leaving, switch_branch
from orbitfinder.families.entries import kind_of
from orbitfinder.families.equilibria import RestBranch, follow_equilibria
from orbitfinder.families.equilibrium import EQUILIBRIA, Equilibria, RestEvent, load_equilibria, save_equilibria
from orbitfinder.families.folder import follow_family
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.rest_starts import find_equilibria
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.records.certificate import Certificate, Check, at_most, equal
from orbitfinder.records.codec import Codec
from orbitfinder.records.ends import stuck
from orbitfinder.records.family import JOURNAL, End, Event, Family, load_family, reached, save_family
from orbitfinder.records.journal import refuse_other
from orbitfinder.records.reading import write_atomically
from orbitfinder.records.registry import kinds
from orbitfinder.records.table import Tabled

Fork = tuple["DiagramCurve", int]
"""A curve and the number of its event"""
NORM, SAME, NEAR, STEP = "norm", 1e-6, 0.2, 0.25
"""What is drawn instead of a coordinate, the length of the state or its root mean square; shares of the range and of a
period in which parameters and periods of an event agree where no error bar says it, in which a curve begins near its
event; the longest step along cycles, so that what is drawn is smooth"""
BECAME, FILES, NAMES = (
    ("followed", "joined", "depth", "budget", "failed"),
    {"equilibria.json": load_equilibria, "family.json": load_family},
    {"hopf": "Hopf point", "torus": "torus bifurcation", "fold": "fold of cycles"},
)
"""What may become of an event at which something leaves; what reads a curve, by its file's name; what events are called
where it is not their kind, folds those of cycles"""


@dataclass(frozen=True)
class DiagramCurve:
    """A curve of a diagram: its file beside diagram.json, how often was switched to come there, of which curve and
    event it is born, and its record."""

    __repr__ = brief("file", "depth")
    _entries = ("file", "depth", "parent", "event")

    file: str
    depth: int
    parent: str = ""
    event: int = -1
    record: Any = None

    def _check(self) -> None:
        folder, _, name = self.file.partition("/")
        if name not in FILES or folder in ("", ".", ".."):
            raise ValueError(f"file: {self.file!r} is not NAME/{' or NAME/'.join(FILES)}")


@dataclass(frozen=True)
class Branching:
    """An event of a curve at which something leaves, what `became` of it (see `BECAME`) in words, and the files of the
    curves that are born there, or that come there from elsewhere."""

    __repr__ = brief("file", "event", "became", "words")

    file: str
    event: int
    became: str
    words: str
    leads: tuple[str, ...] = ()

    def _check(self) -> None:
        if self.became not in BECAME:
            raise ValueError(f"became: {self.became!r} is none of {', '.join(BECAME)}")


@dataclass(frozen=True)
class BifurcationDiagram(Tabled):
    """Equilibria along a parameter, what is born on them, what is born on that.

    Args:
        name: a word for files.
        system: plain description that rebuilds the model.
        parameter: what is followed in.
        between: its first and last value.
        depth: how often is switched at most.
        coordinate: what is drawn: a coordinate, or "norm".
        curves: each with its record, Equilibria or a Family.
        branchings: every event at which something leaves, and what became of it.
        title: what pictures are headed with; the name where it is empty.

    Examples:
        >>> tree.counts
        '1 curve of equilibria with 1 Hopf point, 1 of cycles; 1 followed'
        >>> tree.curves[1].record.ends[0].kind, tree.undone
        ('target', ())
    """

    __repr__ = brief("name", "parameter", "curves", "branchings")
    _sparse = ("title",)
    _tables = "families.table:diagram_tables"
    name: str
    system: Mapping[str, Any]
    parameter: str
    between: tuple[float, float]
    depth: int
    coordinate: str
    curves: tuple[DiagramCurve, ...]
    branchings: tuple[Branching, ...] = ()
    title: str = ""

    @property
    def undone(self) -> tuple[str, ...]:
        """What was left undone and why, a sentence each."""
        left = [f"{fork.file}, {fork.words}" for fork in self.branchings if fork.became not in ("followed", "joined")]
        ends = [(curve.file, end) for curve in self.curves for end in curve.record.ends]
        stops = [f"{file} stops: {end.reason}" for file, end in ends if end.facts.lengthened]
        return (*left, *stops, *self.unknown)

    @property
    def unknown(self) -> tuple[str, ...]:
        """Where the stability changes and no event says how, a sentence each."""
        return tuple(f"{curve.file}, {sentence}" for curve in self.curves for sentence in curve.record.unknown)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is worth a look, a sentence each: a bound that no equilibria reached, as their curves turned back."""
        rests = {curve.file: curve.record for curve in self.curves if isinstance(curve.record, Equilibria)}
        ends = {file: (rest.points[0].value, rest.points[-1].value) for file, rest in rests.items()}
        missed = [bound for bound in self.between if not any(bound in values for values in ends.values())]
        return tuple(
            f"{file} turned back at {self.parameter} {self._farthest(rests[file]):.9g} and left by {self.parameter} = "
            f"{values[0]:g}, where it begins: {self.parameter} = {missed[0]:g} was not reached; look for other curves "
            f"with --box, or begin at that bound with --from"
            for file, values in ends.items() if missed and values[0] == values[1] in self.between
        )  # fmt: skip

    def _farthest(self, rest: Equilibria) -> float:
        """The value of the parameter at which equilibria are farthest from where they begin."""
        values = [*(point.value for point in rest.points), *(event.parameter for event in rest.events)]
        return max(values, key=lambda value: abs(value - rest.points[0].value))

    @property
    def counts(self) -> str:
        """How many curves there are, with what, and what became of the events at which something leaves."""
        rest = [curve.record for curve in self.curves if isinstance(curve.record, Equilibria)]
        cycles = [curve.record for curve in self.curves if isinstance(curve.record, Family)]
        made = [fork.became for fork in self.branchings]
        became = ", ".join(f"{made.count(word)} {word}" for word in dict.fromkeys(made)) or "nothing leaves them"
        return (
            f"{plural(len(rest), 'curve')} of equilibria{_with(rest)}, {len(cycles)} of cycles{_with(cycles)}; {became}"
        )


def told(record: Equilibria | Family) -> list[int]:
    """The numbers of the events that are worth telling: all of equilibria, of cycles those at which stability may
    change."""
    if isinstance(record, Equilibria):
        return list(range(len(record.events)))
    return [k for k, event in enumerate(record.events) if kind_of(event.kind).critical]


def happened(diagram: BifurcationDiagram, curve: DiagramCurve) -> Iterator[str]:
    """What happens along a curve, a line each: its events with their error bars and what became of them, why cycles
    end, how they were followed where that was not by shooting alone."""
    forks = {fork.event: fork for fork in diagram.branchings if fork.file == curve.file}
    for k in told(curve.record):
        event, fork = curve.record.events[k], forks.get(k)
        words, colon, why = (fork.words if fork else _told(curve, k)).partition(": ")
        known = [_bar(getattr(event, "error", None))]
        if np.isfinite(lyapunov := getattr(event, "lyapunov", np.nan)):
            known.append(f", l1 = {lyapunov:.6g}{_bar(event.lyapunov_error)}")
        leads = f"; {fork.became} {', '.join(fork.leads)}".rstrip() if fork else ""
        yield f"{words}{''.join(known)}{colon}{why}{leads}"
    if isinstance(curve.record, Family):
        if reason := curve.record.curve.get("method_reason"):
            yield f"by collocation: {reason}"
        for end in curve.record.ends:
            where = "" if end.parameter is None else f" at {diagram.parameter} {end.parameter:.9g}{_bar(end.error)}"
            yield f"ends: {end.kind}{where}" if where else f"ends: {end.kind}, {end.reason}"


def facts(diagram: BifurcationDiagram) -> dict[str, Any]:
    """What is shown of a diagram: its curves, what happens along each, what was left undone."""
    names = ("counts", "name", "system", "parameter", "between", "depth", "coordinate", "remarks", "undone")
    curves = [
        {"file": curve.file, "depth": curve.depth, "points": len(curve.record.points)} for curve in diagram.curves
    ]
    lines = [{"file": curve.file, "what": line} for curve in diagram.curves for line in happened(diagram, curve)]
    return {name: getattr(diagram, name) for name in names} | {"curves": curves, "happened": lines}


def _bar(error: float | None) -> str:
    """An error bar in words, nothing of one that is not known."""
    return f" (+- {error:.1g})" if error is not None and np.isfinite(error) else ""


def _with(records: Sequence[Equilibria | Family]) -> str:
    """The events of some curves counted by kind."""
    kinds = [record.events[k].kind for record in records for k in told(record)]
    kinds = [NAMES.get(kind, kind.replace("_", " ")).removesuffix(" of cycles") for kind in kinds]
    counted = [plural(kinds.count(kind), kind) for kind in dict.fromkeys(kinds)]
    return f" with {', '.join(counted)}" if counted else ""


CODEC = Codec(BifurcationDiagram, "diagram", "`orbitfinder diagram`", "make the diagram again")


def save_diagram(diagram: BifurcationDiagram, path: str | Path) -> Path:
    """Write a diagram.json, and beside it those of its curves that are not there yet.

    Args:
        diagram: a BifurcationDiagram.
        path: where.

    Returns:
        The path.

    Raises:
        InputError: where it cannot be written.

    Examples:
        >>> of.save_diagram(tree, "diagram.json").name
        'diagram.json'
    """
    for curve in diagram.curves:
        if not (file := Path(path).parent / curve.file).exists():
            _write(curve, file)
    return CODEC.save(diagram, path)


def _write(curve: DiagramCurve, file: Path) -> None:
    rest = isinstance(curve.record, Equilibria)
    save_equilibria(curve.record, file) if rest else save_family(curve.record, file.parent)


def load_diagram(path: str | Path) -> BifurcationDiagram:
    """Read a diagram.json and the curves beside it.

    Args:
        path: of the diagram.json.

    Returns:
        A BifurcationDiagram.

    Raises:
        InputError: on anything unreadable, and where a curve's file is missing.

    Examples:
        >>> _ = of.save_diagram(tree, "diagram.json")
        >>> [curve.file for curve in of.load_diagram("diagram.json").curves]
        ['equilibria/equilibria.json', 'equilibria-0/family.json']
    """
    bare, home = CODEC.load(path), Path(path).parent
    if bare.between[0] == bare.between[1]:
        raise InputError(
            f"{path}: between: begins and ends at {bare.parameter} {bare.between[0]:g}; make the diagram again"
        )
    read = [replace(curve, record=FILES[Path(curve.file).name](home / curve.file)) for curve in bare.curves]
    return replace(bare, curves=tuple(read))


def leaving(record: Equilibria | Family) -> list[int]:
    """The numbers of the events at which a diagram goes on: where cycles or other equilibria are born, or cycles of the
    same or twice the period."""
    if isinstance(record, Equilibria):
        return list(rest_leaving(record))
    kinds = [kind_of(event.kind) for event in record.events]
    return [k for k, kind in enumerate(kinds) if kind.branches and kind.critical]


@one_thread()
def diagram(
    model: Model, state: Sequence[float] | np.ndarray | None, parameter: str, until: float, *, depth: int = 2,
    points: int = 400, coordinate: str | None = None, box: Mapping[str, Sequence[float]] | None = None,
    method: str | None = None, limit: float | None = None, name: str = "diagram", out: str | Path | None = None,
    progress: Callable[[DiagramCurve], None] | None = None, workers: int = 1, scheduler: str | None = None,
    folder: str | Path | None = None, title: str = "",
) -> BifurcationDiagram:  # fmt: skip
    """The whole bifurcation diagram between two values of a parameter: equilibria, and breadth first what is born at
    their branch points and Hopf points, at doublings and branch points of those cycles, and so on.

    Nothing is followed twice: of a family that ends at a Hopf point, or at a doubling of the family that it comes from,
    it is said that it joins there.

    Args:
        model: the system, at the parameter's first value.
        state: near an equilibrium there, or where a simulation to rest begins; with a box it may be None.
        parameter: a physical parameter.
        until: its last value; every curve ends at either.
        depth: 0: the equilibria; 1: what leaves them; 2: what leaves that; ...
        points: the most of each curve, each way.
        coordinate: what is drawn, the first unless said; "norm" for the length of the state.
        box: from where to where of each component equilibria are looked for at both values (see `of.find_equilibria`);
            those that are on no curve yet begin others.
        method: of cycles, shooting | collocation; None: shooting, and collocation where that cannot carry a curve on.
        limit: s after which nothing more is followed, which `undone` says.
        name: a word for files.
        out: a folder: everything goes to OUT/<name>/, and what is finished there is not followed again.
        progress: called with each curve.
        workers: processes that follow cycles of one depth side by side; what is made is the same.
        scheduler: address of a Dask cluster that does it instead.
        folder: of a trusted module that makes the system.
        title: what its picture is headed with.

    Returns:
        A BifurcationDiagram.

    Raises:
        InputError: for a system that cannot rest, a parameter or a coordinate that it has not.
        ConvergenceError: where no equilibrium is found near the state.

    Examples:
        >>> tree = of.diagram(of.systems.brusselator(rate=1.8), [1.0, 1.8], "rate", 2.4)
        >>> [(fork.became, fork.leads) for fork in tree.branchings]
        [('followed', ('equilibria-0/family.json',))]
    """
    coordinate = model.state_names[0] if coordinate is None else coordinate
    drawn(coordinate, model)
    if depth < 0:
        raise InputError(f"depth: must be at least 0, got {depth}")
    first = model.named_parameters.get(parameter, until)
    empty = BifurcationDiagram(name, model.system, parameter, (first, until), depth, coordinate, (), title=title)
    if out is not None and (earlier := Path(out) / name / "diagram.json").exists():
        there = CODEC.load(earlier)
        if there.depth > depth:  # less of it than is there
            refuse_other(earlier, {"depth": there.depth}, {"depth": depth})
        begins, ends = there.between
        if begins == first and (until - first) / (ends - first) < 1.0:
            refuse_other(earlier, {"until": ends}, {"until": until})
    settings = FamilySettings(parameter=parameter, directions="away", points=points, longest_step=STEP, method=method)
    tree = _Tree(empty, model, settings, None if out is None else Path(out) / name, progress or (lambda curve: None))
    with (locks.alone_in(tree.folder), limited(limit), scheduler_at(scheduler, "diagram", folder) as far,
          tasks.crew(journals, workers, "diagram", far) as answers):  # fmt: skip
        if workers > 1 or far is not None:
            build_model(model.system, None if folder is None else Path(folder))  # or nobody else can
            tree.answers = answers
            tree.trusted = far.luggage.folder if far else None if folder is None else str(folder)
        try:
            for count, (follow, value) in enumerate(_beginnings(tree, state, box), 1):
                file = "equilibria" if count == 1 else f"box-{count}"
                tree.add(DiagramCurve(f"{file}/equilibria.json", 0, record=tree.rest(follow, file, value)))
                tree.grow()
        except LimitError as error:
            if not tree.curves:
                raise
            tree.stopped = str(error)
    return tree.made()


def drawn(coordinate: str, model: Model) -> int:
    """The number of the coordinate that a diagram shows, behind all that of the norm. Raises `InputError`."""
    names = (*model.coordinates, NORM)
    if coordinate not in names:
        raise InputError(f"coordinate: unknown {coordinate!r}{closest(coordinate, names)}; this system has "
                         f"{', '.join(names[:20])}")  # fmt: skip
    return names.index(coordinate)


def _beginnings(
    tree: _Tree, state: Sequence[float] | np.ndarray | None, box: Mapping[str, Sequence[float]] | None
) -> Iterator[tuple[Callable[..., Equilibria], float]]:
    """What follows each curve that is not born on another, and from where: through the state, and through equilibria of
    a box at both bounds that are on no curve so far. Raises `ConvergenceError` where there is none."""
    model, name, bounds = tree.model, tree.empty.parameter, tree.empty.between
    assert model is not None
    if state is not None:
        yield partial(follow_equilibria, model, state, name), bounds[0]
    for bound in bounds if box else ():
        there = with_parameters(model, {name: bound})
        met = find_equilibria(there, box or {}, name)
        size = nonzero(np.abs([rest.state for rest in met]).max(axis=0)) if met else 1.0
        for rest in met:
            if not any((np.abs(other - rest.state) <= SAME * size).all() for other in tree.resting(bound)):
                yield partial(follow_equilibria, there, rest.state, name), bound
    if not tree.curves:
        raise ConvergenceError("no equilibrium was met in the box; give a larger one")


def journals(
    empty: BifurcationDiagram, settings: FamilySettings, trusted: str | None, curve: DiagramCurve, k: int
) -> dict[str, bytes]:  # fmt: skip
    """The journals of the families that leave a curve at an event, by name, as far as they can be followed."""
    with tempfile.TemporaryDirectory() as out:
        tree = _Tree(empty, build_model(empty.system, home(trusted)), settings, Path(out))
        with contextlib.suppress(*UNSOLVED):  # which is met again where it is told
            for file, follow in tree.beside(curve, k):
                if file.endswith("family.json"):
                    follow()
        return {path.parent.name: path.read_bytes() for path in Path(out).glob(f"*/{JOURNAL}")}


class _Tree:
    """A diagram in the making: its curves, and what became of their events so far."""

    def __init__(
        self, empty: BifurcationDiagram, model: Model | None = None, settings: FamilySettings | None = None,
        folder: Path | None = None,
        report: Callable[[DiagramCurve], None] = lambda curve: None,
    ) -> None:  # fmt: skip
        self.empty, self.model, self.folder, self.report = empty, model, folder, report
        self.settings = settings or FamilySettings()
        self.curves, self.branchings, self.stopped = list(empty.curves), list[Branching](), "not reached yet"
        self.answers: tasks.Answers | None = None
        self.trusted: str | None = None
        self.followed = dict[str, bytes]()

    def made(self) -> BifurcationDiagram:
        """What there is, written where there is a folder; events that were not come to are said to be undone."""
        known = {(fork.file, fork.event) for fork in self.branchings}
        rest = [
            self.over(curve, k, "budget", f"{_told(curve, k)}: {self.stopped}")
            for curve in self.curves for k in leaving(curve.record) if (curve.file, k) not in known
        ]  # fmt: skip
        made = replace(self.empty, curves=tuple(self.curves), branchings=(*self.branchings, *rest))
        if self.folder is not None:
            save_diagram(made, self.folder / "diagram.json")
        return made

    def add(self, curve: DiagramCurve) -> None:
        """Another curve, finished."""
        if self.folder is not None:
            _write(curve, self.folder / curve.file)
        self.curves.append(curve)
        self.made()
        self.report(curve)

    def resting(self, bound: float) -> list[np.ndarray]:
        """The equilibria of all curves at a bound."""
        rests = [curve.record for curve in self.curves if isinstance(curve.record, Equilibria)]
        return [point.state for rest in rests for point in rest.points if point.value == bound]

    def grow(self) -> None:
        """What leaves the last curve, breadth first."""
        level = self.curves[-1:]
        while level:
            count = len(self.curves)
            for fork in self.ready([(curve, k) for curve in level for k in leaving(curve.record)]):
                self.branchings.append(self.left(*fork))
            level = self.curves[count:]

    def ready(self, forks: list[Fork]) -> Iterator[Fork]:
        """The same events in their order, each when what leaves there has been followed elsewhere, if anybody does."""
        sent = [k for k, (curve, event) in enumerate(forks) if self.answers and self.apart(curve, event)]
        waiting = set(sent if len(sent) > 1 else ())
        answers: Iterator[tuple[int, Any]] = iter(())
        if waiting and self.answers:
            bare = replace(self.empty, curves=()), self.settings, self.trusted
            answers = self.answers([(*bare, *forks[k]) for k in sent])
        for k, fork in enumerate(forks):
            while k in waiting:
                number, made = next(answers)
                self.followed |= made
                waiting.remove(sent[number])
            yield fork

    def apart(self, curve: DiagramCurve, k: int) -> bool:
        """Whether cycles are to be followed from an event that nobody has begun with."""
        event = curve.record.events[k]
        if np.isnan(event.period) or curve.depth >= self.empty.depth or self.known(curve, event):
            return False
        return self.folder is None or not any(self.folder.glob(f"{curve.record.name}-{k}*/{JOURNAL}"))

    def left(self, curve: DiagramCurve, k: int) -> Branching:
        """What becomes of an event: it is known from elsewhere, too deep, followed, or that fails."""
        if known := self.known(curve, curve.record.events[k]):
            return Branching(curve.file, k, "joined", _told(curve, k), (known.file,))
        if curve.depth >= self.empty.depth:
            return Branching(curve.file, k, "depth", f"{_told(curve, k)}: deeper than {self.empty.depth}")
        became, words = "followed", _told(curve, k)
        try:
            for file, follow in self.beside(curve, k):
                self.add(DiagramCurve(file, curve.depth + 1, curve.file, k, record := follow()))
                if why := stuck(record):
                    became, words = "failed", f"{words}: {why}"
        except UNSOLVED as error:
            became, words = "failed", f"{words}: {error}"
        return self.over(curve, k, became, words)

    def over(self, curve: DiagramCurve, k: int, became: str, words: str) -> Branching:
        """What became of an event, with the curves that are born there so far."""
        born = [child.file for child in self.curves if (child.parent, child.event) == (curve.file, k)]
        return Branching(curve.file, k, became, words, tuple(born))

    def beside(self, curve: DiagramCurve, k: int) -> Iterator[tuple[str, Callable[[], Equilibria | Family]]]:
        """The files of what leaves at an event, and what follows each."""
        settings = self.settings
        begin = branches if isinstance(curve.record, Family) else switch_branch
        starts = begin(curve.record, k, settings=settings, model=self.model)
        for start in starts if isinstance(starts, list) else [starts]:
            if isinstance(start, RestBranch):
                yield f"{start.name}/equilibria.json", partial(self.rest, partial(follow_equilibria, start), start.name)
                continue
            follow = partial(follow_family, start, settings=settings, name=start.name, model=self.model)
            yield (
                f"{start.name}/family.json",
                partial(self.cycles, partial(follow, between=self.empty.between), start.name),
            )

    def cycles(self, follow: Callable[..., Family], name: str) -> Family:
        """Cycles, read from the journal that was made elsewhere where there is one."""
        if (journal := self.followed.pop(name, None)) is None:
            return follow(out=self.folder)
        with contextlib.nullcontext(self.folder) if self.folder else tempfile.TemporaryDirectory() as out:
            file = Path(out) / name / JOURNAL
            file.parent.mkdir(exist_ok=True)
            write_atomically(file, journal)
            return follow(out=out)

    def rest(self, follow: Callable[..., Equilibria], name: str, value: float = np.nan) -> Equilibria:
        """Equilibria between the bounds, that begin at a value."""
        first, until = self.empty.between if value != self.empty.between[1] else self.empty.between[::-1]
        file = None if self.folder is None else self.folder / name / "equilibria.json"
        with contextlib.nullcontext() if file is None else kept(file, save_equilibria):
            record = follow(until=until, at=[first], points=self.settings.points, name=name, out=self.folder)
        record = within(record, self.empty.between)
        before = (
            load_equilibria(file) if file and file.exists() else record
        )  # in which events have the same last digits
        states = [[(point.value, *point.state) for point in each.points] for each in (record, before)]
        same = states[0] == states[1] and len(record.events) == len(before.events)
        alike = same and all(map(_alike, record.events, before.events))
        return replace(record, events=before.events) if alike else record

    def known(self, curve: DiagramCurve, event: RestEvent | Event) -> DiagramCurve | None:
        """The curve that ends at an event, or that it is an event of as well."""
        rests = [other for other in self.curves if isinstance(other.record, Equilibria)]
        every = [event] if isinstance(event, Event) else [each for rest in rests for each in rest.record.events]
        for other in (other for other in self.curves if isinstance(other.record, Family)):
            for end in other.record.ends:
                met = [each for each in every if self.meets(end, each)]
                if (other.parent == curve.file or not isinstance(event, Event)) and event in _nearest(
                    met, other.record
                ):
                    return other
        if isinstance(event, Event):
            return None
        return next(
            (rest for rest in rests if rest is not curve and any(_alike(each, event) for each in rest.record.events)),
            None,
        )

    def meets(self, end: End, event: RestEvent | Event) -> bool:
        """Whether a family ends at an event: parameters within error bars, or round-off, and periods agree."""
        if end.parameter is None or end.period is None:
            return False
        low, high = sorted(self.empty.between)
        near = SAME * (high - low) if event.error is None else 10 * ((end.error or 0.0) + event.error)
        turns = {1, getattr(event, "order", 1)}
        off = min(abs(end.period / (event.period * count) - 1) for count in turns)
        return abs(end.parameter - event.parameter) <= near and off <= 1e3 * SAME


def _told(curve: DiagramCurve, k: int) -> str:
    event = curve.record.events[k]
    named = f"{event.criticality} {NAMES.get(event.kind, '')}".strip() if isinstance(event, Event) else ""
    words = named if named.endswith("of cycles") else event.words
    return f"event {k}, {words} at {curve.record.parameter} {event.parameter:.9g}"


def _alike(event: RestEvent, other: RestEvent) -> bool:
    """Whether two events of equilibria are the same."""
    near = event.words == other.words and abs(event.parameter - other.parameter) <= 10 * (event.error + other.error)
    return near and bool(np.abs(event.state - other.state).max() <= SAME * nonzero(np.abs(event.state).max()))


def _nearest(events: Sequence[Any], family: Family) -> list[Any]:
    """The event about which the last orbit of a family goes, of those that share parameter and period."""
    last = max(family.points, key=lambda point: abs(point.arclength))
    middle = np.vstack([last.state, *last.shooting_nodes]).mean(axis=0)
    size = nonzero(np.abs(np.vstack([middle, *(event.state for event in events)])).max(axis=0))
    return sorted(events, key=lambda event: float(np.abs((event.state - middle) / size).max()))[:1]


def within(rest: Equilibria, between: tuple[float, float]) -> Equilibria:
    """The part of equilibria about their first that is between two values of the parameter."""
    low, high = sorted(between)
    beyond = [k for k, point in enumerate(rest.points) if not low <= point.value <= high]
    start = int(np.argmin([abs(point.arclength) for point in rest.points]))
    first = max((k + 1 for k in beyond if k < start), default=0)
    last = min((k for k in beyond if k > start), default=len(rest.points))
    points, ends = rest.points[first:last], list(rest.ends)
    for k, cut in ((0, first > 0), (-1, last < len(rest.points))):
        ends[k] = End("target", reached(rest.parameter, points[k].value)) if cut else ends[k]
    events = tuple(replace(event, index=event.index - first) for event in rest.events
                   if points[0].arclength <= event.arclength <= points[-1].arclength)  # fmt: skip
    return replace(rest, points=points, events=events, ends=tuple(ends))


def verified(diagram: BifurcationDiagram, model: Model) -> Certificate:
    """Every curve by its own checks; that each is between the bounds and begins where it is said to be born, that what
    is said to be joined is, and that no event is left out."""
    tree, (low, high) = _Tree(diagram), sorted(diagram.between)
    values = np.array([point.value for curve in diagram.curves for point in curve.record.points])
    wanted = sorted((curve.file, k) for curve in diagram.curves for k in leaving(curve.record))
    listed = sorted((fork.file, fork.event) for fork in diagram.branchings)
    astray = [fork.words for fork in diagram.branchings if not _true(tree, fork)]
    children = [file for fork in diagram.branchings if fork.became != "joined" for file in fork.leads]
    lost = sorted(curve.file for curve in diagram.curves if curve.parent) != sorted(children)
    return Certificate((
        *(check for curve in diagram.curves for check in _checks(curve, model)),
        at_most("range", max(low - values.min(), values.max() - high, 0.0) / (high - low), 1e-9, "beyond the bounds"),
        equal("branchings", float(len(astray) + lost), 0.0, f"that are not so: {'; '.join(astray) or 'none'}"),
        equal("events", float(listed != wanted), 0.0, "at which something leaves, each listed once"),
    ))  # fmt: skip


def _checks(curve: DiagramCurve, model: Model) -> Iterator[Check]:
    """The checks of a curve, each with where it is made."""
    made = loaded(kinds()[EQUILIBRIA if isinstance(curve.record, Equilibria) else "family"].verify)(curve.record, model)
    placed = [("", check) for check in made.checks] if isinstance(made, Certificate) else made
    for where, check in placed:
        yield replace(check, note=f"{curve.file} {where}: {check.note}".replace(" :", ":"))


def _true(tree: _Tree, fork: Branching) -> bool:
    """Whether what is said of an event is so."""
    curves = {curve.file: curve for curve in tree.curves}
    if fork.file not in curves or fork.event not in leaving(curves[fork.file].record) or not {*fork.leads} <= {*curves}:
        return False
    own, leads = curves[fork.file], [curves[file] for file in fork.leads]
    event = own.record.events[fork.event]
    if fork.became == "joined":
        return tree.known(own, event) in leads
    deep, wanted = own.depth >= tree.empty.depth, fork.became == "followed"
    return (
        (fork.became == "depth") <= deep
        and bool(leads) >= wanted
        and all(_born(lead, own, fork.event, tree) for lead in leads)
    )


def _born(curve: DiagramCurve, own: DiagramCurve, number: int, tree: _Tree) -> bool:
    """Whether a curve begins at an event of another."""
    event, (low, high) = own.record.events[number], sorted(tree.empty.between)
    first = min(curve.record.points, key=lambda point: abs(point.arclength))
    period = getattr(event, "order", 1) * event.period
    near = np.isnan(period) or abs(getattr(first, "period", np.nan) / period - 1) <= NEAR
    said = (curve.parent, curve.event, curve.depth) == (own.file, number, own.depth + 1)
    return bool(said and near and abs(first.value - event.parameter) <= NEAR * (high - low))
