"""Restricted three bodies: published orbits, close approaches, and the families that leave a libration point."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp

from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.families.branches import switch_branch
from orbitfinder.families.folder import follow_family
from orbitfinder.families.point import FamilySettings
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.loop import Equations
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.symmetry import NONE, Symmetry, called, named
from orbitfinder.mechanics.kind import build_model, restricted
from orbitfinder.orbits.certify import certify
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.floquet import analyse
from orbitfinder.orbits.guesses.modes import gyroscopic_modes, normal_mode, rest_near
from orbitfinder.problemfile.read import load_problem
from orbitfinder.records.family import load_family
from orbitfinder.show.facts import has_path
from orbitfinder.show.paths import path_views
from orbitfinder.show.plot import save_figures
from orbitfinder.systems import henon_heiles, restricted_three_body, three_bodies, van_der_pol

ROOT = Path(__file__).parents[1]
DATA = Path(__file__).parent / "data"
NUMBERS = {one["id"]: one for one in json.loads((DATA / "smooth.json").read_text(encoding="utf-8"))["entries"]}
"""Independent numbers: 140-bit Taylor integration outside this project"""
TABLE = json.loads((DATA / "restricted_orbits.json").read_text(encoding="utf-8"))["orbits"]
EARTH_MOON = 0.01215058560962404


def solved(name, room="published"):
    """The orbit of a problem file, with its certificate, which [expected] is part of."""
    orbit = find_orbit(load_problem(ROOT / "problems" / room / f"{name}.toml"))
    assert orbit.certificate.passed, orbit.certificate.failures
    return orbit


def trace(orbit):
    """Sum of the multipliers that are not trivial."""
    return float(orbit.floquet_multipliers.sum().real)


@pytest.mark.parametrize("number", (1, 2))
def test_howells_halo_orbits(number):
    """Of her table, x0 given: the height, the speed, the period and Jacobi's constant."""
    known, orbit = NUMBERS["howell-halo"]["values"][number - 1], solved(f"howell-halo-{number}")
    assert orbit.symmetry == "mirror"
    assert orbit.state[2] == pytest.approx(float(known["z0"]), abs=1e-11)
    assert orbit.state[4] == pytest.approx(float(known["ydot0"]), abs=1e-11)
    assert orbit.period == pytest.approx(2 * float(known["half_T"]), abs=1e-11)
    assert -2 * orbit.energy == pytest.approx(float(known["C"]), abs=1e-11)


@pytest.mark.parametrize("number", (1, 2, 3))
def test_sharps_orbits(number):
    """Past the Moon at 0.006: speed and period, and the trace to ten digits."""
    known, orbit = NUMBERS["sharp-20"]["values"][number - 1], solved(f"sharp-{number}")
    assert orbit.state[3] == pytest.approx(float(known["ydot0"]), abs=1e-12)
    assert orbit.period == pytest.approx(float(known["T"]), abs=1e-12)
    assert trace(orbit) == pytest.approx(float(known["trace_minus_2"]), rel=1e-7)


def test_the_figure_eight():
    """Energy pinned: places, speeds and period of the choreography, and its elliptic multipliers."""
    known, orbit = NUMBERS["figure-eight"]["values"], solved("figure-eight")
    assert orbit.period == pytest.approx(float(known["T"]), abs=1e-11)
    moduli = np.sort(np.abs(orbit.floquet_multipliers.imag))
    assert np.allclose(moduli[-2:], 0.954691690276, atol=1e-7) and orbit.stability == "elliptic"
    x1, y1 = float(known["x1"]), float(known["y1"])
    sizes = np.hypot(*orbit.samples[:, :2].T)  # |x2 - x1|: twice |x1| where the third is in the middle
    assert np.abs(sizes - 2 * np.hypot(x1, y1)).min() < 1e-4


