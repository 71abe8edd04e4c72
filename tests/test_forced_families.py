"""Families of driven systems: resonance curves, doublings, tori, isolas; by closed forms and numbers of 140 bits."""

import json
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner

from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.families.branches import switch_branch
from orbitfinder.families.folder import follow_family
from orbitfinder.families.members import amplitudes
from orbitfinder.families.point import FamilySettings, unknowns_of
from orbitfinder.families.start import begin, curve_of
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.symmetry import symplectic
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.mechanisms.library import forced_duffing, vibrated_pendulum
from orbitfinder.orbits.certify import certify
from orbitfinder.orbits.find import find_orbit
from orbitfinder.problemfile.read import load_problem
from orbitfinder.records.family import load_family
from orbitfinder.show.plot import axis_name, response

PROBLEMS = Path(__file__).parents[1] / "problems" / "families"
KNOWN = json.loads((Path(__file__).parent / "data" / "forced.json").read_text())
FORWARD = FamilySettings(directions="forward")


def kinds(family):
    """Its events in order."""
    return [event.kind for event in family.events]


@pytest.fixture(scope="module")
def resonance(lend):
    """Duffing's resonance curve by the command that its problem file names."""
    command = ["continue", str(PROBLEMS / "duffing-resonance.toml"), "--parameter", "frequency", "--until", "2.5"]

    def make(folder):
        done = CliRunner().invoke(cli, [*command, "--out", str(folder)])
        assert done.exit_code == 0, done.output

    folder = lend("duffing-resonance", make, __file__)
    return load_family(folder / "duffing-resonance" / "family.json"), folder / "duffing-resonance"


def test_both_folds_of_duffings_resonance(resonance):
    """To ten digits, stable but between them, and drawn."""
    family, folder = resonance
    assert kinds(family) == ["fold", "stability_change"] * 2
    found = [event.parameter for event in family.events[::2]]
    assert found == pytest.approx([float(one) for one in KNOWN["duffing folds"]], abs=1e-11)
    assert family.curve["cycles"] == 1 and family.curve["symmetry"] == "reflection"
    between = [found[1] < point.value < found[0] for point in family.points]
    assert any(between) and all(len(point.floquet_multipliers) == 2 for point in family.points)
    assert {point.stability for point in family.points} == {"asymptotically stable", "unstable"}
    assert [end.kind for end in family.ends] == ["target"] and family.points[-1].certified
    assert (folder / "response.png").exists() and not (folder / "frequency_energy.png").exists()


def test_two_formulations_agree(resonance):
    """The whole period instead of half of it."""
    start = begin(load_problem(PROBLEMS / "duffing-resonance.toml"), FamilySettings(parameter="frequency"), "none")
    family = follow_family(start, until=2.0, settings=FORWARD, name="whole")
    assert family.curve["symmetry"] == "none" and family.parameter == "frequency"
    found, other = ([one.parameter for one in each.events] for each in (family, resonance[0]))
    assert found == pytest.approx(other, abs=1e-12)


def test_a_linear_resonance_is_its_closed_form():
    """Amplitude, state and multipliers of x'' + c x' + x = F cos w t at every w of its curve; no event."""
    c, force = 0.2, 0.7
    model = forced_duffing(1.0, 0.0, c, force, 0.5)
    family = follow_family(Problem(model, Guess([0.9, 0.1], 12.5), name="line"), "frequency", until=2.0, at=(1.0,))
    w = family.values("value")
    answer = force / (1 - w**2 + 1j * c * w)
    states = np.array([point.state for point in family.points])
    assert states == pytest.approx(np.column_stack([answer.real, -w * answer.imag]), abs=1e-11)
    assert amplitudes(family, model)[:, 0] == pytest.approx(np.abs(answer), rel=1e-4)
    sizes = np.abs([point.floquet_multipliers for point in family.points])
    assert sizes == pytest.approx(np.exp(-c / 2 * 2 * np.pi / w)[:, None].repeat(2, 1), abs=1e-9)
    assert not family.events and [point.value for point in family.points if point.role == "at"] == [1.0]


