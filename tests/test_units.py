"""One orbit told in other units is found alike, certified alike, and verified alike from its file."""

import contextlib
import json
from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from test_scales import rescaled

import orbitfinder as of
from orbitfinder.atlas.attempt import Job, attempts
from orbitfinder.atlas.starts import Target, context_of
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.families.branches import branches
from orbitfinder.families.point import FamilySettings, extents
from orbitfinder.families.start import begin
from orbitfinder.loops.shooting import transcribe
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.scales import units_of
from orbitfinder.orbits.evidence import ClosureCheck
from orbitfinder.orbits.guesses.modes import equilibrium, normal_modes
from orbitfinder.systems import bouncing_ball, compass_gait, duffing, impact_oscillator, slip_runner, vertical_hopper

UNITS = {
    "metres and seconds": (1.0, 1.0),
    "millimetres": (1e3, 1.0),
    "megametres": (1e-6, 1.0),
    "milliseconds": (1.0, 1e3),
    "a resonator of 2 um and 1 MHz": (2e-6, 1.6e-7),
    "microns and weeks": (1e6, 1e-6),
    "an amplitude of a nanometre": (1e-9, 1.0),
}
"""Lengths and times of the same motion, in units of which the first is told in."""
FEW = [
    pytest.param(
        *sizes, id=name, marks=[pytest.mark.slow] * (name not in ("millimetres", "a resonator of 2 um and 1 MHz"))
    )
    for name, sizes in UNITS.items()
]
PERIOD = 4.7680220291024620


def told(length: float, time: float) -> dict[str, float]:
    """x'' + x + x^3 = 0 with x measured in `length` and t in `time`."""
    return {"stiffness": time**-2, "cubic": time**-2 * length**-2}


@pytest.mark.parametrize(("length", "time"), FEW)
def test_a_duffing_orbit_is_found_and_certified_in_any_units(length, time):
    """The period is the exact one to 1e-13 in all of them, and the certificate passes with like numbers."""
    model = duffing(**told(length, time))
    orbit = of.find_orbit(of.Problem(model, of.Guess([length, 0.0], 5.0 * time), pin=of.pin(x=length)))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.period / time == pytest.approx(PERIOD, rel=1e-13)
    assert orbit.certificate.scale == pytest.approx(3.549, rel=1e-3)
    assert (orbit.stability, orbit.symmetry) == ("elliptic", "brake+reflection")


@pytest.mark.parametrize(("length", "time"), FEW)
def test_by_the_command_and_from_the_file(length, time, tmp_path):
    """`run` certifies it, `verify` says so again from the file, and a period off by 1e-8 is rejected in all units."""
    numbers = ", ".join(f"{name} = {value!r}" for name, value in told(length, time).items())
    (tmp_path / "p.toml").write_text(
        f'name = "p"\n[system]\nkind = "python"\nfunction = "duffing"\narguments = {{ {numbers} }}\n'
        f"[guess]\nstate = [{length!r}, 0.0]\nperiod = {5.0 * time!r}\n[find]\npin = {{ x = {length!r} }}\n"
    )
    file = tmp_path / "out" / "p" / "orbit.json"
    assert CliRunner().invoke(cli, ["run", str(tmp_path / "p.toml"), "--out", str(tmp_path / "out")]).exit_code == 0
    assert CliRunner().invoke(cli, ["verify", str(file)]).exit_code == 0
    document = json.loads(file.read_text())
    assert document["period"] / time == pytest.approx(PERIOD, rel=1e-13)
    document["period"] *= 1 + 1e-8
    del document["record"]
    file.write_text(json.dumps(document))
    assert CliRunner().invoke(cli, ["verify", str(file)]).exit_code == 1


CHAINS = {
    "metres": {}, "millimetres": {"length": 1e3, "gravity": 9.8e3},
    "links of 1 mm and 1 g": {"length": 1e-3, "mass": 1e-3},
    "a microgram": {"mass": 1e-9}, "slow": {"gravity": 9.8e-12}, "a heavy end": {"mass": [1.0, 1e6]},
}  # fmt: skip


