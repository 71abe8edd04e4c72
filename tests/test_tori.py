"""Invariant tori: exact ones, the golden one of Hénon and Heiles, and what must not be called a torus."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, root
from scipy.special import ellipk

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.integrate.march import uniform
from orbitfinder.loops.loop import Equations
from orbitfinder.loops.symmetry import NONE
from orbitfinder.show.tori import save_torus_figures
from orbitfinder.site.gather import gather
from orbitfinder.site.section import section_data
from orbitfinder.structures.ring import Circle, Turned, at_angles, resampled, turning
from orbitfinder.structures.sections import surface
from orbitfinder.structures.tori import certify_torus, crossed, filled, resonance

GOLDEN = (3 - 5**0.5) / 4
REFERENCE = next(
    one for one in json.loads((Path(__file__).parent / "data" / "curves.json").read_text())["entries"]
    if one["id"] == "hh-torus"
)["values"]  # fmt: skip


@pytest.fixture(scope="module")
def loop_orbit():
    guess = of.Guess([0, 0.25, 0.3, 0.0], 6.2)
    return of.find_orbit(of.Problem(of.systems.henon_heiles(), guess=guess, pin=of.pin(energy=1 / 12)))


@pytest.fixture(scope="module")
def golden(loop_orbit):
    return of.torus(loop_orbit, GOLDEN)


def rates(_, x):
    return [x[2], x[3], -x[0] - 2 * x[0] * x[1], -x[1] - x[0] ** 2 + x[1] ** 2]


def test_the_golden_torus_of_henon_and_heiles(golden):
    assert golden.certificate.passed, golden.certificate.failures
    assert golden.rotation == pytest.approx(GOLDEN, abs=1e-14)
    assert golden.period == pytest.approx(float(REFERENCE["mean_return_time"]), abs=1e-10)
    assert golden.frequencies[0] == pytest.approx(float(REFERENCE["omega1"]), abs=1e-10)
    assert golden.frequencies[1] == pytest.approx(float(REFERENCE["omega2"]), abs=1e-10)
    lines, model = 60, of.systems.henon_heiles()
    paths = filled(golden, model, lines)
    times = np.linspace(0.0, golden.period, paths.shape[1])

    def end(place):
        start = at_angles(golden.curve, place[:1])[0]
        return solve_ivp(rates, (0, place[1]), start, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]

    for name, side in (("y_right", 1), ("y_left", -1)):  # where the torus meets x = 0, py = 0, px > 0
        away = np.hypot(paths[:, :, 0], paths[:, :, 3])
        away[(paths[:, :, 2] < 0) | (side * (paths[:, :, 1] - 0.25) < 0)] = np.inf
        line, place = np.unravel_index(np.argmin(away), away.shape)
        met = root(lambda at: end(at)[[0, 3]], [2 * np.pi * line / lines, times[place]], tol=1e-12).x
        assert end(met)[1] == pytest.approx(float(REFERENCE[name]), abs=1e-10)


def test_frequencies_of_the_golden_torus(golden):
    """Those of the reference, of motions that begin on it: the basis that is found is w1, w1 - w2."""
    found = of.frequency_map(of.systems.henon_heiles(), golden.curve[:1], 2400.0)
    first, second = float(REFERENCE["omega1"]), float(REFERENCE["omega2"])
    np.testing.assert_allclose(found.frequencies[0], [first, first - second], rtol=0, atol=1e-8)
    assert found.diffusion[0] < 1e-8


def test_a_torus_is_drawn_in_a_section(golden, loop_orbit, tmp_path):
    """Its crossings lie on the plane, at its energy, and on the curve that returns of one of its motions draw."""
    model = of.systems.henon_heiles()
    found = surface(model, "x=0", ("y", "ydot"))
    states = crossed(golden, found)
    assert np.abs(states[:, 0]).max() == 0 and max(abs(of.energy(model, one) - 1 / 12) for one in states[::40]) < 1e-12
    ends = [states[:, 1].max(), states[:, 1].min()]
    assert ends == pytest.approx([float(REFERENCE["y_right"]), float(REFERENCE["y_left"])], abs=1e-5)
    returns = found.passing(states[:1], 40, tolerance=1e-13).states[0][:, 1:4:2]
    apart = np.linalg.norm(returns[:, None] - states[None][:, :, 1:4:2], axis=2).min(axis=1)
    assert apart.max() < 2e-3  # half of what neighbours of the 480 are apart
    with pytest.raises(InputError, match="plane: the torus does not cross x = 3"):
        crossed(golden, surface(model, "x=3", ("y", "ydot")))
    of.save_orbit(replace(loop_orbit, name="loop"), tmp_path / "orbit.json")
    family = of.Tori("golden", loop_orbit.system, "rotation", {}, (golden,))
    of.save_tori(family, tmp_path / "tori.json")
    asked = ["section", tmp_path / "orbit.json", "--plane", "x=0", "--axes", "y,ydot", "--seeds", 3, "--returns", 9]
    drawn = [*asked, "--with", tmp_path / "tori.json", "-o", tmp_path]
    done = CliRunner().invoke(cli, list(map(str, drawn)), catch_exceptions=False)
    assert done.exit_code == 0 and (tmp_path / "loop" / "section.png").stat().st_size > 20_000
    together = gather([tmp_path / "loop" / "section.json", tmp_path / "tori.json"])
    data = section_data(together.sections[0], together)
    assert [one["kind"] for one in data["curves"]] == ["torus"] and len(data["curves"][0]["x"]) == len(states)


def duffing(level):
    """rad/s of x'' = -k x - x^3 with k = 1 from its energy, by the complete elliptic integral."""
    square = np.sqrt(1 + 4 * level) - 1
    return np.sqrt(1 + square) * np.pi / 2 / ellipk(square / 2 / (1 + square))


@pytest.mark.parametrize("rotation", [0.75**0.5 - 0.175, 1.175 - 0.75**0.5])
def test_a_torus_of_an_integrable_product_either_way_round(rotation):
    """Two oscillators that know nothing of each other, the second 1.7 times as quick and hardening: 0.676 to 0.709."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    first, second = q[0] ** 2 / 2 + q[0] ** 4 / 4, 1.7**2 * (q[1] ** 2 / 2 + q[1] ** 4 / 4)
    scaled = of.lagrange(v[0] ** 2 / 2 + v[1] ** 2 / 2, first + second, of.Symbols(q, v), angles=(False, False))
    level = 0.02
    quick = 1.7 / duffing(level)
    orbit = of.find_orbit(of.Problem(scaled, of.Guess([0.2, 0, 0, 0], 6.2), of.pin(energy=level)))
    assert quick == pytest.approx(1.6755578, abs=1e-6)
    torus = of.torus(orbit, rotation, model=scaled)
    assert torus.certificate.passed and torus.rotation == pytest.approx(rotation, abs=1e-12)
    share = brentq(lambda own: 1.7 * duffing((level - own) / 1.7**2) / duffing(own) - 0.825 - 0.75**0.5, 0.0, level)
    assert torus.period == pytest.approx(2 * np.pi / duffing(share), rel=1e-9)


