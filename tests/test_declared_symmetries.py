"""Symmetries that a problem file declares: signs and generators, confirmed, imposed, split off and read back."""

import json

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from test_found_symmetries import rosette, springs

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.mechanics.kind import build_model
from orbitfinder.problemfile.read import load_problem_file
from orbitfinder.problemfile.write import orbit_text

THREE_BODIES = """
[system]
kind = "equations"
[system.rates]
x = "vx"
y = "vy"
vx = "2*vy + x - (1 - mu)*(x + mu)/r1^3 - mu*(x - 1 + mu)/r2^3"
vy = "-2*vx + y - (1 - mu)*y/r1^3 - mu*y/r2^3"
[system.let]
r1 = "sqrt((x + mu)^2 + y^2)"
r2 = "sqrt((x - 1 + mu)^2 + y^2)"
[system.parameters]
mu = 0.0121505856
[system.invariants]
jacobi = "(vx^2 + vy^2 - x^2 - y^2)/2 - (1 - mu)/r1 - mu/r2"
[system.symmetries]
mirror = { time = -1, signs = { y = -1, vx = -1 } }
[guess]
state = [0.8234, 0.0, 0.0, 0.1263]
period = 2.743
[find]
pin = { x = 0.8234 }
symmetry = "mirror"
"""
"""The planar restricted problem, whose Lyapunov orbits cross the axis of the primaries at right angles"""
WELL = dict(coordinates=["x", "y"], kinetic="(xdot^2 + ydot^2)/2", potential="k*(sqrt(x^2 + y^2) - 1)^2")
TURN = {"turn": {"generator": {"x": "-y", "y": "x"}}}


def command(*words):
    return CliRunner().invoke(cli, list(map(str, words)))


def refused(**given):
    with pytest.raises(InputError) as error:
        of.equations(**given)
    return str(error.value)


def test_a_reversing_mirror_of_a_file_is_imposed_certified_shown_and_read_back(tmp_path):
    file = tmp_path / "lyapunov.toml"
    file.write_text(THREE_BODIES)
    made = command("run", file, "-o", tmp_path, "--no-figures")
    assert made.exit_code == 0, made.output
    record = tmp_path / "lyapunov" / "orbit.json"
    document = json.loads(record.read_text())
    assert document["symmetry"] == "mirror" and document["system"]["symmetries"]["mirror"]["time"] == -1
    assert command("verify", record).exit_code == 0
    known = of.Problem(of.systems.restricted_three_body(0.0121505856), of.Guess([0.8234, 0.0, 0.0, 0.1263], 2.743),
                       pin=of.pin(x=0.8234))  # fmt: skip
    assert document["period"] == pytest.approx(of.find_orbit(known).period, rel=1e-10)
    rebuilt = build_model(document["system"])
    assert rebuilt.symmetries == (("mirror", -1, (1, -1, -1, 1)),) and rebuilt.system == document["system"]
    again = tmp_path / "again.toml"
    again.write_text(orbit_text(document))
    assert load_problem_file(again).model.symmetries == rebuilt.symmetries
    listed = command("show", file).output
    assert "symmetries" in listed and "mirror y -> -y, vx -> -vx, running the film backwards" in listed
    file.write_text(THREE_BODIES.replace('symmetry = "mirror"', 'symmetry = "miror"'))
    with pytest.raises(InputError, match=r"find.symmetry: unknown 'miror'; use one of none, .*mirror"):
        load_problem_file(file)


def test_an_orbit_has_a_declared_mirror_that_is_not_asked_for():
    """A mirror beside it, run forwards, is none of this orbit; with both a quarter would be integrated."""
    hamiltonian = "(px^2 + py^2)/2 + (x^2 + y^2)/2 + x^2*y - y^3/3"
    declared = {"mirror": {"time": -1, "signs": {"x": -1, "py": -1}}, "flip": {"signs": {"x": -1, "px": -1}}}
    model = of.equations(hamiltonian=hamiltonian, coordinates=["x", "y"], momenta=["px", "py"], symmetries=declared)
    assert model.symmetries == (("mirror", -1, (-1, 1, 1, -1)), ("flip", 1, (-1, 1, -1, 1)))
    guess, pin = of.Guess([0.0, 0.2, 0.4, 0.0], 6.3), of.pin(energy=0.1)
    whole, half = (of.find_orbit(of.Problem(model, guess, pin=pin, symmetry=name)) for name in ("none", "mirror"))
    assert whole.symmetry == half.symmetry == "mirror" and half.certificate.passed
    assert whole.period == pytest.approx(half.period, rel=1e-12)
    assert of.Problem(model, guess, pin=pin, symmetry="mirror+flip").boundary.parts == 4


