"""The driver follows anything that is F(w) = 0: a circle, a two-point boundary value problem, fixed points of a map."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from orbitfinder.continuation.follow import (
    CurveJournal,
    Direction,
    Goals,
    Pace,
    follow,
    reached,
    rise,
    towards,
    zero,
)
from orbitfinder.continuation.problem import Linear, Point, Solver, plane, solved
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.mechanics.newton import Settings
from orbitfinder.records.journal import begin_journal, header_of

PACE = Pace(first=0.1, longest=0.3, points=40)


CORRECTOR = Settings(floor=1e-13, round_off=1e-13, most_evaluations=30)


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Unknowns that are no more than numbers."""

    vector: np.ndarray

    def moved(self, step: np.ndarray) -> Coordinates:
        """Their sum with a step."""
        return Coordinates(self.vector + step)


@dataclass(frozen=True, eq=False)
class Dense:
    """A Linear that is a matrix."""

    matrix: np.ndarray

    def closed(self, rows: np.ndarray) -> Solver:
        """The square system's, or of more rows than unknowns the one of least squares."""
        whole = np.vstack([self.matrix, rows])

        def step(rows: np.ndarray) -> np.ndarray:
            try:
                square = whole.shape[0] == whole.shape[1]
                return -(np.linalg.solve(whole, rows) if square else np.linalg.lstsq(whole, rows, rcond=None)[0])
            except np.linalg.LinAlgError as error:
                raise ConvergenceError("the equations are singular there") from error

        return step


@dataclass(frozen=True, eq=False)
class Plain:
    """A problem of a few numbers: `function(w)` gives its rows and their derivatives, `names` are those of w."""

    function: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    names: tuple[str, ...]
    settings: Settings = CORRECTOR

    def rows(self, w: Coordinates) -> np.ndarray:
        """F(w)."""
        return np.asarray(self.function(w.vector)[0])

    def linearise(self, w: Coordinates) -> tuple[np.ndarray, Linear]:
        """F(w) and its derivatives."""
        rows, slopes = self.function(w.vector)
        return np.asarray(rows), Dense(np.asarray(slopes))

    def phases(self, w: Coordinates) -> np.ndarray:
        """None."""
        return np.zeros((0, w.vector.size))

    def metric(self, w: Coordinates) -> np.ndarray:
        """Of Euclid."""
        return np.ones(w.vector.size)

    def value(self, w: Coordinates, name: str) -> float:
        """One of the unknowns."""
        return float(w.vector[self.names.index(name)])

    def aim(self, w: Coordinates, name: str, value: float) -> tuple[float, np.ndarray]:
        """It less a value."""
        row = np.zeros(w.vector.size)
        row[self.names.index(name)] = 1.0
        return self.value(w, name) - value, row

    def at(self, w: Coordinates, tangent: np.ndarray) -> tuple[Plain, Coordinates, np.ndarray]:
        """The same everywhere."""
        return self, w, tangent

    def carried(self, w: Coordinates, onto: Coordinates) -> Coordinates:
        """Itself: there is one mesh."""
        assert w.vector.size == onto.vector.size
        return w


class Numbers(Direction):
    """Along a problem of plain numbers from its start; the record of a point is w."""

    def __init__(self, start, goals):
        super().__init__(goals, 1.0, {"w": start[1]})
        self.start, self.problem, self.solves = start, start[0], 0

    def begin(self):
        return begun(*self.start)

    def tests(self):
        return {"fold": lambda point: rise(point, self.goals.name)}

    def record(self, point):
        self.solves += 1
        return point.w.vector

    def write(self, point, record):
        return {"w": record, "tangent": point.tangent, "arclength": point.arclength, "step": point.step}

    def read(self, entry):
        w = np.array(entry["w"], float)
        tangent = np.array(entry["tangent"], float)
        return Point(self.problem, Coordinates(w), tangent, entry["arclength"], entry["step"]), w