@pytest.mark.parametrize("arguments", CHAINS.values(), ids=CHAINS)
def test_a_double_pendulum_is_certified_whatever_it_is_measured_in(arguments):
    """Multipliers, pairs and symplecticity hold in canonical coordinates of any size."""
    model = of.chain(2, **arguments)
    guess = of.guesses.normal_mode(model, 1, 0.5)
    orbit = of.find_orbit(of.Problem(model, guess, pin=of.pin(theta1=float(np.asarray(guess.state)[0]))))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert np.abs(orbit.floquet_multipliers) == pytest.approx(1.0, abs=1e-8)


def elastic(length=1.0, time=1.0, mass=1.0, scales=None):
    """An elastic pendulum in polar coordinates, k = 40 m, g = 9.8, told in units of length, time and mass."""
    q, v, work = ca.SX.sym("q", 2), ca.SX.sym("v", 2), mass * length**2 / time**2
    r = q[1] / length
    return of.lagrange(
        mass * (v[1] ** 2 + (q[1] * v[0]) ** 2) / 2, work * (20 * (r - 1) ** 2 - 9.8 * r * ca.cos(q[0])),
        of.Symbols(q, v), names=["phi", "r"], angles=[True, False], scales=scales,
    )  # fmt: skip


def capacitor(length=1.0, charge=1.0, time=1.0):
    """A plate that moves beside a charge that swings: coordinates of two units, told apart by their inertias alone."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    x, c = q[0] / length, q[1] / charge
    return of.lagrange(
        time**2 * ((v[0] / length) ** 2 + (v[1] / charge) ** 2) / 2, x**2 / 2 + c**2 + 0.3 * x * c**2 + x**4 / 4,
        of.Symbols(q, v), names=["x", "charge"],
    )  # fmt: skip


def driven(length=1.0, time=1.0, mass=1.0):
    """x'' + 0.1 x' + x + x^3 = 0.3 cos 1.5 t in units of length, time and mass."""
    q, v, t = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("t")
    stiff = mass / time**2
    return of.lagrange(
        mass * v**2 / 2, stiff * (q**2 / 2 + q**4 / 4 / length**2),
        of.Symbols(q, v, time=t, forcing_period=2 * np.pi / 1.5 * time),
        forces=-0.1 * mass * v / time + 0.3 * stiff * length * ca.cos(1.5 * t / time), names=["x"],
    )  # fmt: skip


MECHANICAL = {
    "SI": (1.0, 1.0, 1.0), "2 um, 1 MHz, 1 ng": (2e-6, 1.6e-7, 1e-12), "1 km, 11 days": (1e3, 1e6, 1.0),
    "micrograms": (1.0, 1.0, 1e-9), "a million tons": (1.0, 1.0, 1e9),
}  # fmt: skip
"""Length (m), time (s) and mass (kg) that one motion is told in."""
SWING = np.array([0.3, 1.2, 0.0, 0.0]), 2.2, -10.0


def swing(length, time, mass, **more):
    """The Problem of an elastic pendulum's swing of energy -10, told in these units."""
    state, period, energy = SWING
    sizes, work = np.array([1.0, length, 1.0 / time, length / time]), mass * length**2 / time**2
    guess = of.Guess(state * sizes, period * time)
    return of.Problem(elastic(length, time, mass, **more), guess, pin=of.pin(energy=energy * work)), sizes, work


@pytest.fixture(scope="module")
def swings():
    """The swing in all units: name -> (orbit, problem, sizes, work)."""
    told_in = {name: swing(*units) for name, units in MECHANICAL.items()}
    return {name: (of.find_orbit(one[0]), *one) for name, one in told_in.items()}


@pytest.mark.parametrize("name", MECHANICAL)
def test_an_angle_beside_a_length_is_found_refined_and_certified_alike(swings, name):
    """Same period to 1e-13 and multipliers to 1e-8; refinement from 1e-4 away ends at the same orbit, certified."""
    orbit, problem, _, _ = swings[name]
    known, time = swings["SI"][0], MECHANICAL[name][1]
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.period / time == pytest.approx(known.period, rel=1e-13)
    assert np.sort_complex(orbit.floquet_multipliers) == pytest.approx(
        np.sort_complex(known.floquet_multipliers), abs=1e-8
    )
    assert (orbit.symmetry, orbit.stability) == ("brake", known.stability)
    refiner = of.Refiner(problem)
    again = refiner.refine(of.Guess(orbit.state * (1 + 1e-4), orbit.period))
    assert again.period / time == pytest.approx(known.period, rel=1e-13)
    assert refiner.orbit(again).certificate.passed


