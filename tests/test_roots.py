"""Roots along a curve: two hundred random fields against eigenvalues on a fine grid, and cases in closed form.

The grid is this file's own: NumPy's eigenvalues of slopes written here, counted. Rule for what the grid cannot say,
written before it was run: a place of the grid where the number of unstable eigenvalues changes by more than one event
accounts for, and events on either side of it that are nearer to each other than `BLIND` cells, are left out of both
lists; they may be no more than one in fifty.
"""

import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from conftest import verified

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.continuation.tests import Entries, Roots, crossings, matched
from orbitfinder.errors import ConvergenceError
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.problemfile.read import load_problem_file

DATA = Path(__file__).parent / "data"
FINER, CELLS, BLIND, SPAN = 40, 10000, 2, (-0.2, 0.7)
KINDS = ("crossing", "equal", "nearly equal", "out and back", "real and pair", "two real", "split", "split at once")


class Planted:
    """x' = S [D(p) y + Q(y, y) - |y|^2 y], y = S^-1 (x - c(p)): rest at c(p), with the eigenvalues of the blocks D.

    S has a condition of at most 10, so that round-off moves growths by less than what goes out and back within the gap.
    """

    def __init__(self, seed):
        random = np.random.default_rng(seed)
        self.kind = KINDS[seed % len(KINDS)]
        self.gap = 1e-3 * random.uniform(0.5, 1.5)
        self.first = p1 = random.uniform(0.0, 0.5)
        least = {"out and back": 2, "two real": 2, "split": 2, "split at once": 2, "real and pair": 3}.get(self.kind, 4)
        self.size = max(least, int(random.integers(2, 7)))
        p2, (w1, w2), (r1, r2) = p1 + self.gap, random.uniform(0.5, 4.0, 2), random.uniform(0.5, 2.0, 2)
        w2 = {"equal": w1, "nearly equal": w1 * (1 + 1e-3)}.get(self.kind, w2)
        self.blocks = {
            "out and back": [self.pair(lambda p: r1 * (p - p1) * (p2 - p), w1)],
            "real and pair": [self.pair(lambda p: r1 * (p - p1), w1), [[lambda p: r2 * (p2 - p)]]],
            "two real": [[[lambda p: r1 * (p - p1)]], [[lambda p: r2 * (p2 - p)]]],
            "split": [[[lambda p: r1 * (p - p1), lambda p: 1.0], [lambda p: p2 - p - 0.1, lambda p: r1 * (p - p1)]]],
            "split at once": [[[lambda p: -1.0, lambda p: 1.0], [lambda p: r1 * (p - p1), lambda p: -1.0]]],
        }.get(self.kind, [self.pair(lambda p: r1 * (p - p1), w1), self.pair(lambda p: r2 * (p2 - p), w2)])
        fill = random.uniform(-2.0, -0.6, self.size - sum(map(len, self.blocks)))
        self.blocks += [[[lambda p, value=value: value]] for value in fill]
        left, right = (np.linalg.qr(random.normal(size=(self.size, self.size)))[0] for _ in range(2))
        self.shape = left * random.uniform(1.0, 10.0, self.size) @ right
        self.bent = 0.3 * random.normal(size=(self.size,) * 3)
        self.rest = random.normal(size=(3, self.size))

    @staticmethod
    def pair(growth, turn):
        return [[growth, lambda p: -turn], [lambda p: turn, growth]]

    def slopes(self, p):
        whole, k = np.zeros((self.size, self.size)), 0
        for block in self.blocks:
            for i, row in enumerate(block):
                for j, entry in enumerate(row):
                    whole[k + i, k + j] = entry(p)
            k += len(block)
        return self.shape @ whole @ np.linalg.inv(self.shape)

    def at(self, p):
        return self.rest[0] + p * self.rest[1] + p**2 * self.rest[2]

    def model(self):
        inverse = np.linalg.inv(self.shape)

        def rates(_, x, p):
            y = ca.DM(inverse) @ (ca.vertcat(*(x[k] for k in range(self.size))) - self.at(p[0]))
            found, k = [], 0
            for block in self.blocks:
                found += [sum(entry(p[0]) * y[k + j] for j, entry in enumerate(row)) for row in block]
                k += len(block)
            found = ca.vertcat(*(found[k] + y.T @ ca.DM(self.bent[k]) @ y for k in range(self.size)))
            whole = ca.DM(self.shape) @ (found - ca.dot(y, y) * y)
            return [whole[k] for k in range(self.size)]

        return of.ode(rates, [f"x{k}" for k in range(self.size)], parameters={"p": SPAN[0]})

    def by_brute_force(self):
        grid = np.linspace(*SPAN, CELLS + 1)
        return counted(grid, np.linalg.eigvals(np.array([self.slopes(p) for p in grid])), 1.0 / CELLS)

    def found(self):
        return of.follow_equilibria(self.model(), self.at(SPAN[0]), "p", until=SPAN[1])


