"""Feedback along orbits: Riccati's equation, multipliers of the nonlinear closed loop, basins, exports, refusals."""

import ctypes
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from conftest import DATA
from scipy.integrate import solve_ivp
from scipy.linalg import solve_discrete_are
from scipy.optimize import linear_sum_assignment
from test_search_command import run

import orbitfinder as of
from orbitfinder.control.basin import disturbed
from orbitfinder.control.controller import save_controller
from orbitfinder.control.export import export_controller, law_of
from orbitfinder.control.feedback import certify_controller, verified
from orbitfinder.control.riccati import Scattering, periodic, whole
from orbitfinder.control.strikes import Striking, left
from orbitfinder.control.transverse import Reference
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.lagrange import Symbols
from orbitfinder.mechanics.model import vector_field
from orbitfinder.records.orbit import save_orbit

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))

from feedback import by_differences  # noqa: E402

RICCATI = next(one for one in json.loads((DATA / "control.json").read_text())["entries"] if one["id"] == "riccati")
P0, MULTIPLIER = 2.15015910320884971803, 0.0005962133018630247767574
"""Of x' = x cos t + u, Q = R = 1: in control.json, as text"""


def failed(controller):
    return [check.name for check in controller.certificate.checks if not check.passed]


@pytest.fixture(scope="module")
def held(report_orbits):
    """The report's unstable triple 1 with a motor at its second joint."""
    return of.stabilise(report_orbits["triple-1"], ["torque2"])


# --------------------------------------------------------------------------------------------------
# Riccati's equation


