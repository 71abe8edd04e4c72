"""Families of periodic orbits against known curves, reference orbits and the report's own orbits."""

import json
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import replace
from itertools import accumulate, combinations, pairwise
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from conftest import dop853
from maps import bouncing, planted
from scipy.special import ellipk

import orbitfinder as of
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.families.folder import follow_family
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.stability import matching
from orbitfinder.families.start import begin
from orbitfinder.families.verified import verified
from orbitfinder.integrate.compiled import compiling
from orbitfinder.integrate.cvodes import build_flow
from orbitfinder.loops import mesh as mesh_module
from orbitfinder.loops.condensed import Linearised
from orbitfinder.loops.problem import Problem
from orbitfinder.loops.symmetry import SYMMETRIES
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.evidence import ClosureCheck, tour
from orbitfinder.orbits.floquet import judged
from orbitfinder.orbits.guesses.modes import equilibria, mode_problem, normal_modes, oscillating
from orbitfinder.orbits.measure import multipliers
from orbitfinder.records.family import family_to_document, load_family, plain, read_journal
from orbitfinder.records.registry import load_orbit

DATA = Path(__file__).parent / "data"
FAMILIES = Path(__file__).parents[1] / "results" / "families"
MODES = json.loads((DATA / "normal_modes.json").read_text(encoding="utf-8"))["orbits"]
REPORT = {one["name"]: one for one in json.loads((DATA / "report_orbits.json").read_text(encoding="utf-8"))["orbits"]}
SEVEN = [(3, 1), (3, 2), (3, 3), *(pytest.param(4, mode, marks=pytest.mark.slow) for mode in (1, 2, 3, 4))]


def complex_of(pairs):
    return np.array([complex(*pair) for pair in pairs])


def multiplier_error(found, wanted):
    """Largest relative distance of each wanted multiplier from the nearest found one."""
    return max(np.abs(found - mu).min() / max(1.0, abs(mu)) for mu in wanted)


def exact_point(family, energy):
    """The one point that was asked for at this energy."""
    (point,) = (p for p in family.points if p.role != "step" and abs(p.energy - energy) < 1e-9)
    return point


@pytest.mark.parametrize(("links", "mode"), SEVEN)
def test_normal_modes_reproduce_the_reference(links, mode, tmp_path):
    """All seven families at 0.1, 1, 6 and 20 J: period to 1e-10, multipliers to 1e-7, closure certified."""
    wanted = [one for one in MODES if one["links"] == links and one["mode"] == mode]
    problem = mode_problem(chain(links), mode)
    quiet = FamilySettings(events=False)
    family = follow_family(problem, at=[one["energy"] for one in wanted], out=tmp_path, settings=quiet)
    assert family.ends[0].kind == "target"
    for one in wanted:
        point = exact_point(family, one["energy"])
        assert abs(point.period - one["period"]) < 1e-10
        expected = complex_of(one["floquet_multipliers"])
        if np.abs(expected).max() < 1e3:
            assert multiplier_error(point.floquet_multipliers, expected) < 1e-7
        assert point.stability == one["stability"]
    assert all(point.closure <= 1e-11 * point.scale for point in family.points)
    assert all(point.symmetry == "brake+reflection" for point in family.points)


def test_simple_pendulum_to_the_separatrix(tmp_path):
    """T = 4 K(sin(a/2)) / w0 along the whole family, until the period is five times the linear one."""
    model = chain(1)
    linear = 2 * np.pi / np.sqrt(9.8 * 0.5 / (1 / 12 + 0.25))
    settings = FamilySettings(longest_period=5.5, directions="forward")
    family = follow_family(mode_problem(model, 1), out=tmp_path, settings=settings)
    assert family.ends[0].kind == "homoclinic"
    assert family.points[-1].period > 5 * linear
    for point in family.points:
        # sin^2(a/2) from the energy V = -4.9 cos(a) is ill-conditioned at the separatrix, so from the angle
        amplitude = point.state[0]
        exact = linear / (np.pi / 2) * ellipk(np.sin(amplitude / 2) ** 2)
        slope = np.tan(amplitude / 2) + 1  # of the period with the amplitude, in orders of magnitude
        assert abs(point.period - exact) < 1e-11 * slope * max(1.0, point.period)