def circle():
    """p^2 + x^2 = 1, from (0, -1)."""
    problem = Plain(lambda w: (np.array([w @ w - 1.0]), 2 * w[None]), ("p", "x"))
    return problem, np.array([0.02, -1.01]), np.array([1.0, 0.0])


def bratu(count=40):
    """u'' + p exp(u) = 0, u(0) = u(1) = 0, by second differences, from p = 0; its fold is at p = 3.513830719."""

    def function(w):
        u, p, h = w[:-1], w[-1], 1.0 / (count + 1)
        second = (np.diag(np.full(count, -2.0)) + np.eye(count, k=1) + np.eye(count, k=-1)) / h**2
        rows = second @ u + p * np.exp(u)
        return rows, np.column_stack([second + np.diag(p * np.exp(u)), np.exp(u)])

    problem = Plain(function, (*(f"u{k}" for k in range(count)), "p"))
    return problem, np.zeros(count + 1), np.append(np.zeros(count), 1.0)


def logistic():
    """Points of period three of x -> p x (1 - x): the cycle is born at the fold p = 1 + sqrt(8)."""

    def function(w):
        x, p = w
        by_x, by_p, y = 1.0, 0.0, x
        for _ in range(3):
            by_x, by_p, y = p * (1 - 2 * y) * by_x, p * (1 - 2 * y) * by_p + y * (1 - y), p * y * (1 - y)
        return np.array([y - x]), np.array([[by_x - 1.0, by_p]])

    problem = Plain(function, ("x", "p"))
    return problem, np.array([0.5, 3.8318740552833]), np.array([0.0, -1.0])


def begun(problem, w, direction):
    """The first point, going along a direction."""
    guess = Coordinates(w)
    point = solved(problem, guess, plane(problem, guess, direction))
    sense = 1.0 if point.inner(direction) >= 0 else -1.0
    return replace(point, tangent=sense * point.tangent)


def whole(start, goals, pace=PACE, path=None):
    """The curve to its end."""
    curve = Numbers(start, goals)
    assert list(follow(curve, pace, path)) == curve.points
    return curve


def test_round_a_circle():
    """Folds, and exact values on both sides of them, again and again."""
    curve = whole(circle(), Goals("p", at=(0.5, -0.5)))
    assert curve.end.kind == "point limit" and len([one for one in curve.points if one.role == "step"]) == 40
    folds = np.array([one.record for one in curve.events])
    assert len(folds) >= 2 and np.allclose(folds[:, 0], np.where(np.arange(len(folds)) % 2, -1.0, 1.0), atol=1e-12)
    exact = np.array([one.record for one in curve.points if one.role == "at"])
    assert np.allclose(np.abs(exact), [0.5, np.sqrt(0.75)], atol=1e-12) and len(exact) >= 4
    lengths = [one.point.arclength for one in curve.points]
    assert lengths == sorted(lengths)


def test_a_boundary_value_problem_round_its_fold():
    """u = 2 ln(cosh a / cosh(a (1 - 2 x))), p = 8 (a / cosh a)^2: what differences miss falls with h^2."""
    missed = []
    for count in (39, 79):
        curve = whole(bratu(count), Goals("p", at=(1.0,)), Pace(first=0.5, longest=3.0, points=30))
        (fold,) = curve.events
        upper = [one.record for one in curve.points if one.role == "at"][-1]
        a = brentq(lambda a: 8 * (a / np.cosh(a)) ** 2 - 1.0, 1.3, 5.0)
        assert upper[-1] == pytest.approx(1.0, abs=1e-12)
        missed.append([fold.record[-1] - 3.513830719125, upper[:-1].max() - 2 * np.log(np.cosh(a))])
    assert np.divide(*missed) == pytest.approx([4.0, 4.0], rel=0.05) and np.abs(missed[-1]).max() < 0.02


