"""`orbitfinder continue` from files: branches of a family, orbits of every kind of system, mistakes."""

import json
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.families.branches import branches
from orbitfinder.families.folder import follow_family
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.start import begin
from orbitfinder.problemfile.read import load_problem
from orbitfinder.records.family import family_to_document, load_family
from orbitfinder.records.registry import load_orbit

ROOT = Path(__file__).parents[1]
FAMILIES = ROOT / "problems" / "families"
TRIPLE_1 = (-38.35109857464619, 1.6553389883146419)


def invoke(*arguments):
    return CliRunner().invoke(cli, [str(argument) for argument in arguments])


def said(result):
    """What a failed command says on standard error."""
    return " ".join(result.stderr.split()) if result.stderr else str(result.exception)


@pytest.fixture(scope="module")
def second_mode(lend):
    """family.json of the triple pendulum's second mode up to its first branch points, by the command."""
    options = ("--direction", "forward", "--until", -36.5, "--no-figures")

    def make(folder):
        result = invoke("continue", FAMILIES / "triple-mode-2.toml", *options, "--out", folder)
        assert result.exit_code == 0, result.output

    return lend("triple-mode-2", make, __file__) / "triple-mode-2" / "family.json"


def test_triple_1_by_commands_alone(second_mode, tmp_path):
    """Switch at the event where the second mode loses its reflection; the report's orbit is on that branch."""
    energy, period = TRIPLE_1
    options = ("--switch", 2, "--at", energy, "--points", 20, "--no-figures", "--out", tmp_path)
    result = invoke("continue", second_mode, *options)
    assert result.exit_code == 0, result.output
    family = load_family(tmp_path / "triple-mode-2-2-1" / "family.json")
    points = [one for one in family.points if one.role == "at"]  # on both sides of the fold in energy
    shown = [f"family.json#{k}, period {one.period:.9g} s" for k, one in enumerate(family.points) if one in points]
    assert len(shown) == 2 and all(line in result.stdout for line in shown), "the numbers that FILE#K takes"
    assert min(abs(one.period - period) for one in points) < 1e-11 and points[0].symmetry == "brake"
    assert family.source["kind"] == "branch" and family.source["family"] == "triple-mode-2"
    # the same command again finds its journal and adds nothing
    again = invoke("continue", second_mode, *options)
    assert (
        again.exit_code == 0
        and load_family(tmp_path / "triple-mode-2-2-1" / "family.json").values("period").tolist()
        == family.values("period").tolist()
    )


def test_show_says_what_breaks_what_is_born_and_commands_that_run(second_mode, tmp_path):
    """Each event has its sentence; a command of each kind is run as it is printed."""
    events = json.loads(invoke("show", second_mode, "--json").stdout)["results"][0]["events"]
    lines, run = invoke("show", second_mode).stdout, set()
    assert all(event["what"] and event["what"] in lines for event in events)
    doubled = next(event for event in events if event["kind"] == "period_doubling")
    assert f"born are orbits of period {2 * doubled['period']:.9g}" in doubled["what"]
    broken = next(event for event in events if event["kind"] == "branch_point")
    assert "what breaks is brake or reflection, which these orbits have" in broken["what"]
    assert not any("--curve" in command for command in broken["follow"])  # lasts while its symmetry does
    for event in events:
        for command in event["follow"]:
            way = command.split()[3]
            assert command in lines
            if way in run:
                continue
            run.add(way)
            words = shlex.split(command)[1:]
            done = invoke(*words, "--points", 2, "--no-figures", "--out", tmp_path)
            assert done.exit_code == 0, (command, done.output)
    assert run == {"--switch", "--curve"}


def test_a_family_without_its_nodes_says_that_nothing_follows_from_it_alone(second_mode, tmp_path):
    shutil.copy(second_mode, tmp_path / "family.json")
    assert "family.npz is not beside it: continue the family again" in invoke("show", tmp_path / "family.json").stdout
    events = json.loads(invoke("show", tmp_path / "family.json", "--json").stdout)["results"][0]["events"]
    assert not any(event.get("follow") for event in events)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "--switch: missing; give the event to leave triple-mode-2 at: 0"),
        (("--switch", 3), "no branch leaves at event 3; choose one of 0"),
        (("--switch", 99), "--switch: no branch leaves at event 99"),
        (("--switch", 2, "--branch", 5), "--branch: 5 asked for, 1 found at event 2; give 1 to 1"),
        (("--switch", 2, "--name", "a/b"), "--name: must consist of letters"),
    ],
)
def test_mistakes_in_switching_are_named(second_mode, tmp_path, arguments, message):
    """Exit code 2 and one sentence."""
    result = invoke("continue", second_mode, *arguments, "--out", tmp_path)
    assert (result.exit_code, message in said(result)) == (2, True), said(result)