def test_a_response_is_drawn_without_nodes(resonance, tmp_path):
    """family.json alone is enough; one without its curve is refused."""
    family, folder = resonance
    (tmp_path / "family.json").write_bytes((folder / "family.json").read_bytes())
    bare = load_family(tmp_path / "family.json")
    sizes = amplitudes(family, forced_duffing())
    assert amplitudes(bare, forced_duffing()) == pytest.approx(sizes, rel=1e-4)
    assert len(response([bare], forced_duffing()).axes[0].lines) == 3 + len(family.events)
    with pytest.raises(InputError, match="curve: missing"):
        amplitudes(replace(bare, curve={}), forced_duffing())


def test_page_of_a_resonance_curve(resonance, tmp_path):
    """Amplitude against frequency are the axes that the page begins with."""
    done = CliRunner().invoke(cli, ["page", str(resonance[1]), "-o", str(tmp_path)])
    assert done.exit_code == 0, done.output
    page = (tmp_path / "families" / "duffing-resonance.html").read_text()
    assert '<select id="across"><option value="value">frequency' in page
    assert '<select id="up"><option value="amplitude" selected>amplitude of x' in page and "Response" in page


def test_the_frequency_of_a_drive_has_its_unit(resonance):
    """rad/s by the period; of other parameters nothing is known."""
    assert axis_name(resonance[0]) == "frequency (rad/s)"
    force = follow_family(Problem(forced_duffing(), Guess([0.9, 0.5], 5.2), name="f"), "force", points=2)
    assert axis_name(force) == "force"
    with pytest.raises(InputError, match="unknown 'y'; this system has x"):
        response([force], forced_duffing(), "y")


def test_jacobian_of_a_driven_curve_against_differences():
    """Rows of the clock, of a segment that begins later and of a freed frequency."""
    start = begin(Problem(forced_duffing(), Guess([0.9, 0.5], 5.2)), FamilySettings(parameter="frequency"), "none")
    curve, w = start.curve, start.solution.place
    curve = curve.through(w)
    matrix = curve.linearised(w, curve.equations.varied(w)).matrix()
    assert len(w.nodes) > 1 and matrix.shape[0] + 1 == matrix.shape[1]
    for k in range(matrix.shape[1]):
        step = np.eye(matrix.shape[1])[k] * 1e-6
        ends = [curve.rows(one, curve.equations.ends(one)) for one in (w.moved(step), w.moved(-step))]
        assert (ends[0] - ends[1]) / 2e-6 == pytest.approx(matrix[:, k], abs=1e-8)


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    """The driven pendulum's families by the commands that its problem file names."""
    folder = tmp_path_factory.mktemp("pendulum")
    first = [str(PROBLEMS / "driven-pendulum.toml"), "--parameter", "torque", "--until", "1.3"]
    second = [str(folder / "driven-pendulum" / "family.json"), "--switch", "0"]
    third = [str(folder / "driven-pendulum-0-1" / "family.json"), "--switch", "0", "--at", "1.07"]
    for command in (first, second, third):
        done = CliRunner().invoke(cli, ["continue", *command, "--out", str(folder), "--no-figures"])
        assert done.exit_code == 0, done.output
    return [load_family(folder / f"driven-pendulum{one}" / "family.json") for one in ("", "-0-1", "-0-1-0-1")]


@pytest.mark.slow
def test_a_driven_pendulum_loses_its_symmetry(pendulum):
    """The lopsided swings leave at a branch point and join again at another."""
    symmetric, lopsided, _ = pendulum
    assert symmetric.curve["symmetry"] == "reflection" and kinds(symmetric) == ["branch_point", "stability_change"]
    assert symmetric.events[0].parameter == pytest.approx(1.00432, abs=1e-5)
    assert lopsided.curve["symmetry"] == "none"
    (end,) = lopsided.ends
    assert end.kind == "merged" and end.reason.startswith("joins a family of symmetry reflection at torque 2.178")
    assert "branch_point" not in kinds(lopsided) and kinds(lopsided).count("period_doubling") == 2