class Generic:
    """x' = (A + p B) x + Q(x, x) + 2 tanh(T x) - 0.3 x^3 + p u + 0.3 v."""

    def __init__(self, seed):
        random = np.random.default_rng(seed)
        self.size = n = int(random.integers(2, 7))
        shapes = (n, n), (n, n), (n, n, n), (n, n), (n,), (n,)
        weights = (1.0, 1.0, 0.5, 1.0, 1.0, 1.0)
        self.parts = [w * random.normal(size=shape) for w, shape in zip(weights, shapes, strict=True)]

    def rates_and_slopes(self, w):
        (a, b, q, t, u, v), x, p = self.parts, w[:, :-1], w[:, -1:]
        bent = np.tanh(x @ t.T)
        rates = x @ a.T + p * (x @ b.T) + np.einsum("ijk,nj,nk->ni", q, x, x) + 2 * bent - 0.3 * x**3 + p * u + 0.3 * v
        slopes = a + p[:, :, None] * b + np.einsum("ijk,nk->nij", q + q.transpose(0, 2, 1), x)
        slopes = slopes + 2 * (1 - bent**2)[:, :, None] * t - 0.9 * x[:, :, None] ** 2 * np.eye(self.size)
        return rates, slopes, x @ b.T + u

    def model(self):
        a, b, q, t, u, v = self.parts

        def rates(_, x, p):
            x = ca.vertcat(*(x[k] for k in range(self.size)))
            square = ca.vertcat(*(x.T @ ca.DM(q[k]) @ x for k in range(self.size)))
            found = (a + p[0] * b) @ x + square + 2 * ca.tanh(t @ x) - 0.3 * x**3 + p[0] * u + 0.3 * v
            return [found[k] for k in range(self.size)]

        return of.ode(rates, [f"x{k}" for k in range(self.size)], parameters={"p": 0.0})

    def found(self, points):
        return of.follow_equilibria(self.model(), np.full(self.size, 0.1), "p", points=points)

    def by_brute_force(self, places):
        """Between places on the curve, own corrections on planes across their chords."""
        shares = (np.arange(FINER) / FINER)[:, None]
        along = (places[1:] - places[:-1])[:, None]
        start = np.vstack([(places[:-1, None] + shares * along).reshape(-1, self.size + 1), places[-1:]])
        rows = np.vstack([np.repeat(along[:, 0], FINER, axis=0), along[-1]])
        w = start.copy()
        for _ in range(10):
            rates, slopes, by_p = self.rates_and_slopes(w)
            matrix = np.concatenate([np.concatenate([slopes, by_p[:, :, None]], axis=2), rows[:, None]], axis=1)
            left = np.column_stack([rates, np.sum(rows * (w - start), axis=1)])
            w = w - np.linalg.solve(matrix, left[:, :, None])[:, :, 0]
        assert np.abs(self.rates_and_slopes(w)[0]).max() < 1e-9
        cells = np.linalg.norm(w[1:] - w[:-1], axis=1)
        return counted(w, np.linalg.eigvals(self.rates_and_slopes(w)[1]), np.append(cells, cells[-1])), w