def test_switch_needs_a_family(tmp_path):
    """A problem file or an orbit has no events."""
    result = invoke("continue", FAMILIES / "triple-mode-2.toml", "--switch", 0, "--out", tmp_path)
    assert result.exit_code == 2 and "--switch: goes with a family.json" in said(result)
    orbit = ROOT / "results" / "orbits" / "triple-1" / "orbit.json"
    result = invoke("continue", orbit, "--switch", 0, "--out", tmp_path)
    assert result.exit_code == 2 and "is not a family.json" in said(result)


def test_family_without_its_nodes_cannot_be_switched(second_mode, tmp_path):
    """family.json alone is read (an orbit is its state and period); older files lack the curve."""
    bare = tmp_path / "family.json"
    shutil.copy(second_mode, bare)
    whole, alone = load_family(second_mode), load_family(bare)
    assert whole.values("period").tolist() == alone.values("period").tolist()
    with pytest.raises(InputError, match=r"family\.npz"):
        branches(bare, 2)
    document = json.loads(bare.read_text(encoding="utf-8"))
    del document["curve"], document["record"], document["dense"]
    bare.write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(InputError, match="curve: missing"):
        branches(bare, 2)


def test_a_branch_is_sought_square_to_the_old_family():
    """Lorenz's doubled cycle at its own doubling, where a slanting plane meets the old family and no other."""
    few = FamilySettings(certify=False, points=20)
    family = follow_family(load_problem(FAMILIES / "lorenz-doubling.toml"), "rho", until=228.0, settings=few)
    for rho in (229.40670857, 218.21012778):  # AUTO-07p's demo lor
        doubling = next(k for k, one in enumerate(family.events) if one.kind == "period_doubling")
        assert family.events[doubling].parameter == pytest.approx(rho, abs=1e-7)
        branch = branches(family, doubling, few)[0]
        assert branch.start.solution.place.period == pytest.approx(2 * family.events[doubling].period, rel=0.01)
        if rho > 220:
            family = follow_family(branch, until=217.0, settings=few)


@pytest.mark.slow
def test_a_branch_point_is_where_it_is_from_either_side():
    """Of the doubled motion of two pendula, in two step sizes, and back along its mirror image in others.

    Beside it orbits are told from those of the family that crosses by no more than round-off over their distance.
    """
    once = FamilySettings(certify=False, directions="backward", resonances=1)
    family = follow_family(
        problem := load_problem(FAMILIES / "coupled-pendula.toml"), "torque", settings=once, until=0.179
    )
    started, found = branches(family, 0, once)[0], []
    for directions, step, points in (("both", 0.5, 68), ("away", 0.3, 90)):
        asked = FamilySettings(certify=False, directions=directions, longest_step=step, resonances=1)
        branch = follow_family(started, settings=asked, points=points)
        ends = [end.kind for end in branch.ends]
        assert ends == ["merged", "point limit"][-len(ends) :]  # what runs round twice joins what does so once
        found.append(next(event for event in branch.events if event.kind == "branch_point"))
    last = next(one for one in branch.points if one.arclength > found[1].arclength + 0.3)
    guess = of.Guess(last.shooting_nodes[0][[1, 0, 3, 2]], last.period)
    mirrored = of.Problem(problem.model, guess, pin=of.pin(torque=last.value), winding=(2, 2))
    back = FamilySettings(certify=False, directions="forward", longest_step=0.4, resonances=1)
    branch = follow_family(mirrored, "torque", settings=back, points=12)
    found.append(next(event for event in branch.events if event.kind == "branch_point"))
    assert [one.parameter for one in found] == pytest.approx([0.33144524063895] * 3, rel=1e-11)
    assert np.ptp([one.period for one in found]) < 1e-9


def test_no_branch_is_an_error(second_mode, monkeypatch):
    """When nothing is found at an event, that is said."""
    monkeypatch.setattr("orbitfinder.families.branches.switch", lambda *_: [])
    with pytest.raises(ConvergenceError, match="no branch was found at event 2"):
        branches(second_mode, 2)


SYSTEM = '''
import casadi as ca
import orbitfinder as of


def stiffening(k=1.0):
    """x'' = -k x - x^3."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    symbols = of.Symbols(q, v)
    return of.lagrange(v**2 / 2, float(k) * q**2 / 2 + q**4 / 4, symbols, names=["x"])
'''
TRUSTED = """
name = "stiff"
[system]
kind = "python"
module = "stiffening_system"
function = "stiffening"
arguments = { k = 2.0 }
[guess]
state = [1.0, 0.0]
period = 3.6
[find]
pin = { x = 1.0 }
"""