@pytest.mark.slow
def test_doublings_of_a_driven_pendulum(pendulum):
    """The first to ten digits, its branch of twice the period with an orbit at 1.07, and where that doubles again."""
    _, lopsided, doubled = pendulum
    first = next(event for event in lopsided.events if event.kind == "period_doubling")
    assert first.parameter == pytest.approx(float(KNOWN["pendulum doubling"]), abs=1e-11) and first.certified
    assert doubled.curve["cycles"] == 2 and doubled.points[0].period == pytest.approx(2.0, abs=1e-12)
    (asked,) = [point for point in doubled.points if point.role in ("at", "end") and point.value == 1.07]
    assert asked.certified and asked.stability == "asymptotically stable"
    alone = find_orbit(Problem(with_parameters(load_problem(PROBLEMS / "driven-pendulum.toml").model, {"torque": 1.07}),
                               Guess(asked.state, 2.0)))  # fmt: skip
    assert alone.certificate.passed and alone.state == pytest.approx(asked.state, abs=1e-10)


@pytest.mark.slow
def test_a_known_orbit_of_the_driven_pendulum(pendulum):
    """The state at A = 1.06 by a program outside this project."""
    problem = load_problem(PROBLEMS / "driven-pendulum.toml")
    known = np.array(KNOWN["pendulum at 1.06"], float)
    below = replace(problem, guess=Guess(known, 1.0), model=with_parameters(problem.model, {"torque": 1.05}))
    family = follow_family(below, "torque", until=1.06)
    assert family.points[-1].state == pytest.approx(known, abs=1e-11)


def planted(field, value, w=2.5):
    """q = cos(w t) + y with y'' = field(y, y', a): what y does about its equilibria, the driven motion does."""
    q, v, t, a = (ca.SX.sym(name) for name in "qvta")
    y, rate = q - ca.cos(w * t), v + w * ca.sin(w * t)
    symbols = Symbols(q, v, a, ("a",), (value,), time=t, forcing_period=2 * np.pi / w)
    return lagrange(v**2 / 2, ca.SX(0), symbols, forces=field(y, rate, a) - w**2 * ca.cos(w * t), names=["q"])


def followed(model, state, until=None):
    """The family of a planted motion in a."""
    return follow_family(Problem(model, Guess(state, 2 * np.pi / 2.5), name="planted"), "a", until=until, model=model)


def test_torus_of_a_driven_system_in_closed_form():
    """y'' = (a - y^2) y' - y: multipliers exp((a/2 +- i sqrt(1 - a^2/4)) T), a torus at a = 0 and nothing else."""
    model = planted(lambda y, rate, a: (a - y**2) * rate - y, -0.3)
    family = follow_family(
        Problem(model, Guess([1.0, 0.0], 2 * np.pi / 2.5), name="torus"), "a", until=0.3, model=model
    )
    assert kinds(family) == ["torus", "stability_change"]
    assert family.events[0].parameter == pytest.approx(0.0, abs=1e-11)
    assert family.curve["symmetry"] == "reflection"  # whose half map the multiplier is one of
    assert family.events[0].multiplier ** 2 == pytest.approx(np.exp(2j * np.pi / 2.5).conj(), abs=1e-9)


def test_neutral_saddle_of_a_driven_system_is_no_torus():
    """y'' = a y' + y: two real multipliers whose product passes 1 at a = 0."""
    model = planted(lambda y, rate, a: a * rate + y, -0.3)
    family = follow_family(
        Problem(model, Guess([1.0, 0.0], 2 * np.pi / 2.5), name="saddle"), "a", until=0.3, model=model
    )
    products = [np.prod(point.floquet_multipliers).real for point in family.points]
    assert products[0] < 1 < products[-1] and not family.events