def counted(grid, values, cells):
    """(kind, number of the cell) where unstable eigenvalues become one or two more or less, and blind cells."""
    number = np.count_nonzero(values.real > 0, axis=1)
    found, blind = [], []
    for k in np.flatnonzero(np.diff(number)):
        near = values[k][np.argsort(np.abs(values[k].real))[:2]]
        pair = abs(near[0].imag) > 0 and np.isclose(near[0], near[1].conj())
        change = abs(int(number[k + 1] - number[k]))
        kind = "hopf" if change == 2 and pair else "zero" if change == 1 else None
        (found if kind else blind).append((kind, int(k)))
    return found, [k for _, k in blind]


def agreed(wanted, blind, got):
    """Both lists (kind, cell) less what the grid is blind to: nothing is missed or invented; how many, how many not."""
    cells = sorted([k for _, k in wanted] + blind)
    near = {k for a, b in pairwise(cells) if b - a <= BLIND for k in (a, b)} | set(blind)
    hidden = [event for event in wanted if event[1] in near]
    clear = [event for event in wanted if event[1] not in near]
    left = [event for event in got if not any(abs(event[1] - k) <= BLIND + 1 for k in near)]
    for kind, k in clear:
        close = [event for event in left if event[0] == kind and abs(event[1] - k) <= 2]
        assert close, ("missed", kind, k, wanted, got)
        left.remove(min(close, key=lambda event: abs(event[1] - k)))
    assert not left, ("invented", left, wanted)
    return len(clear), len(hidden)


def kinds(found):
    return [("hopf" if event.kind == "hopf" else "zero", event) for event in found.events
            if event.kind != "neutral_saddle"]  # fmt: skip


def balanced(found):
    """Unstable eigenvalues before and after each stretch with events differ as these say."""
    assert not found.unknown
    number = [int(np.count_nonzero(point.eigenvalues.real > 0)) for point in found.points]
    for k, (a, b) in enumerate(pairwise(number)):
        steps = [2 if kind == "hopf" else 1 for kind, event in kinds(found) if event.index == k]
        if a != b or steps:
            assert (b - a - sum(steps)) % 2 == 0 and abs(b - a) <= sum(steps), (k, a, b, steps)


def planted(seed):
    """One of the fields whose eigenvalues are planted."""
    field = Planted(seed)
    found = field.found()
    assert all(point.certified for point in found.points) and all(event.check.passed for event in found.events)
    wanted, blind = field.by_brute_force()
    width = (SPAN[1] - SPAN[0]) / CELLS
    got = [(kind, int((event.parameter - SPAN[0]) / width)) for kind, event in kinds(found)]
    balanced(found)
    return agreed(wanted, blind, got)


def generic(seed, points=60):
    """One of the fields about which nothing is known."""
    field = Generic(seed)
    try:
        found = field.found(points)
    except ConvergenceError:
        return 0, 0  # a motion from there goes on for ever
    assert all(point.certified for point in found.points) and all(event.check.passed for event in found.events)
    places = np.array([[*point.state, point.value] for point in found.points])
    (wanted, blind), w = field.by_brute_force(places)
    got = []
    for kind, event in kinds(found):  # in which of the cells of its stretch it is
        own = slice(event.index * FINER, (event.index + 1) * FINER + 1)
        along = (places[event.index + 1] - places[event.index]) @ (w[own] - [*event.state, event.parameter]).T
        got.append((kind, event.index * FINER + int(np.clip(np.searchsorted(along, 0.0) - 1, 0, FINER - 1))))
    balanced(found)
    return agreed(wanted, blind, got)


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 6, 7, 8, 9, 11, 12, 13, 14])
def test_a_dozen_random_fields(seed):
    """Planted ones and others in turn."""
    planted(seed) if seed % 3 else generic(seed, 15)