def test_families_end_at_the_equilibrium(tmp_path):
    """Backwards from a small amplitude the family shrinks to the hanging position, and says so."""
    settings = FamilySettings(directions="backward")
    family = follow_family(mode_problem(chain(2), 1, 0.1), out=tmp_path, settings=settings)
    assert family.ends[0].kind == "equilibrium"
    assert family.points[0].energy < family.points[-1].energy


def test_modes_of_every_equilibrium():
    """2^n equilibria; each has as many oscillating modes as its potential has rising directions."""
    model = chain(3)
    places = equilibria(model)
    assert len(places) == 8
    counts = [oscillating(normal_modes(model, place)[0]).size for place in places]
    assert counts[0] == 3 and counts[-1] == 0
    assert counts == [3 - round(place.sum() / np.pi) for place in places]
    with pytest.raises(InputError, match="oscillating"):
        mode_problem(model, 1, equilibrium=places[-1])


def test_family_of_an_upright_equilibrium(tmp_path):
    """A family born where the last link stands upright: its period tends to the linear one."""
    model, place = chain(3), np.array([0.0, 0.0, np.pi])
    settings = FamilySettings(directions="forward", events=False)
    family = follow_family(mode_problem(model, 1, 1e-3, place), points=5, out=tmp_path, settings=settings)
    linear = 2 * np.pi / np.sqrt(next(one for one in normal_modes(model, place)[0] if one > 0))
    assert abs(family.points[0].period - linear) < 1e-5
    assert all(point.stability == "unstable" for point in family.points)


@pytest.fixture(scope="module")
def second_mode():
    """The triple pendulum's second mode up to 12 J above hanging."""
    return walked(2, -32.5)


def walked(mode, until):
    settings = FamilySettings(directions="forward", certify=False, resonances=4)
    return follow_family(mode_problem(chain(3), mode), until=until, settings=settings)


def branches_at(family, event):
    """Every branch that leaves there."""
    branches = [of.switch_branch(family, event)]
    while True:
        try:
            branches.append(of.switch_branch(family, event, len(branches) + 1))
        except InputError:
            return branches


def branch_at(branch, energy, points=80):
    """Follow a branch away from where it was born; the point at an energy."""
    settings = FamilySettings(events=False, points=points, directions="away")
    family = follow_family(branch, until=energy, settings=settings)
    return exact_point(family, energy)


def test_triple_1_is_reached_by_switching(second_mode):
    """The report's first triple orbit lies on the branch that breaks the second mode's reflection."""
    event = next(one for one in second_mode.events if one.kind == "branch_point")
    assert event.multiplier == -1.0  # of the half map: the reflection is lost
    (branch,) = branches_at(second_mode, event)
    point = branch_at(branch, REPORT["triple-1"]["energy"])
    assert point.symmetry == "brake"
    assert abs(point.period - 1.65533898831464) < 1e-11
    wanted = complex_of(REPORT["triple-1"]["floquet_multipliers"])
    assert multiplier_error(point.floquet_multipliers, wanted) < 1e-9


def test_branch_ends_where_it_was_born(second_mode, tmp_path):
    """Followed backwards, the branch of triple 1 says that it joins the second mode, and where."""
    event = next(one for one in second_mode.events if one.kind == "branch_point")
    (branch,) = branches_at(second_mode, event)
    settings = FamilySettings(directions="forward")
    family = follow_family(branch, points=8, out=tmp_path, name="branch", settings=settings)
    assert family.ends[0].kind == "merged"
    assert not [one for one in family.events if one.kind == "fold"]
    assert abs(family.ends[0].parameter - event.parameter) < 1e-9 * abs(event.parameter)
    assert abs(family.ends[0].period - event.period) < 1e-9 * event.period


