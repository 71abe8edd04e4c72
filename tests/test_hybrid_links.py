"""What closes a hybrid loop and what is asked of it: symmetries, shifts, trajectories, constraints; closed forms."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

import orbitfinder as of
from orbitfinder.errors import ConvergenceError, CountError, InputError
from orbitfinder.mechanics.hybrid import changed
from orbitfinder.mechanisms.machines import rocking_block, simplest_walker

GAP, KEPT, PACE = 0.5, 0.8, 2.0
"""Of the walls from the middle, of the speed at one, of the forcing"""


def between_walls(force: float = 1.0, cycle=("left", "right")):
    """x'' + x = force cos(phase) between two walls, phase' = 2."""
    moving = of.ode(
        lambda _, x, p: [x.v, p.force * ca.cos(x.phase) - x.x, PACE], ["x", "v", "phase"],
        parameters={"force": force}, angles=["phase"], symmetries={"mirror": (1, {"x": -1, "v": -1})},
    )  # fmt: skip

    def hit(name, side):
        return of.Transition(
            name, "free", "free", guard=lambda x, p: GAP - side * x.x,
            reset=lambda x, p: changed(x, x=side * GAP, v=-KEPT * x.v),
        )  # fmt: skip

    return of.hybrid({"free": moving}, [hit("right", 1), hit("left", -1)], cycle)


def exact(force: float = 1.0) -> list[tuple[float, float]]:
    """(v, phase) right after the right wall of orbits that hit both in turn, mirrored after half a period.

    x = A cos t + B sin t + C cos(2 t + phase); of x(h) = -x(0) and v after the left wall = -v(0) all follows from A.
    """
    h, c = np.pi / PACE, force / (1 - PACE**2)
    by_a = -(1 + np.cos(h)) / np.sin(h)  # B / A
    speed = 2 * by_a / (1 + 1 / KEPT)  # v(0) / A
    slope = (by_a - speed) / PACE  # C sin(phase) / A
    roots = np.roots([1 + slope**2, -2 * GAP, GAP**2 - c**2])
    return [(speed * a, float(np.arctan2(slope * a / c, (GAP - a) / c))) for a in roots.real]


def walls(model=None, **asked):
    model = model or between_walls()
    return of.Problem(model, of.Guess([GAP, -0.7, 0.2], np.pi), **asked)


@pytest.fixture(scope="module")
def mirrored():
    return of.find_orbit(walls(symmetry="mirror"))


def test_an_orbit_between_two_walls_closes_after_half_a_period(mirrored):
    count = walls(symmetry="mirror").count()
    assert (count.equations["guards"], count.unknowns["durations of arcs"], count.freedom) == (1, 0, 0)
    assert mirrored.certificate.passed and mirrored.symmetry == "mirror" and mirrored.winding == (0, 0, 1)
    assert mirrored.period == pytest.approx(np.pi, abs=1e-13)
    assert min(np.abs(np.array(one) - mirrored.state[1:]).max() for one in exact()) < 1e-12
    whole = of.find_orbit(walls())
    assert whole.symmetry == "none" and np.allclose(whole.state, mirrored.state, atol=1e-12)
    assert np.allclose(np.sort(whole.floquet_multipliers), np.sort(mirrored.floquet_multipliers), atol=1e-9)


def test_planted_symmetries_that_a_hybrid_orbit_has_not(mirrored):
    model = between_walls()
    for name in ("reflection", "brake", "none+"):
        failed = [one.name for one in of.certify(replace(mirrored, symmetry=name), model).checks if not one.passed]
        assert failed == ["symmetry"]
    limping = of.find_orbit(of.Problem(relay(0.6, 0.5), of.Guess([-0.5], 2.5)))
    assert limping.certificate.passed and limping.period == pytest.approx(np.log(1.5 / 0.4 * 1.6 / 0.5), abs=1e-12)
    failed = of.certify(replace(limping, symmetry="reflection"), relay(0.6, 0.5)).checks
    assert [one.name for one in failed if not one.passed] == ["symmetry"]
    with pytest.raises(
        InputError, match="'reflection' .* does not take modes, guards and resets of half of the events"
    ):
        of.Problem(relay(0.6, 0.5), of.Guess([-0.5], 2.5), symmetry="reflection")


