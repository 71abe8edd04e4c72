"""First-order systems and Hamilton's equations: known orbits, two formulations, planted failures, files."""

import ctypes
import json
import subprocess
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.special import ellipk

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import CountError, InputError
from orbitfinder.loops.symmetry import symmetries_of
from orbitfinder.mechanics.model import vector_field
from orbitfinder.orbits.guesses.modes import first_order_modes
from orbitfinder.problemfile.read import load_problem

LORENZ = of.Guess([-13.7636, -19.5788, 27.0], 1.5587)
LORENZ_PERIOD = 1.5586522107161747
"""D. Viswanath, Physica D 190 (2004) 115-128"""


def rigid_body(**parts):
    """Euler's equations of a free top in its angular momentum."""

    def field(_, x, p):
        return [
            (1 / p.c - 1 / p.b) * x.m2 * x.m3, (1 / p.a - 1 / p.c) * x.m3 * x.m1, (1 / p.b - 1 / p.a) * x.m1 * x.m2
        ]  # fmt: skip

    known = {
        "energy": lambda x, p: (x.m1**2 / p.a + x.m2**2 / p.b + x.m3**2 / p.c) / 2,
        "square": lambda x, _: x.m1**2 + x.m2**2 + x.m3**2,
    }
    return of.ode(field, ("m1", "m2", "m3"), {"a": 1.0, "b": 2.0, "c": 3.0}, **{"invariants": known, **parts})


def pendulum():
    """H = p^2 / 2 - cos q."""
    return of.hamiltonian(lambda x, _: x.p**2 / 2 - ca.cos(x.q), ("q",), ("p",), angles=("q",))


def test_lorenz_orbit_is_the_published_one():
    """Period to 1e-13, multipliers mu = 4.71294727 and exp(-41/3 T) / mu, the symmetry recognised, no energy."""
    orbit = of.find_orbit(of.Problem(of.systems.lorenz(), LORENZ))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.period == pytest.approx(LORENZ_PERIOD, abs=1e-13)
    first, second = orbit.floquet_multipliers.real
    assert first == pytest.approx(4.71294727, abs=1e-8)
    assert second == pytest.approx(np.exp(-41 / 3 * LORENZ_PERIOD) / first, rel=0.05)
    assert (orbit.symmetry, orbit.stability, orbit.winding) == ("turn", "unstable", (0, 0, 0))
    assert np.isnan(orbit.energy) and orbit.action > 0


def test_half_of_lorenz_orbit_is_enough():
    """x(T/2) = (-x, -y, z): the same orbit and multipliers from half of the period."""
    problem = of.Problem(of.systems.lorenz(), LORENZ, symmetry="turn")
    orbit = of.find_orbit(problem)
    assert orbit.certificate.passed and orbit.period == pytest.approx(LORENZ_PERIOD, abs=1e-13)
    refined = of.Refiner(problem).refine()
    assert refined.period == pytest.approx(LORENZ_PERIOD, abs=1e-12)


def test_an_orbit_without_energy_goes_to_a_file_and_back(tmp_path):
    """null in orbit.json, nan in the Orbit, the digest kept, and certified again from the file alone."""
    orbit = of.find_orbit(of.Problem(of.systems.rossler(), of.Guess([-3.9, 5.6, 0.03], 5.88)))
    path = of.save_orbit(orbit, tmp_path / "orbit.json")
    assert json.loads(path.read_text())["energy"] is None
    again = of.load_orbit(path)
    assert np.isnan(again.energy) and again.period == orbit.period == pytest.approx(5.881088455553877, abs=1e-12)
    assert of.certify(again).passed
    changed = json.loads(path.read_text()) | {"winding": [0]}
    path.write_text(json.dumps(changed))
    with pytest.raises(InputError, match="energy: missing, that of a mechanical system"):
        of.load_orbit(path)


