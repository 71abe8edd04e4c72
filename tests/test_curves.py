"""Curves of bifurcations in two parameters: exact loci, numbers of 140 bits, codimension two, planted failures."""

import json
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from maps import bouncing, diagonal, planted, symplectic, wound_back

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.families.curves import curve_start
from orbitfinder.families.doubling import bending
from orbitfinder.integrate.compiled import compiling
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.records.family import Event, load_family, save_family
from orbitfinder.show.plot import save_figures, two_parameters
from orbitfinder.systems import impact_oscillator

PROBLEMS = Path(__file__).parents[1] / "problems" / "families"
FEW = of.FamilySettings(certify=False, points=60)


def turning(growth, names, values):
    """r' = r growth(r^2, p), once round in 2 pi: its cycles are the zeros of growth."""

    def field(_, x, p):
        rate = growth(x.x**2 + x.y**2, p)
        return [rate * x.x - x.y, x.x + rate * x.y]

    return of.ode(field, ("x", "y"), dict(zip(names, values, strict=True)))


def family_of(model, parameter, until, radius=1.0, **settings):
    """The family of a turning system's cycles from one of a radius."""
    problem = of.Problem(model, of.Guess([radius, 0.0], 2 * np.pi), name="turning")
    chosen = replace(FEW, **settings)
    return of.follow_family(problem, parameter, until=until, settings=chosen, model=model)


def event_of(family, kind, detail=""):
    return next(k for k, one in enumerate(family.events) if one.kind == kind and (not detail or one.detail == detail))


@pytest.fixture(scope="module")
def duffing():
    return of.follow_family(of.load_problem(PROBLEMS / "duffing-resonance.toml"), "frequency", until=2.0, settings=FEW)


def test_orbits_along_a_curve_of_folds_are_certified(duffing):
    """Their equations are all but singular: a gap of 5e-14 is 0.05 of the motion there, so they close to round-off."""
    curve = of.follow_curve(
        duffing, event_of(duffing, "fold"), ("force", "frequency"), settings=replace(FEW, points=40)
    )
    model = of.load_problem(PROBLEMS / "duffing-resonance.toml").model
    for point in curve.points[::4]:
        judged = of.certify(point, with_parameters(model, point.free))
        # at a fold nothing isolates an orbit at its parameters: only the curve's own condition says where it is
        assert set(judged.failures) <= {"distance"}, (point.value, judged.failures)


# ---- exact loci ---------------------------------------------------------------------------------------------


def test_a_cusp_where_two_folds_meet():
    """b + a u - u^3 with u = (r^2 - 8) / 3 folds where b = -+2 (a / 3)^(3/2): a semicubical parabola, its cusp at 0."""

    def growth(rho, p):
        u = (rho - 8) / 3
        return 0.02 * (p.b + p.a * u - u**3)

    model = turning(growth, ("a", "b"), (3.0, -3.0))
    family = family_of(model, "b", 3.0, radius=1.3)
    fold = event_of(family, "fold", "b")
    assert family.events[fold].parameter == pytest.approx(2.0, abs=1e-9)
    settings = replace(FEW, points=30, directions="backward")
    curve = of.follow_curve(family, fold, ("a", "b"), settings=settings, model=model)
    at = curve.places[: len(curve.points)]
    assert np.abs(at[:, 1] ** 2 - 4 * (at[:, 0] / 3) ** 3).max() < 1e-9 and np.ptp(np.sign(at[:, 1])) == 2
    (cusp,) = curve.events
    assert cusp.kind == "cusp" and [cusp.free[name] for name in "ab"] == pytest.approx([0.0, 0.0], abs=1e-7)


@pytest.mark.parametrize("sign, kind", [pytest.param(1, "isola_centre", marks=pytest.mark.slow), (-1, "transcritical")])
def test_where_an_isola_is_born_and_where_two_families_cross(sign, kind):
    """b = u^2 + a^2 is a closed curve in (a, u) for every b, and shrinks to a point; b = u^2 - a^2 crosses itself."""
    model = turning(lambda rho, p: 0.1 * (p.b - (rho - 2) ** 2 - sign * p.a**2), ("a", "b"), (0.8, 1.0))
    radius, until = (np.sqrt(2.6), 0.5) if sign > 0 else (np.sqrt(2 + np.sqrt(1.64)), -0.8)
    family = family_of(model, "b", until, radius=radius, directions="backward")
    fold = event_of(family, "fold", "b")
    settings = replace(FEW, points=15, directions="backward")
    curve = of.follow_curve(family, fold, ("a", "b"), settings=settings, model=model)
    at = curve.places[: len(curve.points)]
    assert np.abs(at[:, 1] - sign * at[:, 0] ** 2).max() < 1e-9
    assert [one.kind for one in curve.events] == [kind]
    assert list(curve.events[0].free.values()) == pytest.approx([0.0, 0.0], abs=1e-7)