def relay(top: float, bottom: float):
    """x' = 1 - x up to the top, then x' = -1 - x down to the bottom."""
    modes = {name: of.ode(lambda _, x, p, to=to: [to - x.x], ["x"]) for name, to in (("up", 1.0), ("down", -1.0))}
    ends = [
        of.Transition("top", "up", "down", guard=lambda x, p: x.x - top, direction=1),
        of.Transition("bottom", "down", "up", guard=lambda x, p: x.x + bottom),
    ]
    return of.hybrid(modes, ends, ["top", "bottom"])


def test_modes_that_a_symmetry_exchanges():
    """Of a relay between h and -h: T = 2 log((1 + h) / (1 - h))."""
    orbit = of.find_orbit(of.Problem(relay(0.6, 0.6), of.Guess([-0.55], 2.5), symmetry="reflection"))
    assert orbit.certificate.passed and orbit.symmetry == "reflection"
    assert orbit.period == pytest.approx(2 * np.log(1.6 / 0.4), abs=1e-13) and orbit.state == pytest.approx([-0.6])


def test_a_mirrored_orbit_at_a_speed_that_is_asked_for():
    """A freed force, the state at t = 0 held by a constraint; by the closed form that force is a root."""
    slower = of.Constraint(lambda v: v["v"], -0.6, -0.6, name="speed")
    orbit = of.find_orbit(walls(symmetry="mirror", free=("force",), constraints=(slower,)))
    force = orbit.provenance["free"]["force"]
    assert orbit.certificate.passed and orbit.state[1] == pytest.approx(-0.6, abs=1e-9)
    assert min(np.abs(np.array(one) - orbit.state[1:]).max() for one in exact(force)) < 1e-10


def test_a_family_of_a_mirrored_orbit_watches_all_its_events():
    family = of.follow_family(walls(symmetry="mirror"), "force", points=3)
    for point in family.points:
        known = exact(point.free["force"])
        assert min(np.abs(np.array(one) - point.state[1:]).max() for one in known) < 1e-8


