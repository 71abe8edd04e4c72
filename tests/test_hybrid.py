"""Hybrid orbits: references at 140 bits, closed forms, planted failures, saltation, the simulator, families."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import orbitfinder as of
from orbitfinder.errors import ConvergenceError, InputError, IntegrationError
from orbitfinder.integrate.automaton import Automaton
from orbitfinder.loops.condensed import eliminated
from orbitfinder.loops.loop import Equations, Loop
from orbitfinder.loops.symmetry import NONE
from orbitfinder.mechanics.hybrid import Mode, Transition, changed, hybrid, impact, with_cycle
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanisms.machines import (
    bouncing_ball,
    compass_gait,
    five_link_walker,
    impact_oscillator,
    kneed_walker,
    rimless_wheel,
    rocking_block,
    simplest_walker,
    slip_runner,
    vertical_hopper,
)
from orbitfinder.orbits.hybrid import HybridCheck, cycle_from, first_unknowns, gather_hybrid

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

from hybrid_gaits import compass, doubling

REFERENCE = {
    one["id"]: one["values"]
    for one in json.loads((Path(__file__).parent / "data" / "hybrid.json").read_text())["entries"]
}


def number(entry, name):
    return float(REFERENCE[entry][name])


def pair(text):
    """A complex pair written "a +- b i"."""
    real, imaginary = text.split(",")[0].replace(" i", "").split(" +- ")
    return complex(float(real), float(imaginary))


@pytest.fixture(scope="module")
def walker():
    """The long gait of the simplest walker, from a guess rounded to two digits."""
    return of.find_orbit(of.Problem(simplest_walker(0.009), of.Guess([0.20, 0.40, -0.20, -0.02], 3.9)))


def falling(restitution=0.5, **parts):
    """A ball on level ground."""
    symbols = of.Symbols(q := ca.SX.sym("q"), v := ca.SX.sym("v"))
    model = of.lagrange(v**2 / 2, q, symbols, names=["y"])
    bounce = Transition("bounce", "air", "air", guard=lambda x, p: x.y,
                        reset=lambda x, p: changed(x, y=0, ydot=-restitution * x.ydot), **parts)  # fmt: skip
    return hybrid({"air": model}, [bounce], ["bounce"])


def test_simplest_walker_long(walker):
    assert walker.certificate.passed
    assert walker.state[0] == pytest.approx(number("walker-long", "theta"), abs=1e-12)
    assert walker.state[2] == pytest.approx(number("walker-long", "thetadot"), abs=1e-12)
    assert walker.period == pytest.approx(number("walker-long", "T"), abs=1e-11)
    found = walker.floquet_multipliers
    assert abs(found[np.argmax(found.imag)] - pair(REFERENCE["walker-long"]["multipliers"])) < 1e-10
    assert walker.stability == "asymptotically stable"
    assert any(one.name == "events" and "mid-stance" in one.note for one in walker.certificate.checks)


def test_the_foot_scuffs_where_it_is_known_to():
    """The strike's guard has an earlier root, of the short gait at t = 2.1438, that is let through and declared."""
    model = simplest_walker(0.009)
    orbit = of.find_orbit(of.Problem(model, of.Guess([0.19, 0.38, -0.20, -0.01], 3.1)))
    (arc,) = Automaton(model).arcs(orbit.state, "stance", events=1)
    heights = CubicSpline(arc.times, arc.states[:, 1] - 2 * arc.states[:, 0])
    (scuff,) = [t for t in heights.roots() if 0.1 < t < arc.duration - 0.1]
    assert scuff == pytest.approx(2.1438, abs=1e-4)


def test_the_balls_fold_is_where_its_bounces_stop():
    """A = g T (1 - e) / (2 w (1 + e)): below, the table is too slow for a bounce a period."""
    orbit = of.find_orbit(of.Problem(bouncing_ball(), of.Guess([0.008, 0.49, 0.8], 1.0), winding=(0, 0, 1)))
    settings = of.FamilySettings(parameter="amplitude", directions="backward", points=14)
    (fold,) = [one for one in of.follow_family(orbit, settings=settings).events if one.kind == "fold"]
    assert fold.certified and fold.parameter == pytest.approx(0.2 / (2 * 2 * np.pi * 1.8), abs=1e-14)


def test_simplest_walker_short():
    """The other gait, unstable, whose period tends to pi."""
    orbit = of.find_orbit(of.Problem(simplest_walker(0.009), of.Guess([0.19, 0.38, -0.20, -0.01], 3.1)))
    assert orbit.certificate.passed and orbit.stability == "unstable"
    assert orbit.period < 3.2


def test_compass_gait():
    wanted = REFERENCE["compass-3deg"]
    model = compass_gait(slope=np.deg2rad(3.0))
    orbit = of.find_orbit(of.Problem(model, of.Guess([0.22, -0.32, -1.09, -0.38], 0.73)))
    assert orbit.certificate.passed
    named = [float(wanted[name]) for name in ("th_s", "th_ns", "dth_s", "dth_ns")]
    assert orbit.state == pytest.approx(named, abs=1e-12)
    assert orbit.period == pytest.approx(float(wanted["T"]), abs=1e-12)
    found = orbit.floquet_multipliers
    assert abs(found[np.argmax(found.imag)] - pair(wanted["multipliers"])) < 1e-10
    assert np.min(np.abs(found - 0.1315726240771768)) < 1e-10
    names = [one.name for one in orbit.certificate.checks]
    assert {"holds: ground force", "holds: impulse of strike", "energy_balance"} <= set(names)


def test_rimless_wheel_in_closed_form():
    orbit = of.find_orbit(of.Problem(rimless_wheel(), of.Guess([0.08 - np.pi / 8, 1.2], 1.0)))
    assert orbit.certificate.passed
    assert orbit.state[1] == pytest.approx(number("rimless", "omega_plus"), abs=1e-12)
    assert orbit.period == pytest.approx(number("rimless", "T"), abs=1e-12)
    assert orbit.floquet_multipliers == pytest.approx([0.5], abs=1e-11)