def langford(a, b, c, d):
    """Cycles z = b, r^2 = c + a b - b^3 / 3, of which pairs pass the unit circle at a = b^2."""

    def field(_, x, p):
        rate = x.z - p.b
        return [rate * x.x - p.d * x.y, p.d * x.x + rate * x.y, p.c + p.a * x.z - x.z**3 / 3 - x.x**2 - x.y**2]

    model = of.ode(field, ("x", "y", "z"), {"a": a, "b": b, "c": c, "d": d})
    guess = of.Guess([np.sqrt(c + a * b - b**3 / 3), 0, b], 2 * np.pi / d)
    return model, of.Problem(model, guess, name="langford")


def test_a_curve_of_tori_and_its_strong_resonances():
    """a = b^2 for every c, the pair turned by 2 pi sqrt(2 c + 4 b^3 / 3) / d: 1:4 and 1:3 where that is 1/4 and 1/3."""
    model, problem = langford(0.4, 0.7, 0.3, 3.5)
    family = of.follow_family(problem, "a", until=0.6, model=model, settings=FEW)
    curve = of.follow_curve(family, event_of(family, "torus"), ("c", "a"), at=(0.1, 0.5), settings=FEW, model=model)
    at = curve.places[: len(curve.points)]
    assert np.abs(at[:, 1] - 0.49).max() < 1e-12
    found = {one.detail: one.free["c"] for one in curve.events}
    wanted = {f"1:{q}": ((3.5 / q) ** 2 - 4 * 0.7**3 / 3) / 2 for q in (3, 4)}
    assert found == pytest.approx(wanted, abs=1e-8)
    assert all(one.kind == "strong_resonance" for one in curve.events)


def test_a_branch_point_where_the_equations_lose_a_rank():
    """In the plane z = 0, which z -> -z keeps, any cycle loses its symmetry at a = b^2 + b."""

    def field(_, x, p):
        return [x.y, (1 - x.x**2) * x.y - x.x + 0.3, (p.a - p.b - p.b**2) * x.z - x.z**3]

    model = of.ode(field, ("x", "y", "z"), {"a": 0.2, "b": 0.3})
    family = of.follow_family(of.Problem(model, of.Guess([2.0, 0, 0], 6.66), name="plane"), "a", until=0.6, model=model,
                              settings=FEW)  # fmt: skip
    start = curve_start(family, event_of(family, "branch_point"), ("b", "a"), model=model)
    assert start.start.curve.degenerate
    settings = replace(FEW, points=12)
    curve = of.follow_curve(family, start.event, ("b", "a"), at=(0.0,), settings=settings, model=model)
    at = curve.places[: len(curve.points)]
    assert np.abs(at[:, 1] - at[:, 0] - at[:, 0] ** 2).max() < 1e-11 and np.ptp(at[:, 0]) > 0.25


def test_a_conservative_doubling_keeps_its_scaling():
    """x -> x / c takes Henon and Heiles' coupling 1 to c and the energy to E / c^2: E c^2 and T stay as they are."""
    problem = of.load_problem(PROBLEMS / "henon-heiles-straight.toml")
    family = of.follow_family(problem, until=0.14, settings=replace(FEW, directions="forward", resonances=3))
    event = event_of(family, "period_doubling")
    curve = of.follow_curve(family, event, ("energy", "coupling"), settings=replace(FEW, points=3))
    at, periods = curve.places[: len(curve.points)], curve.values("period")
    assert len(at) == 7 and np.ptp(at[:, 1]) > 0.1
    assert np.abs(at[:, 0] * at[:, 1] ** 2 / family.events[event].energy - 1).max() < 1e-9
    assert np.abs(periods / family.events[event].period - 1).max() < 1e-9
    assert np.abs(np.array([one.indices[0] for one in curve.points]) + 2).max() < 1e-9