def rolling(bumps: float = 0.0):
    """A ball that bounces along a floor."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    ball = of.lagrange(ca.sumsqr(v) / 2, 9.8 * q[1], of.Symbols(q, v), names=["x", "y"])
    bounce = of.Transition(
        "bounce", "air", "air", guard=lambda x, p: x.y + bumps * ca.sin(x.x),
        reset=lambda x, p: changed(x, ydot=-x.ydot),
    )  # fmt: skip
    return of.hybrid({"air": ball}, [bounce], ["bounce"], conserved=["energy", "momentum_x"])


def test_a_ball_that_bounces_along_comes_back_shifted():
    model, pins = rolling(), of.pin(energy=12.005 + 1.125, momentum_x=1.5)
    problem = of.Problem(model, of.Guess([0.0, 0.0, 1.4, 4.8], 0.9), pin=pins, relative=("x",))
    orbit = of.find_orbit(problem)
    assert orbit.certificate.passed and orbit.period == pytest.approx(1.0, abs=1e-12)
    assert orbit.shift == pytest.approx({"x": 1.5}, abs=1e-12)
    failed = [one.name for one in of.certify(replace(orbit, shift={"x": 1.4}), model).checks if not one.passed]
    assert "closure" in failed
    failed = [one.name for one in of.certify(orbit, rolling(1e-3)).checks if not one.passed]
    assert "cyclic" in failed
    for point in of.follow_family(problem, points=3).points:
        assert point.shift["x"] == pytest.approx(1.5 * point.period, rel=1e-9)


@pytest.mark.parametrize(
    "cycle, symmetry", [(("left", "right"), "mirror"), (("left", "right"), "none"), (None, "none")]
)
def test_a_trajectory_of_a_rough_simulation_is_a_guess(mirrored, cycle, symmetry):
    """61 rows of an integration at 1e-6, events between them; the arcs are read off it."""
    grid, t, y, side = np.linspace(0.0, np.pi, 61), 0.0, np.array([GAP, -0.72, 0.15]), -1
    rows = [y]
    while len(rows) < grid.size:

        def wall(_, y, side=side):
            return GAP - side * y[0]

        wall.terminal, wall.direction = True, -1
        span = (t, np.pi)
        found = solve_ivp(lambda t, y: [y[1], np.cos(y[2]) - y[0], PACE], span, y, rtol=1e-6, events=wall,
                          t_eval=grid[len(rows) :])  # fmt: skip
        rows += list(found.y.T)
        if found.status != 1:
            break
        t, (x, v, phase), side = found.t_events[0][0], found.y_events[0][0], -side
        y = np.array([x, -KEPT * v, phase])
    guess = of.Guess(rows[0], np.pi, times=grid[: len(rows)], states=np.array(rows))
    problem = of.Problem(between_walls(cycle=cycle), guess, symmetry=symmetry)
    assert problem.model.hybrid.cycle == ("left", "right")
    orbit = of.find_orbit(problem)
    assert orbit.certificate.passed and np.allclose(orbit.state, mirrored.state, atol=1e-12)


@pytest.mark.slow
def test_a_trajectory_of_an_unstable_gait_twice_over():
    """Errors grow threefold in a step; of samples off by 1e-3, times of events twice, each arc begins at its own."""
    model = simplest_walker(0.03)
    one = of.find_orbit(of.Problem(model, of.Guess([0.297, 0.594, -0.284, -0.049], 4.0)))
    assert one.certificate.passed and np.abs(one.floquet_multipliers).max() > 3
    times = np.concatenate([[*(k * one.period + one.times[:-1]), (k + 1) * one.period] for k in range(8)])
    states = np.vstack([one.samples] * 8) + 1e-3 * np.random.default_rng(0).normal(size=(times.size, 4))
    eight = of.hybrid(*model.hybrid.given[:2], ["strike"] * 8)
    guess = of.Guess(states[0], 8 * one.period, times=times, states=states)
    assert of.Refiner(of.Problem(eight, guess)).refine().period == pytest.approx(8 * one.period, abs=1e-9)


def test_a_trajectory_in_a_file(mirrored, tmp_path):
    of.export_orbit(
        of.find_orbit(of.Problem(simplest_walker(), of.Guess([0.2, 0.4, -0.2, -0.02], 3.9))), "csv", tmp_path
    )
    (table,) = tmp_path.glob("*.csv")
    (tmp_path / "walk.toml").write_text(
        'name = "walk"\n[system]\nkind = "python"\nfunction = "simplest_walker"\n'
        f'[guess]\ncsv = "{table.name}"\n[find]\nfree = ["slope"]\nbounds = {{ theta = [0.15, 0.19] }}\n'
    )
    orbit = of.find_orbit(of.load_problem(tmp_path / "walk.toml"))
    assert orbit.certificate.passed and orbit.state[0] == pytest.approx(0.19, abs=1e-9)
    assert orbit.provenance["free"]["slope"] == pytest.approx(slope_of(0.19), abs=1e-9)


def slope_of(theta: float) -> float:
    """The slope on which the simplest walker's long gait has steps of this angle, by SciPy alone."""

    def off(unknown):
        slope, rate = unknown

        def field(_, x):
            push = np.sin(x[0] - slope)
            return [x[2], x[3], push, push + x[2] ** 2 * np.sin(x[1]) - np.cos(x[0] - slope) * np.sin(x[1])]

        start = [theta, 2 * theta, rate, (1 - np.cos(2 * theta)) * rate]
        found = solve_ivp(
            field, (0.0, 4.4), start, "DOP853", events=lambda _, x: x[1] - 2 * x[0], rtol=1e-12, atol=1e-13
        )
        end = found.y_events[0][-1]  # the one before, in mid-stance, scuffs
        return [end[0] + theta, np.cos(2 * end[0]) * end[2] - rate]

    return float(fsolve(off, [0.009 * (theta / 0.2) ** 3, -theta], xtol=1e-12)[0])