def test_triple_2_is_reached_by_switching():
    """The report's second triple orbit lies on a period-quadrupled branch of the third mode."""
    family = walked(3, -43.0)
    event = next(one for one in family.events if one.kind == "resonance" and one.order == 4)
    branches = branches_at(family, event)
    near = FamilySettings(events=False, points=1, directions="away")
    found = {follow_family(branch, settings=near).points[0].symmetry: branch for branch in branches}
    assert set(found) == {"brake", "reversal"} and len(branches) == 2
    point = branch_at(found["reversal"], REPORT["triple-2"]["energy"])
    assert abs(point.period - 2.92523733309107) < 1e-11


def test_events_are_located(second_mode):
    """At a branch point a multiplier of the whole period is +1: by CVODES over a full period."""
    model = chain(3)
    flow = build_flow(model)
    chosen = [one for one in second_mode.events if one.kind in ("branch_point", "period_doubling")]
    assert len(chosen) >= 3
    for event in chosen:
        mu = multipliers(model, flow, event.state[None], event.period).multipliers
        target = 1.0 if event.kind == "branch_point" else -1.0
        pair = mu[np.argsort(np.abs(mu - target))[:2]]
        # the pair is double and good to a square root only, its sum to all digits
        assert abs(pair.sum() - 2 * target) < 1e-8


@pytest.mark.slow
def test_symmetric_and_full_formulations_agree(tmp_path):
    """A quarter period and a whole one give the same orbit, multipliers and action."""
    wanted = [one["energy"] for one in MODES if one["links"] == 3 and one["mode"] == 3][:3]
    settings = FamilySettings(events=False, certify=False)
    problem = mode_problem(chain(3), 3, 0.05)
    found = []
    for symmetry in ("brake+reflection", "reflection", "brake", "none"):
        origin, folder = begin(problem, settings, symmetry=symmetry), tmp_path / symmetry
        found.append(follow_family(origin, at=wanted, out=folder, name="mode", settings=settings))
        assert found[-1].points[0].symmetry == symmetry
    for energy in wanted:
        quarter, *others = (exact_point(family, energy) for family in found)
        for other in others:
            assert abs(other.period - quarter.period) < 1e-12
            assert abs(other.action - quarter.action) < 1e-10 * quarter.action
            assert multiplier_error(other.floquet_multipliers, quarter.floquet_multipliers) < 1e-9


def test_physical_parameter_at_constant_energy(tmp_path):
    """A length varied at constant energy: the end of the family is an orbit of the changed system."""
    model = chain(2)
    origin = Problem(model, mode_problem(model, 1, 0.5).guess, symmetry="brake+reflection", name="longer")
    family = follow_family(origin, "length2", until=1.3, out=tmp_path, settings=FamilySettings(events=False))
    last = family.points[-1]
    assert last.free["length2"] == pytest.approx(1.3, abs=1e-13)
    assert abs(last.energy - family.points[0].energy) < 1e-12 * abs(last.energy) + 1e-12
    changed = chain(2, length=[1.0, 1.3])
    assert ClosureCheck(changed)(last.state, last.period, np.zeros(2)) < 1e-11 * last.scale


def test_unknown_parameter_is_refused(tmp_path):
    """The message names what is known."""
    with pytest.raises(InputError, match="use one of energy"):
        follow_family(mode_problem(chain(1), 1), "enregy", out=tmp_path)


def test_matching_follows_curves_that_cross():
    """Two indices that pass through each other keep their order by where they were heading."""
    before, slope = np.array([1.0 + 0j, 0.9 + 0j]), np.array([-0.2 + 0j, 0.2 + 0j])
    found = np.array([1.1 + 0j, 0.8 + 0j])
    assert np.array_equal(found[matching(before + slope, found)], [0.8, 1.1])