@pytest.mark.parametrize("name", ["SI", "2 um, 1 MHz, 1 ng"])
def test_a_length_that_is_wrong_is_seen_beside_an_angle(swings, name):
    """The check of a family point says so of r alone, off by 1e-7 of itself, although an angle moves by 0.8 rad."""
    orbit, problem, sizes, _ = swings[name]
    curve = begin(orbit, model=problem.model).curve
    units, check = extents(curve, orbit.samples), ClosureCheck(problem.model)
    turns = np.zeros(2)
    assert check(orbit.state, orbit.period, turns, 1e-11, units=units) < 1e-11
    off = orbit.state + np.array([0.0, 1e-7 * sizes[1], 0.0, 0.0])
    assert check(off, orbit.period, turns, 1e-11, units=units) > 1e-9


def test_families_have_the_same_events_and_branches_in_any_units(swings):
    """Steps, events and branches: the family through the swing, and what leaves it at its first resonance."""
    found = {}
    for name in ("SI", "2 um, 1 MHz, 1 ng", "1 km, 11 days"):
        orbit, problem, _, work = swings[name]
        settings = FamilySettings(directions="backward", certify=False)
        family = of.follow_family(orbit, model=problem.model, points=9, settings=settings)
        leaving = branches(family, 0, model=problem.model)
        periods = sorted(one.start.solution.place.period / MECHANICAL[name][1] for one in leaving)
        found[name] = [(one.kind, one.energy / work) for one in family.events], len(family.points), periods
    (events, points, periods), *others = found.values()
    assert "resonance" in {kind for kind, _ in events} and periods
    for seen, count, left in others:
        assert [kind for kind, _ in seen] == [kind for kind, _ in events] and abs(count - points) <= 1
        resonances = [[energy for kind, energy in one if kind == "resonance"] for one in (seen, events)]
        assert resonances[0] == pytest.approx(resonances[1], abs=1e-8)
        assert left == pytest.approx(periods, rel=1e-4)


@pytest.mark.parametrize(
    "units",
    [
        pytest.param(sizes, id=name, marks=[pytest.mark.slow] * (not name.startswith(("2", "micro"))))
        for name, sizes in MECHANICAL.items()
    ],
)
def test_a_driven_oscillator_is_refined_and_certified_in_any_units(units):
    """Also of a nanogram, whose damping of 1e-10 kg/s is damping all the same."""
    length, time, _ = units
    problem = of.Problem(driven(*units), of.Guess([0.5 * length, 0.0], 2 * np.pi / 1.5 * time))
    orbit = of.find_orbit(problem)
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.floquet_multipliers[0].real == pytest.approx(-0.26968500, abs=1e-8)
    refiner = of.Refiner(problem)
    again = refiner.refine(of.Guess(orbit.state * 1.001, orbit.period))
    assert again.state / orbit.state == pytest.approx(1.0, abs=1e-11) and refiner.orbit(again).certificate.passed


@pytest.mark.parametrize("told_in", [(1.0, 1.0, 1.0), (2e-6, 1e-12, 1.6e-7), (1e-9, 1e3, 1.0)])
def test_coordinates_of_two_units_need_nothing_said(told_in):
    """A displacement and a charge: their inertias say how they compare."""
    length, charge, time = told_in
    guess = of.Guess([0.3 * length, 0.5 * charge, 0.0, 0.0], 4.7 * time)
    orbit = of.find_orbit(of.Problem(capacitor(*told_in), guess, pin=of.pin(energy=0.3)))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.period / time == pytest.approx(4.47114923197785, rel=1e-13)