def scalar_pieces(count):
    """x' = x cos t + u with Q = R = 1, from DOP853 of its Hamiltonian system."""

    def field(t, y):
        return (np.array([[np.cos(t), -1.0], [-1.0, -np.cos(t)]]) @ y.reshape(2, 2)).ravel()

    found = []
    for span in pairwise(np.linspace(0, 2 * np.pi, count + 1)):
        end = solve_ivp(field, span, np.eye(2).ravel(), method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
        found.append(Scattering.of(end.reshape(2, 2)[:, :, None, None]))
    return found


def test_the_reference_is_what_is_compared():
    assert str(P0)[:15] in RICCATI["values"]["scalar_a_cos_t"]
    assert str(MULTIPLIER)[:15] in RICCATI["values"]["scalar_a_cos_t"]


@pytest.mark.parametrize("count", [3, 16])
def test_periodic_riccati_equation_against_the_reference(count):
    found = periodic(scalar_pieces(count))
    assert found.solutions[0, 0, 0] == pytest.approx(P0, abs=1e-12)
    assert found.monodromy[0, 0] == pytest.approx(MULTIPLIER, abs=1e-14)


def test_the_whole_design_against_the_reference():
    """x = sin t of x' = (x - sin t) cos t + cos t + u: in units of extents and radians the weights are 1 again."""
    model = of.ode(
        lambda t, x, p: [(x["x"] - ca.sin(t)) * ca.cos(t) + ca.cos(t) + p["u"]], ["x"], {"u": 0.0},
        forcing_period=2 * np.pi, controls=["u"],
    )  # fmt: skip
    orbit = of.find_orbit(of.Problem(model, of.Guess([0.1], 2 * np.pi)))
    found = of.stabilise(orbit, model=model)
    assert found.clock and found.stabilised and found.units[0] == pytest.approx(found.control_units[0], rel=1e-9)
    assert found.gains[0, 0] == pytest.approx(P0, abs=1e-8)
    assert found.predicted[0].real == pytest.approx(MULTIPLIER, abs=1e-10)
    assert found.multipliers[0].real == pytest.approx(MULTIPLIER, abs=1e-10)


def test_doubling_agrees_with_scipys_discrete_riccati_equation(held):
    """The period as one step: P(0) of all the pieces is that of `solve_discrete_are` on Phi, G and H."""
    reference = trial(held)
    pieces = reference.pieces(np.eye(6), np.eye(1))
    one = whole(pieces)
    root = np.linalg.cholesky(one.reach + 1e-300 * np.eye(5))
    expected = solve_discrete_are(one.transition, root, one.cost, np.eye(5))
    assert np.abs(periodic(pieces).solutions[0] - expected).max() <= 1e-8 * np.abs(expected).max()


def trial(controller):
    """The orbit of a controller, as it was designed on."""
    return Reference(
        build_model(controller.system), controller.actuators, controller.period, controller.states, controller.units,
        controller.clock,
    )  # fmt: skip


def test_riccati_differential_equation_closes_to_1e_8(held):
    """-P' = A^T P + P A - P B R^-1 B^T P + Q, integrated backwards by DOP853 in all six components, comes back."""
    reference = trial(held)
    found, model, units = periodic(reference.pieces(np.eye(6), np.eye(1))), reference.model, reference.units
    p = reference.bases @ found.solutions @ reference.bases.transpose(0, 2, 1)
    field = vector_field(model, held.actuators)
    t, x, u = ca.SX.sym("t"), ca.SX.sym("x", 6), ca.SX.sym("u", 1)
    rate = field(t, x, ca.SX(0, 1), u)
    slopes = ca.Function("slopes", [x, u], [rate, ca.jacobian(rate, x), ca.jacobian(rate, u)])

    def backwards(_, y):
        rate, a, b = (one.full() for one in slopes(y[:6], [0.0]))
        across = np.eye(6) - (n := rate / units[:, None]) @ n.T / (n.T @ n)
        a, b, now = a * units / units[:, None], b / units[:, None] * reference.control_units, y[6:].reshape(6, 6)
        change = a.T @ now + now @ a - now @ b @ b.T @ now + across
        return np.concatenate([-rate.ravel(), change.ravel()])

    edges, largest = np.linspace(0, len(p) - 1, 9).astype(int), 0.0
    for first, last in pairwise(edges):
        span = (last - first) * held.period / (len(p) - 1)
        start = np.concatenate([reference.states[last], p[last].ravel()])
        end = solve_ivp(backwards, (0, span), start, method="DOP853", rtol=1e-10, atol=1e-12).y[6:, -1]
        largest = max(largest, float(np.abs(end.reshape(6, 6) - p[first]).max()))
    assert largest <= 1e-8 * np.abs(p).max()


def test_what_is_out_of_reach_has_no_solution():
    stuck = Scattering(np.array([[1.1]]), np.zeros((1, 1)), np.ones((1, 1)))
    with pytest.raises(ConvergenceError, match="out of the actuators' reach"):
        periodic([stuck])
    with pytest.raises(ConvergenceError, match="Q gives it no weight"):
        periodic([Scattering(np.eye(1), np.eye(1), np.zeros((1, 1)))])


# --------------------------------------------------------------------------------------------------
# What is claimed of a controller, and what must not be


def test_triple_1_is_held_by_its_second_joint(held, report_orbits):
    """2n - 1 deviations, the energy among them; all decay, and twice the same numbers."""
    free = report_orbits["triple-1"].floquet_multipliers
    assert np.abs(held.open_loop).max() == pytest.approx(np.abs(free).max(), abs=1e-7)
    assert len(held.open_loop) == 5 and np.abs(held.open_loop - 1.0).min() <= 1e-7  # the energy's
    assert held.stabilised and np.abs(held.multipliers).max() < 0.9
    assert min(held.authority.values()) > 0 and set(held.authority) == {"torque1", "torque2", "torque3"}
    assert held.system["motors"] == [2] and max(one.value for one in held.certificate.checks[::2]) <= 1e-8


def test_multipliers_by_another_program(held):
    """SciPy's DOP853 on the exported law, central differences of fourth order: all five to 1e-8."""
    apart = np.abs(by_differences(held)[:, None] - held.multipliers)
    assert apart[linear_sum_assignment(apart)].max() <= 1e-8


def test_planted_gains_of_the_wrong_sign(held):
    wrong = verified(replace(held, gains=-held.gains))
    assert not wrong.stabilised and "multipliers" in failed(wrong) and np.abs(wrong.multipliers).max() > 1.5


def test_planted_no_gains(held):
    idle = verified(replace(held, gains=0 * held.gains))
    assert not idle.stabilised and "multipliers" in failed(idle)
    assert np.abs(idle.multipliers).max() == pytest.approx(np.abs(held.open_loop).max(), abs=1e-6)


def test_planted_gains_a_percent_off(held):
    """Still stable, and yet not the design: named."""
    assert failed(verified(replace(held, gains=1.01 * held.gains))) == ["agreement"]


def test_planted_another_orbit(held):
    assert "reference" in failed(verified(replace(held, states=held.states * (1 + 1e-6))))


def test_planted_units_that_hide_a_gap(held):
    """A motion that is none, in units so large that no gap is seen, its multipliers said to be as designed."""
    faster = np.r_[np.ones(3), np.full(3, 1.02)]
    other = verified(replace(held, states=held.states * faster, units=held.units * 1e9))
    assert "reference" in failed(verified(replace(other, predicted=other.multipliers)))


def test_planted_motion_that_does_not_close(held):
    turned = held.states.copy()
    turned[-1, 0] += 1e-6
    assert "reference" in failed(verified(replace(held, states=turned)))


def test_planted_multipliers_in_the_record(held):
    found = certify_controller(replace(held, multipliers=0.9 * held.multipliers))
    assert found.failures == ("recorded_multipliers",)


def test_what_is_not_stabilised_is_not_exported(held, tmp_path):
    with pytest.raises(InputError, match="triple-1: its certificate does not hold"):
        export_controller(replace(held, certificate=None), tmp_path)


@pytest.fixture(scope="module")
def uncoupled():
    """Two masses on springs of their own, of which the first swings."""
    q, v, p = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("p", 2)
    symbols = Symbols(q, v, p, ("force1", "force2"), (0.0, 0.0))
    model = of.lagrange(
        ca.sumsqr(v) / 2, q[0] ** 2 / 2 + q[0] ** 4 / 4 + 1.5 * q[1] ** 2, symbols, forces=p,
        controls=["force1", "force2"],
    )  # fmt: skip
    return model, of.find_orbit(of.Problem(model, of.Guess([1.0, 0.0, 0.0, 0.0], 5.0), of.pin(q1=1.0)))


def test_an_actuator_that_cannot_is_refused_by_name(uncoupled):
    model, orbit = uncoupled
    refused = "actuators: force1 cannot hold this orbit: the deviation of multiplier .* is out of reach"
    with pytest.raises(InputError, match=refused):
        of.stabilise(orbit, ["force1"], model=model)
    both = of.stabilise(orbit, model=model)
    assert both.stabilised and both.actuators == ("force1", "force2")
    assert both.authority == {"force1": 0.0, "force2": 0.0}


def test_a_joint_that_cannot_is_refused_and_another_named():
    """A balanced wheel at the end of a pendulum: the motor at the ground does not turn it, its own swings both."""
    wheel = of.chain(2, com=[0.5, 0.0], inertia=[0.1, 0.2])
    lone = of.chain(1, length=1.0, mass=2.0, com=0.75, inertia=0.1 + 0.25**2 + 0.25**2)
    swing = of.find_orbit(of.Problem(lone, of.Guess([1.0, 0.0], 2.0), of.pin(theta1=1.0)))
    whole = np.zeros((len(swing.samples), 4))
    whole[:, [0, 2]] = swing.samples
    both = replace(
        swing, system=wheel.system, state=whole[0], samples=whole, nodes=whole[:1], winding=(0, 0), name="wheel"
    )
    with pytest.raises(InputError, match=r"torque1 cannot hold this orbit.*torque2 can, each alone"):
        of.stabilise(both, ["torque1"])
    found = of.stabilise(both)
    assert found.actuators == ("torque2",) and found.stabilised


def test_the_clock_is_kept_too(report_orbits):
    """With it the sixth deviation, along the orbit, is brought back as well."""
    found = of.stabilise(report_orbits["triple-1"], ["torque1"], clock=True, R=4.0)
    assert found.stabilised and len(found.multipliers) == 6 and np.abs(found.multipliers).max() < 1


@pytest.fixture(scope="module")
def forced():
    """The middle swing of a forced oscillator, unstable."""
    return of.find_orbit(of.load_problem(ROOT / "problems" / "gallery" / "forced-duffing-middle.toml"))


def test_a_forced_motion_is_held_by_the_clock(forced):
    found = of.stabilise(forced, ["force"])
    assert found.clock and found.stabilised and np.abs(found.multipliers).max() < 0.1
    assert np.abs(found.open_loop).max() == pytest.approx(np.abs(forced.floquet_multipliers).max(), abs=1e-9)


@pytest.mark.slow
def test_dissipative_and_running_motions():
    """A limit cycle, a pendulum that turns over."""
    orbit = of.find_orbit(of.load_problem(ROOT / "problems" / "gallery" / "van-der-pol.toml"))
    found = of.stabilise(orbit, ["damping"])
    assert found.stabilised and not found.clock and found.multipliers[0].real < 0.5 * found.open_loop[0].real
    orbit = of.find_orbit(of.load_problem(ROOT / "problems" / "examples" / "pendulum-running.toml"))
    found = of.basin(of.stabilise(orbit), [0.1], 5, 10, rate=64)
    assert found.stabilised and found.basin.rows[0].returned == 5


@pytest.mark.slow
def test_a_linkage_on_its_constraints():
    """Five bars in maximal coordinates: three deviations of 24 components are left, every joint can hold them."""
    orbit = of.find_orbit(of.load_problem(ROOT / "problems" / "linkages" / "five-bar-slow-mode.toml"))
    found = of.basin(of.stabilise(orbit), [0.1], 10, 20)
    assert found.stabilised and len(found.multipliers) == 3 and len(found.authority) == 5
    assert found.basin.rows[0].returned == 10


# --------------------------------------------------------------------------------------------------
# Basins


def test_small_disturbances_return_and_are_repeated(held):
    first = of.basin(held, [0.005], 6, 50, rate=64).basin
    soon, again = (of.basin(held, [0.005], 2, 2, rate=16).basin for _ in range(2))
    assert first.rows[0].returned == 6 and np.array_equal(soon.rows[0].peak, again.rows[0].peak)
    assert first.near == 0.01 and soon.near == 0.5  # 0.81 a period leaves more
    assert 0 < first.rows[0].rms[0] < first.rows[0].peak[0] < 1.0
    starts, places = disturbed(held, build_model(held.system), np.full(4, 0.2), 3)
    on = law_of(held).at(places)[:, :6]
    assert np.linalg.norm((starts - on) / held.units, axis=1) == pytest.approx(0.2)


def test_without_gains_nothing_returns(held):
    """Multiplier 1.24: an unstable orbit is left, whatever a controller without gains is called."""
    found = of.basin(replace(held, gains=0 * held.gains), [0.01], 6, 20, rate=64).basin
    assert found.rows[0].returned == 0


def test_torque_stays_within_its_limits_and_noise_is_told_from_return(held):
    """A tenth of a newton metre still brings back a hundredth; what noise does by itself counts as having returned."""
    limited = replace(held, limits={"torque2": (-0.1, 0.1)})
    rows = of.basin(limited, [0.01], 6, 40, rate=32).basin.rows
    assert rows[0].returned == 6 and rows[0].peak[0] == 0.1
    run = of.recovery(limited, 0.3, 2)
    assert np.abs(run.controls).max() == 0.1 and run.states.shape == (400, 6) and run.distance[0] <= 0.31
    assert of.basin(limited, [0.01], 6, 15, noise=1e-3, rate=32).basin.rows[0].returned == 6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "joint", "size", "multiplier"),
    [("control/stabilised-triple-1", 2, 0.03, 1.24), ("report/triple-2", 1, 0.03, 1.6),
     ("examples/triple-mode-2-strong", 3, 0.01, 100.0)],
)  # fmt: skip
def test_two_hundred_disturbances_for_a_hundred_periods(file, joint, size, multiplier):
    """The report's unstable orbits and a normal mode of multiplier 1140, each by one motor."""
    orbit = of.find_orbit(of.load_problem(ROOT / "problems" / f"{file}.toml"))
    found = of.basin(of.stabilise(orbit, [f"torque{joint}"]), [size], 200, 100)
    assert np.abs(found.open_loop).max() > multiplier and found.stabilised
    assert found.basin.rows[0].returned >= 198