def test_bouncing_ball_in_closed_form():
    orbit = of.find_orbit(of.Problem(bouncing_ball(), of.Guess([0.008, 0.49, 0.8], 1.0), winding=(0, 0, 1)))
    assert orbit.certificate.passed and np.isnan(orbit.energy)
    assert orbit.state[1:] == pytest.approx([0.5, number("bouncing-ball-table", "A0p012_phase")], abs=1e-12)
    found = orbit.floquet_multipliers
    assert found.sum() == pytest.approx(number("bouncing-ball-table", "trace_A0p012"), abs=1e-11)
    assert found.prod() == pytest.approx(number("bouncing-ball-table", "det"), abs=1e-11)


@pytest.mark.parametrize(
    "stiffness, gravity, speed, name", [(100, 9.81, 2, "T_w10_v2_g981"), (40, 1, 1, "T_k40_v1_g1")]
)
def test_hopper_in_closed_form(stiffness, gravity, speed, name):
    model = vertical_hopper(stiffness=float(stiffness), gravity=float(gravity))
    guess = of.Guess([0.0, -0.95 * speed], 1.0)
    orbit = of.find_orbit(of.Problem(model, guess, pin=of.pin(ydot=-float(speed))))
    assert orbit.certificate.passed and orbit.period == pytest.approx(number("hopper", name), abs=1e-12)


@pytest.mark.parametrize("height, name", [(0.1, "T_phi0_0p1"), (0.2, "T_phi0_0p2"), (0.29, "T_phi0_0p29")])
def test_rocking_block_against_quadrature(height, name):
    """Elastic: by its energy, the period is that of the fall from a height."""
    speed = np.sqrt(2 * 0.75 * (np.cos(0.3 - height) - np.cos(0.3)))
    orbit = of.find_orbit(of.Problem(rocking_block(), of.Guess([0.0, speed], 5.0), pin=of.pin(phidot=float(speed))))
    assert orbit.certificate.passed and orbit.stability == "elliptic"
    assert orbit.period == pytest.approx(number("rocking-block", name), abs=1e-12)


def test_runner_keeps_its_energy_through_three_arcs():
    energy = 80 * 9.81 * 1.02 + 40 * 25.0
    problem = of.Problem(slip_runner(attack=0.35), of.Guess([0.0, 1.02, 5.0, 0.0], 0.8), pin=of.pin(energy=energy))
    count = problem.count()
    assert count.freedom == 0 and count.unknowns["durations of arcs"] == 2 and count.equations["guards"] == 3
    orbit = of.find_orbit(problem)
    assert orbit.certificate.passed and orbit.energy == pytest.approx(energy, rel=1e-13)
    assert orbit.floquet_multipliers.size == 2 and orbit.stability == "unstable"


def test_multipliers_are_those_of_the_return_map(walker):
    """The saltation matrices' product against differences of the simulated return map."""
    model = simplest_walker(0.009)
    found = gather_hybrid(model, walker.state, walker.period, np.zeros(2, int))
    step, columns = 1e-6, []
    for unit in np.eye(4):
        ends = [cycle_from(model, walker.state + sign * step * unit)[-1].after for sign in (1, -1)]
        columns.append((ends[0] - ends[1]) / (2 * step))
    mapped = np.linalg.eigvals(np.array(columns).T)
    wanted = found.floquet.multipliers[np.abs(found.floquet.multipliers) > 1e-6]
    for one in wanted:
        assert np.min(np.abs(mapped - one)) < 1e-7


def test_rows_have_the_derivatives_they_say(walker):
    """The Jacobian of a hybrid loop of three arcs, freed parameter and durations included, against differences."""
    model = slip_runner(attack=0.35)
    equations = Equations(model, NONE, ("stiffness",))
    assert equations.free == ("stiffness", "share_1", "share_2") and equations.physical == ("stiffness",)
    w = first_unknowns(equations, of.Guess([0.0, 1.02, 5.0, 0.0], 0.8), 2, 24)
    loop = Loop(equations, np.zeros(4)).through(w)
    path = equations.varied(w)
    system = loop.linearised(w, path)
    matrix, rows = system.matrix(), loop.rows(w, path.ends)
    for k in range(matrix.shape[1]):
        h = 1e-6 * max(1.0, 1e4 * (k == matrix.shape[1] - 3))  # the stiffness
        step = np.zeros(matrix.shape[1])
        step[k] = h
        ends = [loop.rows(one, equations.ends(one)) for one in (w.moved(step), w.moved(-step))]
        assert np.allclose(matrix[:, k], (ends[0] - ends[1]) / (2 * h), atol=1e-5 * max(1, np.abs(matrix[:, k]).max()))
    square = np.vstack([matrix, w.spread(np.eye(4 + 1 + 3)[5])])  # the stiffness held
    direct = -np.linalg.lstsq(square, np.append(rows, 0.0), rcond=None)[0]
    assert np.allclose(matrix @ direct, -rows, atol=1e-8 * np.abs(rows).max())
    assert np.allclose(matrix @ eliminated(system)(rows), -rows, atol=1e-7 * np.abs(rows).max())


@pytest.mark.slow
def test_period_doublings_of_the_walker(walker):
    """To period 2 and 4: located, certified, switched to; the slopes are those of the paper's cascade."""
    family = of.follow_family(walker, "slope", until=0.0165)
    (doubling,) = [one for one in family.events if one.kind == "period_doubling"]
    assert doubling.certified and doubling.free["slope"] == pytest.approx(0.0150884379411168, abs=1e-11)
    settings = of.FamilySettings(parameter="slope", directions="away", points=16)
    second = of.follow_family(of.switch_branch(family, doubling), settings=settings)
    assert second.points[0].period == pytest.approx(2 * doubling.period, rel=1e-2)
    again = [one for one in second.events if one.kind == "period_doubling"]
    assert again[0].certified and again[0].free["slope"] == pytest.approx(0.01766937486, abs=1e-9)
    assert dict(second.points[0].system)["cycle"] == ["strike", "strike"]
    assert all(of.certify(one).passed for one in second.points[:4])
    for one in second.points[:4]:  # the action is that after Newton's last step, which may be 1e-10 long
        recomputed = gather_hybrid(build_model(one.system), one.state, one.period, np.zeros(2, int)).action
        assert one.action == pytest.approx(recomputed, rel=1e-12)