def test_searches_find_the_same_orbits_in_any_units():
    """Henon-Heiles' three short orbits, from as many starts."""
    found = []
    for length, time, mass in [*MECHANICAL.values()][:2]:
        work, q, v = mass * length**2 / time**2, ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        x, y = q[0] / length, q[1] / length
        potential = work * ((x**2 + y**2) / 2 + x**2 * y - y**3 / 3)
        context = context_of(
            of.lagrange(mass * ca.sumsqr(v) / 2, potential, of.Symbols(q, v)),
            Target(0.12 * work, (0.5 * time, 8.0 * time)),
        )
        seen = [attempts(context, 0, [Job(k, True)], ())[0].orbit for k in range(16)]
        found.append({round(one.period / time, 8) for one in seen if one is not None})
    assert found == [{6.08239554, 6.88059773, 7.43702046}] * 2


def test_lengths_are_given_where_no_motion_shows_them():
    """An equilibrium of microns is found with a length given, and its modes are those of metres."""
    length, time = 1e-6, 1e-3
    model, known = elastic(length, time, scales={"length": length}), elastic()
    place = equilibrium(model)
    assert place / [1.0, length] == pytest.approx(equilibrium(known), abs=1e-9)
    slow = normal_modes(model, place)[0] * time**2
    assert slow == pytest.approx(normal_modes(known, equilibrium(known))[0], rel=1e-6)
    assert elastic(scales={"r": 2.0}).scales == {"r": 2.0}