@pytest.mark.parametrize("name", ("Pi1", "Pi4", "Pi7"))
@pytest.mark.parametrize("energy", ("1/12", "1/10"))
def test_henon_heiles_table(name, energy):
    """Period and trace of each, and where it crosses x = 0 with y' = 0."""
    words = NUMBERS["henon-heiles"]["values"][energy][name].split()
    known = {key: float(value) for key, value in zip(words[::2], words[1::2], strict=True)}
    orbit = solved(f"henon-heiles-{name.lower()}-{energy.replace('/', '-')}")
    assert orbit.period == pytest.approx(known["T"], abs=1e-11)
    assert trace(orbit) == pytest.approx(known["trace"], abs=1e-8)
    acceleration = henon_heiles().acceleration

    def rates(_, s):
        return [*s[2:], *acceleration(0.0, s[:2], s[2:], [1.0]).full().ravel()]

    def crosses(_, s):
        return s[0]

    start, clock = orbit.state, (0.0, 0.05)
    if abs(start[0]) > 1e-12 and start[0] * start[2] > 0:
        clock = (0.0, -0.05)
    path = solve_ivp(rates, clock, start, "DOP853", rtol=1e-13, atol=1e-15, events=crosses)
    there = path.y_events[0][-1] if path.y_events[0].size and name != "Pi1" else start
    assert there[1] == pytest.approx(known["y"], abs=1e-9)
    assert abs(there[2]) == pytest.approx(known.get("px", 0.0), abs=1e-9)


@pytest.mark.parametrize("ratio", (1e-7, 0.01215, 0.3, 0.5))
def test_landmarks_are_at_rest(ratio):
    """Nothing moves from a libration point."""
    model = restricted_three_body(ratio, spatial=True)
    for name in ("L1", "L2", "L3", "L4", "L5"):
        place = np.array(model.landmarks[name])
        pull = model.acceleration(0.0, place, np.zeros(3), model.parameter_values).full()
        assert np.abs(pull).max() < 1e-9, name
    assert restricted_three_body(ratio).landmarks["primary"] == (-ratio, 0.0)


def test_jacobis_constant_is_pinned_followed_and_a_column():
    """C = x^2 + y^2 + 2 (1 - m) / r1 + 2 m / r2 - v^2, written out."""

    def constant(x):
        near, far = np.hypot(x[0] + EARTH_MOON, x[1]), np.hypot(x[0] - 1 + EARTH_MOON, x[1])
        return x[:2] @ x[:2] + 2 * (1 - EARTH_MOON) / near + 2 * EARTH_MOON / far - x[2:] @ x[2:]

    model = restricted_three_body(EARTH_MOON)
    orbit = find_orbit(Problem(model, Guess([0.8234, 0.0, 0.0, 0.1263], 2.743), pin=pin(jacobi=3.17)))
    assert orbit.certificate.passed and constant(orbit.state) == pytest.approx(3.17, abs=1e-13)
    followed = [follow_family(orbit, name, model=model, points=1) for name in ("jacobi", "energy")]
    for family in followed:
        table = family.table()
        assert [float(each) for each in table["jacobi"]] == pytest.approx([constant(p.state) for p in family.points])
    assert [float(each) for each in followed[0].table()["jacobi"]] == [point.value for point in followed[0].points]
    with pytest.raises(InputError, match="unknown quantity 'jacobi'"):
        Problem(henon_heiles(), Guess([0.0, 0.1, 0.1, 0.0], 6.0), pin=pin(jacobi=3.0)).count()
    assert restricted(model.system) and not restricted({**model.system, "module": "somebody.elses"})