def test_an_isola_closes():
    """y'' = -y' - (y^2 + a^2 - 1): y = sqrt(1 - a^2) stable, y = -sqrt(1 - a^2) a saddle, folds at a = +-1."""
    model = planted(lambda y, rate, a: -rate - (y**2 + a**2 - 1), 0.0)
    family = followed(model, [2.0, 0.0])
    assert [end.kind for end in family.ends] == ["returned"]
    folds = [event.parameter for event in family.events if event.kind == "fold"]
    assert sorted(folds) == pytest.approx([-1.0, 1.0], abs=1e-11)
    places = np.array([[point.value, point.state[0] - 1.0] for point in family.points])
    assert np.linalg.norm(places, axis=1) == pytest.approx(np.ones(len(places)), abs=1e-10)


def test_parameter_that_breaks_a_symmetry():
    """At a = 0 the swing is its own mirror image, elsewhere it is not: no half period is taken for the whole."""
    model = planted(lambda y, rate, a: -rate - y + a, 0.0)
    family = followed(model, [1.0, 0.0], until=0.5)
    assert family.curve["symmetry"] == "none"
    assert [point.state[0] - point.value for point in family.points] == pytest.approx([1.0] * len(family.points))


def test_driven_without_damping():
    """Multipliers come in pairs: resonances and stable stretches, no torus; a certificate says the same."""
    model = forced_duffing(damping=0.0, frequency=2.6)
    problem = Problem(model, Guess([-0.05, 0.0], 2 * np.pi / 2.6), name="undamped")
    family = follow_family(problem, "frequency", until=1.7)
    assert kinds(family) == ["period_doubling", "resonance"]
    assert {point.stability for point in family.points} == {"elliptic"}
    orbit = find_orbit(problem)
    assert orbit.stability == "elliptic" and orbit.certificate.passed and certify(family.points[3], None).passed
    assert not symplectic(forced_duffing()) and not symplectic(vibrated_pendulum()) and symplectic(model)
    assert symplectic(vibrated_pendulum(damping=0.0))
    damped = begin(problem, FamilySettings(parameter="damping")).curve
    assert not damped.equations.symplectic


def test_a_saved_family_is_the_same_curve(resonance):
    """Clock included: an orbit of the file satisfies the rows that are rebuilt from it."""
    family, _ = resonance
    curve = curve_of(family.curve, forced_duffing(), FamilySettings(parameter="frequency"))
    w = unknowns_of(curve, family.points[40])
    assert curve.cycles == 1 and np.abs(curve.through(w).rows(w, curve.equations.ends(w))).max() < 1e-12


def test_a_killed_sweep_goes_on(tmp_path, monkeypatch):
    """What is resumed is what is computed at once."""
    problem = load_problem(PROBLEMS / "duffing-resonance.toml")
    asked = {"settings": FORWARD, "points": 8}
    at_once = follow_family(problem, "frequency", **asked)
    follow_family(problem, "frequency", out=tmp_path, settings=FORWARD, points=4)
    resumed = follow_family(problem, "frequency", out=tmp_path, **asked)
    assert resumed.values("value") == pytest.approx(at_once.values("value"), abs=1e-12)


@pytest.mark.parametrize(("name", "said"), [
    ("energy", "do not come in families by energy.*stiffness"), ("period", "do not come in families by period"),
    ("xdot", "by xdot"), ("forec", "unknown 'forec'.*force'.; use one of freq"),
])  # fmt: skip
def test_what_a_driven_system_is_not_followed_in(name, said):
    """Energy and period are no parameters of a driven motion."""
    with pytest.raises(InputError, match=said):
        begin(Problem(forced_duffing(), Guess([0.9, 0.5], 5.2)), FamilySettings(parameter=name))


@pytest.mark.slow
def test_a_branch_keeps_to_its_parameter(pendulum):
    """Another parameter is refused with what to do."""
    with pytest.raises(InputError, match="'mass' on a branch of a family in torque; leave it out"):
        follow_family(switch_branch(pendulum[1], 0), "mass")


def test_a_driven_equilibrium_is_no_orbit():
    """The hanging pendulum of a shaken pivot does not move."""
    problem = Problem(vibrated_pendulum(), Guess([1e-4, 0.0], 2 * np.pi / 60.0), name="rest")
    with pytest.raises(ConvergenceError, match="equilibrium"):
        follow_family(problem, "damping", points=2)