def rotor(detuning=0.0):
    """x' = - x + cos t and a limit cycle of radius sqrt(mu) that turns with w: a torus that is known."""

    def field(t, x, p):
        square = x.u**2 + x.v**2
        return [-x.x + ca.cos(t), (p.mu - square) * x.u - p.w * x.v, (p.mu - square) * x.v + p.w * x.u]

    given = {"mu": 0.0, "w": 5**0.5 / 5 + detuning}
    return of.ode(field, ("x", "u", "v"), given, forcing_period=2 * np.pi)


def test_a_torus_that_is_known_exactly():
    model = rotor()
    guess = of.Guess([0.5, 0.0, 0.0], 2 * np.pi)
    orbit = of.find_orbit(of.Problem(model, guess=guess))
    with pytest.raises(InputError, match="parameter: None; tori of a system without energy are followed in one of mu"):
        of.follow_tori(orbit, model=model)
    found = of.follow_tori(orbit, parameter="mu", until=0.25, model=model, settings=of.TorusSettings(certify=False))
    assert found.end == "mu reached 0.25"
    for one in found.tori:
        radius, grown = np.hypot(one.curve[:, 1], one.curve[:, 2]), 4 * np.pi * one.free["mu"]  # slow attraction
        assert radius == pytest.approx(one.free["mu"] ** 0.5, abs=1e-12 / min(grown, 1.0))
        assert one.curve[:, 0] == pytest.approx(0.5, abs=1e-11)
        assert one.rotation == pytest.approx(5**0.5 / 5, abs=1e-11)
        assert np.isnan(one.energy)
    last = certify_torus(found.tori[-1], model)
    assert last.certificate.passed, last.certificate.failures