# --------------------------------------------------------------------------------------------------
# Gaits: an impact ends the period, and the law begins anew


def walking(slope):
    """The compass gait with motors at hip and stance ankle, and its step, whose multiplier is -2.13 on 0.1 rad."""
    step = of.Guess([0.238, -0.438, -1.182, 0.077], 0.77)
    return of.find_orbit(of.Problem(of.systems.driven_compass(slope=slope), step))


@pytest.fixture(scope="module")
def gait():
    return replace(walking(0.1), name="walker")


@pytest.fixture(scope="module")
def walker(gait):
    return of.stabilise(gait)


def kicked(controller, count, seed=0):
    """States and places of kicks of 5 % of each state's extent, root mean square over the states, in seeded directions
    at seeded places of the step."""
    return disturbed(controller, build_model(controller.system), np.full(count, 0.05 * 2), seed)


def test_a_gait_is_held(gait, walker):
    """Of three deviations across the flow every one decays; the recorded motion is the step, from strike to strike."""
    assert walker.stabilised and walker.actuators == ("hip", "ankle") and walker.event == "strike"
    assert np.sort(abs(walker.open_loop)) == pytest.approx(np.sort(abs(gait.floquet_multipliers)), rel=1e-8)
    assert np.abs(walker.open_loop).max() > 2 and np.abs(walker.multipliers).max() < 0.05
    assert walker.certificate.checks[-1].name == "automaton" and walker.certificate.checks[-1].value < 1e-3
    states, places = kicked(walker, 1)
    assert max(left(walker, build_model(walker.system), states, places, 3)) < 1e-3
    held = of.basin(walker, [0.1], 4, 4, rate=64).basin
    assert held.rows[0].returned == 4 and of.recovery(walker, 0.1, 2, rate=50).distance[-1] < 0.01
    assert of.basin(replace(walker, gains=0 * walker.gains), [0.1], 4, 4, rate=64).basin.rows[0].returned == 0


