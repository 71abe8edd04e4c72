"""No certificate for a false orbit: what the first edition's `verify` accepted, and how each is named now."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.loops.symmetry import recognise
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.mechanics.model import altered
from orbitfinder.orbits.certify import certify
from orbitfinder.orbits.evidence import gather
from orbitfinder.systems import pendulum_on_cart

RESULTS = Path(__file__).parents[1] / "results"
SHIPPED = sorted([*RESULTS.glob("orbits/*/orbit.json"), *RESULTS.glob("gallery/*/orbit.json")])
NAMES = (
    "triple-2", "triple-1", "duffing", "van-der-pol", "forced-duffing-upper", "double-pendulum-running",
    "five-bar-slow-mode",
)  # fmt: skip
FEW = [path for path in SHIPPED if path.parent.name in NAMES]


def record(model, state, period, turns=None, **changes):
    """A record of a state and a period that agrees with all that is recomputed from them."""
    state, n = np.asarray(state, float), model.degrees_of_freedom
    turns = np.zeros(n, int) if turns is None else np.asarray(turns)
    found = gather(model, state, period, turns)
    orbit = of.Orbit(
        name="planted", system=model.system, state=state, period=period, energy=found.energy, action=found.action,
        closure=found.closure, symmetry=recognise(found.times, found.states, model),
        winding=tuple(int(k) for k in turns), floquet_multipliers=found.floquet.multipliers,
        pair_defect=found.floquet.pair_defect, stability=found.floquet.stability, unfolding=(0.0,), nodes=state[None],
        times=np.zeros(0), samples=np.zeros((0, 2 * n)), tolerance=1e-12,
    )  # fmt: skip
    return replace(orbit, **changes)


def times_round(orbit, k):
    """The same orbit, recorded as if k times its period were the period."""
    return replace(
        orbit, period=k * orbit.period, action=k * orbit.action, winding=tuple(k * one for one in orbit.winding),
        floquet_multipliers=orbit.floquet_multipliers**k, record=None, expected={}, times=np.zeros(0),
        samples=np.zeros((0, orbit.state.size)), nodes=orbit.state[None],
    )  # fmt: skip


@pytest.mark.parametrize("path", FEW, ids=lambda path: path.parent.name)
@pytest.mark.parametrize("k", [2, 9, *(pytest.param(k, marks=pytest.mark.slow) for k in (3, 7, 31))])
def test_a_multiple_of_the_period_is_rejected_by_name(path, k):
    """Odd multiples too: the motion is integrated to T/k, where a spline through samples was off by 1e-5."""
    orbit = of.load_orbit(path)
    assert "minimal_period" in certify(times_round(orbit, k)).failures


def test_a_multiple_that_errors_have_grown_over_is_rejected():
    """Round-off has grown to 7e-7 after 23 periods of the Rossler cycle: that is how near it comes to itself before."""
    orbit = of.load_orbit(Path(__file__).parents[1] / "results" / "gallery" / "rossler" / "orbit.json")
    for k in (23, 25, 26):  # 25 and 26 close in long double, the motion looked at is of double
        assert certify(times_round(orbit, k)).failures == ("minimal_period",)


@pytest.mark.slow
@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.parent.name)
def test_no_multiple_from_2_to_31_of_any_shipped_orbit_is_accepted(path):
    """41 orbits, 30 multiples each; two minutes an orbit of the slow ones."""
    orbit = of.load_orbit(path)
    assert certify(orbit).passed
    assert not [k for k in range(2, 32) if certify(times_round(orbit, k)).passed]


def forced(force, clock):
    """x'' + 0.2 x' + 2 x = force(t), its period declared as `clock`."""
    q, v, t = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("t")
    return lagrange(v**2 / 2, q**2, Symbols(q, v, time=t, forcing_period=clock), forces=force(t) - 0.2 * v)


PLANTED_FORCES = {
    "cos(t), 1 s": (ca.cos, 1.0),
    "cos(2 pi t), 2 pi s": (lambda t: ca.cos(2 * np.pi * t), 2 * np.pi),
    "cos(1.3 t), 3 s": (lambda t: ca.cos(1.3 * t), 3.0),
    "a chirp": (lambda t: ca.cos(t + 0.1 * t**2), 2 * np.pi),
    "exp(-t)": (lambda t: ca.exp(-t), 1.0),
    "0.3 t": (lambda t: 0.3 * t, 1.0),
}


