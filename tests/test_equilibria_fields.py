"""Random smooth fields: folds and Hopf points against eigenvalues on a grid 25 times as fine."""

import casadi as ca
import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.errors import ConvergenceError

FINER = 25


def coefficients(seed):
    """Of x' = (A + p B) x + Q(x, x) + 2 tanh(T x) - 0.3 x^3 + p u + 0.3 v."""
    random = np.random.default_rng(seed)
    shapes = (3, 3), (3, 3), (3, 3, 3), (3, 3), (3,), (3,)
    return [random.normal(size=shape) * (0.5 if len(shape) == 3 else 1.0) for shape in shapes]


def field(seed):
    """The system, stated for CasADi."""
    a, b, q, t, u, v = coefficients(seed)

    def rates(_, x, p):
        x = ca.vertcat(*(x[k] for k in range(3)))
        square = ca.vertcat(*(x.T @ ca.DM(q[k]) @ x for k in range(3)))
        found = (a + p[0] * b) @ x + square + 2 * ca.tanh(t @ x) - 0.3 * x**3 + p[0] * u + 0.3 * v
        return [found[k] for k in range(3)]

    return of.ode(rates, ["x", "y", "z"], parameters={"p": 0.0})


def rates_and_slopes(seed, w):
    """The same in NumPy, of rows w = (x, p): rates (N x 3), slopes in x (N x 3 x 3) and in p (N x 3)."""
    (a, b, q, t, u, v), x, p = coefficients(seed), w[:, :3], w[:, 3:]
    bent = np.tanh(x @ t.T)
    rates = x @ a.T + p * (x @ b.T) + np.einsum("ijk,nj,nk->ni", q, x, x) + 2 * bent - 0.3 * x**3 + p * u + 0.3 * v
    slopes = a + p[:, :, None] * b + np.einsum("ijk,nk->nij", q + q.transpose(0, 2, 1), x)
    slopes = slopes + 2 * (1 - bent**2)[:, :, None] * t - 0.9 * x[:, :, None] ** 2 * np.eye(3)
    return rates, slopes, x @ b.T + u


def by_brute_force(seed, places):
    """Kinds and places (x, p) by changes of sign, on a grid between places on the curve."""
    shares = (np.arange(FINER) / FINER)[:, None]
    ends, along = places[:-1, None], (places[1:] - places[:-1])[:, None]
    start = np.vstack([(ends + shares * along).reshape(-1, 4), places[-1:]])
    rows = np.vstack([np.repeat(along[:, 0], FINER, axis=0), along[-1]])
    w = start.copy()
    for _ in range(8):
        rates, slopes, by_p = rates_and_slopes(seed, w)
        matrix = np.concatenate([np.concatenate([slopes, by_p[:, :, None]], axis=2), rows[:, None]], axis=1)
        left = np.column_stack([rates, np.sum(rows * (w - start), axis=1)])
        w = w - np.linalg.solve(matrix, left[:, :, None])[:, :, 0]
    values = np.linalg.eigvals(rates_and_slopes(seed, w)[1]).astype(complex)
    sums = values[:, [0, 0, 1]] + values[:, [1, 2, 2]]
    found = [("fold", w[k]) for k in _changes(np.prod(values, axis=1).real)]
    for k in _changes(np.prod(sums, axis=1).real):
        i, j = ((0, 1), (0, 2), (1, 2))[int(np.argmin(np.abs(sums[k])))]
        found.append(("hopf" if (values[k, i] * values[k, j]).real > 0 else "neutral_saddle", w[k]))
    return found


def _changes(numbers):
    return np.flatnonzero(np.sign(numbers[:-1]) != np.sign(numbers[1:]))