def test_planted_laws_of_a_gait(walker):
    assert failed(verified(replace(walker, gains=-walker.gains))) == ["multipliers", "agreement", "automaton"]
    early = walker.states.copy()
    early[-1] -= 1e-6 * (early[-1] - early[-2])  # not at the guard yet
    assert "reference" in failed(verified(replace(walker, states=early, gains=-walker.gains)))


@pytest.mark.slow
def test_planted_gains_of_another_gait_and_limits_that_cut_the_law_off(walker):
    other = of.stabilise(walking(0.09))
    assert failed(verified(replace(walker, gains=other.gains))) == ["agreement"]
    cut = walker.gains * (np.arange(len(walker.gains)) < len(walker.gains) / 2)[:, None]
    assert "agreement" in failed(verified(replace(walker, gains=cut)))
    small = dict.fromkeys(walker.actuators, (-0.01, 0.01))
    assert failed(verified(replace(walker, limits=small))) == ["automaton"]


@pytest.mark.slow
@pytest.mark.parametrize("clock", [None, True])
def test_multipliers_of_a_gait_by_the_automatons_return_map(gait, clock):
    """Central differences of strike to strike, guards watched: no saltation matrix, no variations."""
    held = of.stabilise(gait, clock=clock)
    striking = Striking(held, build_model(held.system))
    basis = Reference(striking.model, held.actuators, held.period, held.states, held.units, held.clock).bases[0]
    ends = [
        (striking.after(held.states[0] + push * held.units, 0.0, 1)[0] - held.states[0]) / held.units
        for push in np.vstack([1e-4 * basis.T, -1e-4 * basis.T])
    ]
    forth, back = np.split(np.array(ends), 2)
    found = np.linalg.eigvals(basis.T @ (forth - back).T / 2e-4)
    apart = np.abs(found[:, None] - held.multipliers)
    assert apart[linear_sum_assignment(apart)].max() <= 1e-4