def test_a_cycle_of_a_map_is_born_at_its_fold():
    """Of period three, of x -> p x (1 - x), at p = 1 + sqrt(8), stable on one side and not on the other."""
    curve = whole(logistic(), Goals("p", at=(3.83,)), Pace(first=0.001, longest=0.01, points=40))
    assert [one.record[1] for one in curve.events] == pytest.approx([1 + np.sqrt(8)], abs=1e-12)
    exact = [one.record[0] for one in curve.points if one.role == "at"]
    assert len(exact) == 2 and abs(exact[0] - exact[1]) > 1e-3


@pytest.mark.parametrize("start", [circle, bratu, logistic])
@pytest.mark.parametrize("lines", [1, 2, 7, 11])
def test_cut_anywhere_it_ends_as_if_it_had_not_been(start, lines, tmp_path):
    """The journal cut after a line, and within the next one; nothing that it has is solved again."""
    path, name = tmp_path / "curve.jsonl", "p"
    pace = Pace(first=0.01, longest=0.5, points=14)
    values = (0.1, 0.3, 3.83)
    before = whole(start(), Goals(name, at=values), pace, path)
    text = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(text[:lines]) + text[min(lines, len(text) - 1)][:40])
    after = whole(start(), Goals(name, at=values), pace, path)
    assert [one.record.tolist() for one in after.points] == [one.record.tolist() for one in before.points]
    assert [one.role for one in after.points] == [one.role for one in before.points] and after.end == before.end
    known = sum(
        len(entry["at"]) + len(entry["events"]) + (entry["step"] is not None)
        for entry in map(json.loads, text[1:lines])
    )
    assert after.solves == before.solves - known
    assert path.read_bytes().splitlines() == b"".join(text).splitlines()


def test_more_is_asked_for(tmp_path):
    """More points, another end, other values: what is known is not solved again, the result is that of a fresh run."""
    path = tmp_path / "curve.jsonl"
    whole(circle(), Goals("p", until=0.5, at=(0.2,)), Pace(first=0.1, longest=0.3, points=4), path)
    for goals, points in ((Goals("p", until=0.5, at=(0.2,)), 30), (Goals("p", until=-0.5, at=(0.3, 0.9)), 30),
                          (Goals("p", at=(0.9,)), 12), (Goals("p", until=0.1), 40)):  # fmt: skip
        pace = Pace(first=0.1, longest=0.3, points=points)
        kept = whole(circle(), goals, pace, path)
        fresh = whole(circle(), goals, pace)
        assert [one.role for one in kept.points] == [one.role for one in fresh.points] and kept.end == fresh.end
        a, b = (np.array([one.record for one in each.points]) for each in (kept, fresh))
        assert np.allclose(a, b, atol=1e-12) and len(kept.events) == len(fresh.events)
        assert whole(circle(), goals, pace, path).solves == 0
    assert kept.solves == 1


def test_a_curve_that_ends(tmp_path):
    """p = sqrt(x) ends at x = 0; what ended is not tried again, also where other values are asked for meanwhile."""
    calls = []

    def function(w):
        calls.append(1)
        x, p = w
        return np.array([p - np.sqrt(x)]), np.array([[-0.5 / np.sqrt(x), 1.0]])

    start, tries = (Plain(function, ("x", "p")), np.array([1.0, 1.0]), np.array([-1.0, -1.0])), []
    with np.errstate(all="ignore"):
        for at in ((), (), (0.5,), (0.5,)):
            calls.clear()
            curve = whole(start, Goals("p", at=at), Pace(points=400), tmp_path / "root.jsonl")
            tries.append(len(calls))
            assert curve.end.kind == "step underflow" and 0 < curve.points[-1].record[0] < 0.01
            assert [one.record[0] for one in curve.points if one.role == "at"] == pytest.approx([0.25] * len(at))
    assert tries[0] > 100 and tries[1] == 0 and 0 < tries[2] < 20 and tries[3] == 0


