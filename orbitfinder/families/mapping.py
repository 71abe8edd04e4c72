"""`map_plane(problem, p=values, q=values)`: an orbit of a family at every place in a plane of two parameters."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime import cluster, tasks
from orbitfinder._runtime import limit as limited
from orbitfinder._runtime.cluster import scheduler_at
from orbitfinder._runtime.keeping import finished
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import UNSOLVED, ConvergenceError, InputError, LimitError, shortened
from orbitfinder.families.curves import both_parameters
from orbitfinder.families.pixels import BEHIND, ParameterPlane, PixelBlock, described, flooded, plane_of
from orbitfinder.families.plane import BLANK, COLOURED, STOPPED, UNTRIED, ParameterMap
from orbitfinder.families.point import FamilySettings, extents, make_point, parameter_value
from orbitfinder.families.start import begin, entry_of, released, unknown_parameters
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.loops.continued import NO_ROWS, Solution, at_place
from orbitfinder.loops.loop import Equations, Unknowns
from orbitfinder.loops.problem import Problem
from orbitfinder.loops.symmetry import momenta_of
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.certify import certify
from orbitfinder.orbits.floquet import STABILITIES
from orbitfinder.records.certificate import Certificate, at_most, equal
from orbitfinder.records.codec import plain
from orbitfinder.records.family import CLOSURE
from orbitfinder.records.journal import AGAIN, Checkpoints, checkpoints, packed, read_lines, unpacked
from orbitfinder.records.reading import Table, content_digest, read_as, typed

LIMIT, STRIP, TOGETHER, SAME, SEED = 3600.0, 16, 256, 1e-6, (-1, 0)
"""Seconds after which a map stops unless told otherwise; rows that are a task; orbits that are verified beside
each other; relative difference of numbers that were computed again; what fills the first pixel, as round and task"""
Axes = tuple[np.ndarray, np.ndarray]
"""Values across and up"""
Progress = Callable[[int, int], None]
"""Told how many pixels are done by now, and how many there are"""


@one_thread()
def map_plane(
    problem: Problem, values: Mapping[str, Sequence[float]] | None = None, *, by: str = "stability", sample: int = 40,
    seed: int = 0, workers: int = 1, scheduler: str | None = None, limit: float | None = LIMIT,
    folder: str | Path | None = None, progress: Progress | None = None, out: str | Path | None = None,
    shards: Sequence[str | Path] = (), **named: Sequence[float],
) -> ParameterMap:  # fmt: skip
    """An orbit at each place in a plane of two parameters, with its stability, period and amplitudes.

    The problem's own orbit is solved for once; every pixel's is continued from its neighbour's. A pixel without
    an orbit is blank, with its reason. What was computed is not changed by how many processes share it.

    Args:
        problem: solved first at its own values.
        values: as the keywords, as a mapping.
        by: what a picture is coloured by: stability, multiplier, amplitude, period.
        sample: how many orbits, drawn by `seed`, are certified by independent means.
        seed: of the sample.
        workers: processes that share the rows.
        scheduler: address of a Dask cluster that does them instead.
        limit: s after which what is missing stays blank.
        folder: of a trusted module that makes the system.
        progress: called with how many pixels are done.
        out: a folder: OUT/<name>/map.jsonl keeps what is done, and what was stopped goes on from there.
        shards: such journals of the same map on some of its rows, from which everything is taken that they have; what
            they have not is computed.
        **named: values of two physical parameters, the first across; energy may be among them where the system
            conserves it.

    Returns:
        A ParameterMap.

    Raises:
        InputError: for unknown names, values that make no plane, and shards of another map or version.
        ConvergenceError: when there is no orbit at the problem's own values, or none leads to the plane.

    Examples:
        >>> driven = of.systems.forced_pendulum(torque=0.9, damping=0.5)
        >>> swing = of.Problem(driven, of.Guess([0.1, 0.0], 3.14159), name="swing")
        >>> plane = of.map_plane(swing, damping=[0.4, 0.5, 0.6], torque=[0.8, 0.9], sample=2)
        >>> plane.counts
        '6 of 6 pixels have an orbit, 6 asymptotically stable; certified 2 of 2 sampled (33 %)'

    See Also:
        `of.follow_curve` solves for the boundaries themselves.
    """
    names, axes = _axes(problem.model, {**(values or {}), **named})
    if by not in COLOURED:
        raise InputError(f"by: {by!r} is none of {', '.join(COLOURED)}; choose among these")
    path = None if out is None else Path(out) / problem.name / "map.jsonl"
    asked = plain({"map": dict(zip(names, axes, strict=True)), "system": dict(problem.model.system),
                   "guess": problem.guess, "symmetry": problem.symmetry, "method": problem.method})  # fmt: skip
    parts = [_part(Path(file), asked) for file in shards]
    for file, _, lines in parts:
        if _read(lines[0])[:3] != _read(parts[0][2][0])[:3]:
            raise InputError(f"{file}: curve: made of another orbit than {parts[0][0]}; delete its folder, or both")
    if parts:
        asked["shards"] = [content_digest({"lines": lines}) for _, _, lines in parts]
    with checkpoints(path, asked, _read) as journal, scheduler_at(scheduler, "map", folder) as far:
        journal.known.extend(_read(lines[0]) for _, _, lines in parts[:1])
        trusted = far.luggage.folder if far else None if folder is None else str(folder)
        text, vector = _begun(problem, (names, axes), journal, trusted)
        study = _Filling(problem, (by, seed), text, journal)
        for _, first, lines in parts:
            for line in lines[1:]:
                study.fill(_read(line)[2], first)
        apart = workers > 1 or far is not None
        try:
            with limited.limited(limit), tasks.crew(flooded, workers, "map", far) as answers:
                if apart:
                    build_model(problem.model.system, None if folder is None else Path(folder))  # or nobody else can
                for done, pixels in study.rounds(vector, answers, text if apart else study.plane):
                    finished(lambda: study.record(0))
                    limited.note(f"{done} of {pixels} pixels are done")
                    if progress:
                        progress(done, pixels)
        except LimitError:
            study.block.blank[study.block.blank == UNTRIED] = STOPPED
    return study.record(sample)


def _axes(model: Model, given: Mapping[str, Sequence[float]]) -> tuple[tuple[str, str], Axes]:
    """The two parameters and their values, increasing. Raises `InputError`."""
    names, axes = both_parameters(model, tuple(given)), []
    for name in names:
        try:
            axis = np.unique(np.array([float(number) for number in given[name]]))
        except (TypeError, ValueError) as error:
            raise InputError(f"{name}: must be a list of numbers, got {shortened(given[name])}") from error
        if axis.size < 2 or not np.isfinite(axis).all():
            raise InputError(f"{name}: must be two different finite numbers at least, got {shortened(given[name])}")
        model.check_clock(name, axis)
        axes.append(axis)
    return names, (axes[0], axes[1])


Origin = tuple[dict[str, Any], int, str, str]
"""The entry of a curve, segments, and as text the mesh and the unknowns of its first orbit"""
Filled = tuple[int, int, str]
"""The number of a round, that of a task in it, and as text what it has filled"""


def _read(line: Table) -> Origin | Filled:
    """What a line of the journal stands for. Raises `ValueError`."""
    fields = {"curve": dict, "segments": int, "mesh": str, "vector": str} if "curve" in line else \
             {"round": int, "task": int, "pixels": str}  # fmt: skip
    made = tuple(typed(kind, line.get(name), name) for name, kind in fields.items())
    sizes = [len(unpacked(text, 1 if "curve" in line else None)) for text in made[2:]]
    if "curve" in line and not 0 < made[1] <= min(sizes):
        raise ValueError(f"segments: {made[1]} for {sizes[0]} instants and {sizes[1]} unknowns")
    return made  # type: ignore[return-value]


def _part(file: Path, asked: Table) -> tuple[Path, int, list[Any]]:
    """The journal of some rows of a map: the number of the first, and its lines. Raises `InputError`."""
    (header, *lines), _ = read_lines(file, file.name) or ([{}], True)
    known, (across, up) = partial(read_as, where=f"{file}: request", remedy=AGAIN), asked["map"]
    theirs = known(dict, header.get("request", {}))
    rows, own = asked["map"][up], known(tuple[Any, ...], known(dict, theirs.get("map", {})).get(up, []))
    first = rows.index(own[0]) if own and own[0] in rows else 0
    wanted = {**asked, "map": {across: asked["map"][across], up: rows[first : first + len(own)]}}
    for number, line in enumerate(lines, start=2):
        try:
            _read(line)
        except ValueError as error:
            raise InputError(f"{file}: line {number}: {error}; {AGAIN}") from error
    for what, value in wanted.items():
        if theirs.get(what) != value:
            raise InputError(f"{file}: {what}: of another map than this; give its own, or another folder")
    if not lines:
        raise InputError(f"{file}: nothing is done there yet; run that shard, or delete its folder")
    here, there = cluster.packed(None).versions, known(dict, lines[0].get("versions", {}))
    if other := [f"{name} {there.get(name)}, here {here[name]}" for name in here if there.get(name) != here[name]]:
        raise InputError(f"{file}: versions: made with {', '.join(other)}, and its numbers would be others; run that "
                         "shard again with what is here")  # fmt: skip
    return file, first, lines


def _begun(
    problem: Problem, plane: tuple[tuple[str, str], Axes], journal: Checkpoints[Origin | Filled], folder: str | None
) -> tuple[str, np.ndarray]:  # fmt: skip
    """The plane as text and the unknowns of the orbit at the problem's own values, computed or of the journal."""
    model, (names, axes) = problem.model, plane
    origin = next((line for line in journal.known if len(line) == 4), None)
    if origin is None:
        physical = tuple(name for name in names if name in model.parameter_names)
        start = begin(replace(problem, expected={}), FamilySettings(parameter=names[0]))
        old = start.curve.equations
        equations, held = Equations.of(old.model, old.symmetry, physical, old.by), momenta_of(old.symmetry, old.model)
        if len(physical) == 2:
            held = unknown_parameters(model, FamilySettings(parameter=names[0]), held)[1]
        curve, w = released(start.curve, start.solution.place, equations, held)
        w = w.on(old.finer(w.mesh))  # it must do for all of the plane
        origin = plain(entry_of(curve)), len(w.nodes), packed(w.mesh[:, None]), packed(w.vector[:, None])
        line = dict(zip(("curve", "segments", "mesh", "vector"), origin, strict=True))
        journal.add(line | {"versions": dict(cluster.packed(None).versions)})
    entry, segments, mesh, vector = origin
    text = described(model.system, folder, entry, names, axes, unpacked(mesh, 1).ravel(), segments)
    return text, unpacked(vector, 1).ravel()