def test_a_family_ends_where_its_cycle_changes():
    """Of a runner that no longer leaves the ground before its apex; named by the event that comes first."""
    check = HybridCheck(model := slip_runner(attack=0.35))
    orbit = of.find_orbit(
        of.Problem(model, of.Guess([0.0, 1.02, 5.0, 0.0], 0.8), pin=of.pin(energy=80 * 9.81 * 1.02 + 1000.0))
    )
    arcs = cycle_from(model, orbit.state)
    lasted = np.array([arc.duration for arc in arcs]) / orbit.period
    free = {"share_1": float(lasted[0]), "share_2": float(lasted[1])}
    assert check(orbit.state, orbit.period, np.zeros(2, int), free=free) < 1e-12
    assert check(orbit.state, orbit.period * (1 + 1e-6), np.zeros(2, int), free=free) > 1e-8


def test_saved_loaded_and_still_true(walker, tmp_path):
    file = of.save_orbit(walker, tmp_path / "orbit.json")
    again = of.load_orbit(file)
    assert of.certify(again).passed and again.period == walker.period


def failing(orbit, model, *names):
    certificate = of.certify(orbit, model)
    assert not certificate.passed and set(names) <= set(certificate.failures), certificate.failures


def test_planted_another_state(walker):
    failing(replace(walker, state=walker.state + np.array([1e-7, 2e-7, 0, 0])), simplest_walker(0.009), "closure")


def test_planted_another_period(walker):
    failing(replace(walker, period=walker.period * (1 + 1e-9)), simplest_walker(0.009), "recorded_period")


def test_planted_doubled_cycle(walker):
    twice = with_cycle(simplest_walker(0.009), ["strike", "strike"])
    doubled = replace(walker, period=2 * walker.period, system=twice.system)
    failing(doubled, twice, "minimal_cycle")


def test_planted_wrong_reset(walker):
    """The walker's orbit under an impact that keeps a little more speed."""
    model = simplest_walker(0.009)
    (mode,), (strike,), _ = model.hybrid.given
    other = replace(strike, reset=lambda x, p: 1.0001 * ca.vertcat(*_listed(strike.reset(x, p))))
    failing(walker, hybrid([mode], [other], ["strike"], system=model.system), "closure")


def _listed(column):
    return [column[k] for k in range(4)]


def test_planted_step_through_the_ground():
    """A block that is let through its side: what its mode holds is broken."""
    model = rocking_block()
    (mode,), (bounce,), kept = model.hybrid.given
    deep = replace(bounce, guard=lambda x, p: x.phi + 0.05)
    through = hybrid([mode], [deep], ["bounce"], conserved=kept, system=model.system)
    orbit = of.find_orbit(of.Problem(through, of.Guess([-0.05, 0.2], 3.0), pin=of.pin(phidot=0.2)))
    failing(orbit, through, "holds: gap")


def test_planted_impulse_of_the_wrong_sign():
    """An impact that pulls, with everything else in order."""
    model = rocking_block()
    (mode,), (bounce,), kept = model.hybrid.given
    pulling = replace(bounce, impulse=lambda x, p: x.phidot)
    orbit = of.find_orbit(of.Problem(model, of.Guess([0.0, 0.2], 2.4), pin=of.pin(phidot=0.2)))
    failing(
        orbit, hybrid([mode], [pulling], ["bounce"], conserved=kept, system=model.system), "holds: impulse of bounce"
    )


def test_planted_energy_balance():
    model = rimless_wheel()
    (mode,), (strike,), _ = model.hybrid.given
    orbit = of.find_orbit(of.Problem(model, of.Guess([0.08 - np.pi / 8, 1.2], 1.0)))
    more = replace(strike, lost=lambda x, p: 1.01 * strike.lost(x, p))
    failing(orbit, hybrid([mode], [more], ["strike"], system=model.system), "energy_balance")


def test_planted_skipped_guard():
    """A runner told to fly from apex to apex touches the ground instead."""
    model = with_cycle(slip_runner(attack=0.35), ["apex"])
    with pytest.raises(ConvergenceError, match="goes through touchdown where the cycle asks for apex"):
        of.find_orbit(of.Problem(model, of.Guess([0.0, 1.02, 5.0, 0.0], 0.8), pin=of.pin(energy=1800.0)))


def test_planted_skipped_guard_in_a_record():
    """The runner's orbit told as one arc from apex to apex: the simulation names what comes before."""
    model = slip_runner(attack=0.35)
    pinned = of.pin(energy=80 * 9.81 * 1.02 + 1000.0)
    orbit = of.find_orbit(of.Problem(model, of.Guess([0.0, 1.02, 5.0, 0.0], 0.8), pin=pinned))
    failing(orbit, with_cycle(model, ["apex"]), "events")
    assert "goes through touchdown where" in of.certify(orbit, with_cycle(model, ["apex"])).checks[0].note


def test_what_an_impact_cannot_be_made_of():
    """A gap that no coordinate changes, one of velocities, a restitution that is no number, a name that is taken."""
    for gap in (lambda x, p: 1.0, lambda x, p: x.theta1dot):
        with pytest.raises(InputError, match="contact: gaps are functions of the coordinates, and of no velocity"):
            impact(of.chain(2), gap)
    with pytest.raises(InputError, match="restitution: must be finite, got nan"):
        impact(of.chain(2), lambda x, p: x.theta1, float("nan"))
    shared = of.ode(lambda t, x, p: [x.v, -p.share_1], ("y", "v"), {"share_1": 1.0})
    with pytest.raises(InputError, match="a parameter 'share_1' is the share of an arc"):
        of.hybrid({"air": shared}, [Transition("b", "air", "air", guard=lambda x, p: x.y)], ["b"])