def test_family_file_round_trip(tmp_path):
    """family.json and family.npz give back every number exactly; the contract's names are there."""
    settings = FamilySettings(directions="forward")
    family = follow_family(mode_problem(chain(2), 2), points=12, out=tmp_path, settings=settings)
    path = tmp_path / "mode-2" / "family.json"
    again = load_family(path)
    pairs = list(zip(family.points, again.points, strict=True))
    assert all(np.array_equal(a.nodes, b.nodes) and a.period == b.period for a, b in pairs)
    document = json.loads(path.read_text(encoding="utf-8"))
    names = ("state", "period", "energy", "action", "closure", "floquet_multipliers", "stability", "energy")
    assert all(name in point for name in names for point in document["points"])
    assert all({"kind", "index", "parameter", "period", "state"} <= set(event) for event in document["events"])


SCRIPT = """
import sys
sys.path.insert(0, {root!r})
import orbitfinder as of
from orbitfinder.orbits.guesses.modes import mode_problem
settings = of.FamilySettings(directions="forward", longest_step={step})
of.follow_family(mode_problem(of.chain(2), 1), points={points}, out={out!r}, settings=settings)
"""


def killed_and_resumed(tmp_path, kills, points, step, rng):
    """Run, kill at random moments, run to the end; the families of that and of an undisturbed run."""
    root = str(Path(__file__).parents[1])
    out = tmp_path / "killed"
    script = textwrap.dedent(SCRIPT.format(root=root, out=str(out), points=points, step=step))
    for _ in range(kills):
        process = subprocess.Popen([sys.executable, "-c", script])
        wait_for_growth(out / "mode-1" / "family.jsonl", process)
        time.sleep(float(rng.uniform(0.0, 0.3)))
        process.send_signal(signal.SIGKILL)
        process.wait()
    subprocess.run([sys.executable, "-c", script], check=True)
    whole = tmp_path / "whole"
    script = textwrap.dedent(SCRIPT.format(root=root, out=str(whole), points=points, step=step))
    subprocess.run([sys.executable, "-c", script], check=True)
    return load_family(out / "mode-1" / "family.json"), load_family(whole / "mode-1" / "family.json")


def wait_for_growth(path, process):
    size = path.stat().st_size if path.exists() else 0
    while process.poll() is None and (path.stat().st_size if path.exists() else 0) <= size:
        time.sleep(0.01)


def compare(killed, whole, points):
    assert len(killed.points) == len(whole.points) == points + 1
    places = killed.values("arclength")
    assert np.all(np.diff(places) > 0)
    assert np.allclose(places, whole.values("arclength"), rtol=0, atol=1e-7)
    assert np.allclose(killed.values("period"), whole.values("period"), rtol=1e-8)
    assert [event.kind for event in killed.events] == [event.kind for event in whole.events]


def test_killed_run_resumes(tmp_path):
    """SIGKILL at a random moment: no point lost, none doubled, the same family as without."""
    compare(*killed_and_resumed(tmp_path, 1, 20, 0.03, np.random.default_rng(1)), 20)


@pytest.mark.slow
def test_killed_twenty_times(tmp_path):
    """300 points, twenty kills."""
    compare(*killed_and_resumed(tmp_path, 20, 300, 0.004, np.random.default_rng(2)), 300)


def test_torn_line_is_dropped(tmp_path):
    """A journal cut in the middle of a line resumes from the line before."""
    settings = FamilySettings(directions="forward")
    first = follow_family(mode_problem(chain(1), 1), points=6, out=tmp_path, settings=settings)
    journal = tmp_path / "mode-1" / "family.jsonl"
    data = journal.read_bytes()
    journal.write_bytes(data[: data.rfind(b"\n", 0, len(data) - 1) - 40])
    kept = read_journal(tmp_path / "mode-1")
    assert len(kept.steps(1)) < 6
    again = follow_family(mode_problem(chain(1), 1), points=6, out=tmp_path, settings=settings)
    assert [p.period for p in again.points] == pytest.approx([p.period for p in first.points], abs=1e-10)
    assert kept.header["curve"]["symmetry"] == "brake+reflection" == again.points[-1].symmetry