@pytest.mark.parametrize(
    "asked, theta",
    [
        ({"constraints": (of.Constraint(lambda v: v["theta"], 0.23, 0.23, name="step"),)}, 0.23),
        (
            {"constraints": (of.Constraint(lambda v: ca.sin(v["theta"]), 0.1, 0.21),), "objective": "up"},
            np.arcsin(0.21),
        ),
        pytest.param({"bounds": {"theta": (0.15, 0.22)}, "objective": "up"}, 0.22, marks=pytest.mark.slow),
        pytest.param({"bounds": {"theta": (0.18, 0.3)}, "objective": "down"}, 0.18, marks=pytest.mark.slow),
    ],
)
def test_steps_of_a_walker_on_a_slope_that_is_free(asked, theta):
    slopes = {"up": lambda v: -v["slope"], "down": lambda v: v["slope"]}
    asked = asked | ({"objective": slopes[asked["objective"]]} if "objective" in asked else {})
    guess = of.Guess([0.20, 0.40, -0.20, -0.02], 3.9)
    orbit = of.find_orbit(of.Problem(simplest_walker(0.009), guess, free=("slope",), **asked))
    assert orbit.certificate.passed and orbit.state[0] == pytest.approx(theta, abs=1e-8)
    assert orbit.provenance["free"]["slope"] == pytest.approx(slope_of(theta), abs=1e-8)


def test_multipliers_that_are_asked_for_are_those_of_the_return_map():
    """The monodromy in a constraint goes through the saltation matrices; the certificate's by another integrator."""
    asked = of.Constraint(lambda v: ca.trace(v.monodromy), 0.7, 0.7, name="trace")
    guess = of.Guess([0.20, 0.40, -0.20, -0.02], 3.9)
    orbit = of.find_orbit(of.Problem(simplest_walker(0.009), guess, free=("slope",), constraints=(asked,)))
    assert orbit.certificate.passed
    assert sum(orbit.floquet_multipliers) == pytest.approx(0.7 - 1.0, abs=1e-6)
    least = of.Problem(simplest_walker(0.009), guess, free=("slope",), objective="min_instability",
                       bounds={"slope": (0.005, 0.011)})  # fmt: skip
    assert of.find_orbit(least).provenance["free"]["slope"] == pytest.approx(0.011)


def test_the_nearest_of_a_family_is_found_without_a_pin():
    """Of a ball that bounces elastically: T = 2 v / g, whatever v it takes."""
    level = {"energy": lambda x, p: x.v**2 / 2 + 9.8 * x.y}
    fall = of.ode(lambda t, x, p: [x.v, -9.8], ["y", "v"], invariants=level)
    bounce = of.Transition("bounce", "air", "air", lambda x, p: x.y, lambda x, p: [x.y, -x.v])
    ball = of.hybrid({"air": fall}, [bounce], ["bounce"], conserved=["energy"])
    orbit = of.find_orbit(of.Problem(ball, of.Guess([0.0, 5.0], 1.0)))
    assert orbit.certificate.passed and orbit.period == pytest.approx(2 * orbit.state[1] / 9.8, abs=1e-12)
    slow = of.Problem(ball, of.Guess([0.0, 5.0], 1.0), objective=lambda v: v["v"], bounds={"period": (0.6, 2.0)})
    assert of.find_orbit(slow).period == pytest.approx(0.6, abs=1e-9)


