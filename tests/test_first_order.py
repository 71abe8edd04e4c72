"""First-order systems and Hamilton's equations: known orbits, two formulations, planted failures, files."""

import json
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.special import ellipk

import orbitfinder as of
from orbitfinder.errors import CountError, InputError
from orbitfinder.loops.symmetry import symmetries_of
from orbitfinder.mechanics.model import vector_field
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
    with pytest.raises(InputError, match="energy of a mechanical system is missing"):
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
        lambda: of.ode(lambda t, x, p: [x.a], ("a",), symmetries={"s": (1, {"b": -1})}), "symmetries: 'b': -1"
    ),
    "sense": (lambda: of.ode(lambda t, x, p: [x.a], ("a",), symmetries={"s": (2, {})}), "sense of time 2; give 1"),
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


KNOWN = ("brusselator", "fitzhugh-nagumo", "hodgkin-huxley", "lorenz", "rossler", "three-body-halo")


@pytest.mark.parametrize("name", KNOWN)
def test_gallery(name):
    """Every problem file of a first-order system gives the number that it expects, certified."""
    orbit = of.find_orbit(load_problem(f"problems/gallery/{name}.toml"))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert "expected_period" in {check.name for check in orbit.certificate.checks}