@pytest.mark.slow
def test_two_hundred_kicked_walkers_under_the_exported_c(walker, tmp_path):
    """Kicks of 5 % of each state's extent at any moment of the step: simulated by the automaton under the exported C,
    after five strikes at most a hundredth of every kick is left; sampled by the package too, all 200 return."""
    model, (states, places) = build_model(walker.system), kicked(walker, 200)
    apart = left(walker, model, states, places, 5, compiled_law(walker, tmp_path))
    assert np.sum(apart <= 0.01 * 0.1) == 200
    assert of.basin(walker, [0.1], 200, 12).basin.rows[0].returned == 200


@pytest.mark.slow
def test_two_hundred_kicked_walkers_fall_alone(walker):
    """The same kicks, the motors idle: none walks sixty steps."""
    idle = Striking(walker, build_model(walker.system), lambda x, tau: (np.zeros(2), tau))
    assert sum(len(idle.after(*kick, 60)) < 60 for kick in zip(*kicked(walker, 200), strict=True)) == 200


def compiled_law(controller, folder):
    """The exported C as a law: (x, tau) -> u, tau."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    _, source, _ = export_controller(controller, folder)
    library, word = folder / "law.so", source.stem.removesuffix("_controller")
    subprocess.run([compiler, "-O2", "-shared", "-fPIC", str(source), "-o", str(library), "-lm"], check=True)
    control = getattr(ctypes.CDLL(str(library)), f"{word}_control")
    control.restype, control.argtypes = ctypes.c_double, [ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p]

    def law(x, tau):
        x, u = np.ascontiguousarray(x, float), np.empty(len(controller.actuators))
        return u, control(x.ctypes.data, tau, u.ctypes.data)

    return law


# --------------------------------------------------------------------------------------------------
# Files and programs


def test_saved_and_loaded(held, tmp_path):
    rich = of.basin(replace(held, limits={"torque2": (-3.0, 4.0)}), [0.01], 2, 2)
    again = of.load_controller(of.save_controller(rich, tmp_path / "c" / "controller.json"))
    for name in vars(rich):
        one, two = getattr(rich, name), getattr(again, name)
        if isinstance(one, np.ndarray):
            assert np.array_equal(one, two), name
    assert repr(again.certificate) == repr(rich.certificate)  # from Python 3.13 on nan is unequal in dataclasses too
    assert again.limits == rich.limits and again.stabilised
    assert again.basin.rows[0].returned == rich.basin.rows[0].returned
    assert verified(again).certificate.passed


def test_damaged_files_are_refused(held, tmp_path):
    file = of.save_controller(held, tmp_path / "controller.json")
    whole = json.loads(file.read_text())
    for change, said in (
        ({"format": "orbitfinder/orbit"}, "format: expected 'orbitfinder/controller'"),
        ({"version": 99}, "version: this orbitfinder reads 1, got 99"),
        ({"gains": whole["gains"][:-1]}, "gains: shape"),
        ({"states": "x"}, "states: expected a list of numbers"),
        ({"limits": {"torque3": [0, 1]}}, "limits: 'torque3' is none of the actuators"),
        ({"period": -1.0}, "period and units: must be positive"),
        ({"multipliers": [1.0]}, "multipliers"),
    ):
        file.write_text(json.dumps(whole | change))
        with pytest.raises(InputError, match=said):
            of.load_controller(file)
    file.write_text("{}")
    with pytest.raises(InputError, match="give a controller.json"):
        of.load_controller(file)


PROGRAM = """
#include "{source}"
#include <stdio.h>
#include <stdlib.h>
int main(int count, char **words)
{{
  double x[{word}_states], u[{word}_controls], tau;
  int i;
  for (i = 0; i < {word}_states; i++) x[i] = atof(words[i + 1]);
  tau = {word}_control(x, count > {word}_states + 1 ? atof(words[{word}_states + 1]) : {word}_start(x), u);
  for (i = 0; i < {word}_controls; i++) printf("%.17g ", u[i]);
  printf("%.17g\\n", tau);
  return 0;
}}
"""


def test_exported_programs_do_what_the_package_does(held, tmp_path):
    """The Python one away from the package, the C one where there is a compiler, at seeded states; the table as CSV."""
    limited = replace(held, limits={"torque2": (-0.4, 0.5)})
    table, source, script = export_controller(limited, tmp_path)
    rows = np.loadtxt(table, delimiter=",", skiprows=1)
    assert np.array_equal(rows[:, 1:7], held.states) and np.array_equal(rows[:, 8:], held.gains)
    assert table.read_text().startswith("t,theta1,theta2,theta3,theta1dot,theta2dot,theta3dot,torque2,K_torque2_theta1")
    programs = [[sys.executable, "-I", str(script)]]
    if compiler := shutil.which("gcc") or shutil.which("cc"):
        (tmp_path / "main.c").write_text(PROGRAM.format(source=source.name, word="triple_1"))
        command = [compiler, "-std=c99", "-Wall", "-Werror", "-pedantic", "-ffp-contract=off", "main.c", "-o", "held"]
        subprocess.run([*command, "-lm"], cwd=tmp_path, check=True)
        programs.append([str(tmp_path / "held")])
    law, states = law_of(limited), disturbed(limited, build_model(held.system), np.array([0.1, 0.5]), 1)[0]
    states[1, 0] += 2 * np.pi  # whole turns are no deviation
    for x in states:
        for tail in ([], [1.0]):
            u, tau = law(x, tail[0] if tail else law.start(x)[0])
            for program in programs:
                words = [repr(float(one)) for one in [*x, *tail]]
                said = subprocess.run([*program, *words], capture_output=True, text=True, check=True, cwd=tmp_path)
                assert [float(word) for word in said.stdout.split()] == pytest.approx([*u, tau], rel=1e-11, abs=1e-12)
    refused = subprocess.run([*programs[0], "1"], capture_output=True, text=True, check=False)
    assert refused.returncode == 1 and "usage" in refused.stderr


def test_the_command(pendulum_orbit, tmp_path):
    file = save_orbit(pendulum_orbit, tmp_path / "orbit.json")
    given = ("stabilise", file, "--out", tmp_path, "--periods", "3", "--disturbances", "2", "--rate", "32")
    out, _ = run(*given, "--sizes", "0.01", "--saturation", "2")
    assert "pendulum: stabilised by torque1" in out and "returned" in out and "(acts)" in out
    folder = tmp_path / "pendulum"
    assert {one.name for one in folder.iterdir()} == {
        "controller.json", "controller.jsonl", "pendulum_gains.csv", "pendulum_controller.c", "pendulum_controller.py"
    }  # fmt: skip
    controller = of.load_controller(folder / "controller.json")
    assert controller.limits == {"torque1": (-2.0, 2.0)}
    assert "certified" in run("verify", folder / "controller.json")[0]
    idle = save_controller(replace(controller, gains=0 * controller.gains), tmp_path / "idle.json")
    assert "REJECTED by multipliers" in run("verify", idle, code=1)[0]  # though its file says that it is stabilised
    said = run(*given, "--sizes", "0.01", "--saturation", "3", code=2)[1]
    assert "controller.jsonl: limits.torque1.0: -2.0 there, -3.0 asked for" in said
    assert of.load_controller(folder / "controller.json").limits == controller.limits
    given = (*given[:3], tmp_path / "b", *given[4:])
    found = json.loads(run(*given, "--motors", "1", "--sizes", "0.1", "--json")[0])
    assert found["stabilised"] and found["basin"]["rows"][0]["count"] == 2 and found["authority"]["torque1"] > 0
    assert "actuators: 'torque7' is none" in run("stabilise", file, "--motors", "7", "--out", tmp_path, code=2)[1]
    assert "--motors: 'a' is not a number" in run("stabilise", file, "--motors", "a", "--out", tmp_path, code=2)[1]


@pytest.mark.slow
def test_the_command_animates_a_recovery(pendulum_orbit, tmp_path):
    file = save_orbit(pendulum_orbit, tmp_path / "orbit.json")
    given = ("stabilise", file, "--out", tmp_path, "--periods", "3", "--disturbances", "2", "--rate", "32")
    run(*given, "--sizes", "0.01", "--animate")
    assert (tmp_path / "pendulum" / "recovery.gif").stat().st_size > 1000


# --------------------------------------------------------------------------------------------------
# What cannot be asked


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"actuators": ["torque5"]}, "actuators: 'torque5' is none of the parameters"),
        ({"actuators": "torque1"}, "actuators"),
        ({"actuators": ["torque1", "torque1"]}, "actuators: 'torque1' is none of the parameters, or is named twice"),
        ({"actuators": ["torque1"], "R": -1.0}, "R: must be a number, 1 numbers or a 1 x 1 matrix, positive definite"),
        ({"actuators": ["torque1"], "R": 0.0}, "R: must be"),
        ({"actuators": ["torque1"], "Q": [1.0, 2.0]}, "Q: must be a number, 6 numbers or a 6 x 6 matrix"),
        ({"actuators": ["torque1"], "Q": -1.0}, "Q: must be .* not negative"),
        ({"actuators": ["torque1"], "Q": 0.0}, "Q gives it no weight"),
        (
            {"actuators": ["torque1"], "limits": {"torque1": (1.0, 2.0)}},
            "limits.torque1: the orbit itself takes 0 to 0",
        ),
        ({"actuators": ["torque1"], "limits": {"torque2": 1.0}}, "limits: 'torque2' is no control"),
        ({"actuators": ["torque1"], "limits": -1.0}, "limits.torque1: must be a positive number"),
    ],
)
def test_what_cannot_be_asked(report_orbits, asked, said):
    with pytest.raises((InputError, ConvergenceError), match=said):
        of.stabilise(report_orbits["triple-1"], **asked)


def test_orbits_that_are_not_held_yet(report_orbits, forced):
    walker = of.systems.kneed_walker()
    hybrid = replace(report_orbits["triple-1"], system=walker.system, name="walker")
    with pytest.raises(InputError, match=r"walker: 2 events in a period \(knee, strike\); feedback is for"):
        of.stabilise(hybrid)
    relative = replace(report_orbits["triple-1"], shift={"theta1": 0.1})
    with pytest.raises(InputError, match="a relative orbit, which does not come back in theta1"):
        of.stabilise(relative)
    controlled = replace(report_orbits["triple-1"], name="swing")
    object.__setattr__(controlled, "control", {"shape": "linear"})
    with pytest.raises(InputError, match="swing: a controlled motion"):
        of.stabilise(controlled)
    with pytest.raises(InputError, match="clock: False for a forced system"):
        of.stabilise(forced, ["force"], clock=False)
    with pytest.raises(InputError, match="actuators: nothing acts on this system"):
        of.stabilise(forced)


@pytest.mark.parametrize(
    ("asked", "said"),
    [({"sizes": []}, "sizes"), ({"sizes": [-1.0]}, "sizes: must be positive"), ({"disturbances": 0}, "disturbances"),
     ({"periods": 0}, "periods: must be at least 1"), ({"rate": 4}, "rate: must be at least 8"),
     ({"noise": -1.0}, "noise: must be 0 or more")],
)  # fmt: skip
def test_basins_that_cannot_be_asked(held, asked, said):
    with pytest.raises(InputError, match=said):
        of.basin(held, **asked)