def test_modes_of_a_libration_point():
    """Frequencies of L1 in closed form: w^2 = (2 - c + sqrt(9 c^2 - 8 c)) / 2 in the plane, c beside it."""
    model = restricted_three_body(EARTH_MOON, spatial=True)
    place = rest_near(model, [0.8, 0.0, 0.0])
    assert np.allclose(place, model.landmarks["L1"], atol=1e-13)
    gap = 1 - EARTH_MOON - place[0]
    pull = (1 - EARTH_MOON) / (place[0] + EARTH_MOON) ** 3 + EARTH_MOON / gap**3
    planar = np.sqrt((2 - pull + np.sqrt(9 * pull**2 - 8 * pull)) / 2)
    frequencies, _ = gyroscopic_modes(model, place)
    assert np.allclose(frequencies, [np.sqrt(pull), planar], rtol=1e-12)
    for mode in (1, 2):
        guess = normal_mode(model, mode, 1e-6, place)
        states = solve_ivp(
            lambda _, s: [*s[3:], *model.acceleration(0.0, s[:3], s[3:], model.parameter_values).full().ravel()],
            (0, guess.period / 2), guess.state, "DOP853", rtol=1e-12, atol=1e-14,
        )  # fmt: skip
        half = 2 * np.append(place, np.zeros(3)) - guess.state  # half a period on, on the other side of the point
        assert np.abs(states.y[:, -1] - half).max() < 1e-8
        assert np.abs(guess.state[[1, 3]]).max() < 1e-15  # begins where the mirror holds it


@pytest.mark.parametrize(
    ("wrong", "message"),
    (
        (lambda model: normal_mode(model, 3, 1e-3, model.landmarks["L1"]), "between 1 and 2, got 3; 2 modes oscillate"),
        (lambda model: normal_mode(model, 1, 1e-3, [0.5, 0.2, 0.1]), r"0.1\] is not an equilibrium"),
        (lambda model: rest_near(model, [0.5]), "shape .1,. for 3 coordinates"),
        (lambda model: rest_near(model, [-EARTH_MOON, 0.0, 0.0]), "no equilibrium found from"),
        (lambda model: restricted_three_body(spatial=1), "spatial: must be true or false, got 1"),
    ),
)
def test_wrong_equilibria_are_said(wrong, message):
    with pytest.raises(InputError, match=message):
        wrong(restricted_three_body(EARTH_MOON, spatial=True))


def test_an_unknown_landmark_is_said(tmp_path):
    text = (ROOT / "problems" / "families" / "lyapunov-l1.toml").read_text(encoding="utf-8")
    (tmp_path / "wrong.toml").write_text(text.replace('"L1"', '"L6"'), encoding="utf-8")
    with pytest.raises(InputError, match="unknown 'L6'; the landmarks of this system are primary, secondary, L1"):
        load_problem(tmp_path / "wrong.toml")


@pytest.mark.parametrize(("name", "symmetry"), (("lyapunov-l1", "mirror"), ("vertical-l1", "mirror+plane")))
def test_small_orbits_about_a_libration_point(name, symmetry):
    """Certified, their action too, which is a millionth of what each half of the loop adds to it."""
    orbit = solved(name, "families")
    assert orbit.symmetry == symmetry and abs(orbit.action) < 1e-5
    other = certify(replace(orbit, action=orbit.action * (1 + 1e-7)))
    assert "action" in other.failures


def test_a_family_shrinks_to_a_libration_point():
    """Its end is the point, named while it is still resolved, and not a step that could not be taken."""
    problem = load_problem(ROOT / "problems" / "families" / "lyapunov-l1.toml")
    family = follow_family(problem, settings=FamilySettings(directions="backward", points=20, events=False))
    (end,) = family.ends
    assert end.kind == "equilibrium" and "0.83691" in end.reason.replace("8.3691", "0.83691"), end
    assert len(family.points) < 18
    system = Equations(problem.model, NONE, ())
    tail = np.concatenate([[1.0], np.zeros(system.march.unfolding)])
    x = np.array([0.83, 0.01, 0.02, 0.1, 0.2, 0.3])
    rates = [system.march.rates((x + h * u)[None], tail)[0] for u in np.eye(6) for h in (1e-6, -1e-6)]
    slopes = np.array([(a - b) / 2e-6 for a, b in zip(rates[::2], rates[1::2], strict=True)]).T
    assert np.allclose(system.march.slopes(x, tail), slopes, rtol=1e-6, atol=1e-5)