@pytest.mark.parametrize("spoiled", ["period", "state", "action", "multipliers", "samples"])
def test_a_false_first_order_orbit_is_rejected(spoiled):
    """A period, a state, an action, a multiplier or a picture that is not the orbit's."""
    orbit = of.find_orbit(of.Problem(of.systems.brusselator(), of.Guess([3.6, 1.3], 7.2)))
    assert orbit.certificate.passed and orbit.stability == "asymptotically stable"
    changes = {
        "period": {"period": orbit.period * (1 + 1e-9)}, "state": {"state": orbit.state + 1e-8},
        "action": {"action": orbit.action * (1 + 1e-8)}, "multipliers": {"floquet_multipliers": np.array([0.5 + 0j])},
        "samples": {"samples": orbit.samples * (1 + 1e-4)},
    }  # fmt: skip
    assert not of.certify(replace(orbit, **changes[spoiled])).passed


def test_two_invariants_take_two_pins():
    """The free top: 4 equations in 6 unknowns; period against its elliptic integral; one pin is refused with the count.

    Landau and Lifshitz, Mechanics, section 37: T = 4 K(k^2) sqrt(I1 I2 I3 / ((I3 - I2) (M^2 - 2 E I1))).
    """
    model = rigid_body()
    guess = of.Guess([0.3, 0.3, 1.0], 20.0)
    with pytest.raises(CountError, match="2 unfolding.*add 1 pins"):
        of.Problem(model, guess, of.pin(energy=0.3)).check_count()
    orbit = of.find_orbit(of.Problem(model, guess, of.pin(energy=0.24, square=1.2)))
    assert orbit.certificate.passed, orbit.certificate.failures
    (a, b, c), energy, square = (1.0, 2.0, 3.0), 0.24, 1.2
    modulus = (b - a) * (2 * energy * c - square) / ((c - b) * (square - 2 * energy * a))
    exact = 4 * ellipk(modulus) * np.sqrt(a * b * c / ((c - b) * (square - 2 * energy * a)))
    assert orbit.period == pytest.approx(exact, rel=1e-12)
    assert orbit.floquet_multipliers.size == 0 and orbit.stability == "elliptic"
    nearest = of.find_orbit(of.Problem(model, guess))
    assert nearest.certificate.passed


def test_what_is_no_invariant_is_refused():
    """Its name and drift; and of Hamilton's equations before anything is integrated."""
    wrong = {"wrong": lambda x, _: x.m1**2 + 2 * x.m2**2}
    with pytest.raises(InputError, match="'wrong' is not conserved, it drifts by"):
        of.find_orbit(of.Problem(rigid_body(invariants=wrong), of.Guess([0.3, 0.3, 1.0], 9.0)))
    with pytest.raises(InputError, match="'wrong' is not conserved, it changes at the rate"):
        of.hamiltonian(lambda x, _: x.p**2 / 2 + x.q**4, ("q",), ("p",), invariants={"wrong": lambda x, _: x.q})


def test_the_field_is_unfolded_by_the_gradient():
    """x' = f + s grad I, against finite differences of I."""
    model = rigid_body()
    field, x, h = vector_field(model, (), model.invariants), np.array([0.4, -0.7, 1.1]), 1e-6
    plain, unfolded = (field(0.0, x, s, []).full().ravel() for s in ([0.0, 0.0], [0.3, 0.0]))
    energy = [of.energy(model, x + h * e) - of.energy(model, x - h * e) for e in np.eye(3)]
    assert unfolded - plain == pytest.approx(0.3 * np.array(energy) / (2 * h), abs=1e-9)
    assert plain == pytest.approx(model.rate(0.0, x, model.parameter_values).full().ravel(), abs=0)