@pytest.mark.parametrize(
    "problem, message",
    [
        (lambda: walls(symmetry="reflection"), "symmetry: 'reflection' .* does not take modes, guards and resets"),
        (lambda: walls(symmetry="mirror", winding=(0, 0, 2)), "symmetry: 'mirror' .* does not take modes"),
        (lambda: walls(symmetry="mirror", winding=(1, 0, 1)), "winding: .* turns a coordinate that is not an angle"),
        (lambda: walls(between_walls(cycle=["left", "right", "left"][:1]), symmetry="mirror"), "odd number"),
        (lambda: walls(phase_condition=lambda v: v["x"]), "phase_condition: chooses t = 0, .* its guard is the phase"),
        (lambda: walls(objective="max_amplitude"), "objective: chooses t = 0"),
        (lambda: walls(coordinate="x"), "coordinate: chooses t = 0"),
        (lambda: walls(relative=("x",)), "relative: 'x' is no cyclic coordinate"),
        (
            lambda: of.Problem(rocking_block(), of.Guess([0.0, 0.2], 5.0), symmetry="brake"),
            "symmetry: 'brake' runs time backwards, and a reset",
        ),
        (
            lambda: of.Problem(between_walls(), of.Guess([GAP, -0.7, 0.2], np.pi, np.ones(3), np.ones((2, 3)))),
            r"guess.states: \(2, 3\) numbers at \(3,\) times; give 3 of a state at each",
        ),
    ],
)
def test_what_cannot_be_asked_of_a_hybrid_is_named(problem, message):
    with pytest.raises(InputError, match=message):
        problem()


def test_a_trajectory_through_other_events_is_named(mirrored):
    other = between_walls(cycle=["left", "left"])
    guess = of.Guess(mirrored.state, np.pi, mirrored.times, mirrored.samples)
    with pytest.raises(ConvergenceError, match="goes through left, right where the cycle asks for left, left"):
        of.find_orbit(of.Problem(other, guess))
    with pytest.raises(CountError, match="nothing is left to choose"):
        of.find_orbit(walls(objective=lambda v: v["v"]))


@pytest.mark.slow
def test_a_sweep_of_mirrored_orbits_goes_warm():
    swept = of.sweep(walls(symmetry="mirror"), force=[1.0, 1.05, 1.1])
    for force, row in zip((1.0, 1.05, 1.1), swept.rows, strict=True):
        assert row.orbit.symmetry == "mirror" and row.orbit.certificate.passed
        assert min(np.abs(np.array(one) - row.orbit.state[1:]).max() for one in exact(force)) < 1e-10


@pytest.mark.slow
def test_half_of_a_cycle_may_have_several_arcs(mirrored):
    """The same motion with its passages through the middle as events; the trace of the whole through both halves."""
    modes, hits, _ = between_walls().hybrid.given
    middle = [of.Transition(name, "free", "free", guard=lambda x, p: x.x, direction=way)
              for name, way in (("down", -1), ("up", 1))]  # fmt: skip
    model = of.hybrid(modes, [*hits, *middle], ["down", "left", "up", "right"])
    problem = walls(model, symmetry="mirror")
    assert problem.count().unknowns["durations of arcs"] == 1
    orbit = of.find_orbit(problem)
    assert orbit.certificate.passed and np.allclose(orbit.state, mirrored.state, atol=1e-12)
    trace = of.Constraint(lambda v: ca.trace(v.monodromy), 0.5, 0.5, name="trace")
    orbit = of.find_orbit(replace(problem, free=("force",), constraints=(trace,), segments=2))
    assert orbit.certificate.passed and sum(orbit.floquet_multipliers) == pytest.approx(0.5 - 1.0, abs=1e-6)
    assert min(np.abs(np.array(one) - orbit.state[1:]).max() for one in exact(orbit.provenance["free"]["force"])) < 1e-9