def agreed(seed, points=70):
    """How many events of a field agree; each of one list has its own of the other."""
    try:
        found = of.follow_equilibria(field(seed), [0.1, 0.1, 0.1], "p", points=points)
    except ConvergenceError:
        return 0  # of some fields a motion from there goes on for ever
    assert all(point.certified for point in found.points) and all(event.check.passed for event in found.events)
    wanted = by_brute_force(seed, np.array([[*point.state, point.value] for point in found.points]))
    left = [(event.kind, np.array([*event.state, event.parameter])) for event in found.events]
    assert sorted(kind for kind, _ in left) == sorted(kind for kind, _ in wanted), seed
    count = len(left)
    for kind, place in wanted:
        apart = [np.abs(there - place).max() if same == kind else np.inf for same, there in left]
        assert min(apart) < 0.02 * max(1.0, np.abs(place).max()), (seed, kind, place)
        left.pop(int(np.argmin(apart)))
    return count


def test_none_is_missed_and_none_is_invented():
    """Twenty fields; with a closed curve among them, and two folds within a step."""
    assert sum(agreed(seed) for seed in range(36, 56)) > 40


@pytest.mark.slow
def test_none_is_missed_and_none_is_invented_of_many():
    """Two hundred more."""
    assert sum(agreed(seed, points=100) for seed in range(100, 300)) > 500


@pytest.mark.parametrize("apart", [1e-2, 1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("start", [-1.0, -0.93, -0.87, -0.817])
def test_two_events_within_a_step(apart, start):
    """p = x^3 - apart x has folds at x^2 = apart / 3; a trace of 2 (apart - p^2) has Hopf points at p^2 = apart."""
    cubic = of.ode(lambda t, x, p: [p[0] - x[0] ** 3 + apart * x[0]], ["x"], parameters={"p": start**3 - apart * start})
    found = of.follow_equilibria(cubic, [start], "p", until=1.0)
    assert [event.kind for event in found.events] == ["fold", "fold"]
    assert np.allclose([event.state[0] for event in found.events], [-((apart / 3) ** 0.5), (apart / 3) ** 0.5], 1e-6)

    def turning(t, x, p):
        a, u = apart - p[0] ** 2, x[0] - 0.3 * p[0]
        return [a * u - x[1], u + a * x[1] - u**2 * x[1]]

    found = of.follow_equilibria(of.ode(turning, ["x", "y"], parameters={"p": start}), [0.3 * start, 0.0], "p", until=1)
    assert [event.kind for event in found.events] == ["hopf", "hopf"]
    assert np.allclose([event.parameter for event in found.events], [-(apart**0.5), apart**0.5], 1e-9)


def test_a_closed_curve_ends_where_it_began(tmp_path):
    """x^2 + p^2 = 1, both ways or towards a value that it does not reach: folds at +-1, once round."""
    ring = of.ode(lambda t, x, p: [x[0] ** 2 + p[0] ** 2 - 1, x[0] * p[0] - x[1]], ["x", "y"], parameters={"p": 0.3})
    for number, until in enumerate((None, 3.0)):
        found = of.follow_equilibria(ring, [1.0, 0.0], "p", until=until, out=tmp_path / str(number))
        assert [end.kind for end in found.ends] == ["returned"]
        assert sorted(event.parameter for event in found.events if event.kind == "fold") == pytest.approx([-1, 1])
        first, last = found.points[0], found.points[-1]
        assert np.allclose(first.state, last.state, rtol=1e-12) and abs(first.value - last.value) < 1e-12
        angles = np.unwrap([np.arctan2(point.state[0], point.value) for point in found.points])
        assert abs(abs(angles[-1] - angles[0]) - 2 * np.pi) < 1e-9
        again = of.follow_equilibria(ring, [1.0, 0.0], "p", until=until, out=tmp_path / str(number))
        assert [point.value for point in again.points] == [point.value for point in found.points]
        assert again.ends == found.ends
    short = of.follow_equilibria(ring, [1.0, 0.0], "p", until=-0.9)
    assert [end.kind for end in short.ends] == ["target"]


def test_a_parameter_that_begins_at_zero_is_measured_by_what_moves_the_state():
    """Both ways from 0 in any unit of it: the same curve."""
    for unit in (1e-6, 1.0, 1e6):
        model = of.ode(lambda t, x, p: [p[0] / unit + 1 - x[0] ** 3], ["x"], parameters={"p": 0.0})  # noqa: B023
        found = of.follow_equilibria(model, [1.1], "p", points=60)
        assert found.points[0].value < -0.9 * unit and found.points[-1].value > 2 * unit