def test_pendulum_in_hamiltonian_form_is_the_pendulum():
    """Swing: T = 4 K(sin^2(a/2)) from rest; rotation with a turn: T = 2 k K(k^2), k^2 = 2 / (1 + E), action = area."""
    model = pendulum()
    swing = of.find_orbit(of.Problem(model, of.Guess([1.0, 0.0], 6.5), of.pin(q=1.0), symmetry="brake"))
    assert swing.certificate.passed, swing.certificate.failures
    assert swing.period == pytest.approx(4 * ellipk(np.sin(0.5) ** 2), rel=1e-13)
    assert swing.energy == pytest.approx(-np.cos(1.0), abs=1e-14)
    turn = of.find_orbit(of.Problem(model, of.Guess([0.0, 2.4], 3.1), of.pin(energy=2.0)))
    assert turn.certificate.passed and turn.winding == (1, 0)
    assert turn.period == pytest.approx(2 * np.sqrt(2 / 3) * ellipk(2 / 3), rel=1e-13)


def test_restricted_three_bodies_two_ways():
    """The same orbit from Lagrange's and from Hamilton's equations: period, multipliers, energy and action."""
    ratio, state, period = 0.01215057, [0.8232, 0.0, 0.0, 0.1270], 2.7437
    lagrange = of.systems.restricted_three_body(ratio=ratio)
    one = of.find_orbit(of.Problem(lagrange, of.Guess(state, period), of.pin(x=state[0]), symmetry="mirror"))
    model = of.systems.restricted_three_body_canonical(ratio=ratio)
    start = [state[0], 0.0, 0.0, 0.0, state[3] + state[0], 0.0]
    two = of.find_orbit(of.Problem(model, of.Guess(start, period), of.pin(x=state[0]), symmetry="mirror"))
    assert one.certificate.passed and two.certificate.passed, (one.certificate.failures, two.certificate.failures)
    for name in ("period", "energy", "action"):
        assert getattr(two, name) == pytest.approx(getattr(one, name), rel=1e-11)
    planar = one.floquet_multipliers.real
    assert min(abs(two.floquet_multipliers - planar[0])) < 1e-6 * planar[0]
    assert two.symmetry == "mirror+plane" or two.symmetry == "mirror"


def test_small_lyapunov_orbit_of_the_trial():
    """T = 2.691599600113614, multipliers 2675.28714 and 0.98447986 +- 0.17549759 i, found with other equations."""
    model = of.systems.restricted_three_body_canonical(ratio=0.01215057)
    guess = of.Guess([0.836605687, 0, 0, 0, 0.839202983, 0], 2.6916)
    orbit = of.find_orbit(of.Problem(model, guess, of.pin(period=2.691599600113614), symmetry="mirror"))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.floquet_multipliers[0].real == pytest.approx(2675.28714, abs=1e-3)
    assert abs(orbit.floquet_multipliers[1]) == pytest.approx(1.0, abs=1e-8)
    assert orbit.floquet_multipliers[1].real == pytest.approx(0.98447986, abs=1e-8)


def test_forced_first_order_system():
    """x' = -x + cos(w t): the circle of amplitude 1 / sqrt(1 + w^2), multiplier exp(-T)."""

    def field(t, x, p):
        return [-x.x + ca.cos(p.w * t)]

    with pytest.raises(InputError, match="field: depends on time; give the period of that, forcing_period="):
        of.ode(field, ("x",), {"w": 2.0})
    model = of.ode(field, ("x",), {"w": 2.0}, forcing_period=lambda p: 2 * np.pi / p.w)
    orbit = of.find_orbit(of.Problem(model, of.Guess([0.1], 3.0)))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.state[0] == pytest.approx(1 / 5, abs=1e-13) and orbit.period == pytest.approx(np.pi, rel=1e-15)
    assert orbit.floquet_multipliers == pytest.approx([np.exp(-np.pi)], rel=1e-9)


@pytest.mark.slow
def test_components_of_units_of_their_own():
    """Volts, amperes and seconds a million times smaller: the same periods, certified alike."""

    def scaled(size, pace):
        def field(_, x, p):
            u, v = x.u / size, x.v
            made = u**2 * v
            return [size * pace * (1 - 4 * u + made), pace * (3 * u - made)]

        return of.ode(field, ("u", "v"))

    for size, pace in ((1.0, 1.0), (1e-6, 1e3), (1e4, 1e-3)):
        orbit = of.find_orbit(of.Problem(scaled(size, pace), of.Guess([3.6 * size, 1.3], 7.2 / pace)))
        assert orbit.certificate.passed, (size, orbit.certificate.failures)
        assert orbit.period * pace == pytest.approx(7.15691992117988, rel=1e-12)