@pytest.mark.slow
@pytest.mark.parametrize("part", range(10))
def test_two_hundred_random_fields(part):
    """Of 2 to 6 components, half of them with two events a thousandth apart: none missed, none invented."""
    seeds = range(1000 + 10 * part, 1010 + 10 * part)
    counts = np.array([each for seed in seeds for each in (planted(seed), generic(seed))])
    assert counts[:, 0].sum() > 15 and 50 * counts[:, 1].sum() <= counts.sum()


def two_pairs(gap, w, v, start):
    """Two pairs of frequencies w and v, one out at p = 1/2 and one in a gap later."""

    def rates(_, s, p):
        x, y, q, r = (s[k] for k in range(4))
        a, b = p[0] - 0.5, 2 * (0.5 + gap - p[0])
        return [a * x - w * y - x * (x**2 + y**2), w * x + a * y - y * (x**2 + y**2),
                b * q - v * r - q * (q**2 + r**2), v * q + b * r - r * (q**2 + r**2)]  # fmt: skip

    return of.ode(rates, ["x", "y", "q", "r"], parameters={"p": start})


@pytest.mark.parametrize(("w", "v"), [(1.0, 3.0), (1.0, 1.0), (1.0, 1.0001), (2.0, 0.5)])
@pytest.mark.parametrize("gap", [2e-2, 1e-3, 1e-5])
def test_a_pair_goes_out_and_another_comes_in(gap, w, v):
    """Wherever the steps end; frequencies equal, nearly equal, and apart."""
    for start in (0.4, 0.47):
        found = of.follow_equilibria(two_pairs(gap, w, v, start), [0.0] * 4, "p", until=0.6)
        assert [event.kind for event in found.events] == ["hopf", "hopf"], start
        assert np.allclose([event.parameter for event in found.events], [0.5, 0.5 + gap], rtol=0, atol=1e-12)
        assert np.allclose([event.frequency for event in found.events], [w, v], 1e-12)
        assert [event.criticality for event in found.events] == ["supercritical"] * 2


def test_the_command_says_both():
    """The file of the review: two Hopf points at 0.5 and 0.501, between two points that are both unstable."""
    problem = load_problem_file(DATA / "two-hopf-points.toml")
    found = of.follow_equilibria(problem.model, [0.0] * 4, "p", until=1.0)
    assert [event.kind for event in found.events] == ["hopf", "hopf"]
    assert [event.parameter for event in found.events] == pytest.approx([0.5, 0.501], abs=1e-13)


@pytest.mark.slow
def test_a_diagram_shows_what_leaves_both():
    """A family from each, at its period."""
    tree = of.diagram(load_problem_file(DATA / "two-hopf-points.toml").model, [0.0] * 4, "p", 1.0)
    families = [curve.record for curve in tree.curves if curve.depth]
    periods = sorted(min(point.period for point in family.points) for family in families)
    assert periods == pytest.approx([2 * np.pi / 3, 2 * np.pi], rel=1e-6)


@pytest.mark.parametrize("fast", [1e3, 1e8, 1e9, 1e12])
def test_a_verdict_is_by_each_eigenvalue_and_not_by_the_largest(fast):
    """mu +- i beside -L: stable below 0, unstable above, however large L is; and a verdict that is none is seen."""
    model = load_problem_file(DATA / "stiff-hopf.toml").model
    model = with_parameters(model, {"L": fast})
    found = of.follow_equilibria(model, [0.0] * 3, "mu", until=0.3)
    assert [event.kind for event in found.events] == ["hopf"] and abs(found.events[0].parameter) < 1e-12
    assert all(point.stability == ("stable" if point.value < 0 else "unstable") for point in found.points)
    assert verified(found, model).passed
    other = replace(found, points=(replace(found.points[0], stability="unstable"), *found.points[1:]))
    assert verified(other, model).failures == ("verdicts",)


def network(fast, a=1.0, rate=1.5):
    """A Brusselator fed by u, in fast exchange with v: u + v is declared, u = a at rest."""
    return of.ode(
        lambda t, s, p: [s[2] - (p[0] + 1) * s[0] + s[0] ** 2 * s[1], p[0] * s[0] - s[0] ** 2 * s[1],
                         fast * (s[3] - s[2]), fast * (s[2] - s[3])],
        ["x", "y", "u", "v"], parameters={"rate": rate}, invariants={"total": lambda s, p: s[2] + s[3]},
    )  # fmt: skip