@pytest.mark.slow
def test_a_stop_is_grazed_at_the_amplitude_of_the_linear_oscillator():
    """stop = 1 / |1 - w^2 + i c w| for every frequency w."""
    guess = of.Guess([0.0, -1.0, 1.0], 2.24)
    orbit = of.find_orbit(of.Problem(impact_oscillator(frequency=2.8), guess, winding=(0, 0, 1)))
    family = of.follow_family(orbit, "stop", settings=replace(FEW, directions="forward"))
    curve = of.follow_curve(family, len(family.events) - 1, ("frequency", "stop"), settings=replace(FEW, points=3))
    w, stop = curve.places[: len(curve.points)].T
    assert len(w) == 7 and np.abs(stop * np.abs(1 - w**2 + 0.1j * w) - 1).max() < 1e-9


# ---- numbers computed outside this project -------------------------------------------------------------------


def test_folds_of_duffings_oscillator(duffing):
    """By a Taylor integration of 140 bits; the cusp is the same whichever fold is followed to it."""
    folds = [k for k, one in enumerate(duffing.events) if one.kind == "fold"]
    wanted = [(1.7797195242985731, 2.2119353170197306), (1.3242362007705656, 1.4386701455142775)]
    cusps = []
    for fold, (first, second) in zip(folds, wanted, strict=True):
        assert duffing.events[fold].parameter == pytest.approx(first, abs=1e-10)
        curve = of.follow_curve(duffing, fold, ("force", "frequency"), at=(0.5,), settings=FEW)
        assert curve.points[-1].free == pytest.approx({"force": 0.5, "frequency": second}, abs=1e-10)
        both = of.follow_curve(
            duffing, fold, ("force", "frequency"), settings=replace(FEW, directions="backward", points=40)
        )
        cusps += [list(one.free.values()) for one in both.events if one.kind == "cusp"]
    assert len(cusps) == 2 and cusps[0] == pytest.approx(cusps[1], abs=1e-8)


def test_doublings_of_two_pendula():
    """AUTO's demo pen at damping 0.1 and 0.5, by a Taylor integration of 140 bits."""
    family = of.follow_family(of.load_problem(PROBLEMS / "coupled-pendula.toml"), "torque", until=0.17, settings=FEW)
    curve = of.follow_curve(family, 0, ("damping", "torque"), at=(0.5,), settings=FEW)
    first, last = curve.points[0], curve.points[-1]
    assert (first.free["torque"], first.period) == pytest.approx((0.17916377626865378, 3.705272099971783), abs=1e-10)
    assert (last.free["torque"], last.period) == pytest.approx((0.7966132828830927, 4.295290713655122), abs=1e-10)


@pytest.mark.slow
def test_a_doubling_of_lorenz_equations():
    """At sigma 10, by a Taylor integration of 140 bits."""
    family = of.follow_family(of.load_problem(PROBLEMS / "lorenz-doubling.toml"), "rho", until=225.0, settings=FEW)
    point = curve_start(family, event_of(family, "period_doubling"), ("sigma", "rho")).start.solution.place
    assert point.free == pytest.approx([10.0, 229.40670856144345], abs=1e-8)
    assert point.period == pytest.approx(0.4808668203110952, abs=1e-10)


@pytest.mark.slow
def test_the_locus_of_the_pendula_ends_homoclinically():
    """AUTO stops at period 29.999: damping 0.980643, torque 0.957295."""
    family = of.follow_family(of.load_problem(PROBLEMS / "coupled-pendula.toml"), "torque", until=0.17, settings=FEW)
    settings = replace(FEW, points=300, directions="forward")
    curve = of.follow_curve(family, 0, ("damping", "torque"), settings=settings)
    late = curve.values("period") > 25
    at = curve.places[: len(curve.points)][late]
    slow = np.array([np.interp(29.999, curve.values("period")[late], one) for one in at.T])
    assert slow == pytest.approx([0.980643, 0.957295], abs=3e-5)