MESSAGES = {
    "states": (lambda: of.ode(lambda t, x, p: [], ()), "states: give the names"),
    "twice": (lambda: of.ode(lambda t, x, p: [x.a], ("a",), {"a": 1.0}), "'a' would name two things"),
    "count": (lambda: of.ode(lambda t, x, p: [x.a], ("a", "b")), "field: 1 rates for 2 states"),
    "name": (lambda: of.ode(lambda t, x, p: [x.aa], ("a",)), "field: unknown name 'aa'.*known are a"),
    "kind": (lambda: of.ode(lambda t, x, p: ["one"], ("a",)), "field: a: expected an expression"),
    "shape": (lambda: of.ode(lambda t, x, p: [ca.SX(2, 1)], ("a",)), "field: a: expected one number, got shape"),
    "stray": (lambda: of.ode(lambda t, x, p: [ca.SX.sym("k")], ("a",)), "field: depends on k"),
    "value": (lambda: of.ode(lambda t, x, p: [x.a], ("a",), {"b": np.inf}), "parameters.b: must be a finite number"),
    "angles": (lambda: of.ode(lambda t, x, p: [x.a], ("a",), angles=("b",)), "angles: 'b' is no component"),
    "signs": (
        lambda: of.ode(lambda t, x, p: [x.a], ("a",), symmetries={"s": (1, {"b": -1})}), "'b': -1}; .*components .a."
    ),
    "sense": (lambda: of.ode(lambda t, x, p: [x.a], ("a",), symmetries={"s": (2, {})}), "sense of time 2 .*give 1"),
    "unmoved": (lambda: of.ode(lambda t, x, p: [x.a], ("a",), symmetries={"s": (1, {"a": 1})}), "not 1 throughout"),
    "momenta": (lambda: of.hamiltonian(lambda x, c: x.p, ("q", "r"), ("p",)), "momenta: 1 names for 2"),
    "invariant": (
        lambda: of.ode(lambda t, x, p: [x.a], ("a",), invariants={"a": lambda x, p: x.a}), "names something else"
    ),
    "clock": (
        lambda: of.ode(lambda t, x, p: [ca.cos(t)], ("a",), forcing_period=lambda p: ca.SX.sym("k")),
        "forcing_period: may depend on the parameters only",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", MESSAGES)
def test_messages(case):
    """Bad input is named with what to do."""
    make, message = MESSAGES[case]
    with pytest.raises(InputError, match=message):
        make()


def test_a_symmetry_that_the_equations_lack_is_refused():
    """Rössler's are no image of themselves under x -> -x; its own names are offered."""
    model = of.systems.rossler()
    assert list(symmetries_of(model)) == ["none", "reflection"]
    with pytest.raises(InputError, match="equations change under x -> -x"):
        of.Problem(model, of.Guess([-3.9, 5.6, 0.03], 5.88), symmetry="reflection")
    with pytest.raises(InputError, match="pin: energy is not conserved"):
        of.Problem(model, of.Guess([-3.9, 5.6, 0.03], 5.88), of.pin(energy=1.0))


KNOWN = ("brusselator", "fitzhugh-nagumo", "hodgkin-huxley", "lorenz", "rossler", "three-body-halo",
         "three-body-lyapunov")  # fmt: skip


@pytest.mark.parametrize("name", KNOWN)
def test_gallery(name):
    """Every problem file of a first-order system gives the number that it expects, certified."""
    orbit = of.find_orbit(load_problem(f"problems/gallery/{name}.toml"))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert "expected_period" in {check.name for check in orbit.certificate.checks}


@pytest.mark.slow
def test_rossler_family_doubles_where_its_multiplier_is_minus_one(tmp_path):
    """In c from 3.2 to 2.6: one period doubling, at an orbit whose multiplier, found apart, is -1; kept in its file."""
    start = of.find_orbit(of.Problem(of.systems.rossler(), of.Guess([-3.9, 5.6, 0.03], 5.88)))
    family = of.follow_family(start, "c", until=2.6, out=tmp_path)
    (doubling,) = [event for event in family.events if event.kind == "period_doubling"]
    assert doubling.certified and doubling.parameter == pytest.approx(2.832445028, abs=2e-9)
    there = of.systems.rossler(c=doubling.parameter)
    orbit = of.find_orbit(of.Problem(there, of.Guess(doubling.state, doubling.period)))
    assert orbit.floquet_multipliers[0].real == pytest.approx(-1.0, abs=1e-8)
    again = of.load_family(next(tmp_path.rglob("family.json")))
    assert np.isnan(again.points[0].energy) and again.points[0].winding == (0, 0, 0)
    assert of.certify(again.points[-1]).passed
    doubled = of.switch_branch(again, 0, settings=of.FamilySettings(points=2))
    branch = of.follow_family(doubled, until=2.9)
    assert branch.points[-1].period == pytest.approx(2 * doubling.period, rel=1e-2)


@pytest.mark.slow
def test_halo_orbits_leave_the_planar_family():
    """From the libration point: mode, planar family, branch points of the trial, and a switch that leaves the plane."""
    model = of.systems.restricted_three_body_canonical(ratio=0.01215057)
    guess = of.guesses.normal_mode(model, 2, 0.02, [0.837, 0, 0, 0, 0.837, 0])
    settings = of.FamilySettings(directions="forward", points=30)
    family = of.follow_family(of.Problem(model, guess, symmetry="mirror"), settings=settings)
    first = next(event for event in family.events if event.kind == "branch_point")
    assert first.parameter == pytest.approx(-1.58717591, abs=1e-8) and first.certified
    halo = of.follow_family(of.switch_branch(family, 0), points=25)
    assert abs(halo.points[-1].state[2]) > 1e-3 and of.certify(halo.points[-1]).passed


def test_free_top_is_followed_in_energy_at_its_momentum():
    """Of two parameters of the family one is held: the square of the momentum stays."""
    model = rigid_body()
    orbit = of.find_orbit(of.Problem(model, of.Guess([0.3, 0.3, 1.0], 20.0), of.pin(energy=0.24, square=1.2)))
    family = of.follow_family(orbit, until=0.25, model=model)
    last = family.points[-1]
    assert last.energy == pytest.approx(0.25, abs=1e-12) and last.state @ last.state == pytest.approx(1.2, abs=1e-11)


def test_modes_of_an_equilibrium():
    """Eigenvalues against closed forms: the Brusselator's at (1, B), and those of L1 whose product is known."""
    place, values, _ = first_order_modes(of.systems.brusselator(rate=2.1), [0.9, 2.0])
    assert place == pytest.approx([1.0, 2.1], abs=1e-12)
    assert values == pytest.approx([0.05 + 1j * np.sqrt(1 - 0.05**2)], abs=1e-12)
    cycle = of.find_orbit(of.Problem(of.systems.brusselator(rate=2.1),
                          of.guesses.normal_mode(of.systems.brusselator(rate=2.1), 1, 0.3, [1, 2])))  # fmt: skip
    assert cycle.certificate.passed and cycle.stability == "asymptotically stable"
    with pytest.raises(InputError, match="guess.mode: must be between 1 and 1, got 2"):
        of.guesses.normal_mode(of.systems.brusselator(rate=2.1), 2, 0.3, [1, 2])
    with pytest.raises(InputError, match="equilibrium: shape"):
        of.guesses.normal_mode(of.systems.brusselator(rate=2.1), 1, 0.3, [1])


def test_what_cannot_be_done_is_said():
    """Peak rates: a sentence and no traceback."""
    clock = of.systems.brusselator()
    with pytest.raises(InputError, match="min_peak_rate is about velocities"):
        of.Problem(clock, of.Guess([3.6, 1.3], 7.2), free=("rate",), objective="min_peak_rate")


def test_largest_amplitude_of_a_clock():
    """max_amplitude over a range of a parameter ends at the range's end."""
    clock = of.systems.brusselator(rate=2.1)
    guess = of.guesses.normal_mode(clock, 1, 0.3, [1, 2])
    problem = of.Problem(clock, guess, free=("rate",), objective="max_amplitude", bounds={"rate": (2.05, 2.5)})
    orbit = of.find_orbit(problem)
    assert orbit.certificate.passed and orbit.provenance["free"]["rate"] == pytest.approx(2.5, abs=1e-9)


def test_pictures_and_exports(tmp_path):
    """Figures without energy or links, a moving state, and C that evaluates to the same rates."""
    orbit = of.find_orbit(load_problem("problems/gallery/hodgkin-huxley.toml"))
    assert {one.name for one in of.save_figures(orbit, tmp_path)} == {"time_histories.png", "phase_portraits.png"}
    clip = of.orbit_clip(orbit)
    assert clip.points.shape[1:] == (2, 1) and np.ptp(clip.points, axis=0) == pytest.approx(1.0, abs=0.05)
    for to in ("csv", "auto", "julia", "c"):
        of.export_orbit(orbit, to, tmp_path)
    assert "energy" not in (tmp_path / "hodgkin_huxley.c").read_text().split("*/")[0]
    library = tmp_path / "rates.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, tmp_path / "hodgkin_huxley.c", "-lm"], check=True)
    call, found = ctypes.CDLL(str(library)).hodgkin_huxley_rhs, (ctypes.c_double * 4)()
    state, current = (ctypes.c_double * 4)(*orbit.state), (ctypes.c_double * 1)(10.0)
    call(ctypes.c_double(0.0), state, current, current, found)
    wanted = of.systems.hodgkin_huxley().rate(0.0, orbit.state, [10.0]).full().ravel()
    assert np.array(found) == pytest.approx(wanted, rel=1e-14)


def test_command_line(tmp_path):
    """run, verify, simulate and page of an orbit without energy: exit code 0, and JSON that has null for it."""
    runner = CliRunner()
    made = runner.invoke(cli, ["run", "problems/gallery/brusselator.toml", "-o", str(tmp_path), "--json"])
    assert made.exit_code == 0 and json.loads(made.stdout)["results"][0]["energy"] is None
    orbit = str(tmp_path / "brusselator" / "orbit.json")
    assert runner.invoke(cli, ["verify", orbit]).exit_code == 0
    moved = runner.invoke(cli, ["simulate", "problems/gallery/brusselator.toml", "--json"])
    assert moved.exit_code == 0 and json.loads(moved.stdout)["energy"] is None
    shown = runner.invoke(cli, ["page", orbit, "-o", str(tmp_path / "site")])
    pages = [page.read_text() for page in (tmp_path / "site" / "orbits").rglob("*.html")]
    assert shown.exit_code == 0 and len(pages) == 1 and "Frequency" in pages[0]
    assert "Action" not in pages[0] and "<dt>Energy" not in pages[0]


def test_an_atlas_tells_orbits_of_a_clock_apart(tmp_path):
    """One orbit begun at two of its instants is one orbit; its energy is 0 in the index and nan in the Orbit."""
    clock = of.systems.brusselator()
    one = of.find_orbit(of.Problem(clock, of.Guess([3.6, 1.3], 7.2)))
    same = of.find_orbit(of.Problem(clock, of.Guess(one.samples[len(one.samples) // 3], 7.2)))
    with of.Atlas(tmp_path / "a.sqlite", clock.system, write=True) as atlas:
        assert atlas.add(one) == (1, True) and atlas.add(same) == (1, False)
        assert atlas.rows()[0].energy == 0.0 and np.isnan(atlas.orbit(1).energy)
    assert of.load_orbit(f"{tmp_path}/a.sqlite#1").period == one.period