def rotating(kind):
    """Two masses on hardening springs as text, with their rotation declared, and the state of the rosette."""
    names = ["x1", "y1", "x2", "y2"]
    spring = "(u)/2 + (u)^2/8"
    first, second, between = "x1^2 + y1^2", "x2^2 + y2^2", "(x1 - x2)^2 + (y1 - y2)^2"
    potential = f"{spring.replace('u', first)} + {spring.replace('u', second)} + ({spring.replace('u', between)})/2"
    symmetries = {"turn": {"generator": {"x1": "-y1", "y1": "x1", "x2": "-y2", "y2": "x2"}}}
    if kind == "kinetic":
        rates = " + ".join(f"{name}dot^2" for name in names)
        return dict(kinetic=f"({rates})/2", potential=potential, coordinates=names, symmetries=symmetries)
    momenta = [f"p{name}" for name in names]
    squares = " + ".join(f"{name}^2" for name in momenta)
    return dict(hamiltonian=f"({squares})/2 + {potential}", coordinates=names, momenta=momenta, symmetries=symmetries)


def test_trivial_multipliers_of_a_declared_rotation_are_split_off(tmp_path):
    """The four that are left are those of the rotation that is found; of a Hamiltonian as text none is looked for."""
    speed, period = rosette()
    guess = of.Guess([1, 0, -1, 0, 0, speed, 0, -speed], period)
    known = of.find_orbit(of.Problem(springs(2), guess))
    for kind in ("kinetic", "hamiltonian"):
        model = of.equations(**rotating(kind))
        assert [each.name for each in model.invariants] == ["energy", "turn"]
        orbit = of.find_orbit(of.Problem(model, guess, pin=of.pin(energy=known.energy)))
        assert orbit.certificate.passed and orbit.floquet_multipliers.size == 4
        gaps = np.abs(orbit.floquet_multipliers[:, None] - known.floquet_multipliers).min(axis=0)
        assert gaps.max() < 1e-8 and orbit.period == pytest.approx(known.period, rel=1e-10)
        again = of.load_orbit(of.save_orbit(orbit, tmp_path / f"{kind}.json"))
        assert of.certify(again).passed


@pytest.mark.parametrize("kind", ["kinetic", "hamiltonian"])
def test_an_orbit_is_relative_along_a_declared_shift(kind):
    """Two masses that swing against each other and drift: in a period both go as far as their centre does."""
    spring = "(x1 - x2)^2/2 + (x1 - x2)^4/4"
    given = dict(coordinates=["x1", "x2"], symmetries={"slide": {"generator": {"x1": "1", "x2": "1"}}})
    if kind == "kinetic":
        given |= {"kinetic": "(x1dot^2 + 3*x2dot^2)/2", "potential": spring}
    else:
        given |= {"hamiltonian": f"p1^2/2 + p2^2/6 + {spring}", "momenta": ["p1", "p2"]}
    model, heavy = of.equations(**given), 1.0 if kind == "kinetic" else 3.0
    assert [each.name for each in model.invariants] == ["energy", "slide"]
    problem = of.Problem(model, of.Guess([0.5, -0.5, 0.25, 0.25 * heavy], 4.0), pin=of.pin(slide=1.0, energy=0.875),
                         relative=["slide"])  # fmt: skip
    orbit = of.find_orbit(problem)
    assert orbit.certificate.passed and orbit.shift["slide"] == pytest.approx(0.25 * orbit.period, rel=1e-11)


def test_a_declared_generator_stands_for_those_that_say_the_same():
    """A shift beside a found shift stays beside it; the name of a found momentum is not taken from that."""
    model = of.equations(**WELL, parameters={"k": 1.0}, symmetries=TURN)
    assert [each.name for each in model.invariants] == ["energy", "turn"]
    free = dict(coordinates=["x", "y"], kinetic="(xdot^2 + 2*ydot^2)/2")
    names = [each.name for each in of.equations(**free).invariants]
    assert names == ["energy", "momentum_x", "momentum_y"]
    along = {"diagonal": {"generator": {"x": "1", "y": "2"}}}
    names = [each.name for each in of.equations(**free, symmetries=along).invariants]
    assert names == ["energy", "diagonal", "momentum_x"]
    along = {"momentum_y": {"generator": {"x": "1"}}}
    names = [each.name for each in of.equations(**free, symmetries=along).invariants]
    assert names == ["energy", "momentum_y", "momentum_y_2"]


def test_a_momentum_is_that_of_noether():
    """dL/dv.g, of a screw that no coordinate shows: its potential depends on phi - z / c."""
    screw = {"screw": {"generator": {"phi": "1", "z": "c"}}}
    model = of.equations(
        coordinates=["phi", "z"], kinetic="(phidot^2 + m*zdot^2)/2", potential="cos(phi - z/c)", angles=["phi"],
        parameters={"c": 2.0, "m": 3.0}, symmetries=screw,
    )  # fmt: skip
    values = {each.name: float(each.value([0.4, 0.7], [0.3, 0.2], [2.0, 3.0])) for each in model.invariants}
    assert values.keys() == {"energy", "screw"} and values["screw"] == pytest.approx(0.3 + 3 * 0.2 * 2, abs=1e-15)