@pytest.mark.parametrize("fast", [1.0, 1.35e9])
def test_a_network_with_a_declared_total(fast):
    """Its total is no energy: a Hopf point at rate 1 + a^2, and verdicts, also beside a spectral radius of 2.7e9."""
    found = of.follow_equilibria(network(fast), [1.0, 1.5, 1.0, 1.0], "rate", until=2.5)
    assert [(event.kind, round(event.parameter, 6)) for event in found.events] == [("hopf", 2.0)]
    assert all(point.stability == ("stable" if point.value < 2 else "unstable") for point in found.points)


def test_a_sign_below_its_error_is_no_sign():
    """r' = mu r + b r^3 - r^5: l1 is b / 1, and degenerate where that is 0 or noise."""
    for b, word in ((0.0, "degenerate"), (2e-67, "degenerate"), (1e-3, "subcritical"), (-1e-3, "supercritical")):

        def rates(_, s, p, b=b):
            x, y, square = s[0], s[1], s[0] ** 2 + s[1] ** 2
            growth = p[0] + (1 + b) * square - square * (1 - 1e-17) - square**2
            return [growth * x - y, growth * y + x]

        (event,) = of.follow_equilibria(
            of.ode(rates, ["x", "y"], parameters={"mu": -0.2}), [0.0, 0.0], "mu", 0.2
        ).events
        assert event.kind == "hopf" and event.criticality == word, b


def along(values, start, end):
    """Roots of a diagonal matrix by functions of s, their derivatives, and unit vectors, between two places."""
    d = len(values(0.0))

    def look(share):
        s = start + share * (end - start)
        slopes = (values(s + 1e-6) - values(s - 1e-6)) / 2e-6
        return Roots(values(s), slopes, np.eye(d), np.full(d, 1e-14), 2 * np.pi)

    return look, (look(0.0), look(1.0)), end - start


def test_multipliers_are_entered_as_their_logarithms():
    """Two pairs of one angle, one out and one in; -1 crossed by one of two that meet on the negative axis."""
    look, ends, length = along(lambda s: np.array([s + 1j, s - 1j, 0.01 - s + 1j, 0.01 - s - 1j]), -0.3, 0.4)
    crossed = crossings(look, ends, length, (Entries.SUMS,))
    places = [-0.3 + 0.7 * np.array(one.within) for one in crossed]
    assert len(crossed) == 2 and places[0][0] <= 0.0 <= places[0][1] and places[1][0] <= 0.01 <= places[1][1]

    def flipped(s):  # mu^2 + 1.9 mu + 0.9 + s: a pair until they meet at -0.95, then real; one goes through -1 at s = 0
        return np.log(np.roots([1.0, 1.9, 0.9 + s]).astype(complex))

    look, ends, length = along(flipped, 0.05, -0.05)
    (crossing,) = crossings(look, ends, length, (Entries.ROOTS,))
    assert abs(crossing.value(look(0.5 + 1e-9), 0.5, length)[1].imag) == np.pi
    assert crossing.within[0] <= 0.5 <= crossing.within[1]


def test_what_predictions_match_positions_do_not():
    """Two roots that pass each other between two places: by positions none crosses."""
    first = Roots(np.array([-1e-3, 1e-3]) + 1j, np.array([0.1, -0.1]) + 0j, np.eye(2), np.full(2, 1e-15))
    second = Roots(np.array([-1e-3, 1e-3]) + 1j, np.array([-0.1, 0.1]) + 0j, np.eye(2)[:, ::-1], np.full(2, 1e-15))
    there, sure = matched(first, second, 0.02)
    assert sure and np.array_equal(there.values.real, [1e-3, -1e-3])