def told(family):
    """What a family says, but for the time that it took."""
    document = family_to_document(family)
    points = [{key: value for key, value in one.items() if key != "wall_time"} for one in document.pop("points")]
    return json.loads(json.dumps(plain([document, points])))


FORWARD = {"points": 14, "settings": FamilySettings(directions="forward"), "at": (-2.5,)}


@pytest.mark.parametrize("stops", [(None, -2.0), (1.0, -2.0)])
def test_nearer_ends_leave_what_is_there(stops, tmp_path):
    """The points beyond were cut off the journal and the file, without a word."""
    problem = mode_problem(chain(1), 1, 1.0)
    follow_family(problem, out=tmp_path, until=stops[0], **FORWARD)
    before = {path: path.read_bytes() for path in tmp_path.glob("*/family.json*")}
    with pytest.raises(InputError, match=r"family.jsonl: until: points at \S+ there, energy = -2 asked for; what is"):
        follow_family(problem, out=tmp_path, until=stops[1], **FORWARD)
    assert len(before) == 2 and all(path.read_bytes() == text for path, text in before.items())


@pytest.mark.parametrize("stops", [(-2.0, 1.0), (-2.0, None), (-2.0, -2.0)])
def test_goes_on_to_another_end(stops, tmp_path):
    """Farther: what is known stays as it is, to the last bit, and is not computed again."""
    ask = FORWARD
    problem, steps = mode_problem(chain(1), 1, 1.0), []
    follow_family(problem, out=tmp_path / "on", until=stops[0], **ask)
    (journal,) = (tmp_path / "on").glob("*/family.jsonl")
    known = journal.read_bytes().splitlines()
    found = follow_family(problem, out=tmp_path / "on", until=stops[1], progress=steps.append, **ask)
    assert told(found) == told(follow_family(problem, until=stops[1], **ask))
    assert [one.kind for one in found.ends] == ["point limit" if stops[1] is None else "target"]
    assert [one.role for one in found.points].count("at") == 1
    lines = journal.read_bytes().splitlines()
    kept = sum(one in known for one in lines[1:])
    assert len(steps) == len(lines) - 1 - kept and kept > 3


def test_events_near_a_parameter_of_zero_stay_where_a_family_goes_on(tmp_path):
    """Events of a run that was stopped before them, and of its file alone, are measured as any other's."""
    orbit = load_orbit(Path(__file__).parents[1] / "results" / "gallery" / "van-der-pol" / "orbit.json")
    for points in (3, 14):
        family = follow_family(orbit, "damping", points=points, out=tmp_path)
    assert [one.kind for one in family.events] == ["branch_point", "stability_change"]
    assert abs(family.events[0].parameter) < 1e-9
    assert all(check.passed for _, check in verified(family, build_model(family.system)))


@pytest.fixture(scope="module")
def wild():
    """The double pendulum's slow mode to where its largest multiplier is far above what one turn can close to."""
    settings = FamilySettings(events=False, directions="forward", certify=False)
    problem = replace(mode_problem(chain(2), 1, 0.5), symmetry="brake+reflection")
    return follow_family(problem, until=19.55, settings=settings)


def followed_from(point):
    """What is followed from an orbit of that family, each orbit with its closure."""
    problem = Problem(chain(2), of.Guess(point.state, point.period), symmetry="brake+reflection")
    with compiling("off"):  # nothing is doubted here for which the certificate would take long double
        return follow_family(problem, settings=FamilySettings(events=False, directions="forward", points=1))


def test_very_unstable_orbits_fit_piece_by_piece(wild):
    """Round the loop nothing is left, from node to node everything is."""
    found = next(point for point in wild.points if point.scale > 1e9)
    point = followed_from(found).points[0]
    assert point.period == pytest.approx(found.period, rel=1e-9) and wild.points[-1].scale > 1e9
    assert point.scale > 1e9 and point.closure > 0.1 * np.finfo(float).eps * point.scale
    assert 0 < point.defect < 1e-10 and len(point.shooting_nodes) > 1