def flipping():
    """A cycle r = 1 about which (u, w) turn by half a turn: u' = a u + b u^3 + d u^5, w' = -w.

    Its multipliers are -e^(2 pi a), -e^(-2 pi); the doubled orbit is at a + b u^2 + ... = 0, born to either side by b.
    """

    def field(_, x, p):
        radius = ca.sqrt(x.x**2 + x.y**2)
        angle = ca.atan2(x.y, x.x) / 2
        u = ca.cos(angle) * (radius - 1) + ca.sin(angle) * x.z
        w = -ca.sin(angle) * (radius - 1) + ca.cos(angle) * x.z
        grow, sink = (p.a + p.c) * u + p.b * u**3 + p.d * u**5, -w
        out = ca.cos(angle) * grow - ca.sin(angle) * sink - x.z / 2
        up = ca.sin(angle) * grow + ca.cos(angle) * sink + (radius - 1) / 2
        return [out * x.x / radius - x.y, out * x.y / radius + x.x, up]

    return of.ode(field, ("x", "y", "z"), {"a": -0.1, "b": -0.5, "c": 0.0, "d": -1.0})


@pytest.mark.slow
def test_a_doubling_degenerates_where_its_orbit_is_born_to_the_other_side():
    """At b = 0 and nowhere else, by the normal form's coefficient; what b and d leave where it is has no curve."""
    model = flipping()
    problem = of.Problem(model, of.Guess([1.0, 0.0, 0.0], 2 * np.pi), name="flipping")
    chosen = replace(FEW, directions="forward")
    family = of.follow_family(problem, "a", until=0.1, settings=chosen, model=model)
    event = event_of(family, "period_doubling")
    curve = of.follow_curve(family, event, ("b", "c"), until=0.5, settings=chosen, model=model)
    (special,) = [one for one in curve.events if one.kind == "degenerate_doubling"]
    assert special.free == pytest.approx({"b": 0.0, "c": 0.0}, abs=1e-6)
    assert max(abs(one.free["c"]) for one in curve.points) < 1e-9  # the doubling itself is at a + c = 0
    start = curve_start(family, event, ("b", "c"), model=model).start
    # along u' = b u^3 from the section u -> -u (1 + 2 pi b u^2), so that xi -> -xi + c xi^3 with c = -2 pi b
    assert bending(start.curve, start.solution) == pytest.approx(-2 * np.pi * -0.5, rel=1e-4)
    with pytest.raises(InputError, match="happens whatever b and d are; give a parameter that moves it"):
        curve_start(family, event, ("b", "d"), model=model)


# ---- ends and planted failures -------------------------------------------------------------------------------


def entrained():
    """A van der Pol oscillator that a force has entrained, up to where it lets go."""

    def field(t, x, p):
        return [x.v, 0.4 * (1 - x.x**2) * x.v - x.x + p.force * ca.cos(p.frequency * t)]

    model = of.ode(
        field, ("x", "v"), {"force": 0.6, "frequency": 1.0}, forcing_period=lambda p: 2 * np.pi / p.frequency
    )
    problem = of.Problem(model, of.Guess([2.0, 0.0], 2 * np.pi), name="entrained")
    return model, of.follow_family(
        problem, "frequency", until=1.3, model=model, settings=replace(FEW, directions="forward")
    )


@pytest.mark.slow
def test_a_curve_of_tori_ends_where_its_multipliers_become_real():
    """At 1:1, beyond which neutral saddles meet the same equations. An orbit that is its own mirror image after half a
    period goes on through 1:2: the pair of its half map is at +-i there."""
    model, family = entrained()
    curve = of.follow_curve(family, event_of(family, "torus"), ("force", "frequency"), settings=replace(FEW, points=20),
                            model=model)  # fmt: skip
    assert [one.detail for one in curve.events] == ["1:1", "1:4", "1:3", "1:2"]
    assert [end.kind for end in curve.ends] == ["strong_resonance", "point limit"]
    assert "become real at a 1:1 resonance; beyond is a neutral saddle" in curve.ends[0].reason
    pairs = np.array([one.floquet_multipliers for one in curve.points])
    assert np.abs(np.abs(pairs) - 1).max() < 1e-9 and np.abs(pairs.imag).min() > 1e-6
    for event, mu in zip(curve.events, (1.0, 1j, np.exp(2j * np.pi / 3), -1.0), strict=True):
        found = np.linalg.eigvals(multipliers_of(model, event))
        assert np.abs(found - mu).min() < 1e-4 and np.prod(found) == pytest.approx(1.0, abs=1e-8)