def test_a_vertical_branch_and_what_lies_close():
    """A pitchfork's own branch meets the other; a fold and a branch point; conservative ones by the squares."""
    other = of.ode(lambda t, x, p: [p[0] * x[0] - x[0] ** 3, x[0] - x[1]], ["x", "y"], parameters={"p": 1.0})
    assert [event.kind for event in of.follow_equilibria(other, [1.0, 1.0], "p", -1.0, points=40).events] == [
        "branch_point"
    ]
    for near in (1e-2, 1e-4):  # x^2 = p, and y leaves where x = near
        model = of.ode(
            lambda t, x, p: [p[0] - x[0] ** 2, (x[0] - near) * x[1] - x[1] ** 2], ["x", "y"],  # noqa: B023
            parameters={"p": 0.04},
        )  # fmt: skip
        found = of.follow_equilibria(model, [0.2, 0.0], "p", points=40)
        events = sorted((event.kind, event.parameter) for event in found.events if event.kind != "neutral_saddle")
        assert [kind for kind, _ in events] == ["branch_point", "fold"]
        assert np.allclose([place for _, place in events], [near**2, 0.0], rtol=0, atol=1e-14)
    q, v, p = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("p")
    wells = q[0] ** 4 / 4 - (p - 0.5) * q[0] ** 2 / 2 + q[1] ** 4 / 4 - (0.501 - p) * q[1] ** 2 / 2
    model = of.lagrange(ca.sumsqr(v) / 2, wells, of.Symbols(q, v, p, ("p",), (0.4,)))
    found = of.follow_equilibria(model, [0.0] * 4, "p", until=0.6)
    assert [(event.kind, round(event.parameter, 9)) for event in found.events] == [
        ("branch_point", 0.5), ("branch_point", 0.501),
    ]  # fmt: skip


def test_two_pairs_at_once():
    """Two Hopf points of one p, at a resonance 1:2 of which one has no first Lyapunov coefficient."""

    def rates(_, s, p):
        x, y, q, r = (s[k] for k in range(4))
        return [p[0] * x - y - x * (x**2 + y**2), x + p[0] * y - y * (x**2 + y**2),
                p[0] * q - 2 * r - q * (q**2 + r**2), 2 * q + p[0] * r - r * (q**2 + r**2)]  # fmt: skip

    model = of.ode(rates, ["x", "y", "q", "r"], parameters={"p": -0.1})
    found = of.follow_equilibria(model, [0.0] * 4, "p", until=0.1)
    assert sorted((event.frequency, event.criticality) for event in found.events) == [
        (pytest.approx(1.0), "degenerate"), (pytest.approx(2.0), "supercritical"),
    ]  # fmt: skip
    assert verified(found, model).passed


def test_what_no_event_explains_is_said(tmp_path):
    """Two equal oscillators: a double pair crosses, where no Hopf point is isolated; also two equal pitchforks."""
    file = DATA / "two-equal-oscillators.toml"
    asked = ["equilibria", str(file), "--parameter", "p", "--until", "0.6", "--out", str(tmp_path), "--json"]
    result = CliRunner().invoke(cli, asked)
    document = json.loads(result.stdout)
    assert result.exit_code == 1 and document["events"] == []
    said = r"unknown: the number of growing eigenvalues is 0 at p [\d.]+ and 4 at [\d.]+, .* to separate them"
    assert re.fullmatch(said, document["unknown"][0])

    def rates(_, s, p):
        return [p[0] * s[k] - s[k] ** 3 for k in range(2)]

    model = of.ode(rates, ["x", "y"], parameters={"p": -0.1})
    assert len(of.follow_equilibria(model, [0.0] * 2, "p", until=0.1).unknown) == 1
    apart = two_pairs(1e-3, 1.0, 1.0, 0.45)
    assert of.follow_equilibria(apart, [0.0] * 4, "p", until=0.55).unknown == ()
    doctored = of.follow_equilibria(apart, [0.0] * 4, "p", until=0.55)
    assert len(replace(doctored, events=doctored.events[1:]).unknown) == 1