@pytest.mark.parametrize(("force", "clock"), PLANTED_FORCES.values(), ids=PLANTED_FORCES)
def test_a_declared_period_that_the_forces_do_not_have_is_rejected(force, clock):
    """Their motions close after the declared period and go elsewhere in the next one."""
    orbit = of.find_orbit(of.Problem(forced(force, clock), of.Guess([0.3, 0.1], clock)))
    assert "time_dependence" in orbit.certificate.failures


def test_the_period_that_the_forces_have_is_accepted():
    """cos(t) declared as 2 pi, and as 4 pi, which is a period too (the motion then repeats earlier: named)."""
    orbit = of.find_orbit(of.Problem(forced(ca.cos, 2 * np.pi), of.Guess([0.3, 0.1], 2 * np.pi)))
    assert orbit.certificate.passed, orbit.certificate.failures


def test_a_force_that_depends_on_time_without_saying_so_is_rejected():
    """A model whose forcing period was taken off is seen to differ at another time."""
    model = forced(ca.cos, 2 * np.pi)
    orbit = of.find_orbit(of.Problem(model, of.Guess([0.3, 0.1], 2 * np.pi)))
    hidden = altered(model, forcing_period=None)
    assert "time_dependence" in certify(orbit, hidden).failures


def test_a_cart_that_drifts_away_is_rejected():
    """`winding` on a coordinate that is no angle: 6.28 m a period is no closed motion."""
    model = pendulum_on_cart()
    orbit = of.load_orbit(RESULTS / "gallery" / "pendulum-on-cart" / "orbit.json")
    assert certify(orbit).passed
    drifting = orbit.state.copy()
    drifting[2] += 2 * np.pi / orbit.period
    assert not model.angles[0]
    assert "winding" in certify(record(model, drifting, orbit.period, (1, 0)), model).failures