def test_the_jacobian_is_that_of_the_rows(golden):
    model, h = of.systems.henon_heiles(), 1e-6
    equations = Equations(model, NONE)
    w = Turned(resampled(golden.curve, 17), golden.period, 1.2, np.zeros(0))
    ring = Circle(
        equations, np.array([1.0, 2.0, 1.0, 0.5]), 0.7, np.zeros(0), (("energy", 0.08), ("rotation", 1.1)), 64
    )
    found = ring.linearise(w)[1].matrix
    columns = ring.columns(w)
    for k in (0, 5, 30, 66, 67, 68, 69):
        step = np.zeros(columns.size)
        step[k] = h * columns[k]
        numeric = (ring.rows(w.moved(step)) - ring.rows(w.moved(-step))) / (2 * h)
        assert found[:, k] == pytest.approx(numeric, abs=2e-8)


def test_turning_a_curve_is_exact_for_its_harmonics():
    angles = 2 * np.pi * np.arange(9) / 9
    curve = np.column_stack([np.cos(3 * angles), np.sin(angles + 0.2), np.ones(9)])
    turn, slope = turning(9, 0.7)
    assert turn @ curve == pytest.approx(at_angles(curve, angles + 0.7), abs=1e-14)
    assert slope @ curve == pytest.approx(at_angles(curve, angles + 0.7, derivative=True), abs=1e-13)


def test_what_is_no_torus_is_rejected(golden):
    model = of.systems.henon_heiles()

    def failures(**changed):
        return certify_torus(replace(golden, **changed), model).certificate.failures

    bent = golden.curve + 1e-7 * np.cos(5 * np.arange(len(golden.curve)))[:, None]
    assert "invariance" in failures(curve=bent)
    assert "invariance" in failures(rotation=golden.rotation + 1e-8)
    assert "energy" in failures(energy=golden.energy + 1e-8)
    twice = at_angles(golden.curve, 4 * np.pi * np.arange(199) / 199)  # gone round twice: half the rotation number
    assert failures(curve=twice, rotation=golden.rotation / 2) == ("once",)
    assert "resonance" in failures(rotation=0.2)


def test_an_orbit_is_no_torus(loop_orbit):
    """The states of one orbit, with a shift in time as its angle, and one state again and again."""
    model = of.systems.henon_heiles()
    march = Equations(model, NONE).march
    path = march.states(loop_orbit.state[None], uniform(1.0, 1, 41 * 8), np.array([loop_orbit.period, 0.0]))
    flat = of.Torus(path[:-1:8], loop_orbit.period * GOLDEN, GOLDEN, loop_orbit.energy, 0.0, 1.0)
    assert certify_torus(flat, model).certificate.failures == ("dimension",)
    still = of.Torus(np.tile(loop_orbit.state, (17, 1)), loop_orbit.period, GOLDEN, loop_orbit.energy, 0.0, 1.0)
    assert "amplitude" in certify_torus(still, model).certificate.failures


def test_a_resonant_number_is_refused(loop_orbit):
    with pytest.raises(InputError, match=r"rotation: 0.2 is resonant, 1/5: such a torus is a ring of periodic orbits"):
        of.torus(loop_orbit, 0.2)
    with pytest.raises(InputError, match="rotation: 1.2; give turns a return, between 0 and 1"):
        of.torus(loop_orbit, 1.2)
    assert resonance(GOLDEN, 400) is None
    assert resonance(3 / 7 + 1e-11, 10) == (3, 7)
    with pytest.raises(ConvergenceError, match="no torus of rotation number 0.123456 was reached"):
        of.torus(loop_orbit, 0.123456, settings=of.TorusSettings(points=2, certify=False))


def test_bad_input(loop_orbit, golden):
    straight = of.Guess([0, 0.4, 0.0, 0.1], 7.0)
    model = of.systems.henon_heiles()
    with pytest.raises(InputError, match="parameter: 'coupling'; tori of a conservative system are followed by hold"):
        of.follow_tori(loop_orbit, parameter="coupling")
    with pytest.raises(InputError, match="hold: 'rotation' begins with a Torus of that rotation number"):
        of.follow_tori(loop_orbit, hold="rotation")
    with pytest.raises(InputError, match=r"hold: 'energi'.*use 'energy' or 'rotation'"):
        of.follow_tori(loop_orbit, hold="energi")
    with pytest.raises(InputError, match="mode: 2; 1 pairs of multipliers turn on the unit circle, give 1 to 1"):
        of.follow_tori(loop_orbit, mode=2)
    with pytest.raises(InputError, match="model: missing; a Torus does not say of which system it is"):
        of.follow_tori(golden, hold="rotation")
    with pytest.raises(InputError, match="origin: expected an Orbit or a Torus, got 3"):
        of.follow_tori(3)
    hyperbolic = of.find_orbit(of.Problem(model, guess=straight, pin=of.pin(energy=1 / 12)))
    if hyperbolic.stability == "unstable":
        with pytest.raises(InputError, match="origin: no pair of multipliers turns on the unit circle"):
            of.follow_tori(hyperbolic)