def test_orbits_of_trusted_systems_are_continued(tmp_path, monkeypatch):
    """`run` writes an orbit of a user's own module; `continue` takes it with --trust, and refuses without."""
    (tmp_path / "stiffening_system.py").write_text(SYSTEM, encoding="utf-8")
    (tmp_path / "stiff.toml").write_text(TRUSTED, encoding="utf-8")
    assert invoke("run", tmp_path / "stiff.toml", "--trust", "--out", tmp_path / "orbits").exit_code == 0
    orbit = tmp_path / "orbits" / "stiff" / "orbit.json"
    options = ("--until", 2.0, "--no-figures", "--out", tmp_path / "families")
    refused = invoke("continue", orbit, *options)
    assert refused.exit_code == 2 and "--trust" in said(refused)
    monkeypatch.chdir(tmp_path)
    result = invoke("continue", orbit, "--trust", *options)
    assert result.exit_code == 0, result.output
    family = load_family(tmp_path / "families" / "stiff" / "family.json")
    assert family.ends[0].kind == "target" and family.points[-1].energy == pytest.approx(2.0, abs=1e-12)
    assert invoke("continue", orbit, "--trust", *options).exit_code == 0  # resumed from the journal


def test_free_and_chosen_orbits_start_families(tmp_path):
    """A problem that frees a length continues the orbit of the changed system."""
    text = (ROOT / "problems" / "examples" / "double-prescribed-period.toml").read_text(encoding="utf-8")
    (tmp_path / "free.toml").write_text(text, encoding="utf-8")
    result = invoke("continue", tmp_path / "free.toml", "--points", 3, "--no-figures", "--out", tmp_path)
    assert result.exit_code == 0, result.output


@pytest.mark.slow
def test_running_orbit_of_a_chain_with_an_orbit_file(tmp_path):
    """A running pendulum's orbit.json: winding kept, followed to where its period blows up."""
    problem = ROOT / "problems" / "examples" / "pendulum-running.toml"
    assert invoke("run", problem, "--out", tmp_path).exit_code == 0
    orbit = load_orbit(tmp_path / "pendulum-running" / "orbit.json")
    settings = FamilySettings(directions="backward")
    family = follow_family(orbit, out=tmp_path / "families", settings=settings)
    assert family.ends[0].kind == "homoclinic" and family.points[0].energy == pytest.approx(4.9, abs=0.05)
    assert begin(orbit).curve.equations.symmetry.name == "reversal"
    assert np.all(np.diff(family.values("period")) < 0)


def test_a_family_in_memory_is_that_of_a_folder(tmp_path, monkeypatch):
    """Without out= nothing is written, a branch of it is followed from there, and the numbers are the same."""
    monkeypatch.chdir(tmp_path)
    settings = FamilySettings(directions="forward")
    problem = load_problem(FAMILIES / "triple-mode-2.toml")
    family = of.follow_family(problem, until=-36.5, settings=settings)
    assert not list(tmp_path.iterdir())
    kept = of.follow_family(problem, until=-36.5, settings=settings, out=tmp_path)
    assert family_to_document(family)["events"] == family_to_document(kept)["events"]
    assert np.array_equal(family.values("period"), kept.values("period"))
    branch = of.switch_branch(family, 2)
    assert of.switch_branch(family, family.events[2]).name == branch.name
    assert branch.start.direction == pytest.approx(
        of.switch_branch(tmp_path / family.name / "family.json", 2).start.direction
    )
    away = of.follow_family(branch, settings=FamilySettings(directions="away", points=3))
    assert away.name == "triple-mode-2-2-1" and away.source["event"] == 2 and len(away.points) == 4
    with pytest.raises(InputError, match="^branch: 5 asked for, 1 found at event 2"):
        of.switch_branch(family, 2, 5)
    with pytest.raises(InputError, match="^event: no branch leaves at event 99"):
        of.switch_branch(family, 99)


@pytest.mark.slow
@pytest.mark.parametrize("until", [-33.9, -30.5])
def test_two_families_leave_at_each_high_resonance(until):
    """And no more (K. R. Meyer, Generic bifurcation of periodic points, Trans. Amer. Math. Soc. 149 (1970) 95-107)."""
    settings = FamilySettings(certify=False, directions="forward")
    family = of.follow_family(of.load_problem(FAMILIES / "triple-mode-2.toml"), until=until, settings=settings)
    found = {
        round(event.parameter, 4): [one.start.curve.equations.symmetry.name for one in branches(family, k)]
        for k, event in enumerate(family.events)
        if event.kind == "resonance" and event.order > 3
    }
    known = {
        -38.348: ["brake+reflection"] * 2,
        -35.1818: ["brake", "reversal"],
        -34.4336: ["brake", "reversal"],
        -33.9968: ["brake", "reversal"],  # order 6: they leave along each other, told apart at 0.001 of the orbit
        -33.316: ["brake", "reversal"],
        -33.1869: ["brake+reflection"] * 2,  # order 5: found again as brake orbits
        -32.9983: ["brake", "reversal"],
        -32.4722: ["brake", "reversal"],
        -31.8177: ["brake+reflection"] * 2,
        -31.2049: ["brake", "reversal"],
        -30.8676: ["brake", "reversal"],
        -30.5571: ["brake", "reversal"],  # order 6: one is found at two distances
    }
    assert found == {value: names for value, names in known.items() if value < until}