def test_an_angle_that_the_equations_do_not_know_as_one_is_rejected():
    """x'' = -0.2 x' + 1 runs at 5 m/s for ever; calling x an angle does not make it periodic on a tilted spring."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    model = replace(lagrange(v**2 / 2, 1e-3 * q**2, Symbols(q, v), forces=1.0 - 0.2 * v), angles=(True,))
    assert "winding" in certify(record(model, [0.0, 5.0], 2 * np.pi / 5, (1,)), model).failures


def test_turns_beyond_belief_are_refused_in_a_sentence():
    """10^30 turns are no traceback."""
    orbit = of.load_orbit(RESULTS / "orbits" / "triple-1" / "orbit.json")
    with pytest.raises(InputError, match="winding: more than 1000000 turns"):
        certify(replace(orbit, winding=(10**30, 0, 0)))


def test_no_tolerance_in_a_record_buys_a_gap():
    """A forced saddle (multiplier 1.7e6), 5e-4 off along the contracting direction, asking for 1e-6 itself."""
    q, v, t = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("t")
    rate = np.log(1.7e6) / (2 * np.pi)
    symbols = Symbols(q, v, time=t, forcing_period=2 * np.pi)
    model = lagrange(v**2 / 2, -(rate**2) * q**2 / 2, symbols, forces=ca.cos(t))
    state = np.array([-1.0 / (1 + rate**2), 0.0])  # x = -cos(t) / (1 + rate^2)
    assert certify(record(model, state, 2 * np.pi), model).passed
    off = record(model, state + 5e-4 * np.array([1.0, -rate]), 2 * np.pi, tolerance=1e-6)
    assert {"closure", "distance"} <= set(certify(off, model).failures)


def test_energies_far_below_a_joule_are_compared_in_their_own_size():
    """A pendulum of 1 mg with an energy recorded 3e-5 off, which was within an absolute 1e-10 J."""
    model = of.chain(1, mass=1e-6)
    orbit = of.find_orbit(of.Problem(model, of.Guess([1.0, 0.0], 1.75), pin=of.pin(theta1=1.0)))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert certify(replace(orbit, energy=orbit.energy * (1 + 3e-5))).failures == ("energy",)
    assert certify(replace(orbit, action=orbit.action * (1 + 3e-5))).failures == ("action",)


def test_an_invariant_that_is_none_is_named(report_orbits):
    """Angular momentum declared of a hanging chain: it is not constant along the motion."""
    orbit, model = report_orbits["triple-1"], of.chain(3)
    turning = of.chain(3, gravity=0.0).invariants[1]
    declared = altered(model, invariants=(*model.invariants, turning))
    assert f"invariant_{turning.name}" in certify(orbit, declared).failures


@pytest.mark.parametrize(
    ("changes", "check"),
    [
        ({"pair_defect": 1.0}, "pair_defect"),
        ({"nodes": np.zeros((3, 5))}, "nodes"),
        ({"times": np.zeros(4), "samples": np.zeros((4, 6))}, "samples"),
        ({"times": np.linspace(0, 1, 9), "samples": np.ones((9, 6))}, "samples"),
    ],
)
def test_what_a_record_shows_is_recomputed(report_orbits, changes, check):
    """Nodes, samples and the pair defect may not be anything."""
    assert check in certify(replace(report_orbits["triple-1"], **changes)).failures


def test_an_unfolding_of_a_system_that_has_none_is_rejected():
    """Forced systems unfold nothing; a number there is of some other problem."""
    orbit = of.load_orbit(RESULTS / "gallery" / "forced-duffing-upper" / "orbit.json")
    assert certify(replace(orbit, unfolding=(1e-3,), record=None)).failures == ("unfolding",)


def test_multipliers_across_a_jump_of_the_equations_are_rejected():
    """Coulomb friction: x'' + x = 2 cos(0.7 t) - 0.3 sign(x'). Variations say |mu| = 1, the true map 0.7277.

    The state is that of the motion with its turning points located by events (SciPy), closed to 2e-15.
    """
    drive = 2 * np.pi / 0.7
    rubbing = of.ode(
        lambda t, x, p: [x.v, 2 * ca.cos(0.7 * t) - 0.3 * ca.sign(x.v) - x.x], ("x", "v"), forcing_period=drive
    )
    planted = record(rubbing, [3.842396532, 0.427495645], drive, samples=np.zeros((0, 2)))
    assert planted.stability == "marginal"  # what was certified
    assert "smooth" in certify(planted, rubbing).failures


@pytest.mark.parametrize(
    "force", [lambda t: ca.sign(ca.cos(t)), lambda t: ca.fabs(ca.cos(t)), lambda t: ca.tanh(200 * ca.cos(t))]
)
def test_forces_that_jump_in_time_only_are_no_jump_of_the_motion(force):
    """A square wave jumps for all states at once: the variations are right."""
    orbit = of.find_orbit(of.Problem(forced(force, 2 * np.pi), of.Guess([0.3, 0.1], 2 * np.pi)))
    assert "smooth" not in orbit.certificate.failures


def test_a_kick_in_the_first_period_only_is_rejected():
    """A pulse of a 600th of a period that does not come back: the period after the first is gone through too."""
    kicked = of.ode(
        lambda t, x, p: [-x.x + ca.cos(t) + 0.5 * ca.exp(-(((t - 2.0) / 0.01) ** 2))], ("x",), forcing_period=2 * np.pi
    )
    orbit = of.find_orbit(of.Problem(kicked, of.Guess([0.1], 2 * np.pi)))
    assert "second_closure" in orbit.certificate.failures


@pytest.mark.parametrize("k", [2, 3])
def test_whole_turns_along_a_shift_hide_no_multiple_of_the_period(k):
    """A relative orbit gone round k times, one turn of what it shifts told as winding."""
    model = of.systems.spherical_pendulum()
    pins = of.pin(energy=-2.0, momentum_phi=2.0)
    guess = of.Guess([1.2, 0.3, 0.0, 3.0], 1.2)
    orbit = of.find_orbit(of.Problem(model, guess, pins, relative=("phi",)))
    shift = {"phi": k * orbit.shift["phi"] - 2 * np.pi}
    assert certify(replace(times_round(orbit, k), shift=shift, winding=(0, 1))).failures == ("minimal_period",)


def test_a_recorded_pair_defect_of_a_hybrid_orbit_is_recomputed():
    walk = of.find_orbit(of.Problem(of.systems.simplest_walker(0.009), of.Guess([0.20, 0.40, -0.20, -0.02], 3.9)))
    assert certify(replace(walk, pair_defect=0.5, record=None)).failures == ("pair_defect",)


def test_a_reset_that_is_no_number_is_said():
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    air = lagrange(v**2 / 2, q, Symbols(q, v), names=["y"])
    bounce = of.Transition(
        "bounce", "air", "air", guard=lambda x, p: x.y, reset=lambda x, p: ca.vertcat(x.y, ca.sqrt(x.ydot))
    )
    with pytest.raises(ConvergenceError, match="gives no finite numbers; start elsewhere"):
        of.find_orbit(of.Problem(of.hybrid({"air": air}, [bounce], ["bounce"]), of.Guess([0.0, 1.0], 2.0)))


def energy_of_springs(x, _):
    return (x.u**2 + x.v**2 + x.x**2 + 2 * x.y**2) / 2


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (lambda x, p: energy_of_springs(x, p) ** 2, "'again' is a function of energy and says nothing more"),
        (lambda x, p: ca.exp(energy_of_springs(x, p)) + 3, "'again' is a function of energy"),
        (lambda x, p: 3.0, "'again' is a function of energy"),
    ],
)
def test_invariants_that_are_functions_of_each_other_are_refused(more, message):
    """Their unfoldings would be one parameter twice."""

    def field(_t, x, _p):
        return [x.u, x.v, -x.x, -2 * x.y]

    with pytest.raises(InputError, match=message):
        of.ode(field, ("x", "y", "u", "v"), invariants={"energy": energy_of_springs, "again": more})
    with pytest.raises(InputError, match=message):
        of.hamiltonian(energy_of_springs, ("x", "y"), ("u", "v"), invariants={"again": more})
    apart = {"first": lambda x, p: x.u**2 + x.x**2, "second": lambda x, p: x.v**2 + 2 * x.y**2}
    assert len(of.ode(field, ("x", "y", "u", "v"), invariants=apart).invariants) == 2
    small = {"all": lambda x, p: x.u**2 + x.x**2 + 1e-14 * (x.v**2 + 2 * x.y**2), "large": lambda x, p: x.u**2 + x.x**2}
    assert len(of.ode(field, ("x", "y", "u", "v"), invariants=small).invariants) == 2  # 1e-14 of the energy is another
    with pytest.raises(InputError, match="'one' is a constant"):
        of.ode(field, ("x", "y", "u", "v"), invariants={"one": lambda x, p: 1.0})


AIR = lagrange((_v := ca.SX.sym("v")) ** 2 / 2, _q := ca.SX.sym("q"), Symbols(_q, _v), names=["y"])
BOUNCE = of.Transition("bounce", "air", "air", guard=lambda x, p: x.y)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: of.ode(lambda t, x, p: None, ("x",)), "field: cannot be made of CasADi symbols"),
        (lambda: of.ode(lambda t, x: [x.x], ("x",)), "takes 2 positional arguments but 3 were given"),
        (lambda: of.ode(lambda t, x, p: [x.x if x.x > 0 else 0], ("x",)), "casadi.if_else takes the place of an if"),
        (lambda: of.hamiltonian(lambda c: c.p, ("q",), ("p",)), "energy: cannot be made of CasADi symbols"),
        (lambda: of.hybrid({"air": AIR}, [replace(BOUNCE, guard=None)]), "guard: cannot be made of CasADi symbols"),
        (lambda: of.hybrid({"air": AIR}, [replace(BOUNCE, reset=lambda x, p: "a")]), "reset: cannot be made of"),
        (lambda: of.hybrid({"air": AIR}, ["bounce"]), "transitions: expected a list, each a Transition, got 'bounce'"),
        (lambda: of.hybrid({"air": AIR}, [BOUNCE, BOUNCE]), "transitions: 'bounce' names two of them"),
        (lambda: of.hybrid([of.Mode("air", AIR), of.Mode("air", AIR)], [BOUNCE]), "modes: 'air' names two of them"),
        (lambda: of.hybrid([of.Mode("air", AIR, 3)], [BOUNCE]), "holds of air: expected names with a function each"),
        (lambda: of.hybrid({"air": of.hybrid({"air": AIR}, [BOUNCE])}, [BOUNCE]), "air is a hybrid system itself"),
        (lambda: of.impact(of.ode(lambda t, x, p: [x.x], ("x",)), lambda x, p: x.x), "impact: needs a system of"),
        (lambda: of.impact(AIR, lambda x, p: None), "contact: cannot be made of CasADi symbols"),
        (lambda: of.guesses.normal_modes(of.systems.lorenz()), "a first-order system has no masses"),
    ],
)
def test_what_is_no_system_is_said_in_a_sentence(make, message):
    """Each was a traceback, or a system that was believed."""
    with pytest.raises(InputError, match=message):
        make()