def test_broken_piece_is_refused(wild, monkeypatch):
    """One node moved by 1e-6: the loop's tolerance would let it pass, the pieces do not."""
    ends, moved = ClosureCheck.ends, []

    def broken(check, nodes, *given):
        nodes = nodes.copy()
        nodes[1, 0] += 1e-6
        moved.append(len(nodes))
        return ends(check, nodes, *given)

    monkeypatch.setattr(ClosureCheck, "ends", broken)
    with pytest.raises(ConvergenceError, match="the pieces of the orbit fit only to .* with growth"):
        followed_from(wild.points[-1])
    assert moved


def test_a_check_goes_round_from_the_nodes(wild):
    """From the start alone the multipliers of an unstable orbit have fewer digits; states of no motion are not used."""
    point, symmetry, flow = wild.points[-1], SYMMETRIES["brake+reflection"], build_flow(chain(2))
    steps = (point.mesh.size - 1) // len(point.shooting_nodes)
    pieces = [dop853(flow, node, point.period * point.mesh[k * steps : (k + 1) * steps + 1])
              for k, node in enumerate(point.shooting_nodes)]  # fmt: skip
    quarter = np.vstack([*(piece[:-1] for piece in pieces), pieces[-1][-1:]])
    times, states = symmetry.whole(point.mesh, quarter, np.zeros(4))

    def gone(beside):
        return tour(chain(2), point.state, point.period, np.zeros(2), symmetry.forward, beside)

    def index(tour):
        return judged(np.linalg.eigvals(tour.map())).indices[0].real

    alone, piecewise, known = gone(None), gone((times, states)), point.indices[0].real
    off = abs(index(piecewise) - known)
    # The variations of each piece are known to 1e-13 of its norm in each of some steps, which the others carry on; the
    # eigenvalue's condition is 1.3. From the start alone it was off by 9e-4; both are round-off, which differs from
    # processor to processor.
    befores = [np.eye(4), *accumulate(piecewise.pieces, lambda before, piece: piece @ before)]
    afters = [np.eye(4), *accumulate(reversed(piecewise.pieces), np.matmul)][::-1]
    norms = np.linalg.norm([befores[:-1], piecewise.pieces, afters[1:]], 2, axis=(2, 3))
    assert off < 1.3 * 3e-13 * norms.prod(axis=0).sum() and off < abs(index(alone) - known) / 10 < 1e-3
    assert index(gone((times, states + 1e-6))) == index(alone)