WRONG = {
    "phi": "unknown 'phi'; angles are measured in rad", "mas": "unknown 'mas'", "length": "must be positive and finite",
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_wrong_scales_are_refused(name):
    """Of an angle, of nothing known, of no size."""
    with pytest.raises(InputError, match=WRONG[name]):
        elastic(scales={name: -1.0 if name == "length" else 1.0})


def test_scales_of_a_problem_file_are_in_the_record(tmp_path):
    """`[system] scales` reaches the Model, orbit.json and the Model rebuilt from it, and changes no digit."""
    text = 'name = "p"\n[system]\nkind = "python"\nfunction = "duffing"\n{}[guess]\nstate = [1.0, 0.0]\nperiod = 5.0\n'
    text += "[find]\npin = {{ x = 1.0 }}\n"
    (tmp_path / "p.toml").write_text(text.format("scales = { length = 0.5 }\n"))
    orbit = of.find_orbit(of.load_problem(tmp_path / "p.toml"))
    of.save_orbit(orbit, tmp_path / "orbit.json")
    loaded = of.load_orbit(tmp_path / "orbit.json")
    assert loaded.system["scales"] == {"length": 0.5} == build_model(loaded.system).scales
    assert of.certify(loaded).passed and orbit.period == pytest.approx(PERIOD, rel=1e-13)
    (tmp_path / "p.toml").write_text(text.format("scales = { depth = 0.5 }\n"))
    assert "unknown 'depth'" in CliRunner().invoke(cli, ["run", str(tmp_path / "p.toml")]).output


def test_the_record_says_what_was_measured_in():
    """Units other than 1 are in the provenance."""
    model = duffing(**told(2e-6, 1.6e-7))
    orbit = of.find_orbit(of.Problem(model, of.Guess([2e-6, 0.0], 8e-7), pin=of.pin(x=2e-6)))
    assert orbit.provenance["scales"] == {"x": 2.0**-19, "xdot": 16.0}


def swung(length, time=1.0, mass=1.0):
    """m (x'' + 0.1 x' + x + x^3) = 0.3 m cos 1.2 t, in other lengths, times and masses."""
    q, v, t = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("t")
    well = mass / time**2 * (q**2 / 2 + q**4 / (4 * length**2))
    push = mass * (0.3 * length / time**2 * ca.cos(1.2 * t / time) - 0.1 / time * v)
    drive = of.Symbols(q, v, time=t, forcing_period=2 * np.pi / 1.2 * time)
    return of.lagrange(mass * v**2 / 2, well, drive, forces=push, names=["x"])


OTHERS = [(2.0, 1.0, 1.0), (1024.0, 1.0, 1.0), (1.0, 1 / 64, 4096.0), (7.0, 1.0, 1.0), (1e3, 1e-3, 1e3),
          (1e-6, 1e-6, 1.0), (1.0001, 3.0, 1.0)]  # fmt: skip


@pytest.mark.parametrize("units", OTHERS)
def test_the_finders_program_of_a_mechanical_model_is_one_in_all_units(units):
    """Start, bounds and rows: the same bits for powers of two; no step leaves the period of the forcing."""

    def program(length, time, mass):
        guess = of.Guess([0.3 * length, 0.1 * length / time], 2 * np.pi / 1.2 * time)
        made = transcribe(of.Problem(swung(length, time, mass), guess), np.outer([1.0, -2.0], guess.state))
        parts = made.start, made.lower, made.upper, made.rows(made.start, made.guess.nodes.T).full()
        return made, np.concatenate([np.ravel(part) for part in parts])

    (made, one), (_, other) = program(1.0, 1.0, 1.0), program(*units)
    exact = all(np.log2(unit) % 1.0 == 0.0 for unit in units)
    np.testing.assert_allclose(other, one, rtol=0.0 if exact else 1e-12, atol=0.0 if exact else 1e-13)
    period = made.guess.nodes.size
    slopes = made.jacobian(made.start).full()[:, period]
    assert np.array_equal(np.flatnonzero(slopes), [period])


@pytest.mark.parametrize("length", [1.0, 1e-3, 7.0])
def test_a_cart_at_rest_is_measured_beside_what_swings_from_it(length):
    """x, theta: no length is to be read from theta = 0, theta' = 1, where nothing pushes the cart."""
    x, turn, speed, rate = (ca.SX.sym(name) for name in ("x", "turn", "speed", "rate"))
    kinetic = speed**2 + length * speed * rate * ca.cos(turn) + length**2 * rate**2 / 2
    symbols = of.Symbols(ca.vertcat(x, turn), ca.vertcat(speed, rate))
    model = of.lagrange(kinetic, -length * ca.cos(turn), symbols, angles=[False, True])
    units = units_of(model, np.array([[0.0, 0.0, 0.0, 1.0]]), 2 * np.pi, 0.0)
    # m L^2 is the same for both: 2 x^2 = length^2 theta^2; a tenth of a quarter of that
    np.testing.assert_allclose(units, np.tile([length / np.sqrt(2) / 40, 1.0], 2), rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("start", [(1.0, 1.0), (-1.0, 0.5), (0.3, 0.0), (0.2, 0.1)])
def test_a_driven_orbit_is_found_in_the_same_iterations_in_all_units(start):
    """Defects of all iterations beside those in the first units."""

    def iterations(length, time=1.0, mass=1.0):
        seen, guess = [], of.Guess([start[0] * length, start[1] * length / time], 2 * np.pi / 1.2 * time)
        problem = of.Problem(swung(length, time, mass), guess)
        orbit = of.find_orbit(problem, of.SolveSettings(with_certificate=False), seen.append)
        assert all(report.period == pytest.approx(guess.period, rel=1e-6) for report in seen)
        return [each.defect for each in seen if each.stage == "shooting"], orbit.state / [length, length / time]

    (one, state) = iterations(1.0)
    for units in OTHERS:
        other, found = iterations(*units)
        assert len(one) == len(other)
        np.testing.assert_allclose(other[:5], one[:5], rtol=1e-6, atol=1e-11 * one[0])
        np.testing.assert_allclose(found, state, rtol=1e-11)
        if all(np.log2(unit) % 1.0 == 0.0 for unit in units):
            assert other[:20] == one[:20]  # of no simulation that settles


@pytest.mark.parametrize("cycles", [1, 2])
def test_no_step_of_the_program_leaves_the_period_of_a_forcing(cycles):
    """The period is in no row but its own, and no bound pushes it."""
    guess = of.Guess([0.3, 0.1], cycles * 2 * np.pi / 1.2)
    made = transcribe(of.Problem(swung(1.0), guess), np.array([[0.3, 0.1], [-0.6, -0.2]]))
    period = made.guess.nodes.size
    assert np.array_equal(np.flatnonzero(made.jacobian(made.start).full()[:, period]), [period])
    assert made.lower[period] == -np.inf and made.upper[period] == np.inf


@pytest.mark.slow
def test_a_search_that_wanders_keeps_the_period_of_the_forcing():
    """IPOPT's restoration went from 5.23599 s to 5.23727 s."""
    said, period = [], 2 * np.pi / 1.2
    with contextlib.suppress(ConvergenceError):
        of.find_orbit(of.Problem(swung(1.0), of.Guess([0.3, 0.0], period)), progress=said.append)
    assert len(said) > 20 and all(report.period == pytest.approx(period, rel=1e-14) for report in said)


@pytest.mark.parametrize(
    ("length", "start", "iterations"),
    [
        (7.0, (0.3, 0.0), 15),
        *(
            pytest.param(length, start, 100, marks=pytest.mark.slow)
            for length in (1.0, 1.0001, 2.0, 1024.0, 1000.0, 3.0, 7.0)
            for start in ((0.3, 0.0), (0.2, 0.1), (1.0, 1.0), (-1.0, 0.5))
        ),
    ],
)
def test_far_guesses_find_the_driven_orbit_in_all_units_of_length(length, start, iterations):
    """x'' + 0.1 x' + x + x^3 / L^2 = 0.3 L cos 1.2 t, by the program or from where a simulation settles."""
    problem = of.Problem(swung(length), of.Guess([start[0] * length, start[1] * length], 2 * np.pi / 1.2))
    orbit = of.find_orbit(problem, of.SolveSettings(with_certificate=False, max_iterations=iterations))
    np.testing.assert_allclose(orbit.state / length, [0.902701574469762, 0.52973200304008], rtol=0, atol=1e-9)
    assert orbit.provenance.get("start", "a simulation that settles") == "a simulation that settles"


def oscillator(length, time, mass):
    """An impact oscillator, whose time is its spring's."""
    del time, mass
    model = impact_oscillator(frequency=2.8, force=length, stop=0.05 * length)
    guess = of.Guess([0.05 * length, -0.17 * length, 3.0], 2.24)
    return of.Problem(model, guess, winding=(0, 0, 1)), 1.0


def ball(length, time, mass):
    """A ball on a vibrating table: a length, a speed and an angle."""
    del mass
    model = bouncing_ball(0.012 * length, 2 * np.pi / time, length / time**2)
    guess = of.Guess([0.008 * length, 0.49 * length / time, 0.8], time)
    return of.Problem(model, guess, winding=(0, 0, 1)), time


def hopper(length, time, mass):
    """A hopper at its energy, told two digits of its speed."""
    model = vertical_hopper(mass, 100 * mass / time**2, 9.81 * length / time**2)
    guess = of.Guess([0.0, -1.9 * length / time], time)
    return of.Problem(model, guess, pin=of.pin(energy=2 * mass * (length / time) ** 2)), time


def compass(length, time, mass):
    """A compass gait: plastic impacts."""
    model = compass_gait(np.deg2rad(3), *[length / 2] * 2, 5 * mass, 10 * mass, 9.81 * length / time**2)
    return of.Problem(model, of.Guess([0.22, -0.32, -1.09 / time, -0.38 / time], 0.73 * time)), time


def runner(length, time, mass):
    """A runner of three arcs."""
    model = slip_runner(80 * mass, 20000 * mass / time**2, length, 0.35, 9.81 * length / time**2)
    guess, energy = of.Guess([0.0, 1.02 * length, 5.0 * length / time, 0.0], 0.8 * time), 80 * 9.81 * 1.02 + 1000
    return of.Problem(model, guess, pin=of.pin(energy=energy * mass * (length / time) ** 2)), time


MACHINES_IN = {
    "SI": (1.0, 1.0, 1.0), "nanometres": (1e-9, 1.0, 1.0), "gigametres": (1e9, 1.0, 1.0), "all small": (1e-9,) * 3,
    "nanoseconds": (1.0, 1e-9, 1.0), "gigaseconds": (1.0, 1e9, 1.0), "all large": (1e9,) * 3,
    "2 um, 160 ns, 1 pg": (2e-6, 1.6e-7, 1e-15),
}  # fmt: skip


@pytest.mark.parametrize(
    ("machine", "names"),
    [
        (oscillator, ["SI", "nanometres"]), (ball, ["SI", "nanoseconds"]),
        pytest.param(hopper, ["SI", "gigametres"], marks=pytest.mark.slow),
        pytest.param(compass, ["SI", "gigaseconds"], marks=pytest.mark.slow),
        *(pytest.param(x, MACHINES_IN, marks=pytest.mark.slow) for x in (oscillator, ball, hopper, compass, runner)),
    ],
)  # fmt: skip
def test_a_machine_is_found_and_certified_in_any_units(machine, names):
    """Hybrid orbits: the same period, multipliers and certificate in units of 1e-9 and 1e9; refined alike."""
    known = None
    for name in names:
        length, time, mass = MACHINES_IN[name]
        problem, clock = machine(length, time, mass)
        refiner = of.Refiner(problem)
        orbit = refiner.orbit(refiner.refine())
        assert orbit.certificate.passed, (name, orbit.certificate.failures)
        known = known or orbit
        assert orbit.period / clock == pytest.approx(known.period, rel=1e-12), name
        assert np.abs(orbit.floquet_multipliers) == pytest.approx(np.abs(known.floquet_multipliers), abs=1e-7), name
        again = refiner.refine(of.Guess(orbit.state * (1 + 1e-4), orbit.period))
        assert again.period / orbit.period == pytest.approx(1.0, abs=1e-12), name
        wrong = replace(orbit, state=orbit.state * (1 + 1e-8), record=None)
        assert not of.certify(wrong, problem.model).passed, name


@pytest.mark.slow
@pytest.mark.parametrize("length", [1e-9, 1e9])
def test_a_stop_is_grazed_where_it_is_in_any_units(length):
    """Amplitude of the linear oscillator = stop, to 1e-10 of it, in nanometres as in gigametres."""
    problem, _ = oscillator(length, 1.0, 1.0)
    settings = FamilySettings(parameter="stop", directions="forward", points=60)
    family = of.follow_family(of.find_orbit(problem), "stop", settings=settings)
    grazing = family.events[-1]
    assert (grazing.kind, grazing.detail) == ("grazing", "hit")
    assert grazing.parameter * abs(1 - 2.8**2 + 0.28j) / length == pytest.approx(1.0, abs=1e-10)
    assert all(of.certify(one).passed for one in family.points)


def peroxidase(x):
    """Steinmetz and Larter's stiff cycle: X is a hundredth of what it is made from."""
    chain, start = 0.1631021 * x[0] * x[1] * x[2], 0.046875 * x[0] * x[1] * x[3]
    lost = 2500 * x[2] ** 2
    return [-chain - start + 1.5 - 0.1175 * x[0], -chain - start + 0.75,
            chain - lost + 2 * start - 20 * x[2] + 0.001, -start + lost - 1.104 * x[3]]  # fmt: skip


def observed(x, b):
    """A chemical clock, and what only follows it."""
    return [1 + x[0] ** 2 * x[1] - (b + 1) * x[0], b * x[0] - x[0] ** 2 * x[1], x[0] - x[2]]


def shaken(later):
    """Duffing's oscillator whose forcing began `later`."""
    return of.ode(lambda t, x, p: [x[1], p[0] * ca.cos(t + later) - 0.2 * x[1] - x[0] - x[0] ** 3],
                  ["x", "v"], {"a": 0.5}, forcing_period=lambda p: 2 * np.pi)  # fmt: skip


CLOCKS = {
    "brusselator": (lambda _: of.systems.brusselator(rate=2.5), [1.4, 3.0], 6.6, ("rate", 2.7)),
    "peroxidase": (lambda _: of.ode(lambda t, x, p: peroxidase(x), list("ABXY")), [2.5, 5.6, 0.024, 1.4], 16.0, None),
    "observed": (lambda _: of.ode(lambda t, x, p: observed(x, p[0]), list("xyz"), {"b": 2.5}),
                 [1.4, 3.0, 1.0], 6.6, ("b", 2.7)),
    "shaken": (shaken, [0.4, 0.1], 2 * np.pi, ("a", 0.6)),
}  # fmt: skip


def seen_of(name, units, eighth, method):
    """What is found, refined, followed and responded of a cycle, told in units, from an eighth of its period."""
    build, state, period, further = CLOCKS[name]
    forced = build(0.0).forced
    at = state if forced or not eighth else of.simulate(build(0.0), state, period * eighth / 8).states[-1]
    model = rescaled(build(period * eighth / 8), units, **({"forcing_period": lambda p: period} if forced else {}))
    problem = of.Problem(model, of.Guess(list(np.array(at) / units), period), method=method)
    orbit = of.find_orbit(problem)
    assert orbit.certificate.passed, orbit.certificate.failures
    seen = {"period": [orbit.period], "multipliers": np.sort(np.abs(orbit.floquet_multipliers))}
    seen["extents"] = np.ptp(orbit.samples, axis=0)[:3] * units[:3]
    stiff = name == "peroxidase"  # for explicit steps of one length, and for phases, whose kicks take many periods
    if not stiff:
        refiner = of.Refiner(replace(problem, guess=of.Guess(list(orbit.state), orbit.period)))
        again = refiner.orbit(refiner.refine())
        assert again.certificate.passed, again.certificate.failures
        seen["refined"] = [again.period]
    if not (forced or stiff):
        curve = of.phase_response(orbit, model)
        assert curve.certificate.passed, curve.certificate.failures
        seen["response"] = [np.abs(curve.response).max(axis=0)[0] / units[0]]
    if further:
        settings = of.FamilySettings(directions="forward")
        family = of.follow_family(orbit, further[0], until=further[1], model=model, settings=settings)
        assert family.points[-1].certified and [end.kind for end in family.ends] == ["target"]
        seen["family"] = [family.points[-1].period, *(event.parameter for event in family.events)]
    return seen


SMALL_AND_LARGE = {
    "as they are": ((1.0, 1.0, 1.0, 1.0), 3), "first small": ((1e-6, 1.0, 1e6, 1e2), 5),
    "first large": ((1e6, 1e-6, 1e-6, 1e6), 0), "tiny": ((1e-6,) * 4, 7), "huge": ((1e6,) * 4, 1),
    "one small": ((1.0, 1e6, 1e-6, 1.0), 4),
}  # fmt: skip
"""Units of components, and the eighth of the period at which t is 0"""


@cache
def seen_plainly(name):
    return seen_of(name, np.ones(len(CLOCKS[name][1])), 0, None)


@pytest.mark.parametrize(("name", "told", "method"), [
    ("brusselator", "one small", "collocation"),
    *(pytest.param(name, told, method, marks=pytest.mark.slow)
      for name in CLOCKS for told in SMALL_AND_LARGE for method in ("shooting", "collocation")),
])  # fmt: skip
def test_nothing_depends_on_units_of_components_nor_on_the_instant(name, told, method):
    plain = seen_plainly(name)
    units, eighth = SMALL_AND_LARGE[told]
    seen = seen_of(name, np.array(units[: len(CLOCKS[name][1])]), eighth, method)
    assert seen.keys() == plain.keys()
    for what, digits in {"period": 1e-12, "multipliers": 1e-7, "extents": 1e-2, "refined": 1e-12, "response": 1e-2,
                         "family": 1e-9}.items():  # fmt: skip
        if what in plain:
            assert np.allclose(seen[what], plain[what], rtol=digits, atol=1e-9 * (what == "multipliers")), what


@pytest.mark.parametrize("units", [(1e6, 1e-6), pytest.param((1e-6, 1e6), marks=pytest.mark.slow)])
def test_a_diagram_is_the_same_in_any_units_of_components(units):
    model = rescaled(of.systems.brusselator(rate=1.8), units)
    tree = of.diagram(model, np.array([1.0, 1.8]) / units, "rate", 2.5)
    rests, cycles = (curve.record for curve in tree.curves)
    assert [(event.kind, event.criticality) for event in rests.events] == [("hopf", "supercritical")]
    assert rests.events[0].parameter == pytest.approx(2.0, rel=1e-10)
    assert cycles.points[-1].period == pytest.approx(6.5772843419058333034, rel=1e-12)