def test_false_orbits_past_the_moon_are_rejected():
    """A speed or a period off in the eighth digit is no orbit, however errors grow."""
    orbit = solved("sharp-3")
    for wrong in (
        replace(orbit, state=orbit.state * np.array([1, 1, 1, 1 + 1e-8])),
        replace(orbit, period=orbit.period * (1 + 1e-8)),
        replace(orbit, state=orbit.state + np.array([1e-8, 0, 0, 0])),
    ):
        assert {"closure", "distance"} & set(certify(wrong).failures)
    far = replace(orbit, floquet_multipliers=orbit.floquet_multipliers * (1 + 1e-5))
    assert "floquet_multipliers" in certify(far).failures


def test_a_hyperbolic_pair_is_unstable_whatever_its_small_multiplier():
    """mu = 5e4: an error of 1e-6 in the matrix spoils the pair's product, not the verdict; at mu = 1 it does."""
    assert analyse(np.diag([5e4, 2e-5 + 1e-6])).stability == "unstable"
    turn = np.array([[np.cos(1e-4), -np.sin(1e-4)], [np.sin(1e-4), np.cos(1e-4)]]) * (1 + 5e-7)
    assert analyse(turn).stability == "marginal"


def test_the_mirror_of_a_plane_is_called_axis():
    model = restricted_three_body(spatial=True)
    both = named("mirror+plane", model)
    assert [called(one, model).name for one, _ in both.narrower()] == ["mirror+plane", "mirror", "axis", "plane"]
    assert called(Symmetry(), model).name == "none"