def test_a_guess_that_starts_beyond_its_guard_is_told():
    with pytest.raises(ConvergenceError, match=r"no event \(in mode air the guard of bounce is crossed from the start"):
        of.find_orbit(of.Problem(falling(0.5), of.Guess([-0.1, -1.0], 0.2)))


def test_a_thermostat_in_closed_form():
    """Two modes of one temperature: T = 2 log(12 / 8) / k."""
    heat = {"low": 18.0, "high": 22.0}
    off, on = (of.ode(lambda t, x, p, to=to: [(to - x.T) * 0.1], ("T",), heat) for to in (10.0, 30.0))
    model = of.hybrid({"off": off, "on": on}, [
        Transition("cold", "off", "on", guard=lambda x, p: x.T - p.low),
        Transition("warm", "on", "off", guard=lambda x, p: x.T - p.high, direction=1),
    ], ["cold", "warm"])  # fmt: skip
    orbit = of.find_orbit(of.Problem(model, of.Guess([22.0], 10.0)))
    assert orbit.certificate.passed and orbit.period == pytest.approx(20 * np.log(1.5), rel=1e-14)


def test_planted_allowed_that_hardly_decides(walker):
    """Whether the strike counts hangs on round-off."""
    model = simplest_walker(0.009)
    (mode,), (strike,), _ = model.hybrid.given
    end = cycle_from(model, walker.state)[-1].states[-1]
    narrow = replace(strike, allowed=lambda x, p: float(end[0]) + 1e-9 - x.theta)
    failing(walker, hybrid([mode], [narrow], ["strike"], system=model.system), "decided")
    assert any(one.name == "decided" and one.value > 0.1 for one in walker.certificate.checks)


def test_planted_grazing():
    """A guard that the motion only just reaches is no transversal event."""
    symbols = of.Symbols(q := ca.SX.sym("q"), v := ca.SX.sym("v"))
    model = of.lagrange(v**2 / 2, q**2 / 2, symbols, names=["x"])
    touch = Transition("touch", "free", "free", guard=lambda x, p: x.x - np.sqrt(1 - 1e-10), direction=1,
                       reset=lambda x, p: changed(x, x=-x.x))  # fmt: skip
    grazing = hybrid({"free": model}, [touch], ["touch"], conserved=["energy"])
    orbit = of.find_orbit(of.Problem(grazing, of.Guess([-np.sqrt(1 - 1e-10), 1e-5], 3.1), pin=of.pin(energy=0.5)))
    failing(orbit, grazing, "transversal")


def test_elastic_impact_keeps_energy_and_plastic_holds():
    """A double pendulum's tip against a wall: M (v+ - v-) = J^T P, J v+ = -e J v-, energy lost = P^2-work."""
    model, state = of.chain(2), np.array([0.3, -0.7, 1.1, 2.3])

    def wall(x, p):
        return ca.sin(x[0]) + ca.sin(x[1]) - 0.2

    q, v = state[:2], state[2:]
    jacobian = np.array([np.cos(q)])
    mass = np.array(
        ca.Function("m", [s := ca.SX.sym("v", 2)], [ca.hessian(model.kinetic(q, s, model.parameter_values), s)[0]])(v)
    )
    for e in (0.0, 0.5, 1.0):
        found = impact(model, wall, e)
        built = hybrid({"free": model}, [Transition("hit", "free", "free", guard=found.gap, reset=found.after,
                                                    impulse=found.impulse, lost=found.lost)], ["hit"])  # fmt: skip
        hit, p = built.hybrid.transition("hit"), built.parameter_values
        after = hit.reset(state, p).full().ravel()[2:]
        impulse = float(hit.impulse(state, p))
        assert jacobian @ after == pytest.approx(-e * jacobian @ v, abs=1e-13)
        assert mass @ (after - v) == pytest.approx(jacobian[0] * impulse, abs=1e-13)
        lost = v @ mass @ v / 2 - after @ mass @ after / 2
        assert float(hit.lost(state, p)) == pytest.approx(lost, abs=1e-12)
        assert lost == pytest.approx(0.0, abs=1e-12) if e == 1 else lost > 0


def test_zeno_is_named():
    with pytest.raises(IntegrationError, match="Zeno: events bounce .* accumulate at t = 4"):
        list(Automaton(falling()).arcs(np.array([0.0, 1.0]), "air", 100.0))


def test_events_are_located_to_round_off():
    """Elastic bounces: y = v t - t^2 / 2, so that they are 2 v apart, each as fast as the last but for its steps."""
    arcs = list(Automaton(falling(1.0)).arcs(np.array([0.0, 1.0]), "air", events=20))
    assert [arc.ended_by for arc in arcs] == ["bounce"] * 20
    speeds = np.array([1.0, *(arc.after[1] for arc in arcs)])
    assert [arc.duration for arc in arcs] == pytest.approx(2.0 * speeds[:-1], abs=1e-14)
    assert speeds == pytest.approx(1.0, abs=1e-13)


def test_time_ends_between_events():
    *_, last = Automaton(falling(1.0)).arcs(np.array([0.0, 1.0]), "air", 3.0)
    assert last.ended_by is None and last.times[-1] == pytest.approx(3.0) and last.after[0] == pytest.approx(0.5)


def test_simultaneous_events_are_named():
    symbols = of.Symbols(q := ca.SX.sym("q", 2), v := ca.SX.sym("v", 2))
    model = of.lagrange(ca.sumsqr(v) / 2, q[0] + q[1], symbols, names=["a", "b"])
    both = [Transition(name, "air", "air", guard=lambda x, p, name=name: x[name]) for name in ("a", "b")]
    box = hybrid({"air": model}, both, ["a"])
    with pytest.raises(IntegrationError, match="events a and b are simultaneous at t = 2"):
        list(Automaton(box).arcs(np.array([0.0, 0.0, 1.0, 1.0]), "air", 10.0))