def multipliers_of(model, event):
    """The monodromy of an event by another integrator."""
    from scipy.integrate import solve_ivp

    force, frequency = event.free["force"], event.free["frequency"]

    def rates(t, y):
        x, v = y[:2]
        slopes = np.array([[0, 1], [-0.8 * x * v - 1, 0.4 * (1 - x**2)]])
        moving = [v, 0.4 * (1 - x**2) * v - x + force * np.cos(frequency * t)]
        return np.concatenate([moving, (slopes @ y[2:].reshape(2, 2)).ravel()])

    start = np.concatenate([event.state, np.eye(2).ravel()])
    end = solve_ivp(rates, (0, event.period), start, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    assert end[:2] == pytest.approx(event.state, abs=1e-9)
    return end[2:].reshape(2, 2)


def test_a_neutral_saddle_is_no_torus():
    """Without damping a driven pendulum's saddle has real multipliers of product 1: no event, and none is forged."""
    model = of.systems.forced_pendulum(damping=-0.02, torque=0.3, frequency=1.0, gravity=1.0)
    problem = of.Problem(model, of.Guess([np.pi, 0.0], 2 * np.pi), name="upright")
    family = of.follow_family(problem, "damping", until=0.02, settings=replace(FEW, directions="forward"))
    pairs = np.array([one.floquet_multipliers for one in family.points])
    products = np.prod(pairs, axis=1).real
    assert products[0] > 1 > products[-1] and np.all(pairs.imag == 0) and np.all(np.abs(pairs[:, 0]) > 1.5)
    assert not [one for one in family.events if one.kind == "torus"]
    point = family.points[int(np.abs(products - 1).argmin())]
    forged = of.follow_family(problem, "damping", at=(0.0,), settings=replace(FEW, directions="forward"))
    point = next(one for one in forged.points if abs(one.value) < 1e-12)
    event = event_like(point)
    with pytest.raises(ConvergenceError, match="a neutral saddle and no torus"):
        of.follow_curve(replace(family, events=(event,)), 0, ("torque", "damping"), settings=FEW)


def event_like(point):
    """An event of kind torus at a point where there is none."""
    return Event("torus", point.index, point.arclength, point.value, point.state, point.period, point.energy,
                 multiplier=0.6 + 0.8j, shooting_nodes=point.shooting_nodes, mesh=point.mesh, tangent=point.tangent,
                 symmetry=point.symmetry, free=point.free)  # fmt: skip


def test_a_branch_point_that_no_symmetry_keeps_is_no_curve():
    """b u - u^2 crosses u = 0 at b = 0, but (a + b u - u^2) does not: its two families avoid each other."""
    model = turning(lambda rho, p: p.a + p.b * (rho - 1) - (rho - 1) ** 2, ("a", "b"), (0.0, -0.4))
    family = family_of(model, "b", 0.3)
    event = event_of(family, "branch_point")
    assert family.events[event].parameter == pytest.approx(0.0, abs=1e-8)
    with pytest.raises(InputError, match="branch point 0: branch_point at b .* one of a and b does: folds leave"):
        curve_start(family, event, ("a", "b"), model=model)


def test_messages(duffing, tmp_path):
    """What cannot be followed is said with what can."""
    fold = event_of(duffing, "fold")
    verdict = event_of(duffing, "stability_change")
    for event, names, said in (
        (99, ("force", "frequency"), "event: duffing-resonance has no event 99; choose one of 0: fold frequency at"),
        (verdict, ("force", "frequency"), r"no curve leads through event \d \(stability_change\); choose one of"),
        (fold, ("force", "frequencies"), "unknown 'frequencies', did you mean 'frequency'.*use two of"),
        (fold, ("energy", "frequency"), "parameters: unknown 'energy'"),
        (fold, ("force", "force"), "parameters: 'force' twice"),
        (fold, ("force",), r"two names are needed, got 1 \(force\)"),
    ):
        with pytest.raises(InputError, match=said):
            curve_start(duffing, event, names)
    bare = tmp_path / "family.json"
    save_family(duffing, tmp_path)
    (tmp_path / "family.npz").unlink()
    with pytest.raises(InputError, match="family.npz is not beside it"):
        of.follow_curve(bare, fold, ("force", "frequency"))


def test_energy_and_period_are_no_two_parameters():
    """Of one orbit one follows from the other; and a fold of the period alone is no bifurcation."""
    problem = of.load_problem(PROBLEMS / "henon-heiles-straight.toml")
    family = of.follow_family(problem, until=0.14, settings=replace(FEW, directions="forward", resonances=3))
    with pytest.raises(InputError, match="energy and period are the family's own.*coupling"):
        curve_start(family, 0, ("energy", "period"))
    turned = replace(family.events[0], kind="fold", detail="period")
    with pytest.raises(InputError, match=r"at a fold of the period no multiplier is at \+1"):
        curve_start(replace(family, events=(turned,)), 0, ("energy", "coupling"))


# ---- records, pictures, parts --------------------------------------------------------------------------------


def test_record_resume_and_figure(duffing, tmp_path):
    """A curve is written, goes on where it was stopped, is read back with what it keeps, and is drawn."""
    chosen = replace(FEW, directions="backward", certify=True)
    fold = event_of(duffing, "fold")
    for points in (5, 24):
        curve = of.follow_curve(duffing, fold, ("force", "frequency"), points=points, settings=chosen, out=tmp_path)
    folder = tmp_path / "duffing-resonance-0-force-frequency"
    lines = (folder / "family.jsonl").read_text().splitlines()
    assert sum('"end":{' in line for line in lines) == 2  # it was not begun again
    alone = of.follow_curve(duffing, fold, ("force", "frequency"), points=24, settings=chosen)
    known = load_family(folder / "family.json")
    assert known.parameters == ("force", "frequency") == alone.parameters
    assert len(known.points) == len(curve.points) and np.array_equal(known.places, curve.places)
    nearest = np.abs(known.places[:, None] - alone.places[None]).max(axis=2).min(axis=1)
    assert np.abs(nearest[:6]).max() < 1e-9 and np.ptp(known.places[:, 0]) > 0.2
    assert known.curve["test"]["kind"] == "fold" and known.source["kind"] == "curve"
    assert [one.kind for one in known.events] == ["cusp"]
    failed = {one.name for one in of.certify(known.points[3]).checks if not one.passed}
    assert failed <= {"distance"}  # at a fold no orbit is isolated
    with pytest.raises(InputError, match="is a curve in two parameters itself"):
        of.follow_curve(known, 0, ("force", "frequency"))
    written = {path.name for path in save_figures(known, tmp_path)}
    assert "two_parameters.png" in written and "response.png" not in written
    labels = [text.get_text() for text in two_parameters([known, alone]).axes[0].texts]
    assert labels == ["cusp"] and "cusp" in known._repr_html_()
    with pytest.raises(InputError, match="varies frequency; give curves in"):
        two_parameters([duffing])


def test_the_command(duffing, tmp_path):
    """--curve and --parameters; options that do not go together exit with 2."""
    save_family(duffing, tmp_path)
    file = str(tmp_path / "family.json")
    asked = [
        "continue",
        file,
        "--curve",
        "0",
        "--parameters",
        "force,frequency",
        "--out",
        str(tmp_path),
        "--no-figures",
    ]
    code, printed, _ = run([*asked, "--no-figures", "--at", "0.32", "--json"])
    told = json.loads(printed)
    assert code == 0
    assert told["parameters"] == ["force", "frequency"] and told["name"] == "duffing-resonance-0-force-frequency"
    for more, said in (
        (["--curve", "0"], "--parameters: missing beside --curve"),
        (["--parameters", "force,frequency"], "--curve: missing beside --parameters"),
        (["--curve", "0", "--parameters", "force,frequency", "--switch", "0"], "goes without --parameter and --switch"),
        (["--curve", "1", "--parameters", "force,frequency"], "no curve leads through event 1"),
    ):
        code, _, printed = run(["continue", file, *more])
        assert code == 2 and said in printed
    code, _, printed = run(
        ["continue", str(PROBLEMS / "duffing-resonance.toml"), "--curve", "0", "--parameters", "a,b"]
    )
    assert code == 2 and "is not a family.json" in printed


def run(arguments):
    """A command: its exit code and what it printed."""
    found = CliRunner().invoke(cli, arguments)
    return found.exit_code, found.stdout, found.stderr


def test_the_row_of_the_test_is_its_derivative(duffing):
    """A curve leads along the kernel of all rows, the test's among them: where its orbits go, by their differences."""
    values = 0.305 + 1e-4 * np.array([-2, -1, 0, 1, 2])
    curve = of.follow_curve(duffing, event_of(duffing, "fold"), ("force", "frequency"), at=values, until=0.31,
                            settings=FEW)  # fmt: skip
    points = [next(one for one in curve.points if abs(one.free["force"] - value) < 1e-12) for value in values]
    along, weights = points[2].tangent, np.array([1, -8, 0, 8, -1]) / 12e-4
    for numbers, rate in (([one.free["frequency"] for one in points], along[-1]),
                          ([one.period for one in points], along[2])):  # fmt: skip
        assert rate / along[-2] == pytest.approx(weights @ numbers, rel=1e-9)


# ---- planted maps ----------------------------------------------------------------------------------------------


def curve_of(problem, kind, until):
    """The curve of the first event of a kind of a planted map M(s, r), to a value of r."""
    family = planted(problem, 1.0)
    settings = replace(FEW, directions="backward" if until < 0 else "forward", points=30)
    with compiling("off"):
        return of.follow_curve(family, event_of(family, kind), ("r", "s"), until=until, settings=settings,
                               model=problem.model)  # fmt: skip


def test_a_curve_of_doublings_where_another_multiplier_is_minus_one_too():
    """-0.7 - s and r, whatever 0.2 does: the product over roots vanishes, and twice where two roots are there."""
    curve = curve_of(wound_back(lambda s, r: diagonal(-0.7 - s, r, 0.2), 3, r=-0.5), "period_doubling", -1.5)
    at = curve.places[: len(curve.points)]
    assert np.abs(at[:, 1] - 1.3).max() < 1e-9 and [end.kind for end in curve.ends] == ["target"]
    (event,) = curve.events
    assert (event.kind, event.detail) == ("strong_resonance", "1:2")
    assert event.free == pytest.approx({"r": -1.0, "s": 1.3}, abs=1e-9)


def test_a_curve_of_tori_beside_a_multiplier_of_minus_one():
    """(0.6 -+ 0.8 i) (s + r / 10 + 0.5) and r: the pair is told by its product, whatever is beside it, a pair of
    product 1/4 too."""

    def family(s, r):
        other = ca.DM([[0.3, -0.4], [0.4, 0.3]])
        return ca.diagcat((0.5 + s + r / 10) * ca.DM([[0.6, -0.8], [0.8, 0.6]]), r, other)

    curve = curve_of(wound_back(family, 5, r=-0.5), "torus", -1.5)
    at = curve.places[: len(curve.points)]
    assert np.abs(at[:, 1] + at[:, 0] / 10 - 1.5).max() < 1e-9 and [end.kind for end in curve.ends] == ["target"]
    (event,) = curve.events
    assert event.kind == "doubling_torus" and event.free == pytest.approx({"r": -1.0, "s": 1.6}, abs=1e-9)


def test_a_curve_of_collisions_in_closed_form():
    """2 eig [[0.35 - s, -c], [c, 0.25]] are one where 0.1 - s = 2 c, c = (1 + r) / 50."""

    def family(s, r):
        c = (1 + r) / 50
        return symplectic(ca.blockcat([[0.35 - s, -c], [c, 0.25]]))

    curve = curve_of(bouncing(family, 2, r=0.5), "collision", 0.9)
    at = curve.places[: len(curve.points)]
    assert np.abs(at[:, 1] - (1.06 - 0.04 * at[:, 0])).max() < 1e-9 and [end.kind for end in curve.ends] == ["target"]
    (event,) = curve_of(bouncing(family, 2, r=0.5), "collision", -20.0).events  # where both indices are 0
    assert (event.kind, event.detail) == ("strong_resonance", "1:4")
    assert event.free == pytest.approx({"r": -13.5, "s": 1.6}, abs=1e-9)


@pytest.mark.parametrize(
    ("system", "family", "kind", "said"),
    [
        (wound_back, lambda s, r: diagonal(0.5 + s), "torus", "no two multipliers are left"),
        (bouncing, lambda s, r: ca.DM([[0.5, 1.0], [-0.75, 0.5]]), "collision", "no two stability indices"),
    ],
)
def test_what_one_root_cannot_do_has_no_curve(system, family, kind, said):
    """A forged event."""
    problem = system(family, 1, r=1.0)
    found = planted(problem, 0.1)
    event = replace(event_like(found.points[0]), kind=kind)
    with pytest.raises(ConvergenceError, match=said):
        of.follow_curve(replace(found, events=(event,)), 0, ("r", "s"), settings=FEW, model=problem.model)