def test_three_unequal_bodies_keep_their_integrals():
    """Energy and angular momentum of a motion in Jacobi coordinates."""
    model, state = three_bodies(1.0, 2.0, 0.5), np.array([1.0, 0.1, -0.3, 1.6, 0.2, 1.0, -0.6, 0.1])
    p = model.parameter_values

    def rates(_, s):
        return [*s[4:], *model.acceleration(0.0, s[:4], s[4:], p).full().ravel()]

    end = solve_ivp(rates, (0.0, 3.0), state, "DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    for one in model.invariants:
        assert float(one.value(end[:4], end[4:], p)) == pytest.approx(float(one.value(state[:4], state[4:], p)), 1e-9)


def test_pictures_mark_bodies_and_libration_points(tmp_path):
    """From every side that the motion has, with a name on each axis; no links of what has none."""
    orbit = solved("howell-halo-2")
    written = {one.name for one in save_figures(orbit, tmp_path)}
    assert written == {"time_histories.png", "phase_portraits.png", "energy_error.png", "path.png"}
    figure = path_views(orbit, build_model(orbit.system))
    assert [(axes.get_xlabel(), axes.get_ylabel()) for axes in figure.axes] == [("x", "y"), ("x", "z"), ("y", "z")]
    assert {one.get_text() for one in figure.axes[1].texts} >= {"secondary", "L1"}
    flat = solved("sharp-3")
    (axes,) = path_views(flat, build_model(flat.system)).axes
    assert {one.get_text() for one in axes.texts} == {"Earth", "Moon", "L1", "L2", "L3", "L4", "L5"}
    assert not has_path(van_der_pol()) and not has_path(henon_heiles())


@pytest.mark.slow
@pytest.mark.parametrize("known", TABLE, ids=lambda one: f"{float(one['x0']):g} {float(one['ydot0']):.5f}")
def test_orbits_past_a_primary_are_certified(known):
    """Twenty-three with perpendicular crossings: speed, period and trace of extended precision."""
    x0, speed, period = (float(known[key]) for key in ("x0", "ydot0", "period"))
    model, guess = restricted_three_body(float(known["ratio"])), Guess([x0, 0, 0, speed], period)
    orbit = find_orbit(Problem(model, guess, pin(x=x0), "mirror"))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.state[3] == pytest.approx(speed, abs=1e-11)
    assert orbit.period == pytest.approx(period, rel=1e-11)
    assert trace(orbit) == pytest.approx(float(known["trace_minus_2"]), rel=1e-4)


def test_the_table_reaches_as_far_as_sharps():
    """Multipliers to 3.5e4 and periods to 182; he has 3.6e4 and 184."""
    assert len(TABLE) >= 20
    assert max(abs(float(one["trace_minus_2"])) for one in TABLE) > 3.5e4
    assert max(float(one["period"]) for one in TABLE) > 170
    assert sum(len(one["ydot0"].lstrip("-").replace(".", "")) >= 16 for one in TABLE) == len(TABLE)


@pytest.mark.slow
def test_from_a_libration_point_to_near_rectilinear_halos_by_commands(tmp_path, monkeypatch):
    """Planar, halo and axial family of L1, the last one from the vertical family too: ends say what is there."""
    monkeypatch.chdir(tmp_path)

    def family(*arguments, name):
        options = ("--no-figures", "--out", ".", "--name", name)
        run = CliRunner().invoke(cli, ["continue", *map(str, arguments), *options])
        assert run.exit_code == 0, run.output
        return load_family(tmp_path / name / "family.json")

    folder, file = ROOT / "problems" / "families", "planar/family.json"
    forward = ("--direction", "forward", "--points")
    planar = family(folder / "lyapunov-l1.toml", *forward, 50, name="planar")
    vertical = family(folder / "vertical-l1.toml", *forward, 56, name="vertical")
    halo = family(file, "--switch", 0, "--points", 64, name="halo")
    axial, other = (
        family(file, "--switch", 1, name="axial"),
        family("vertical/family.json", "--switch", 0, name="other"),
    )
    assert [(one.kind, round(-2 * one.energy, 5)) for one in planar.events[:2]] == [
        ("branch_point", 3.17435), ("branch_point", 3.02139),
    ]  # fmt: skip
    assert {one.symmetry for one in halo.points} == {"mirror"} and {one.symmetry for one in axial.points} == {"axis"}
    # near-rectilinear: stable from the doubling to the fold of the energy; beyond, the same periods come again
    below = [one for one in halo.points if one.energy < -1.4989]
    stable = [2.1132702639757 < one.period < 2.2300803752 for one in below]
    assert any(stable) and stable == [one.stability == "elliptic" for one in below]
    (end,) = halo.ends
    assert end.kind == "point limit"  # near the Moon the steps are short, and the family goes on
    assert np.linalg.norm(halo.points[-1].state[:3] - [1 - EARTH_MOON, 0, 0]) < 3e-3
    for one, met in ((axial, vertical), (other, planar)):
        (joined,) = one.ends
        assert joined.kind == "merged"
        births = [event.energy for event in met.events if event.kind == "branch_point"]
        assert min(abs(joined.parameter - energy) for energy in births) < 1e-9


@pytest.mark.slow
def test_the_butterflies_leave_near_rectilinear_halos():
    """At the doubling of T = 1.37433 (Earth and Moon): half a period later they pass their start nearly as before, and
    were taken for the halo orbit gone round twice."""
    model = restricted_three_body(EARTH_MOON, spatial=True)
    guess = Guess([1.02134, 0.0, -0.18162, 0.0, -0.10176, 0.0], 1.5111)
    halo = find_orbit(Problem(model, guess, symmetry="mirror"))
    family = follow_family(halo, "energy", settings=FamilySettings(points=8), model=model)
    doubled = next(one for one in family.events if one.kind == "period_doubling")
    assert doubled.period == pytest.approx(1.37433, abs=1e-5)
    leaving = switch_branch(family, doubled, model=model)
    butterflies = follow_family(leaving, settings=FamilySettings(points=6), model=model)
    assert "merged" in [end.kind for end in butterflies.ends]
    begun = max(butterflies.points, key=lambda point: point.period)
    assert 0 < begun.period - 2 * doubled.period < 1e-3

    def field(_, x):
        return [*x[3:], *model.acceleration(0, x[:3], x[3:], model.parameter_values).full().ravel()]

    half = begun.period * np.array([0.5, 1.0])
    gone = solve_ivp(field, (0, half[1]), begun.state, t_eval=half, method="DOP853", rtol=1e-12, atol=1e-12).y.T
    gaps = np.abs(gone - begun.state).max(axis=1)
    assert gaps[1] < 1e-8 and gaps[0] > 1e-3