def test_an_oscillator_that_hits_once_in_two_periods_is_another_orbit():
    model = impact_oscillator(frequency=2.8)
    one = of.find_orbit(of.Problem(model, of.Guess([0.0, -1.0, 1.0], 2.24), winding=(0, 0, 1)))
    assert one.certificate.passed and one.period == pytest.approx(2 * np.pi / 2.8, abs=1e-12)
    wrong = replace(one, winding=(0, 0, 2))
    failing(wrong, model, "closure")


@pytest.mark.parametrize(
    "change, message",
    [
        ({"cycle": ["bonce"]}, "unknown transition 'bonce', did you mean 'bounce'"),
        ({"source": "water"}, "transition bounce: unknown mode 'water'"),
        ({"direction": 0}, "direction must be -1"),
        ({"allowed": lambda x, p: x.y}, "ignored must say in words"),
        ({"guard": lambda x, p: ca.vertcat(x.y, x.ydot)}, "guard gives 2 numbers"),
        ({"reset": lambda x, p: x.y}, "reset gives 1 numbers for 2 states"),
        ({"guard": lambda x, p: x.z}, "transition bounce: guard: unknown name 'z'; known are y, ydot"),
        ({"guard": lambda x, p: 1.0}, "transition bounce: guard does not change with the state"),
        ({"impulse": lambda x, p: "hard"}, "transition bounce: impulse: cannot be made of CasADi symbols"),
        ({"holds": {"gap": lambda x, p: x.z}}, "mode air: holds 'gap': unknown name 'z'"),
        ({"holds": {"gap": lambda x, p: [x.y, -1 - x.y]}}, "mode air: holds 'gap' gives 2 numbers; give one"),
        ({"impulse": lambda x, p: [x.y, x.y]}, "transition bounce: impulse gives 2 numbers"),
        ({"conserved": ["momentum"]}, "mode air does not conserve 'momentum'"),
    ],
)
def test_what_does_not_fit_is_said(change, message):
    symbols = of.Symbols(q := ca.SX.sym("q"), v := ca.SX.sym("v"))
    model = of.lagrange(v**2 / 2, q, symbols, names=["y"])
    cycle, conserved = change.pop("cycle", ["bounce"]), change.pop("conserved", [])
    mode = Mode("air", model, change.pop("holds", None))
    given = {"name": "bounce", "source": "air", "target": "air", "guard": lambda x, p: x.y} | change
    with pytest.raises(InputError, match=message):
        hybrid([mode], [Transition(**given)], cycle, conserved=conserved)


def test_modes_share_states_and_parameters():
    symbols = of.Symbols(q := ca.SX.sym("q"), v := ca.SX.sym("v"))
    one, other = (of.lagrange(v**2 / 2, q, symbols, names=[name]) for name in ("y", "z"))
    with pytest.raises(InputError, match="modes: b has states z, zdot, a has y, ydot"):
        hybrid({"a": one, "b": other}, [Transition("up", "a", "b", guard=lambda x, p: x[0])], ["up"])
    with pytest.raises(InputError, match="the system is not hybrid"):
        with_cycle(of.chain(1), ["up"])


def test_nothing_but_a_clock_moves_and_still_no_event_is_missed():
    """A fast table under a slow ball: DOP853 takes one step where the table goes up and down eight times."""
    model = bouncing_ball(amplitude=0.3, frequency=50.0)
    arcs = list(Automaton(model).arcs(np.array([1.0, 0.0, 0.0]), "air", events=1))
    moments = np.linspace(0.0, arcs[0].duration, 200_001)[1:-1]
    gaps = 1.0 - moments**2 / 2 - 0.3 * np.sin(50 * moments)
    assert arcs[0].ended_by == "bounce" and np.all(gaps > 0)


def test_a_dip_between_looks_breaks_what_holds():
    """What a mode holds is followed between the simulator's looks, where it dips below 0 for 1e-4 of the time."""
    symbols = of.Symbols(ca.SX.sym("q"), v := ca.SX.sym("v"))
    model = of.lagrange(v**2 / 2, ca.SX(0), symbols, names=["x"])
    wall = Transition("wall", "free", "free", guard=lambda x, p: 1 - x.x, reset=lambda x, p: changed(x, x=0))
    held = {"narrow": lambda x, p: (x.x - 0.61234) ** 2 - 1e-9}
    built = of.hybrid([Mode("free", model, held)], [wall], ["wall"])
    (arc,) = Automaton(built).arcs(np.array([0.0, 1.0]), "free", events=1)
    assert dict(arc.margins)["narrow"] == pytest.approx(-1e-9 / (0.61234**2 - 1e-9), rel=1e-6)


def turning(guard):
    """A clock that is reset by nothing: x' = 0 under the angle that turns once."""
    model = of.ode(lambda t, x, p: [-x.x, 1.0], ("x", "phase"), angles=("phase",))
    kick = Transition("kick", "on", "on", guard=guard, direction=1, reset=lambda x, p: changed(x, x=x.x + 1))
    return of.hybrid([Mode("on", model)], [kick], ["kick"])


def test_planted_guard_that_knows_how_often_an_angle_has_turned():
    """After a turn this motion never meets its guard again, though state and time are those of an orbit."""
    guess = of.Guess([1.0, -3.0], 6.28)
    true = turning(lambda x, p: ca.sin(x.phase))
    orbit = of.find_orbit(of.Problem(true, guess, winding=(0, 1)))
    assert orbit.certificate.passed and orbit.period == pytest.approx(2 * np.pi, abs=1e-12)
    failing(orbit, turning(lambda x, p: x.phase - round((orbit.state[1] + orbit.period) / np.pi) * np.pi), "winding")


