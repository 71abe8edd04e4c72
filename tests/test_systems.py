"""The built-in systems: known results, symmetric variants, and rebuilding from a description."""

import json
import sys

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import ellipk

from orbitfinder.errors import InputError
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import energy
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.certify import certify
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.simulate import simulate
from orbitfinder.problemfile.read import load_problem
from orbitfinder.records.orbit import save_orbit
from orbitfinder.records.registry import load_orbit
from orbitfinder.systems import FUNCTIONS


def found(function, state, period, pins=(), symmetry="none", **arguments):
    orbit = find_orbit(Problem(FUNCTIONS[function](**arguments), Guess(state, period), pin=pins, symmetry=symmetry))
    assert orbit.certificate.passed, orbit.certificate.failures
    return orbit


@pytest.mark.parametrize("function", FUNCTIONS)
def test_every_system_is_rebuilt_from_its_description(function):
    """Through JSON and back: same rates at random states, same names and numbers."""
    model = FUNCTIONS[function]()
    again = build_model(json.loads(json.dumps(model.system)))
    random = np.random.default_rng(0)
    for _ in range(3):
        x, t = random.normal(0.7, 0.2, len(model.state_names)), random.uniform()
        one = model.rate(t, x, model.parameter_values).full()
        np.testing.assert_array_equal(one, again.rate(t, x, again.parameter_values).full())
    assert model.state_names == again.state_names and model.parameter_names == again.parameter_names
    name, value = model.parameter_names[0], 1.5 * model.parameter_values[0]
    changed = build_model(with_parameters(model, {name: value}).system)
    assert changed.parameter_values[0] == pytest.approx(value)


@pytest.mark.parametrize("amplitude", [0.1, 1.0, 3.0])
def test_duffing_period_is_its_elliptic_integral(amplitude):
    """T = 4 K(m) / sqrt(1 + a^2), m = a^2 / (2 (1 + a^2)) (Nayfeh and Mook, section 2.3), to 1e-13."""
    orbit = found("duffing", [amplitude, 0.0], 6.3 / np.sqrt(1 + 0.7 * amplitude**2), pin(x=amplitude))
    square = amplitude**2
    assert orbit.period == pytest.approx(4 * ellipk(square / (2 * (1 + square))) / np.sqrt(1 + square), rel=1e-13)


@pytest.mark.parametrize("level", [1 / 12, 1 / 8, 0.16])
def test_henon_heiles_straight_line_orbit_is_its_quadrature(level):
    """On x = 0: T = 2 int ds / sqrt(2/3 (c - y(s))), y between the two turning points, c the third root."""

    def potential(y):
        return y**2 / 2 - y**3 / 3

    low, high = (brentq(lambda y: potential(y) - level, *ends, xtol=1e-16) for ends in ((-1, 0), (0, 1)))
    third = 1.5 - low - high
    exact = 2 * quad(
        lambda s: 1 / np.sqrt(2 / 3 * (third - (high + low) / 2 - (high - low) / 2 * np.sin(s))),
        -np.pi / 2, np.pi / 2, epsabs=1e-13, epsrel=1e-13,
    )[0]  # fmt: skip
    orbit = found("henon_heiles", [0.0, low, 0.0, 0.0], exact * 1.01, pin(energy=level))
    assert np.abs(orbit.samples[:, 0]).max() < 1e-9
    assert orbit.period == pytest.approx(exact, rel=1e-12)
    assert orbit.symmetry == "brake"


def test_henon_heiles_loops_are_one_orbit_in_two_directions():
    """The loop at E = 1/8 and its time reversal: equal periods, actions and multipliers, no brake instant."""
    one = found("henon_heiles", [0.0, 0.25, 0.3, 0.0], 6.3, pin(energy=0.125))
    other = found("henon_heiles", [*one.state[:2], *-one.state[2:]], one.period, pin(energy=0.125))
    assert one.symmetry == other.symmetry == "none" and one.stability == "elliptic"
    assert other.period == pytest.approx(one.period, rel=1e-12) and other.action == pytest.approx(one.action, rel=1e-11)


def test_the_vertical_bounce_of_a_swinging_spring_is_harmonic_and_unstable():
    """T = 2 pi sqrt(m / k) at any amplitude; sideways it obeys a Mathieu-like equation and is unstable here."""
    orbit = found("spring_pendulum", [1.2, 0.0, 0.3, 0.8], 1.0, pin(energy=-11.0))
    assert np.abs(orbit.samples[:, 1]).max() < 1e-9
    assert orbit.period == pytest.approx(2 * np.pi / np.sqrt(29.4), rel=1e-13)
    assert orbit.stability == "unstable" and orbit.symmetry == "brake"