def test_at_a_fixed_rotation_number_and_the_file(golden, tmp_path):
    model = of.systems.henon_heiles()
    found = of.follow_tori(golden, hold="rotation", until=golden.energy + 0.001, model=model, name="golden")
    assert found.end.startswith("energy reached") and found.held == {"rotation": pytest.approx(GOLDEN)}
    assert all(one.rotation == pytest.approx(GOLDEN, abs=1e-13) for one in found.tori)
    assert all(one.certificate.passed for one in found.tori)
    again = of.load_tori(of.save_tori(found, tmp_path / "tori.json"))
    assert again.end == found.end and again.held == found.held
    table = again.tables()["points"]
    assert table["rotation"] == [one.rotation for one in found.tori] and all(table["certified"])
    assert np.allclose(table["frequency_2"] / table["frequency_1"], table["rotation"])
    for one, other in zip(found.tori, again.tori, strict=True):
        assert np.array_equal(one.curve, other.curve) and one.period == other.period
        assert one.certificate.checks == other.certificate.checks
    assert [path.name for path in save_torus_figures(found, tmp_path, model)] == ["torus.png", "tori.png"]
    (tmp_path / "bad.json").write_text((tmp_path / "tori.json").read_text().replace('"curve"', '"carve"'))
    with pytest.raises(InputError, match=r"bad.json: malformed entry \(tori\[0\].curve: missing\); compute the tori"):
        of.load_tori(tmp_path / "bad.json")
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(InputError, match="other.json: format: expected 'orbitfinder/tori', got None"):
        of.load_tori(tmp_path / "other.json")


def test_the_command(loop_orbit, tmp_path, capfd):
    of.save_orbit(replace(loop_orbit, name="loop"), tmp_path / "orbit.json")
    runner = CliRunner()

    def invoked(*words):
        return runner.invoke(cli, [*map(str, words)], catch_exceptions=False)

    asked = ("torus", tmp_path / "orbit.json", "--out", tmp_path, "--no-figures")
    done = invoked(*asked, "--until", 0.19718, "--json")
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert document["tori"][-1]["rotation"] == pytest.approx(0.19718, abs=1e-14)
    file = tmp_path / "loop-tori" / "tori.json"
    assert invoked("verify", f"{file}#0").exit_code == 0
    assert invoked("torus", f"{file}#99", "--out", tmp_path).exit_code == 2
    assert "give one of them" in invoked("torus", file, "--out", tmp_path).output
    short = invoked(*asked, "--until", 0.1512345, "--points", 2)
    assert short.exit_code == 1 and "point limit of 2" in short.output
    assert re.search(r"states, \d+ s left\n", capfd.readouterr().err)
    spoilt = json.loads(file.read_text())
    spoilt["tori"][0]["curve"][3][0] += 1e-6
    file.write_text(json.dumps(spoilt))
    failed = invoked("verify", f"{file}#0")
    assert failed.exit_code == 1 and "REJECTED by invariance" in failed.output


@pytest.mark.slow
def test_tori_of_the_double_pendulum_break_down():
    """At a noble rotation number [0; 2, 6, 1, 1, ...], from energy -17 up until the strip has all but closed."""
    problem = of.load_problem("problems/gallery/double-pendulum-fast-mode.toml")
    orbit = of.find_orbit(replace(problem, pin=of.pin(energy=-17.0)))
    one = of.torus(orbit, 1 / (2 + 1 / (6 + 2 / (1 + 5**0.5))))
    settings = of.TorusSettings(points=60, most_states=251)
    found = of.follow_tori(one, hold="rotation", model=problem.model, settings=settings)
    assert found.end.startswith("break-down near energy") and "the strip of convergence is" in found.end
    assert all(torus.certificate.passed for torus in found.tori)
    widths = [torus.strip for torus in found.tori]
    narrowest = np.log(1e11) / (5 / 6 * 125)  # whose harmonics beyond five sixths of 125 are below 1e-11
    assert widths[-1] < 1.25 * narrowest < 1.5 < widths[0]