def test_planted_samples_and_nodes(walker):
    model, moved = simplest_walker(0.009), walker.samples.copy()
    moved[len(moved) // 2, 0] += 1e-3
    failing(replace(walker, samples=moved), model, "samples")
    failing(replace(walker, nodes=walker.nodes + 1e-6), model, "nodes")
    failing(replace(walker, times=walker.times * 0.99), model, "samples")


def test_coinciding_events_across_two_steps_are_named():
    """The second event comes less than 1e-9 of the arc later, in a step of its own or not."""
    symbols = of.Symbols(q := ca.SX.sym("q", 2), v := ca.SX.sym("v", 2))
    model = of.lagrange(ca.sumsqr(v) / 2, q[0] + q[1], symbols, names=["a", "b"])
    late = [Transition("a", "air", "air", guard=lambda x, p: x.a),
            Transition("b", "air", "air", guard=lambda x, p: x.b + 1e-10)]  # fmt: skip
    with pytest.raises(IntegrationError, match="events a and b are simultaneous"):
        list(Automaton(of.hybrid({"air": model}, late, ["a"])).arcs(np.array([0.0, 0.0, 1.0, 1.0]), "air", 10.0))


def test_time_is_no_clock_of_a_mode():
    t, q, v = (ca.SX.sym(name) for name in "tqv")
    model = of.lagrange(v**2 / 2, q * ca.sin(t), of.Symbols(q, v, time=t), names=["x"])
    with pytest.raises(InputError, match="modes: on depends on time; make the clock a state"):
        of.hybrid({"on": model}, [Transition("up", "on", "on", guard=lambda x, p: x.x)], ["up"])


def test_the_cycle_is_taken_from_the_guess():
    """Of the runner without one: touchdown, liftoff, apex, as its guess goes through them."""
    made = slip_runner(attack=0.35)
    modes, transitions, kept = made.hybrid.given
    model = of.hybrid(modes, transitions, conserved=kept)
    pinned = of.pin(energy=80 * 9.81 * 1.02 + 1000.0)
    known = of.find_orbit(of.Problem(made, of.Guess([0.0, 1.02, 5.0, 0.0], 0.8), pin=pinned))
    problem = of.Problem(model, of.Guess(known.state.round(2), round(known.period, 2)), pin=pinned)
    assert problem.model.hybrid.cycle == ("touchdown", "liftoff", "apex")
    orbit = of.find_orbit(problem)
    assert orbit.certificate.passed and orbit.period == pytest.approx(known.period, abs=1e-12)
    assert of.certify(orbit, model).passed
    with pytest.raises(ConvergenceError, match=r"cycle: the motion .* goes through no event in 0.03 s"):
        of.Problem(model, of.Guess([0.0, 1.02, 5.0, 0.0], 0.02))


def test_what_knows_no_events_refuses(walker, tmp_path):
    model = simplest_walker()
    with pytest.raises(InputError, match="a flow knows no events; use simulate"):
        of.flows.build_flow(model)
    with pytest.raises(InputError, match="energy: this system conserves none"):
        of.search(model, [0.1], (3.0, 4.0), tmp_path / "a.sqlite")
    with pytest.raises(InputError, match="c files know no events"):
        of.export_orbit(walker, "c", tmp_path)
    assert of.export_orbit(walker, "csv", tmp_path)[0].read_text().startswith("t,theta,phi")
    with pytest.raises((IntegrationError, ConvergenceError), match="no event|singular|overflow"):
        of.find_orbit(of.Problem(model, of.Guess([0.2, 0.4, 9.0, 0.0], 3.9)))


def test_a_freed_parameter_becomes_the_orbits_own():
    guess = of.Guess([0.20, 0.40, -0.20, -0.02], 3.9)
    refiner = of.Refiner(of.Problem(simplest_walker(0.009), guess, pin=of.pin(theta=0.2), free=("slope",)))
    orbit = refiner.orbit(refiner.refine())
    assert orbit.certificate.passed and orbit.state[0] == pytest.approx(0.2, abs=1e-14)
    assert orbit.system["arguments"]["slope"] == pytest.approx(0.00895, abs=2e-5)


def test_simulation_lists_events(walker):
    run = of.simulate(simplest_walker(0.009), walker.state, 10.0)
    assert [name for _, name in run.events] == ["strike", "strike"]
    assert [t for t, _ in run.events] == pytest.approx([walker.period, 2 * walker.period], abs=1e-12)
    assert run.states.shape == (1001, 4) and run.document()["events"][0]["name"] == "strike"
    assert run.states[0] == pytest.approx(walker.state) and "2 events" in repr(run)


def test_simulation_keeps_the_energy_of_every_mode():
    """The runner's leg stores energy while it stands: drift is that of the integration alone."""
    run = of.simulate(slip_runner(attack=0.35), [0.0, 1.02, 5.0, 0.0], 1.0)
    assert {"touchdown", "liftoff"} <= {name for _, name in run.events}
    assert run.conserved and run.change < 1e-9 * run.exchanged
    with pytest.raises(InputError, match="state: need 4 finite numbers"):
        of.simulate(slip_runner(), [0.0, 1.0], 1.0)
    with pytest.raises(IntegrationError, match="Zeno"):
        of.simulate(falling(), [0.0, 1.0], 10.0)


def test_grazing_ends_a_family_where_the_linear_oscillator_touches_the_stop():
    """Amplitude force / |1 - w^2 + i c w| = stop: the impact that becomes one of speed 0, to round-off."""
    guess = of.Guess([0.0, -1.0, 1.0], 2.24)
    orbit = of.find_orbit(of.Problem(impact_oscillator(frequency=2.8), guess, winding=(0, 0, 1)))
    settings = of.FamilySettings(parameter="stop", directions="forward", points=60, certify=False)
    family = of.follow_family(orbit, "stop", settings=settings)
    grazing = family.events[-1]
    assert (grazing.kind, grazing.detail) == ("grazing", "hit")
    assert grazing.parameter == pytest.approx(1 / abs(1 - 2.8**2 + 0.28j), abs=1e-12)
    assert (
        family.ends[-1].kind == "grazing" and "hit is only just reached beyond stop = 0.1460" in family.ends[-1].reason
    )
    assert all(of.certify(one).passed for one in family.points)


def test_another_guard_is_grazed_at_its_closed_form():
    """A bar across the way of a driven oscillator that it passes below, until its amplitude is that of the bar."""
    model = of.ode(
        lambda t, x, p: [x.v, p.force * ca.cos(x.phase) - 0.1 * x.v - x.x, 2.8], ("x", "v", "phase"),
        {"force": 1.0}, angles=("phase",),
    )  # fmt: skip
    turn = Transition("turn", "free", "free", guard=lambda x, p: ca.sin(x.phase))
    bar = Transition("bar", "free", "free", guard=lambda x, p: x.x - 0.2, direction=1)
    built = of.hybrid([Mode("free", model)], [turn, bar], ["turn"])
    orbit = of.find_orbit(of.Problem(built, of.Guess([0.14, 0.0, np.pi], 2.24), winding=(0, 0, 1)))
    family = of.follow_family(orbit, "force", settings=of.FamilySettings(parameter="force", directions="forward"),
                              model=built)  # fmt: skip
    grazing = family.events[-1]
    assert (grazing.kind, grazing.detail) == ("grazing", "bar")
    assert grazing.parameter == pytest.approx(0.2 * abs(1 - 2.8**2 + 0.28j), abs=1e-11)
    assert "bar comes before turn in mode free" in family.ends[-1].reason


def test_a_spoke_that_would_pull_ends_the_wheels_family():
    """g cos(slope + a) = l w^2 before the strike: tan(slope) = 1 / (9 tan(pi / 8)) for eight spokes."""
    orbit = of.find_orbit(of.Problem(rimless_wheel(), of.Guess([0.08 - np.pi / 8, 1.2], 1.0)))
    family = of.follow_family(orbit, "slope", settings=of.FamilySettings(parameter="slope", directions="forward"))
    lost, table = family.events[-1], family.table()
    assert (lost.kind, lost.detail) == ("holds", "spoke force")
    assert np.allclose(table.amplitude_theta, np.pi / 8, rtol=1e-3) and np.array_equal(
        table.slope, family.values("slope")
    )
    assert lost.parameter == pytest.approx(np.arctan(1 / (9 * np.tan(np.pi / 8))), abs=1e-11)


def test_a_vanishing_arc_ends_its_family():
    """The hopper that no longer leaves the ground, at energy 0: below it there is no flight."""
    orbit = of.find_orbit(of.Problem(vertical_hopper(), of.Guess([0.0, -1.9], 1.0), pin=of.pin(energy=1.0)))
    settings = of.FamilySettings(directions="backward", events=False)
    family = of.follow_family(orbit, "energy", settings=settings)
    last = family.events[-1]
    assert last.kind in ("cycle_change", "grazing") and family.ends[0].kind == last.kind
    assert last.energy == pytest.approx(0.0, abs=1e-12) and last.period == pytest.approx(0.2 * np.pi, abs=1e-9)


def test_errors_of_a_family_grow_through_its_resets():
    """Two steps of the walker: by A of the certificate, and not by the product of what the arcs alone make of them."""
    problem = of.load_problem(Path(__file__).parents[1] / "problems" / "hybrid" / "simplest-walker-period-2.toml")
    settings = of.FamilySettings(parameter="slope", directions="forward", points=2, events=False)
    for point in of.follow_family(of.find_orbit(problem), "slope", settings=settings).points:
        known = gather_hybrid(build_model(point.system), point.state, point.period, np.zeros(2)).closes.amplification
        assert 0.1 * known < point.scale < 10 * known < 1e4


def test_no_family_starts_from_another_cycle():
    """The loop that closes through the apex alone goes through the ground; it is an orbit of no family."""
    model = with_cycle(slip_runner(attack=0.35), ["apex"])
    with pytest.raises(ConvergenceError, match="goes through touchdown"):
        of.follow_family(of.Problem(model, of.Guess([0.0, 1.02, 5.0, 0.0], 0.8), pin=of.pin(energy=1800.0)), "energy")


@pytest.mark.parametrize(
    "guess, period, limit",
    [([0.20, 0.40, -0.20, -0.02], "long_T", 0.970956), ([0.19, 0.38, -0.20, -0.01], "short_T", 0.943976)],
)
def test_the_walkers_gaits_as_the_slope_vanishes(guess, period, limit):
    """theta / slope^(1/3) and the period tend to the published limits, with corrections in slope^(2/3)."""
    wanted = np.pi if period == "short_T" else number("walker-limit", period)
    orbit = of.find_orbit(of.Problem(simplest_walker(0.009), of.Guess(guess, 3.9 if period == "long_T" else 3.1)))
    settings = of.FamilySettings(directions="backward", events=False)
    slopes = (1e-5, 1e-6)
    family = of.follow_family(orbit, "slope", at=slopes, until=5e-7, settings=settings)
    points = [next(one for one in family.points if one.value == slope) for slope in slopes]
    for read, known in ((lambda one: one.state[0] / one.value ** (1 / 3), limit), (lambda one: one.period, wanted)):
        far, near = map(read, points)
        ratio = 10 ** (2 / 3)
        assert (ratio * near - far) / (ratio - 1) == pytest.approx(known, abs=1e-6)


def test_a_second_program_finds_the_same_compass_gait():
    """Equations, impact (from angular momentum), events and multipliers of `benchmarks/hybrid_gaits.py` alone."""
    slope, guess = float(np.deg2rad(3.0)), of.Guess([0.22, -0.32, -1.09, -0.38], 0.73)
    orbit = of.find_orbit(of.Problem(compass_gait(slope=slope), guess))
    walker = compass(slope)
    state, period = walker.orbit(np.asarray(guess.state))
    assert orbit.state == pytest.approx(state, abs=1e-11) and orbit.period == pytest.approx(period, abs=1e-11)
    for one in walker.multipliers(state)[:3]:
        assert np.min(np.abs(orbit.floquet_multipliers - one)) < 1e-8


@pytest.mark.slow
def test_a_second_program_finds_the_same_period_doublings():
    """The compass gait's first two, to 1e-9: 4.3909 degrees, where simulations had told 4.37, and 4.9141."""
    orbit = of.find_orbit(of.Problem(compass_gait(), of.Guess([0.22, -0.32, -1.09, -0.38], 0.73)))
    family = of.follow_family(orbit, "slope", until=float(np.deg2rad(4.6)))
    first = next(one for one in family.events if one.kind == "period_doubling")
    place, _ = doubling(compass, orbit.state, (float(np.deg2rad(4.3)), float(np.deg2rad(4.5))))
    assert first.certified and first.parameter == pytest.approx(place, abs=1e-9)
    settings = of.FamilySettings(parameter="slope", directions="away", points=20)
    limping = of.follow_family(of.switch_branch(family, first), settings=settings, until=float(np.deg2rad(5.0)))
    second = next(one for one in limping.events if one.kind == "period_doubling")
    place, _ = doubling(compass, second.state, (second.parameter - 2e-4, second.parameter + 2e-4), 2)
    assert second.certified and second.parameter == pytest.approx(place, abs=1e-9)  # 4.9141 degrees


@pytest.mark.slow
def test_the_cascade_is_followed_to_period_8(walker):
    """By continuing, and switching where periods double: the doublings of the simplest walker."""
    family, found = of.follow_family(walker, "slope", until=0.0165), []
    for order, points in ((2, 16), (4, 16), (8, 2)):
        settings = of.FamilySettings(parameter="slope", directions="away", points=points)
        event = next(one for one in family.events if one.kind == "period_doubling")
        found.append(event.parameter)
        family = of.follow_family(of.switch_branch(family, event), settings=settings)
        assert dict(family.points[0].system)["cycle"] == ["strike"] * order
        certificates = [of.certify(one) for one in family.points]
        assert not [one.failures for one in certificates if not one.passed]
        assert any(one.name == "minimal_cycle" and one.passed for one in certificates[0].checks)
    assert found == pytest.approx([0.0150884379411, 0.0176693748, 0.0181601196], abs=1e-9)


def test_a_saved_point_of_several_arcs_is_an_orbit(tmp_path):
    """Durations of arcs are no arguments of its system; and what is edited is no orbit."""
    orbit = of.find_orbit(of.Problem(vertical_hopper(), of.Guess([0.0, -1.9], 1.0), pin=of.pin(energy=2.0)))
    of.follow_family(orbit, "stiffness", until=99.0, out=tmp_path, name="hopper")
    point = of.load_orbit(tmp_path / "hopper" / "family.json#1")
    assert set(point.free) == {"stiffness", "share_1"} and "share_1" not in point.system["arguments"]
    assert of.certify(point).passed and point.system["arguments"]["stiffness"] == point.free["stiffness"]
    moved = {**point.system, "arguments": {**point.system["arguments"], "stiffness": point.free["stiffness"] + 1e-3}}
    failing(replace(point, system=moved), vertical_hopper(stiffness=point.free["stiffness"] + 1e-3), "recorded_period")


def test_a_family_is_followed_in_the_parameter_of_its_settings(walker):
    """Told by settings alone; told twice in two ways is refused."""
    settings = of.FamilySettings(parameter="slope", directions="forward", points=2, events=False)
    assert of.follow_family(walker, settings=settings).parameter == "slope"
    with pytest.raises(InputError, match="parameter: 'theta' beside settings with 'slope'; give it in one place"):
        of.follow_family(walker, "theta", settings=settings)


def test_a_simulation_that_would_never_end_is_given_up(walker):
    """After 64 events that promise more than are gone through; of 1e300 s at once."""
    with pytest.raises(IntegrationError, match=r"more than 10000 events in 1e\+09 s, 64 of them in the first 248"):
        of.simulate(simplest_walker(0.009), walker.state, 1e9)
    with pytest.raises(InputError, match=r"duration: must be positive and below 1e\+100 s, got 1e\+300"):
        of.simulate(of.chain(1), [0.1, 0.0], 1e300)


@pytest.mark.slow
def test_five_links_without_a_torso_are_four():
    """The same gait, multipliers and all, as the kneed walker's; a torso below nothing is refused."""
    four, five = kneed_walker(), five_link_walker(torso_mass=0.0)
    guess = of.Guess([0.19, -0.29, -0.29, -1.1, -0.05, -0.05], 0.56)
    one, other = (of.find_orbit(of.Problem(model, guess)) for model in (four, five))
    assert other.certificate.passed and other.state == pytest.approx(one.state, abs=1e-12)
    assert other.floquet_multipliers == pytest.approx(one.floquet_multipliers, abs=1e-9)
    with pytest.raises(InputError, match="torso_mass: must not be negative, got -1"):
        five_link_walker(torso_mass=-1)


def test_an_event_where_a_step_of_the_integrator_ends_is_one_moment(monkeypatch):
    """Figures part a motion where a time comes twice; a motion that ended in such an event had an arc too many."""
    ring = of.Transition("ring", "on", "on", lambda x, p: x.x - 1.0, lambda x, p: [0.0], direction=1)
    model = of.hybrid({"on": of.ode(lambda t, x, p: [1.0], ["x"])}, [ring], ["ring"])
    monkeypatch.setattr(Automaton, "_polished", lambda self, one, field, begin, moment: begin)  # where the step begins
    for arc in Automaton(model, longest=0.125).arcs(np.zeros(1), "on", events=3):
        assert np.diff(arc.times).min() > 0 and len(arc.times) == len(arc.states)