def test_a_direction_is_carried_to_other_segments(wild, monkeypatch):
    """Between two nodes it was interpolated, and a family turned back where its segments were made anew."""
    point = wild.points[-1]
    problem = Problem(chain(2), of.Guess(point.state, point.period), symmetry="brake+reflection")
    settings = FamilySettings(events=False, certify=False, directions="forward", points=8, first_step=0.05)
    with compiling("off"):
        start = begin(problem, settings)
    made = [np.nan]

    def another(curve, solution):
        """The same orbit on segments of other lengths than those of the last."""
        place = solution.place
        made.append(place.period)
        mesh = place.mesh[-1] * np.linspace(0.0, 1.0, place.mesh.size) ** (1.0 + 0.5 * (len(made) % 2))
        nodes = mesh_module.between(curve, solution, mesh[place.steps : -1 : place.steps])
        return replace(place, nodes=np.vstack([place.nodes[:1], nodes]), mesh=mesh)

    monkeypatch.setattr(mesh_module, "remeshed", another)
    monkeypatch.setattr(mesh_module, "regraded", lambda curve, solution: solution.place.mesh)
    monkeypatch.setattr(
        mesh_module, "needs_mesh", lambda curve, solution, every=1: not abs(solution.place.period / made[-1] - 1) < 1e-9
    )
    with compiling("off"):
        family = follow_family(start, settings=settings)
    edges = [each.mesh[:: (each.mesh.size - 1) // len(each.shooting_nodes)] for each in family.points]
    assert not any(np.array_equal(one, two) for one, two in pairwise(edges))
    assert family.points[0].value == pytest.approx(19.55, abs=1e-6) and len(family.points) == 9
    assert np.all(np.diff(family.values("energy")) > 0)


@pytest.mark.parametrize("file", sorted(FAMILIES.glob("*/family.json")), ids=lambda file: file.parent.name)
def test_no_shipped_family_goes_over_itself(file):
    """Each event is met once; quadruple-mode-2 came back over itself and ended where it had begun."""
    met = [((one.kind, one.detail, one.order), (one.parameter, one.period)) for one in load_family(file).events]
    again = [
        one for (one, here), (other, there) in combinations(met, 2) if one == other and np.allclose(here, there, 1e-8)
    ]
    assert not again


@pytest.mark.parametrize(("largest", "kinds"), [(1e12, []), (1e3, ["branch_point"])])
def test_no_bifurcations_out_of_round_off(largest, kinds, caplog):
    """Where the largest multiplier blurs the stability indices none of their passages is looked for: of two pairs the
    index of one goes from 1.9 to 2.1."""

    def family(s):
        a = 1.0 + s / 2
        pair = ca.blockcat([[a, 1.0], [a * a - 1.0, a]])
        return ca.diagcat(largest, pair[0, 0], 1 / largest, pair[1, 1]) + ca.diagcat(
            0.0, ca.blockcat([[0.0, 0.0, pair[0, 1]], [0.0, 0.0, 0.0], [pair[1, 0], 0.0, 0.0]])
        )

    found = planted(bouncing(family, 2, -0.1), 0.2, resonances=2)
    assert [one.kind for one in found.events] == kinds and not caplog.records and len(found.points) == 2


@pytest.mark.slow
@pytest.mark.parametrize("links, mode", [(3, 1), (3, 2), (3, 3), (4, 2), (4, 3), (4, 4)])
def test_modes_to_the_upright_saddle(links, mode, tmp_path):
    """Each mode goes on to where its period blows up: 88.2 J above hanging with three links, 156.8 J with four."""
    settings = FamilySettings(directions="forward", events=False)
    family = follow_family(mode_problem(chain(links), mode), out=tmp_path, settings=settings)
    assert family.ends[0].kind == "homoclinic"
    top = {3: 44.1, 4: 78.4}[links]
    assert abs(family.points[-1].energy - top) < 0.05
    assert max(point.defect for point in family.points if point.scale > 1e3) < 1e-9


def test_family_figures(tmp_path):
    """The four figures are written and not blank."""
    from orbitfinder.show.plot import save_figures

    settings = FamilySettings(directions="forward")
    family = follow_family(mode_problem(chain(2), 2), points=15, out=tmp_path, settings=settings)
    paths = save_figures(family, tmp_path)
    assert len(paths) == 4 and all(path.stat().st_size > 10_000 for path in paths)


def test_variations_that_overflow_are_a_shorter_step_and_no_traceback(monkeypatch):
    """A corrector whose Jacobian is not finite says so, and a nearer point is tried (seen on a five-bar)."""
    settings = FamilySettings(events=False, certify=False, directions="forward", points=3)
    problem, whole, left = mode_problem(chain(2), 1, 0.5), Linearised.matrix, []

    def overflowing(given):
        matrix = whole(given)
        return np.full_like(matrix, np.nan) if left and left.pop() else matrix

    monkeypatch.setattr(Linearised, "matrix", overflowing)

    def followed(times):
        """The family whose Jacobians overflow so often once it has a point."""
        left.clear()
        return follow_family(problem, settings=settings, progress=lambda batch: left.extend([True] * times))

    with compiling("off"):
        steps = [np.diff(followed(times).values("arclength")) for times in (0, 2)]
        stopped = followed(1000)
    assert np.all(steps[0] > 0) and len(steps[1]) == len(steps[0]) and steps[1][1] < steps[0][1]
    assert "variations of the corrector's orbit overflow" in stopped.ends[-1].reason