def test_a_free_cart_shortens_the_period_of_its_pendulum_as_reduction_says():
    """With zero momentum the cart is eliminated: T by quadrature of M(theta) = m l^2 (1 - k cos^2), k = m/(m+M)."""
    orbit = found("pendulum_on_cart", [0.0, 0.5, 0.0, 0.0], 1.4, pin(energy=-9.0))
    amplitude = float(np.arccos(9.0 / 9.8))

    def integrand(s):
        # sin(theta/2) = sin(a/2) sin(s), as for the plain pendulum
        theta = 2 * np.arcsin(np.sin(amplitude / 2) * np.sin(s))
        return np.sqrt(1 - 0.5 * np.cos(theta) ** 2) / np.sqrt(1 - (np.sin(amplitude / 2) * np.sin(s)) ** 2)

    exact = 4 / np.sqrt(9.8) * quad(integrand, 0, np.pi / 2, epsabs=1e-13, epsrel=1e-13)[0]
    assert orbit.period == pytest.approx(exact, rel=1e-11)
    assert len(orbit.unfolding) == 2 and orbit.floquet_multipliers.size == 0
    assert orbit.provenance["invariants"] == ["energy", "momentum_y"]


def test_the_bead_on_a_hoop_has_the_period_of_its_small_motions():
    """Off the bottom at cos(theta) = g / (r W^2): frequency^2 = W^2 sin^2(theta), approached at small amplitude."""
    place = np.arccos(9.8 / 16)
    model = FUNCTIONS["rotating_hoop"](spin=4.0)
    floor = energy(model, [place, 0.0])
    orbit = find_orbit(Problem(model, Guess([place + 0.02, 0.0], 2.0), pin=pin(energy=floor + 1e-4)))
    assert orbit.certificate.passed
    assert orbit.period == pytest.approx(2 * np.pi / (4 * np.sin(place)), rel=1e-4)


def test_cart_chain_modes_are_those_of_the_linear_chain():
    """Without cubic springs every mode k has period 2 pi / (2 sin(k pi / (2 n + 2))) at any amplitude."""
    from orbitfinder.orbits.guesses.modes import normal_mode

    model = FUNCTIONS["cart_chain"](carts=4)
    for k in (1, 2, 3, 4):
        guess = normal_mode(model, k, 0.3)
        assert guess.period == pytest.approx(np.pi / np.sin(k * np.pi / 10), rel=1e-12)


def test_a_moved_file_is_verified_without_the_program(tmp_path):
    """orbit.json of a python system is certified from the file alone."""
    orbit = found("van_der_pol", [2.0, 0.0], 6.5)
    path = save_orbit(orbit, tmp_path / "orbit.json")
    assert certify(load_orbit(path)).passed


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (dict(function="henon_heils"), "system.function: .*did you mean 'henon_heiles'"),
        (dict(module="os", function="getcwd"), "system.module: 'os' is a program .* add --trust"),
        (dict(function="duffing", arguments=dict(mass=1.0)), "system.arguments: .*mass"),
        (dict(function="cart_chain", arguments=dict(carts=10**9)), "carts: must be a whole number from 1 to 200"),
        (dict(function="spring_pendulum", arguments=dict(mass=-1.0)), "mass: must be positive, got -1.0"),
        (dict(function="duffing", arguments=dict(cubic=float("nan"))), "cubic: must be a finite number, got nan"),
        (dict(function="duffing", arguments=dict(cubic="1")), "cubic: must be a finite number, got '1'"),
        (dict(function=3), "system: a python system needs module and function"),
    ],
)
def test_unusable_python_systems_are_refused(system, message):
    """Unknown functions, foreign modules, hostile sizes: InputError with the field and a remedy."""
    with pytest.raises(InputError, match=message):
        build_model({"kind": "python", **system})


def test_foreign_code_runs_only_for_a_trusted_file(tmp_path):
    """A module beside the file is imported with the folder's trust and leaves no trace without it."""
    (tmp_path / "mine.py").write_text(
        "from pathlib import Path\nPath(__file__).with_suffix('.ran').touch()\n"
        "from orbitfinder.systems import FUNCTIONS\ndef make(cubic):\n    return FUNCTIONS['duffing'](1.0, cubic)\n"
        "def wrong():\n    return 3\ndef broken():\n    raise RuntimeError('no')\n"
    )
    system = {"kind": "python", "module": "mine", "function": "make", "arguments": {"cubic": 2.0}}
    with pytest.raises(InputError, match="'mine' is a program that is not part of orbitfinder, so it was not run"):
        build_model(system)
    assert not (tmp_path / "mine.ran").exists()
    model = build_model(system, tmp_path)
    assert (tmp_path / "mine.ran").exists() and dict(model.system) == system
    for name, said in (("wrong", "returned int"), ("broken", "RuntimeError: no"), ("absent", "no function 'absent'")):
        with pytest.raises(InputError, match=said):
            build_model({"kind": "python", "module": "mine", "function": name}, tmp_path)
    with pytest.raises(InputError, match="is no module name"):
        build_model({"kind": "python", "module": "../mine", "function": "make"}, tmp_path)


def test_a_simulation_at_other_parameters():
    """It is that of the model at these; others are refused."""
    model = FUNCTIONS["duffing"](1.0, 0.0)
    run = simulate(model, [1.0, 0.0], 2.0, samples=5, parameters={"stiffness": 4.0})
    assert np.allclose(run.states[:, 0], np.cos(2 * run.times), atol=1e-9)
    assert np.allclose(simulate(model, [1.0, 0.0], 2.0, samples=5).states[:, 0], np.cos(run.times), atol=1e-9)
    with pytest.raises(InputError, match="stifness"):
        simulate(model, [1.0, 0.0], 2.0, parameters={"stifness": 4.0})