def test_a_journal_that_was_edited_is_refused(tmp_path):
    path = tmp_path / "curve.jsonl"
    whole(circle(), Goals("p"), Pace(points=5), path)
    text = path.read_text().replace('"arclength":0.0', '"arclength":0.1')
    path.write_text(text)
    with pytest.raises(InputError, match=r"line 2: not what was written"):
        whole(circle(), Goals("p"), Pace(points=5), path)


def test_another_request_leaves_what_is_there(tmp_path):
    """It was begun anew over it, also where the first point is the same and leads the other way."""
    path = tmp_path / "curve.jsonl"
    whole(circle(), Goals("p"), Pace(points=5), path)
    problem, w, direction = circle()
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"curve.jsonl: w\.0: 0.02 there, 0.04 asked for; .*give another folder"):
        whole((problem, w + 0.02, direction), Goals("p"), Pace(points=5), path)
    elsewhere = Numbers(circle(), Goals("p"))
    elsewhere.leads = lambda first: False
    with pytest.raises(InputError, match=r"curve.jsonl: until: the other way there, this way asked for"):
        CurveJournal(elsewhere, path)
    assert path.read_bytes() == before
    begin_journal(path, header_of({"w": "nothing came of it"}))
    assert whole(circle(), Goals("p"), Pace(points=5), path).solves == 5


def test_which_way_leads_there():
    problem, w, direction = circle()
    point = begun(problem, w, direction)
    assert [towards(point, "p", value) for value in (0.5, -0.5, None)] == [1.0, -1.0, 1.0]


def test_straight_to_values_before_a_fold():
    """x^2 + p = 1: steps that fail are halved, and longer again; beyond p = 1 there are none."""
    known, asked = [(0.0, 1.0)], []

    def corrected(p):
        asked.append(p)
        x = known[-1][1]
        for _ in range(4):
            x = (x + (1 - p) / x) / 2
        if not abs(x * x + p - 1) < 1e-9:
            raise ConvergenceError("no root")
        return x, 4

    assert reached(known, 0.99, corrected) == pytest.approx(0.1, abs=1e-8)
    assert asked[:2] == [0.99, 0.495] and len(asked) < 20 and [one for one, _ in known][-1] == 0.99
    with pytest.raises(ConvergenceError, match="no root"):
        reached(known, 2.0, corrected)
    assert 0.99 < known[-1][0] < 1.0 and len(known) == 2 and len(asked) < 60


def test_halves_of_the_last_straight_step_are_of_a_whole_one():
    """A step of 0.5 where 0.4 are left is tried to the end and then as 0.25, not as 0.2."""
    tried = []

    def corrected(place):
        tried.append(place)
        if len(tried) in (3, 4):
            raise ConvergenceError("too far")
        return place, 1

    pace = Pace(first=0.1, shortest=1e-3, longest=0.5, quick=5, growth=5.0)
    assert reached([(0.0, 0.0)], 1.0, corrected, pace) == 1.0
    assert tried == pytest.approx([0.1, 0.6, 1.0, 0.85, 0.725, 1.0])


def test_no_kind_of_problem_is_known_here():
    """The driver asks no problem what it is."""
    for file in (Path(__file__).parents[1] / "orbitfinder" / "continuation").glob("*.py"):
        text = file.read_text(encoding="utf-8")
        assert "isinstance" not in text, file.name
        for word in ("orbit", "torus", "tori", "optima", "equilibri", "connection", "cycle", "family"):
            code = [line for line in text.splitlines() if word in line.lower() and "orbitfinder" not in line]
            assert not code, (file.name, code)


def test_a_zero_at_the_end_of_a_bracket_that_round_off_moved_beyond_it():
    assert zero(lambda x: x - 1.0, 1.0 + 1e-15, 2.0, 1e-12) == 1.0 + 1e-15
    assert abs(zero(lambda x: x - 1.0, 0.0, 2.5, 1e-12) - 1.0) < 1e-12
    with pytest.raises(ValueError, match="different signs"):
        zero(lambda x: x - 1.0, 1.1, 2.0, 1e-12)