@pytest.mark.parametrize("name", ["jac", "s_", "s__t", "_s"])
def test_a_name_that_no_function_of_casadi_may_have(name):
    model = of.equations(coordinates=["x"], kinetic="xdot^2", symmetries={name: {"generator": {"x": "1"}}})
    assert model.invariants[1].name == name


def test_driven_equations_have_a_mirror_half_of_the_drive_later():
    drive = dict(parameters={"w": 2.0}, period="2*pi/w")
    mirror = {"mirror": {"signs": {"x": -1, "y": -1}}}
    model = of.equations({"x": "y", "y": "-x - x^3 + cos(w*t)"}, symmetries=mirror, **drive)
    assert model.symmetries == (("mirror", 1, (-1, -1)),)
    back = {"back": {"time": -1, "signs": {"y": -1}}}
    assert of.equations({"x": "y", "y": "-x - x^3 + cos(w*t)"}, symmetries=back, **drive).symmetries
    assert "under 'mirror' the equations change" in refused(
        rates={"x": "y", "y": "-x - x^2 + cos(w*t)"}, symmetries=mirror, **drive
    )


def test_a_hybrid_orbit_closes_after_half_of_its_events():
    """A relay that switches at +-d: x' = 1 - x and back, mirrored; the period is known."""
    model = of.equations(
        {"x": "s - x", "s": "0"}, {"d": 0.5}, cycle=["up", "down"],
        symmetries={"mirror": {"signs": {"x": -1, "s": -1}}},
        events={"up": {"guard": "x - d", "direction": 1, "reset": {"s": "-1"}},
                "down": {"guard": "x + d", "direction": -1, "reset": {"s": "1"}}},
    )  # fmt: skip
    orbit = of.find_orbit(of.Problem(model, of.Guess([-0.5, 1.0], 2.2), symmetry="mirror"))
    assert orbit.certificate.passed and orbit.symmetry == "mirror"
    assert orbit.period == pytest.approx(2 * np.log(3), rel=1e-12)


PLANTED = {
    "mirror": ({"mirror": {"time": -1, "signs": {"y": -1, "px": -1}}}, r"under 'mirror' the equations change by \d"),
    "small": ({"flip": {"signs": {"x": -1, "px": -1}}}, r"under 'flip' the equations change by \d.*correct its signs"),
    "forwards": ({"mirror": {"signs": {"x": -1, "py": -1}}}, "under 'mirror' the equations change"),
    "turn": (TURN, r"'turn' is not conserved, it changes at the rate \d.* of terms as large as \d.*; correct it"),
    "values": (TURN, r"^symmetries: 'turn' is not conserved"),
    "energy": ({"same": {"generator": {"x": "0"}}}, "'same' is .*says nothing more; leave it out"),
}


@pytest.mark.parametrize("case", PLANTED)
def test_planted_symmetries_of_a_hamiltonian_are_refused(case):
    declared, message = PLANTED[case]
    """A rotation of one value of k alone too."""
    tilt = {"small": "1e-6*x", "values": "k*x^2/2 - x^2/2 - x^2*y + y^3/3"}.get(case, "0")
    with pytest.raises(InputError, match=message):
        of.equations(
            hamiltonian=f"(px^2 + py^2)/2 + (x^2 + y^2)/2 + x^2*y - y^3/3 + {tilt}", coordinates=["x", "y"],
            momenta=["px", "py"], symmetries=declared, parameters={"k": 1.0},
        )  # fmt: skip


FALSE = {
    "unequal": (
        WELL | {"kinetic": "(xdot^2 + 1.000001*ydot^2)/2"},
        TURN,
        r"along 'turn' the Lagrangian changes.* by \d",
    ),
    "forced": (WELL | {"forces": ["-0.1*xdot", "0"]}, TURN, r"along 'turn' .*or forces act, by .*leave it out"),
    "size": (WELL, {"turn": {"generator": {"x": "-y", "y": "2*x"}}}, "along 'turn' the Lagrangian changes"),
    "rates": (WELL, {"turn": {"generator": {"x": "xdot"}}}, r"'turn' is \[xdot, 0\]; give 2 expressions"),
    "twice": (WELL, TURN | {"half": {"generator": {"x": "-y/2", "y": "x/2"}}}, "'half' moves nothing, or as others do"),
    "still": (WELL, {"still": {"generator": {"x": "0"}}}, "'still' moves nothing"),
    "signs": (WELL | {"potential": "k*(x + x^3 + y^2)"}, {"flip": {"signs": {"x": -1}}}, "under 'flip' the equations"),
    "nowhere": (
        WELL | {"potential": "sqrt(-1 - x^2) + y"},
        {"flip": {"signs": {"x": -1}}},
        "change by .* nowhere finite",
    ),
    "values": (WELL | {"potential": "x^2 + k*y^2"}, TURN, "along 'turn' the Lagrangian changes"),
}