class _Filling:
    """The pixels of a problem's plane, filled round by round, by what the journal knows where it does."""

    def __init__(
        self, problem: Problem, how: tuple[str, int], text: str, journal: Checkpoints[Origin | Filled]
    ) -> None:  # fmt: skip
        self.problem, self.journal, (self.by, self.seed) = problem, journal, how
        self.plane = plane = plane_of(text, problem.model)
        shape = plane.axes[1].size, plane.axes[0].size
        numbers = 3 + plane.curve.equations.model.degrees_of_freedom
        self.block = PixelBlock.empty(shape, plane.place.vector.size, numbers)
        self.known = {line[:2]: line[2] for line in journal.known if len(line) == 3}

    def fill(self, text: str, first: int = 0) -> None:
        """Pixels that a journal has kept, of rows from the `first` on. Raises `InputError`."""
        try:
            matrix = unpacked(text, 4 + int(self.block.vectors.shape[2] + self.block.numbers.shape[2]))
            matrix[:, 0] += first
            self.block.fill(matrix)
        except ValueError as error:
            raise InputError(f"{self.journal.path}: pixels: {error}; {AGAIN}") from error

    def rounds(
        self, vector: np.ndarray, answers: tasks.Answers, plane: ParameterPlane | str
    ) -> Iterator[tuple[int, int]]:
        """How many pixels of how many are done, after each task.

        First the column at the problem's own values, then strips of rows, and again strips that orbits have come to
        the edge of.
        """
        curve, (rows, columns) = self.plane.curve, self.block.blank.shape
        if vector.size != self.plane.place.vector.size or not np.isfinite(vector).all():
            raise InputError(f"{self.journal.path}: vector: {vector.size} numbers where {self.plane.place.vector.size} "
                             f"finite ones belong; {AGAIN}")  # fmt: skip
        w = self.plane.place.at(vector)
        own = np.array([parameter_value(curve, w, name) for name in self.plane.parameters])
        column, row = (int(np.abs(axis - value).argmin()) for axis, value in zip(self.plane.axes, own, strict=True))
        whole = slice(None), slice(None)
        if self.block.blank[row, column] and SEED not in self.known:  # or a shard has it
            before = self.block.part(*whole)
            self.plane.seed(self.block, (row, column), (own, w))
            if self.block.blank[row, column]:
                there = ", ".join(f"{name} = {axis[k]:g}" for name, axis, k in zip(
                    self.plane.parameters, self.plane.axes, (column, row), strict=True))  # fmt: skip
                raise ConvergenceError(
                    f"map: from the problem's own orbit none leads to {there}: {BLANK[self.block.blank[row, column]]}; "
                    "give the problem parameters in the plane"
                )
            self._keep(SEED, self.block.matrix(*whole, before))
        elif SEED in self.known:
            self.fill(self.known[SEED])
        parts, number = [(slice(0, rows), slice(column, column + 1))], 0
        while parts:
            yield from self._round(number, parts, answers, plane)
            strips = [(slice(k, min(k + STRIP, rows)), slice(0, columns)) for k in range(0, rows, STRIP)]
            left = np.any(self.block.frontier(), axis=2)
            parts, number = [part for part in strips if left[part].any()], number + 1

    def _round(
        self, number: int, parts: Sequence[tuple[slice, slice]], answers: tasks.Answers, plane: ParameterPlane | str
    ) -> Iterator[tuple[int, int]]:
        """The tasks of a round, each of which sees what the rounds before have left."""
        requests = dict[int, tuple[Any, ...]]()
        for k, (rows, columns) in enumerate(parts):
            if (number, k) not in self.known:
                first = max(rows.start - BEHIND, 0)
                block = self.block.part(slice(first, rows.stop + BEHIND), slice(None))
                requests[k] = plane, block, (first, 0), slice(rows.start - first, rows.stop - first), columns
        fresh = answers(list(requests.values()))
        for k in range(len(parts)):
            if k not in requests:
                self.fill(self.known[number, k])
        yield self._done()
        for answered, matrix in fresh:
            self.block.fill(matrix)
            self._keep((number, list(requests)[answered]), matrix)
            yield self._done()

    def _keep(self, task: tuple[int, int], matrix: np.ndarray) -> None:
        self.journal.add(dict(zip(("round", "task", "pixels"), (*task, packed(matrix)), strict=True)))

    def _done(self) -> tuple[int, int]:
        return int((self.block.blank != UNTRIED).sum()), self.block.blank.size

    def record(self, sample: int) -> ParameterMap:
        """The map by now, with so many orbits certified."""
        plane, block, p = self.plane, self.block, self.plane.curve.equations
        d, n = plane.place.nodes.size, p.model.degrees_of_freedom
        made = ParameterMap(
            name=self.problem.name, title=self.problem.title, system=dict(p.model.system),
            parameters=plane.parameters, by=self.by,
            coordinates=tuple(p.model.state_names[:n]), curve=plane.entry, seed=self.seed, failures={},
            columns=plane.axes[0], rows=plane.axes[1], mesh=plane.mesh,
            nodes=block.vectors[..., :d].reshape(*block.blank.shape, *plane.place.nodes.shape),
            periods=block.vectors[..., d].copy(),
            unfolding=block.vectors[..., d + 1 : d + 1 + p.march.unfolding].copy(), blank=block.blank.copy(),
            multipliers=block.numbers[..., :2].copy(), verdicts=block.numbers[..., 2].astype(int),
            amplitudes=block.numbers[..., 3:].copy(), sample=np.zeros((0, 3), int),
        )  # fmt: skip
        pixels = np.argwhere(made.known)
        chosen = np.random.default_rng(self.seed).permutation(len(pixels))[:sample]
        failures, rows = Counter[str](), []
        for pixel in pixels[np.sort(chosen)]:
            wrong = _failures(plane, made, pixel)
            failures.update(wrong)
            rows.append((*map(int, pixel), int(not wrong)))
        return replace(made, sample=np.array(rows, int).reshape(-1, 3), failures=dict(failures))