def test_a_module_beside_the_file_imports_its_neighbours(tmp_path):
    """At its top and later, of a Python problem file too; of two folders each its own, and none stays behind."""
    text = (
        "import own_numbers\nimport orbitfinder as of\ndef made(cubic=own_numbers.CUBIC):\n    import own_more\n"
        "    return of.systems.duffing(own_more.STIFFNESS, cubic)\n"
        "def problem():\n    return of.Problem(made(), of.Guess([1.0, 0.0], 5.0), of.pin(x=1.0), name='own')\n"
    )
    for name, cubic in (("a", 2.0), ("b", 3.0)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.py").write_text(text)
        (tmp_path / name / "own_numbers.py").write_text(f"CUBIC = {cubic}\n")
        (tmp_path / name / "own_more.py").write_text("STIFFNESS = 1.5\n")
        model = build_model({"kind": "python", "module": "mine", "function": "made"}, tmp_path / name)
        assert model.parameter_values.tolist() == [1.5, cubic]
        read = load_problem(tmp_path / name / "mine.py", trust=True).model
        assert read.parameter_values.tolist() == [1.5, cubic]
    assert not {"own_numbers", "own_more"} & set(sys.modules) and str(tmp_path / "a") not in sys.path


def test_a_builder_whose_numbers_are_not_its_models_parameters_is_refused_where_it_is_read(tmp_path):
    """What worked until `verify`, which could not give the parameter to it."""
    text = (
        "import orbitfinder as of\ndef made(k=1.0, size=3):\n    return of.systems.duffing(k, 0.5)\n"
        "def right(stiffness=1.0, size=3):\n    return of.systems.duffing(stiffness, 0.5)\n"
    )
    (tmp_path / "mine.py").write_text(text)
    system = {"kind": "python", "module": "mine", "function": "made"}
    said = "system.arguments: mine.made takes 'k', which is no parameter of its Model, and not the Model's 'stiffness'"
    with pytest.raises(InputError, match=said):
        build_model(system, tmp_path)
    (tmp_path / "p.toml").write_text(
        '[system]\nkind = "python"\nmodule = "mine"\nfunction = "made"\n[guess]\nstate = [1.0, 0.0]\nperiod = 5.0\n'
    )
    with pytest.raises(InputError, match="call both the same"):
        load_problem(tmp_path / "p.toml", trust=True)
    assert build_model(system | {"function": "right"}, tmp_path).parameter_names == ("stiffness", "cubic")


def test_a_problem_file_asks_for_trust_and_gets_it(tmp_path):
    """The same through a TOML file."""
    (tmp_path / "mine.py").write_text(
        "from orbitfinder.systems import FUNCTIONS\ndef make():\n    return FUNCTIONS['duffing']()\n"
    )
    file = tmp_path / "problem.toml"
    file.write_text(
        '[system]\nkind = "python"\nmodule = "mine"\nfunction = "make"\n[guess]\nstate = [1.0, 0.0]\nperiod = 5.0\n'
    )
    with pytest.raises(InputError, match="add --trust"):
        load_problem(file)
    assert load_problem(file, trust=True).model.state_names == ("x", "xdot")


def test_a_symmetry_that_the_equations_lack_is_refused():
    """Henon-Heiles is not odd: a reflection cannot be imposed, and the message says so."""
    with pytest.raises(InputError, match="symmetry: this system's equations change under x -> -x"):
        Problem(FUNCTIONS["henon_heiles"](), Guess([0.1, 0.1, 0.0, 0.0], 6.0), symmetry="reflection")


def test_a_running_orbit_is_recognised_with_its_winding():
    """Both links turn over: winding (1, 1) without being asked for, symmetric under reversal, no brake."""
    model = chain(2)
    guess = Guess([0.0, 0.0, 8.0, 8.0], 0.85)
    orbit = find_orbit(Problem(model, guess, pin=pin(energy=energy(model, guess.state))))
    assert orbit.certificate.passed
    assert orbit.winding == (1, 1) and orbit.symmetry == "reversal"


def test_a_limit_cycle_that_stops_is_not_a_brake_orbit():
    """The van der Pol rate vanishes twice a period, but the motion does not run back."""
    assert "brake" not in found("van_der_pol", [2.0, 0.0], 6.5).symmetry


def test_a_damped_forced_motion_is_no_brake_orbit_unless_it_is_linear():
    """Every rate of one coordinate vanishes somewhere; only the sinusoid also runs back as it came."""
    linear = found("forced_duffing", [0.1, 0.0], 5.2, cubic=0.0)
    assert linear.symmetry == "brake+reflection"
    bent = found("forced_duffing", [-1.5, 0.0], 3.93, cubic=0.05, damping=0.2, force=2.5, frequency=1.6)
    assert bent.symmetry == "reflection"