@pytest.mark.parametrize("case", FALSE)
def test_planted_symmetries_of_a_lagrangian_are_refused(case):
    """That of k = 1 alone too: a family in k would not have it."""
    given, declared, message = FALSE[case]
    with pytest.raises(InputError, match=message):
        of.equations(**given, parameters={"k": 1.0}, symmetries=declared)


WRONG = {
    "empty": ({"s": {}}, "symmetries.s: got {}; give time = 1 or -1, and signs = {x = -1} of x, y, or generator"),
    "time-alone": ({"s": {"time": -1}}, "symmetries.s: got {'time': -1.0}; give time"),
    "no-signs": ({"s": {"time": -1, "signs": {}}}, "symmetries.s: got"),
    "both": ({"s": {"signs": {"x": -1}, "generator": {"x": "1"}}}, "symmetries.s: got"),
    "key": ({"s": {"signs": {"x": -1}, "period": 1}}, "symmetries.s: got"),
    "signs-number": ({"s": {"signs": -1}}, "symmetries.s: got {'signs': -1.0}"),
    "component": ({"s": {"signs": {"z": -1}}}, "symmetries.s: got {'signs': {'z': -1.0}}; give"),
    "coordinate": ({"s": {"generator": {"xdot": "1"}}}, "symmetries.s: got {'generator': {'xdot': '1'}}; give"),
    "unknown": ({"s": {"generator": {"x": "zz"}}}, "symmetries.s.x: unknown name 'zz'"),
    "sign": ({"s": {"signs": {"x": -2}}}, "'s' has the sense of time 1 and the signs {'x': -2.0}; give 1 or -1"),
    "time": ({"s": {"time": 2, "signs": {"x": -1}}}, "'s' has the sense of time 2.0 and"),
    "time-text": ({"s": {"time": "back", "signs": {"x": -1}}}, "'s' has the sense of time 'back' and"),
    "list": ({"s": {"signs": {"x": [-1]}}}, "the signs {'x': [-1]}; give 1 or -1 of components (x, y)"),
    "identity": ({"s": {"time": 1, "signs": {"x": 1}}}, "give 1 or -1 of components (x, y), not 1 throughout"),
    "usual": ({"brake": {"signs": {"x": -1}}}, "symmetries.brake: 'brake' is no name that is free"),
    "energy": (({"energy": {"generator": {"x": "1"}}}), "symmetries.energy: 'energy' is no name that is free"),
    "words": ({"a b": {"signs": {"x": -1}}}, "symmetries.a b: 'a b' is no name that is free; use letters"),
    "state": (
        {"x": {"signs": {"x": -1}}},
        "symmetries.x: 'x' is in coordinates too; give each thing a name of its own",
    ),
    "parameter": ({"k": {"signs": {"x": -1}}}, "symmetries.k: 'k' is in parameters too"),
    "many": ({f"s{k}": {"signs": {"x": -1}} for k in range(21)}, "symmetries: 21 are declared, at most 20 are tried"),
    "table": ({"s": 3}, "symmetries: expected names with a table"),
}


@pytest.mark.parametrize("case", WRONG)
def test_declarations_that_nothing_can_mean_are_named(case):
    declared, message = WRONG[case]
    assert message in refused(**WELL, parameters={"k": 1.0}, symmetries=declared)
    with pytest.raises(InputError, match=r"^system.symmetries"):
        build_model({"kind": "equations", "parameters": {"k": 1.0}, "symmetries": declared, **WELL})


def test_rates_have_no_generators():
    assert "or generator = {x = '-y'} of coordinates" in refused(rates={"x": "y", "y": "-x"}, symmetries=TURN)


def test_in_python_generators_join_what_is_detected():
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    central = ca.sumsqr(v) / 2, ca.sumsqr(q) ** 2, of.Symbols(q, v)
    model = of.lagrange(*central, generators={"spin": ca.vertcat(-q[1], q[0])})
    assert [each.name for each in model.invariants] == ["energy", "spin"]
    shifted = of.lagrange(ca.sumsqr(v) / 2, (q[0] - q[1]) ** 2, of.Symbols(q, v), generators={"slide": [1.0, 1.0]})
    assert [each.name for each in shifted.invariants] == ["energy", "slide"]
    for wrong in (q[0], ca.vertcat(ca.SX.sym("a"), q[0]), v):
        with pytest.raises(InputError, match=r"symmetries: 'spin' is .*; give 2 expressions of coordinates"):
            of.lagrange(*central, generators={"spin": wrong})
