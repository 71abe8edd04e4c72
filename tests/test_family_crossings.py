"""Events of families that dissipate: multipliers through the unit circle, planted, in closed form, and real."""

import casadi as ca
import numpy as np
import pytest
from maps import diagonal, planted, wound_back
from scipy.integrate import solve_ivp

import orbitfinder as of
from orbitfinder.mechanics.lagrange import Symbols, lagrange

FORWARD = of.FamilySettings(directions="forward")


def named(family, size, length=1.0):
    """(kind, place) of everything found on one step, in order; every event is checked, and none is left undecided."""
    found = planted(wound_back(family, size), length)
    assert not found.unknown and len(found.points) == 2
    assert all(event.check.passed for event in found.events)
    return [(event.kind, event.parameter - 1.0) for event in found.events if event.kind != "stability_change"]


def pair(radius, angle):
    """A map that turns and stretches: multipliers radius exp(+-i angle)."""
    c, s = np.cos(angle), np.sin(angle)
    return radius * ca.DM([[c, -s], [s, c]])


PLANTED = {
    "doubling": (2, lambda s: diagonal(-0.7 - s, 0.2), [("period_doubling", 0.3)]),
    "branch point": (2, lambda s: diagonal(0.1, 0.8 + s), [("branch_point", 0.2)]),
    "torus": (2, lambda s: pair(0.5 + s, 1.0), [("torus", 0.5)]),
    "neutral saddle": (2, lambda s: diagonal(0.5, 1.5 + s), []),
    "doubling beside a torus": (
        3, lambda s: ca.diagcat(-0.9 - 0.5 * s, pair(0.4 + s, 2.0)), [("period_doubling", 0.2), ("torus", 0.6)]
    ),
    "one out and another in": (
        2, lambda s: diagonal(-0.6 - s, 1.7 - s), [("period_doubling", 0.4), ("branch_point", 0.7)]
    ),
    "out and back": (
        2, lambda s: diagonal(-1.01 + 0.25 * (s - 0.5) ** 2, 0.1), [("period_doubling", 0.3), ("period_doubling", 0.7)]
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", PLANTED)
def test_planted_passages(name):
    """Every passage by its kind and place; a neutral saddle is none."""
    size, family, wanted = PLANTED[name]
    found = named(family, size)
    assert [kind for kind, _ in found] == [kind for kind, _ in wanted]
    assert [place for _, place in found] == pytest.approx([place for _, place in wanted], abs=1e-9)


def by_brute_force(family, count=4001):
    """The same from the eigenvalues at many places: whose modulus passes 1, and what it is there."""
    places = np.linspace(0.0, 1.0, count)
    values = [sorted(np.linalg.eigvals(family(s)), key=abs) for s in places]
    found = []
    for s, before, after in zip(places, values[:-1], values[1:], strict=False):
        moved = [k for k in range(len(before)) if (abs(before[k]) - 1) * (abs(after[k]) - 1) < 0]
        kinds = {"torus" if abs(after[k].imag) > 1e-9 else ("branch_point", "period_doubling")[int(after[k].real < 0)]
                 for k in moved}  # fmt: skip
        found += [(kind, s + 0.5 / count) for kind in sorted(kinds)]
    return found


@pytest.mark.parametrize("seed", range(12))
def test_random_families_against_brute_force(seed):
    """Random curves of maps, four multipliers each, walked in at most eight steps."""
    rng = np.random.default_rng(seed)
    a, b, c = (rng.normal(0, 0.7, (4, 4)) for _ in range(3))

    def family(s):
        return a + s * b + s * s * c

    walked = planted(wound_back(family, 4), 1.0, step=0.125)
    assert not walked.unknown and len(walked.points) <= 9
    found = [(event.kind, event.parameter - 1.0) for event in walked.events if event.kind != "stability_change"]
    wanted = by_brute_force(family)
    assert [kind for kind, _ in found] == [kind for kind, _ in wanted]
    assert [place for _, place in found] == pytest.approx([place for _, place in wanted], abs=1e-3)


def test_half_map_loses_its_reflection():
    """-1 of a half map is a branch point: its square is +1. About a circle u decays to 0.7 + s of itself in half a
    turn, and changes its sign in the reflection."""

    def field(_, x, p):
        out = 1 - x.x**2 - x.y**2
        return [out * x.x - x.y, x.x + out * x.y, ca.log(p.s - 0.3) / np.pi * x.u]

    model = of.ode(field, ("x", "y", "u"), {"s": 1.0})
    problem = of.Problem(model, of.Guess([1.0, 0.0, 0.0], 2 * np.pi), symmetry="reflection", name="mirrored")
    found = planted(problem, 1.0)
    assert {point.symmetry for point in found.points} == {"reflection"}
    (event, change) = found.events
    assert (event.kind, event.multiplier) == ("branch_point", -1.0) and change.kind == "stability_change"
    assert event.check.passed and event.parameter - 1.0 == pytest.approx(0.3, abs=1e-9)


def embedded(f, q, parameter, name, value, rate=1.0):
    """u' = f(u) as q'' = J(q) q' - k (q' - f(q)): its orbits, and n multipliers exp(-k T) besides."""
    v = ca.SX.sym("v", q.numel())
    forces = ca.jacobian(f, q) @ v - rate * (v - f)
    return lagrange(ca.sumsqr(v) / 2, ca.SX(0), Symbols(q, v, parameter, (name,), (value,)), forces=forces)


def followed(model, name, until, guess, period, tmp_path):
    """The family through the orbit of a guess, its first event of each kind."""
    orbit = of.find_orbit(of.Problem(model, of.Guess(guess, period), name="start"))
    return of.follow_family(orbit, name, until=until, out=tmp_path, settings=FORWARD, model=model)


def test_torus_in_closed_form(tmp_path):
    """Langford's system: the circle r = const, z = b loses its stability to a torus where a = b^2 + e r^2.

    Source: W. F. Langford, Numerical studies of torus bifurcations, ISNM 70 (1984) 285-295.
    """
    b, c, d, e = 0.7, 0.6, 3.5, 0.25
    q, a = ca.SX.sym("q", 3), ca.SX.sym("a")
    square = q[0] ** 2 + q[1] ** 2
    f = ca.vertcat((q[2] - b) * q[0] - d * q[1], d * q[0] + (q[2] - b) * q[1],
                   c + a * q[2] - q[2] ** 3 / 3 - square * (1 + e * q[2]))  # fmt: skip
    critical = (b * b + e * (c - b**3 / 3) / (1 + e * b)) / (1 - e * b / (1 + e * b))
    model, r = embedded(f, q, a, "a", 0.5), np.sqrt((c + 0.5 * b - b**3 / 3) / (1 + e * b))
    family = followed(model, "a", 0.95, [r, 0.0, b, 0.0, d * r, 0.0], 2 * np.pi / d, tmp_path)
    assert [event.kind for event in family.events] == ["torus", "stability_change"]
    assert family.events[0].parameter == pytest.approx(critical, abs=1e-9)
    assert abs(family.events[0].multiplier) == pytest.approx(1.0, abs=1e-9) and family.events[0].multiplier.imag > 0.1


@pytest.mark.slow
def test_doubling_of_a_driven_pendulum(tmp_path):
    """Driven by a limit cycle, which makes it autonomous; the doubling is at A = 1.06637286245520 (140 bits)."""
    q, v, strength = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("A")
    w, w0 = 2 * np.pi, 3 * np.pi
    cycle = -(w**2) * q[1] - w * (q[1] ** 2 + (v[1] / w) ** 2 - 1) * v[1]
    forces = ca.vertcat(-w0 / 2 * v[0] - w0**2 * ca.sin(q[0]) + strength * w0**2 * q[1], cycle)
    symbols = Symbols(q, v, strength, ("A",), (1.06,))
    model = lagrange(ca.sumsqr(v) / 2, ca.SX(0), symbols, forces=forces, names=["phi", "y"], angles=[True, False])
    guess = [-0.2465622651385916, 1.0, 18.525754583919333, 0.0]
    family = followed(model, "A", 1.07, guess, 1.0, tmp_path)
    assert [event.kind for event in family.events] == ["period_doubling", "stability_change"]
    assert family.events[0].parameter == pytest.approx(1.0663728624552, abs=1e-9)
    assert family.events[1].detail == "becomes unstable" and family.points[-1].stability == "unstable"


def test_the_symmetry_breaking_of_lorenzs_cycle(tmp_path):
    """In a formulation without the symmetry, so that the rows are singular there; rho by SciPy, from half a period."""
    model = of.ode(lambda t, x, p: [10 * (x[1] - x[0]), x[0] * (p[0] - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]],
                   ["x", "y", "z"], {"rho": 320.0})  # fmt: skip
    problem = of.Problem(model, of.Guess([-47.1114, -18.5885, 328.3983], 0.4066))
    family = of.follow_family(problem, "rho", until=300.0, out=tmp_path, name="lorenz")
    assert [event.kind for event in family.events] == ["branch_point", "stability_change"]
    assert (family.points[0].stability, family.points[-1].stability) == ("unstable", "asymptotically stable")
    assert abs(family.events[0].parameter - 312.9735329841723) <= family.events[0].error < 1e-7


@pytest.mark.slow
def test_doubling_of_roesslers_cycle(tmp_path):
    """Roessler's cycle in c: stable before its doubling, and the multiplier there is -1 by SciPy's integrator."""
    q, c = ca.SX.sym("q", 3), ca.SX.sym("c")
    f = ca.vertcat(-q[1] - q[2], q[0] + 0.2 * q[1], 0.2 + q[2] * (q[0] - c))
    numbers = ca.Function("f", [q, c], [f])
    field = lambda t, x: numbers(x, 2.5).full().ravel()  # noqa: E731
    start = solve_ivp(field, (0, 300), [1, 1, 0.0], rtol=1e-9, atol=1e-9).y[:, -1]
    model = embedded(f, q, c, "c", 2.5)
    family = followed(model, "c", 3.0, [*start, *field(0, start)], 5.75, tmp_path)
    assert [event.kind for event in family.events] == ["period_doubling", "stability_change"]
    doubled = family.events[0]
    assert doubled.parameter == pytest.approx(2.83244503, abs=1e-8)

    def varied(t, x):
        slope = np.array([[0, -1, -1], [1, 0.2, 0], [x[2], 0, x[0] - doubled.parameter]])
        return np.concatenate([numbers(x[:3], doubled.parameter).full().ravel(), (slope @ x[3:].reshape(3, 3)).ravel()])

    start = np.concatenate([doubled.state[:3], np.eye(3).ravel()])
    end = solve_ivp(varied, (0, doubled.period), start, method="DOP853", rtol=1e-12, atol=1e-12).y[3:, -1]
    assert np.abs(np.linalg.eigvals(end.reshape(3, 3)) + 1).min() < 1e-7