def _failures(plane: ParameterPlane, made: ParameterMap, pixel: np.ndarray) -> tuple[str, ...]:
    """The checks that the orbit of a pixel fails as an orbit of its own."""
    try:
        solution = at_place(plane.curve, _place(plane, made, pixel))
        head = np.zeros(solution.place.head.size)
        point = make_point(plane.curve, solution, head, made.parameters[0], None, index=0, arclength=0.0, step=0.0)
        return certify(point, with_parameters(plane.curve.equations.model, point.free)).failures
    except (*UNSOLVED, np.linalg.LinAlgError) as error:
        return (type(error).__name__,)


def _place(plane: ParameterPlane, made: ParameterMap, pixel: np.ndarray) -> Unknowns:
    """The unknowns of a pixel of a record."""
    i, j = pixel
    tail = np.concatenate([[made.periods[i, j]], made.unfolding[i, j], plane.curve.equations.numbers])
    values = np.array([made.columns[j], made.rows[i]])
    return plane.unknowns(np.concatenate([made.nodes[i, j].ravel(), tail]), values)


def verified(made: ParameterMap, model: Model) -> Certificate:
    """Every orbit again from the record alone, by steps of half the length: that it closes, and what is said of it;
    the sample by its certificates."""
    names, axes = made.parameters, (made.columns, made.rows)
    plane = plane_of(described(made.system, None, made.curve, names, axes, made.mesh, made.nodes.shape[2]), model)
    curve, pixels, worst, wrong = plane.curve, np.argwhere(made.known), np.zeros(2), 0
    mesh = curve.equations.finer(plane.mesh)
    for part in np.array_split(pixels, -(-len(pixels) // TOGETHER)) if len(pixels) else ():
        places = [_place(plane, made, pixel).on(mesh) for pixel in part]
        paths = curve.equations.varied_each(places, states=True)
        solutions = [Solution(w, path, NO_ROWS, 0.0) for w, path in zip(places, paths, strict=True)]
        for pixel, solution, numbers in zip(part, solutions, plane.numbers(solutions), strict=True):
            if isinstance(numbers, int):
                wrong += 1
                continue
            i, j = pixel
            rows = curve.through(solution.place).rows(solution.place, solution.march.ends)
            size = nonzero(float(extents(curve, solution.march.states).max()))
            gap = np.abs(rows).max() / size / max(1.0, np.hypot(*numbers[:2]))
            told = np.concatenate([made.multipliers[i, j], made.amplitudes[i, j]])
            off = np.abs(told - numbers[[0, 1, *range(3, numbers.size)]]).max() / nonzero(np.abs(told).max())
            worst = np.maximum(worst, [gap, off])
            unsure = {int(numbers[2]), int(made.verdicts[i, j])} & {STABILITIES.index("marginal")}
            wrong += int(numbers[2]) != made.verdicts[i, j] and not unsure
    sure = [not _failures(plane, made, pixel) for pixel in made.sample[:, :2]]
    return Certificate((
        at_most("closure", float(worst[0]), CLOSURE, "of any orbit, in its size, by steps of half the length"),
        at_most("numbers", float(worst[1]), SAME, "multipliers and amplitudes, relative to the largest"),
        equal("verdicts", float(wrong), 0.0, "on stability that are not so"),
        equal("sample", float(np.sum(sure != made.sample[:, 2].astype(bool))), 0.0, "orbits that are not as said"),
        equal("certified", float(len(sure) - sum(sure)), 0.0, f"of {len(sure)} in the sample that are not"),
    ))  # fmt: skip
