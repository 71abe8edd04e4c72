"""Where families end: Hopf points and joins, solved for; joined families gone on along; branches that begin too far."""

import json
import logging
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from conftest import inside
from scipy.optimize import fsolve

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.families import ends
from orbitfinder.families.folder import directions
from orbitfinder.families.joins import Invariance, agrees
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.rest import can_rest, rest_of
from orbitfinder.families.saddles import SLOW, slowness
from orbitfinder.families.start import begin, curve_in, full_samples
from orbitfinder.families.verified import settled_on, verified
from orbitfinder.loops.symmetry import REFLECTION_MAP
from orbitfinder.mechanics.kind import build_model, check_reachable
from orbitfinder.records.ends import ENDS
from orbitfinder.records.family import End, Reading, plain, save_family

ROOT = Path(__file__).parents[1]
QUIET = FamilySettings(certify=False, events=False)
DOWN, UP = (replace(QUIET, directions=one) for one in ("backward", "forward"))
MORRIS_LECAR = ((93.857618373725453, 78.756609546026915), (212.01881610037437, 42.281921426198822))
"""Hopf points (current, period), by Newton at 50 digits"""
HALF = 0.5


def phases(orbit, model, parameter, count):
    """The same orbit begun at so many instants."""
    start = begin(orbit, FamilySettings(parameter=parameter), model=model)
    states = full_samples(start.curve, start.solution)[1]
    return [of.Problem(model, of.Guess(states[512 * k // count], orbit.period)) for k in range(count)]


def hopf(family, side=0):
    """The Hopf point in which a family ends."""
    end = family.ends[side]
    assert end.kind == "hopf", end.reason
    assert end.error < 1e-8 * max(abs(end.parameter), 1.0)
    return end.parameter, end.period


def normal_form(unit=1.0):
    """r' = mu r - r^3, one turn in 2 pi: amplitude sqrt(mu), and its Hopf point at 0 exactly."""

    def field(_, x, p):
        y = x.y * unit
        square = x.x**2 + y**2
        return [p.mu * x.x - y - x.x * square, (x.x + p.mu * y - y * square) / unit]

    return of.ode(field, ["x", "y"], {"mu": HALF})


@pytest.mark.parametrize("unit", [1.0, 1e-2, 1e4])
def test_the_normal_form_ends_at_zero(unit):
    """From four phases, in any unit of one component, and no event before."""
    model, settings = normal_form(unit), replace(DOWN, events=True)
    for angle in (0.0, 0.8, 2.3, 4.0):
        state = np.sqrt(HALF) * np.array([np.cos(angle), np.sin(angle) / unit])
        family = of.follow_family(of.Problem(model, of.Guess(state, 2 * np.pi)), "mu", settings=settings, model=model)
        value, period = hopf(family)
        assert abs(value) < 1e-10 and period == pytest.approx(2 * np.pi, rel=1e-10) and not family.events
        assert family.points[0].value < 0.05


def brusselator():
    model = of.systems.brusselator()
    return model, of.find_orbit(of.Problem(model, of.Guess([3.6, 1.3], 7.2)))


@pytest.mark.slow
def test_the_brusselator_ends_at_two_from_every_phase():
    """Its Hopf point is at rate = 1 + feed^2 with the frequency `feed`; 0.2.0 said step underflow from all of these."""
    model, orbit = brusselator()
    for problem in phases(orbit, model, "rate", 8):
        value, period = hopf(of.follow_family(problem, "rate", settings=DOWN))
        assert value == pytest.approx(2.0, abs=1e-10) and period == pytest.approx(2 * np.pi, abs=1e-10)


def test_what_is_wanted_before_a_hopf_point_is_reached():
    """Until and at values between the last orbit and the Hopf point; beyond it there is only the end."""
    model, orbit = brusselator()
    family = of.follow_family(orbit, "rate", until=2.000001, at=[2.00001], settings=DOWN, model=model)
    assert family.ends[0].kind == "target" and family.points[0].value == 2.000001
    assert any(one.value == 2.00001 for one in family.points)
    beyond = of.follow_family(orbit, "rate", until=1.9, settings=DOWN, model=model)
    assert hopf(beyond)[0] == pytest.approx(2.0, abs=1e-10)


def morris_lecar(unit=1.0):
    """The nerve of C. Morris and H. Lecar with a Hopf point of each sign of the current, V told in `unit` mV."""

    def field(_, x, p):
        volt, w = x.V * unit, x.w
        opening = (1 + ca.tanh((volt + 1.2) / 18)) / 2
        rate = p.current - 2 * (volt + 60) - 4.4 * opening * (volt - 120) - 8 * w * (volt + 84)
        return [rate / 20 / unit, 0.04 * ((1 + ca.tanh((volt - 2) / 30)) / 2 - w) * ca.cosh((volt - 2) / 60)]

    return of.ode(field, ["V", "w"], {"current": 100.0})


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1.0, 200.0])
def test_both_hopf_points_of_morris_and_lecar(unit):
    """And the two folds between them, in mV as in units of 200 mV."""
    model = morris_lecar(unit)
    orbit = of.find_orbit(of.Problem(model, of.Guess([-8.962315401151326 / unit, 0.15398149396221966], 85.29)))
    family = of.follow_family(orbit, "current", settings=FamilySettings(certify=False), model=model)
    assert [one.kind for one in family.events if one.kind != "stability_change"] == ["fold", "fold"]
    for side, (value, period) in enumerate(MORRIS_LECAR):
        assert hopf(family, side) == (pytest.approx(value, rel=1e-10), pytest.approx(period, rel=1e-10))


def test_a_family_goes_round_its_orbit_once():
    """A guess of five periods, as `recurrences` gives it: 0.2.0 followed the orbit five times round."""
    model = morris_lecar()
    close = of.guesses.recurrences(model, [-20.0, 0.1], 1000.0, count=1)[0]
    assert close.guess.period > 400
    family = of.follow_family(of.Problem(model, close.guess), "current", settings=UP, points=1, model=model)
    assert family.points[0].period == pytest.approx(85.29064104291239, abs=1e-9)


def test_a_self_excited_oscillator_in_si():
    """x'' = -w^2 x + (mu - x^2) x' at w = 100 rad/s from any phase: the Hopf point at mu = 0, and no fold before it."""
    rate = 100.0

    def equations(_, x, p):
        return [x.v, -(rate**2) * x.x + (p.mu - x.x**2) * x.v]

    model = of.ode(equations, ["x", "v"], {"mu": HALF})
    size = 2 * np.sqrt(HALF)
    for angle in (0.0, 0.8, 2.0):
        guess = of.Guess([size * np.cos(angle), -size * rate * np.sin(angle)], 2 * np.pi / rate)
        settings = replace(DOWN, events=True)
        family = of.follow_family(of.Problem(model, guess), "mu", settings=settings, model=model)
        value, period = hopf(family)
        assert abs(value) < 1e-10 and period == pytest.approx(2 * np.pi / rate, rel=1e-10) and not family.events


@pytest.mark.slow
def test_a_canard_is_said_for_what_it_is():
    """FitzHugh's and Nagumo's nerve: at rate 0.08 through the canard to its Hopf point, at 0.02 into it."""
    model = of.systems.fitzhugh_nagumo()
    orbit = of.find_orbit(of.Problem(model, of.Guess([-0.30042436673355616, -0.18828741564996918], 39.4744)))
    family = of.follow_family(orbit, "current", settings=DOWN, model=model)
    assert hopf(family) == (pytest.approx(0.3312813374547458, rel=1e-10), pytest.approx(22.805916865386, rel=1e-10))
    slower = of.follow_family(orbit, "rate", until=0.02, settings=DOWN, model=model).points[0]
    end = of.follow_family(slower, "current", settings=replace(DOWN, points=600, method="shooting")).ends[0]
    assert end.kind == "canard" and end.parameter == pytest.approx(0.2997912, abs=1e-6) and end.error < 1e-5
    assert "the period changes from" in end.reason and "shooting cannot hold them" in end.reason


def test_an_equilibrium_solved_for_of_a_pendulum():
    """The energy at rest and the linear period, of a conservative family; and none where the motion runs round."""
    model = of.chain(1)
    problem = of.Problem(model, of.Guess([0.05, 0.0], 1.64))
    family = of.follow_family(problem, settings=DOWN)
    end = family.ends[0]
    assert end.kind == "equilibrium" and end.parameter == pytest.approx(-4.9, abs=1e-13)
    assert end.period == pytest.approx(2 * np.pi / np.sqrt(9.8 * 0.5 / (1 / 12 + 0.25)), rel=1e-12)
    start = begin(problem, FamilySettings())
    assert can_rest(start.curve) and rest_of(start.curve, start.solution, "energy").others.size == 0
    turning = begin(of.Problem(model, of.Guess([0.0, 9.0], 0.8), winding=(1,)), FamilySettings())
    assert not can_rest(turning.curve)


def test_ends_in_files(tmp_path):
    """What was solved for is in family.json, what was not is left out, and older files load."""
    model, orbit = brusselator()
    family = of.follow_family(orbit, "rate", settings=DOWN, model=model, out=tmp_path, name="clock")
    document = json.loads((tmp_path / "clock" / "family.json").read_text())
    assert sorted(document["ends"][0]) == ["error", "kind", "parameter", "period", "reason"]
    assert of.load_family(tmp_path / "clock" / "family.json").ends == family.ends
    assert plain(End("target", "reached")) == {"kind": "target", "reason": "reached"}


def test_what_is_kept():
    """The gaps of what has a symmetry are 0, and the mean over the images has it."""
    times = np.linspace(0, 2 * np.pi, 481)
    states = np.stack([np.cos(times) + 0.1 * np.cos(2 * times), np.sin(times) + 0.2 * np.sin(3 * times)], axis=1)
    mirror, angles = Invariance(2, REFLECTION_MAP), np.array([False])
    assert np.abs(mirror.gaps(states, angles)).max() == pytest.approx(0.2)
    assert np.abs(mirror.gaps(mirror.joined(states, angles), angles)).max() < 1e-15
    half = Invariance(2).joined(states, angles)
    assert len(half) == 241 and half[:, 0] == pytest.approx(0.1 * np.cos(2 * times[:241]), abs=1e-15)


@pytest.fixture(scope="module")
def pendulum():
    """The driven pendulum's symmetric swings, and the lopsided ones from their birth on."""
    settings = FamilySettings(certify=False)
    problem = of.load_problem(Path(__file__).parents[1] / "problems" / "families" / "driven-pendulum.toml")
    symmetric = of.follow_family(problem, "torque", until=2.5, settings=settings)
    return symmetric, of.follow_family(of.switch_branch(symmetric, 0), settings=settings)


def test_a_join_is_seen_from_both_sides(pendulum):
    """From the lopsided side at both of its ends to what the symmetric side says, never as a fold, from any orbit."""
    symmetric, lopsided = pendulum
    birth = next(one for one in symmetric.events if one.kind == "branch_point")
    assert [end.kind for end in lopsided.ends] == ["merged", "merged"]
    assert lopsided.ends[0].parameter == pytest.approx(birth.parameter, rel=1e-10)
    assert "fold" not in {one.kind for one in lopsided.events}
    for k in (3, len(lopsided.points) // 2):
        again = of.follow_family(lopsided.points[k], "torque", settings=QUIET)
        for end, known in zip(again.ends, lopsided.ends, strict=True):
            assert end.kind == "merged" and end.parameter == pytest.approx(known.parameter, rel=1e-10)
            assert end.error < 1e-9


def test_a_join_ahead_is_solved_for_when_it_is_first_seen_and_where_the_family_ends(pendulum, monkeypatch):
    """Steps on the way only look whether it is still the one ahead."""
    asked, real, seen = [], ends.solved, []
    monkeypatch.setattr(ends, "solved", lambda *given: asked.append(real(*given)) or asked[-1])
    monkeypatch.setattr(ends, "agrees", lambda join, *given: seen.append(join) or agrees(join, *given))
    middle = pendulum[1].points[len(pendulum[1].points) // 2]
    again = of.follow_family(middle, "torque", settings=replace(QUIET, directions="forward"))
    assert again.ends[-1].kind == "merged"
    found = [join for join in asked if join is not None]
    assert len(found) == 2 and len(seen) > 3


def test_the_joined_family_is_gone_on_along(pendulum, tmp_path):
    """From the second join the symmetric swings, both ways, through the place where they lose stability."""
    _, lopsided = pendulum
    end = lopsided.ends[1]
    assert end.joined["symmetry"] == "reflection" and end.joined["period"] == pytest.approx(1.0, rel=1e-12)
    branch = of.switch_branch(lopsided, "end")
    joined = of.follow_family(branch, points=2, settings=FamilySettings(certify=False))
    assert {one.symmetry for one in joined.points} == {"reflection"} and len(joined.points) == 5
    assert joined.points[2].value == pytest.approx(end.parameter, rel=1e-12)
    met = [one.parameter for one in joined.events if one.kind == "branch_point"]
    assert met == [] or met == pytest.approx([end.parameter], rel=1e-9)
    with pytest.raises(InputError, match="joined at the start or the end, got 'middle'"):
        of.switch_branch(lopsided, "middle")


def test_the_command_goes_on_from_a_join(pendulum, tmp_path):
    """--switch end, as said, and the words for what cannot be."""
    file = save_family(replace(pendulum[1], name="lopsided"), tmp_path / "lopsided")
    command = ["continue", str(file), "--switch", "end", "--points", "1", "--out", str(tmp_path), "--no-figures"]
    done = CliRunner().invoke(cli, [*command, "--json"])
    assert done.exit_code == 0 and json.loads(done.stdout)["name"] == "lopsided-end", done.output
    wrong = CliRunner().invoke(cli, ["continue", str(file), "--switch", "ende"])
    assert wrong.exit_code == 2 and "neither the index of an event nor start nor end" in wrong.output
    save_family(replace(pendulum[0], name="symmetric"), tmp_path / "symmetric")
    none = CliRunner().invoke(cli, ["continue", str(tmp_path / "symmetric" / "family.json"), "--switch", "start"])
    assert none.exit_code == 2 and "joins another family at neither side" in none.output


def test_a_target_behind_the_first_point_of_a_branch(pendulum, caplog):
    """Between birth and first point it is turned to, behind the birth it is said."""
    symmetric, _ = pendulum
    branch = of.switch_branch(symmetric, 0)
    born, begun = branch.event.parameter, branch.start.solution.place.free[0]
    away = FamilySettings(certify=False, events=False, directions="away")
    family = of.follow_family(branch, until=(born + begun) / 2, settings=away)
    assert family.ends[0].kind == "target" and len(family.points) == 2
    with caplog.at_level(logging.WARNING):
        of.follow_family(branch, until=born - 0.1 * np.sign(begun - born), settings=away, points=1)
    assert "lies behind the branch" in caplog.text


def test_the_direction_towards_a_target():
    """Away from a birth at 1 and a first point at 2: on to 3, back to 1.5, and on from 0.5, which is behind."""
    point = type("Point", (), {"value": 2.0})()
    away = FamilySettings(parameter="p", directions="away")
    for until, sign in ((3.0, 1), (1.5, -1), (0.5, 1), (None, 1)):
        assert [one[0] for one in directions(point.value, away, (until, ()), 1, 1.0)] == [sign]


def test_an_equilibrium_solved_for_in_a_parameter():
    """A pendulum of one energy as its gravity grows: it hangs still where the potential's bottom is that energy."""
    model = of.chain(1)
    problem = of.Problem(model, of.Guess([0.3, 0.0], 1.65))
    start = begin(problem, FamilySettings(parameter="gravity"))
    rest = rest_of(start.curve, start.solution, "gravity")
    assert rest.value == pytest.approx(9.8 * np.cos(0.3), rel=1e-11)
    assert rest.period == pytest.approx(2 * np.pi / np.sqrt(rest.value * 0.5 / (1 / 12 + 0.25)), rel=1e-11)


@pytest.mark.slow
def test_conservative_joins_from_both_sides():
    """The triple pendulum's second mode: a doubling, and branches that lose its reflection, its brake or both."""
    problem = of.load_problem(Path(__file__).parents[1] / "problems" / "families" / "triple-mode-2.toml")
    settings = FamilySettings(certify=False, resonances=2)
    family = of.follow_family(problem, until=-33.0, settings=replace(settings, directions="forward"))
    places = [k for k, one in enumerate(family.events) if one.kind in ("period_doubling", "branch_point")]
    assert len(places) == 3
    for k in places:
        branch = of.follow_family(of.switch_branch(family, k), points=4, settings=settings)
        (end,) = (one for one in branch.ends if one.kind == "merged")
        assert end.parameter == pytest.approx(family.events[k].parameter, rel=1e-11) and end.error < 1e-9
        assert "fold" not in {one.kind for one in branch.events}


@pytest.mark.slow
def test_the_atmosphere_of_lorenz_1984_is_followed_until_it_is_too_fast():
    """At F = 3e5 a period takes 3,000 steps; in 128 it was not finite: `follow_family` raised a ValueError."""

    def field(t, x, p):
        return [
            -(x.y**2) - x.z**2 - 0.25 * x.x + 0.25 * p.F,
            x.x * x.y - 4 * x.x * x.z - x.y + 0.5,
            4 * x.x * x.y + x.x * x.z - x.z,
        ]

    model = of.ode(field, ["x", "y", "z"], {"F": 4.0})
    settled = of.simulate(model, [1.0, 1.0, 0.1], 400.0).states[-1]
    alone = of.FamilySettings(method="shooting")
    family = of.follow_family(of.Problem(model, of.Guess(list(settled), 1.544)), "F", settings=alone)
    kinds = [one.kind for one in family.events if one.kind != "stability_change"]
    assert kinds == ["period_doubling", "period_doubling", "fold", "fold"]
    hopf, other = sorted(family.ends, key=lambda one: one.kind)
    assert (hopf.kind, other.kind) == ("hopf", "step underflow")

    def rest(x):
        return [-(x[1] ** 2) - x[2] ** 2 - (x[0] - x[3]) / 4, x[0] * (x[1] - 4 * x[2]) - x[1] + 0.5,
                x[0] * (4 * x[1] + x[2]) - x[2], x[3] - hopf.parameter]  # fmt: skip

    x, y, z, _ = fsolve(rest, [1.0, 0.0, 0.1, hopf.parameter], xtol=1e-12)
    jacobian = [[-0.25, -2 * y, -2 * z], [y - 4 * z, x - 1, -4 * x], [4 * y + z, 4 * x, x - 1]]
    pair = max(np.linalg.eigvals(jacobian), key=np.imag)
    assert abs(pair.real) < 1e-10 and hopf.period == pytest.approx(2 * np.pi / pair.imag, rel=1e-9)


def test_a_cycle_on_which_two_equilibria_are_born_is_no_canard():
    """On r = 1, theta' = w - cos theta, so that T = 2 pi / sqrt(w^2 - 1): it ends where they are born, at w = 1.

    There theta' = theta^2 / 2 - ... about (1, 0), whose eigenvalues are 0 and, across, -2, and d theta' / dw = 1: a
    saddle-node, from whose centre the circle leaves and comes back.
    """

    def field(t, x, p):
        inward, turn = 1 - x.x**2 - x.y**2, p.w - x.x
        return [x.x * inward - x.y * turn, x.y * inward + x.x * turn]

    model = of.ode(field, ["x", "y"], {"w": 1.5})
    state = of.simulate(model, [1.0, 0.1], 60.0).states[-1]
    family = of.follow_family(of.Problem(model, of.Guess(list(state), 5.62)), "w", settings=DOWN)
    near = [one for one in family.points if one.value > 1.001]
    assert [one.period for one in near] == pytest.approx(
        [2 * np.pi / np.sqrt(one.value**2 - 1) for one in near], rel=1e-9
    )
    (end,) = (one for one in family.ends if one.kind != "start")
    assert end.kind == "saddle-node" and abs(end.parameter - 1.0) <= end.error < 1e-13, end.reason


def fitzhugh_nagumo(slow=0.08):
    """road.json's nerve, with both of its canards."""
    return of.ode(
        lambda _, x, p: [x.v - x.v**3 / 3 - x.w + p.I, slow * (x.v + 0.7 - 0.8 * x.w)], ["v", "w"], {"I": 1.0}
    )


def reference(name, entry):
    """An entry of a file of independent numbers."""
    known = json.loads((Path(__file__).parent / "data" / name).read_text())
    return next(one for one in (known["entries"] if isinstance(known, dict) else known) if one["id"] == entry)


@pytest.mark.slow
def test_both_canards_are_passed_from_the_relaxation_cycle(tmp_path):
    """From a current of 1 to both Hopf points, through both folds, which verify from a file."""
    model = fitzhugh_nagumo()
    cycle = next(one for one in reference("road.json", "cyc-fhn")["values"] if one["parameter"] == 1.0)
    problem = of.Problem(model, of.Guess([float(x) for x in cycle["state"]], float(cycle["period"])))
    settings = FamilySettings(certify=False, points=600)
    family = of.follow_family(problem, "I", settings=settings, model=model, out=tmp_path, name="nerve")
    folds = sorted((one for one in family.events if one.kind == "fold"), key=lambda one: one.parameter)
    known = reference("road.json", "loc-fhn-right")["values"][0]
    wanted = [float(known["mirror"]), float(known["parameter"])]
    assert [inside(*pair, 6e-11) for pair in zip(folds, wanted, strict=True)] == [True, True]
    left, right = folds  # each other's image
    assert abs(left.parameter + right.parameter - 1.75) <= left.error + right.error < 1e-12
    assert abs(left.period - right.period) <= left.period_error + right.period_error < 1e-6
    assert [one.criticality for one in folds] == ["supercritical", "subcritical"]
    assert folds[0].words == "supercritical fold in I"
    for side, one in enumerate(reference("road.json", "eq-fhn")["values"]["hopf"]):
        assert hopf(family, side) == (
            pytest.approx(float(one["parameter"]), rel=1e-11),
            pytest.approx(float(one["period"])),
        )
        assert f"subcritical (l1 = {float(one['l1']):.6g})" in family.ends[side].reason
    known = of.load_family(tmp_path / "nerve" / "family.json")
    assert all(check.passed for _, check in verified(known, model))


@pytest.mark.slow
def test_both_canards_are_passed_from_a_hopf_point(caplog):
    """From the Hopf point at 1.4187 through both folds to that at 0.3313; nothing that was seen is none."""
    model = fitzhugh_nagumo()
    rest = of.follow_equilibria(model, [-1.2, -0.6], "I", until=2.0)
    assert [one.kind for one in rest.events] == ["hopf"]
    settings = FamilySettings(certify=False, points=600)
    family = of.follow_family(of.switch_branch(rest, 0, model=model), settings=settings)
    known = reference("road.json", "loc-fhn-right")["values"][0]
    folds = sorted((one for one in family.events if one.kind == "fold"), key=lambda one: one.parameter)
    wanted = [float(known["mirror"]), float(known["parameter"])]
    assert [inside(*pair, 6e-11) for pair in zip(folds, wanted, strict=True)] == [True, True]
    assert [one.check.passed for one in family.events] == [True] * 4 and not caplog.records
    assert [one.criticality for one in folds] == ["supercritical", "subcritical"]
    assert sorted(hopf(family, side)[0] for side in (0, 1)) == pytest.approx([0.3312813374547458, 1.418718662545254])


@pytest.mark.slow
def test_a_canard_along_which_the_parameter_stays_has_its_folds(caplog):
    """At a pace of 0.06 the current is that of the fold, to its last digit, for whole steps: the multiplier tells."""
    model = fitzhugh_nagumo(0.06)
    rest = of.follow_equilibria(model, [-1.2, -0.6], "I", until=2.0)
    settings = FamilySettings(certify=False, points=600)
    family = of.follow_family(of.switch_branch(rest, 0, model=model), settings=settings)
    assert [one.kind for one in family.events] == ["fold", "stability_change"] * 2 and not caplog.records
    right, left = (one for one in family.events if one.kind == "fold")
    assert abs(left.parameter + right.parameter - 1.75) <= left.error + right.error < 1e-12
    assert abs(left.period - right.period) <= left.period_error + right.period_error < 1e-5
    assert left.criticality in ("", "supercritical") and right.criticality in ("", "subcritical")  # never the wrong one


@pytest.mark.slow
def test_the_folds_of_autos_demos():
    """fhn: at +-0.43051824495, in a canard; tor: at -0.58433477187."""
    model = of.ode(lambda _, x, p: [3 * (x.x - x.x**3 / 3 + x.y), -(x.x - p.a + 0.8 * x.y) / 3], ["x", "y"], {"a": 0.0})
    settings = FamilySettings(certify=False)
    family = of.follow_family(of.Problem(model, of.Guess([1.5, -1.0], 9.5365)), "a", settings=settings, model=model)
    (known,) = reference("cycles.json", "fhn demo")["points"]
    folds = [one for one in family.events if one.kind == "fold"]
    assert [inside(*pair, 6e-12) for pair in zip(folds, (-known["a"], known["a"]), strict=True)] == [True, True]

    def torus(_, x, p):
        apart = 0.933578 * (x.y - x.x) ** 3
        first = -(0.5 + p.nu) * x.x + 0.5 * x.y - 0.328578 * x.x**3 + apart
        return [first / 0.6, 0.5 * x.x + 0.1 * x.y - x.z - apart, x.y]

    model = of.ode(torus, ["x", "y", "z"], {"nu": -0.9})
    rest = of.follow_equilibria(model, [0.0, 0.0, 0.0], "nu", until=-0.55)
    family = of.follow_family(of.switch_branch(rest, 0, model=model), settings=replace(settings, points=60))
    (known,) = reference("cycles.json", "tor, first fold")["points"]
    fold = next(one for one in family.events if one.kind == "fold")
    assert inside(fold, known["nu"], 6e-12)
    assert abs(fold.period - known["period"]) <= fold.period_error + 6e-9


def turning(kind):
    """A cycle r = 1, about which a doubling or a torus is born at a = 0, to the side of the sign of b."""

    def field(_, x, p):
        radius = ca.sqrt(x.x**2 + x.y**2)
        if kind == "torus":
            u, w, square = radius - 1, x.z, (radius - 1) ** 2 + x.z**2
            out = p.a * u - 0.37 * w + p.b * square * u + 0.2 * u**2
            up = p.a * w + 0.37 * u + p.b * square * w - 0.1 * u * w
        else:
            angle = ca.atan2(x.y, x.x) / 2
            u = ca.cos(angle) * (radius - 1) + ca.sin(angle) * x.z
            w = -ca.sin(angle) * (radius - 1) + ca.cos(angle) * x.z
            out = ca.cos(angle) * (p.a * u + p.b * u**3) + ca.sin(angle) * w - x.z / 2
            up = ca.sin(angle) * (p.a * u + p.b * u**3) - ca.cos(angle) * w + (radius - 1) / 2
        return [out * x.x / radius - x.y, out * x.y / radius + x.x, up]

    return lambda b: of.ode(field, ["x", "y", "z"], {"a": -0.05, "b": b})


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["period_doubling", "torus"])
def test_the_side_to_which_what_is_born_is_born(kind, tmp_path):
    """Both signs, by exact normal forms; recorded, read and verified, and the other one rejected."""
    for b, wanted in ((-0.5, "supercritical"), (0.5, "subcritical")):
        model = turning(kind)(b)
        problem = of.Problem(model, of.Guess([1.0, 0.0, 0.0], 2 * np.pi))
        settings = FamilySettings(certify=False, directions="forward")
        family = of.follow_family(problem, "a", until=0.05, settings=settings, model=model, out=tmp_path, name=wanted)
        (event,) = (one for one in family.events if one.kind == kind)
        assert event.criticality == wanted and event.words == f"{wanted} {kind.replace('_', ' ')}"
        assert abs(event.parameter) <= event.error < 1e-9 and abs(event.period - 2 * np.pi) <= event.period_error < 1e-8
    written = json.loads((tmp_path / wanted / "family.json").read_text())["events"]
    assert [one.get("criticality") for one in written] == [wanted, None]
    assert written[0]["error"] == written[0]["check"]["parameter_error"] == event.error
    known = of.load_family(tmp_path / wanted / "family.json")
    assert [one.criticality for one in known.events] == [wanted, ""]
    assert all(check.passed for _, check in verified(known, model))
    wrong = replace(event, check=replace(event.check, criticality="supercritical"))
    checks = [check for name, check in verified(replace(family, events=(wrong,)), model) if name.startswith("event")]
    assert not checks[0].passed and "recorded as supercritical, found subcritical" in checks[0].note
    wrong = replace(event, check=replace(event.check, parameter_error=1e-30))
    checks = [check for name, check in verified(replace(family, events=(wrong,)), model) if name.startswith("event")]
    assert not checks[0].passed and "an error bar is recorded as 1e-30, found" in checks[0].note


@pytest.mark.slow
def test_the_side_by_the_branch_itself():
    """Lorenz' doubling at 229.4067: the doubled orbit is stable below, where the simple one is not; it doubles again,
    and once more."""
    problem = of.load_problem(Path(__file__).parents[1] / "problems" / "families" / "lorenz-doubling.toml")
    settings = FamilySettings(certify=False)
    family = of.follow_family(problem, "rho", until=225.0, settings=settings)
    k = next(k for k, one in enumerate(family.events) if one.kind == "period_doubling")
    event = family.events[k]
    exact = reference("curves.json", "lorenz-pd")["values"]  # of 140 bits
    assert event.criticality == "supercritical" and inside(event, float(exact["PD1_r"]))
    assert abs(event.period - float(exact["PD1_T"])) <= event.period_error < 1e-11
    known, away = reference("cycles.json", "lorenz doublings")["points"], replace(settings, directions="away")
    for one, until, digit in zip(known[1:], (217.0, 215.5), (5e-8, 5e-6), strict=True):
        before = event.parameter
        family = of.follow_family(of.switch_branch(family, k), until=until, settings=away)
        k = next(k for k, each in enumerate(family.events) if each.kind == "period_doubling")
        event = family.events[k]
        born = [each for each in family.points if each.value > event.parameter + 0.1]
        assert all(each.value < before and each.stability != "unstable" for each in born) and born
        assert event.criticality == "supercritical" and inside(event, one["rho"], digit)
        assert abs(event.period - one["period"]) <= event.period_error + digit / 100


def test_where_no_side_is_told():
    """Conservative families, and events that were read without it."""
    family = of.follow_family(of.Problem(of.chain(2), of.Guess([0.3, 0.42, 0.0, 0.0], 2.2)), points=3,
                              settings=FamilySettings(certify=False))  # fmt: skip
    assert {one.criticality for one in family.events} <= {""}
    assert Reading(0.0, 1e-9, True).criticality == "" and "criticality" not in plain(Reading(0.0, 1e-9, True))


@pytest.mark.parametrize(
    ("file", "parameter", "goals", "words"),
    [
        ("families/duffing-resonance", "frequency", {"until": -1.0}, "until: frequency cannot become -1: .*-6.28"),
        ("families/duffing-resonance", "frequency", {"at": [1.0, 0.0]}, "at: frequency cannot become 0: .* inf s"),
        ("families/duffing-resonance", "frequency", {"until": np.nan}, "until: must be a finite value of frequency"),
        ("examples/double-mode-2", "period", {"until": -1.0}, "until: period: must be positive, got -1;"),
        ("examples/double-mode-2", "mass1", {"until": 0.0}, "until: mass1 cannot become 0: mass: must be greater"),
        ("hybrid/bouncing-ball", "frequency", {"until": -2.0}, "until: frequency cannot become -2: .*must be positive"),
        ("structures/beam", "frequency", {"until": -0.1}, "until: frequency cannot become -0.1: .*positive"),
        ("gallery/brusselator", "rate", {"until": -1.0}, "until: rate cannot become -1: .*rate: must be positive"),
    ],
)
def test_goals_that_no_orbit_can_have_are_refused_at_once(file, parameter, goals, words):
    """They ended by step underflow, after all steps on the way; equilibria went there and could not be read again."""
    problem = of.load_problem(ROOT / "problems" / f"{file}.toml")
    with pytest.raises(InputError, match=words):
        of.follow_family(problem, parameter, **goals)
    if file == "gallery/brusselator":
        with pytest.raises(InputError, match=words):
            of.follow_equilibria(problem.model, problem.guess.state, parameter, **goals)


def test_loops_that_may_not_close_there_are_left_to_the_family():
    """Where a linkage cannot be assembled its family says where it ends; what is made by a program says its forcing."""
    linkage = of.load_problem(ROOT / "problems" / "linkages" / "five-bar-slow-mode.toml").model
    check_reachable(linkage, "length1", {"until": [20.0]})
    with pytest.raises(InputError, match="until: length1 cannot become -1: length: must be greater than 0"):
        check_reachable(linkage, "length1", {"until": [-1.0]})
    made = of.ode(lambda t, x, p: [x[1], -x[0] + p[0]], ["x", "v"], parameters={"push": 1.0})
    check_reachable(made, "push", {"until": [-1.0], "at": []})


SHIPPED = {
    name: ROOT / "results" / "families" / name / "family.json"
    for name in ("five-bar-fast", "five-bar-slow", "quadruple-mode-1")
}
FALSE = [
    End("point limit", "500 points were asked for"),
    End("target", "reached energy = 0.1"),
    End("returned", "a closed family: back at its start after an arclength of 20"),
    End("equilibrium", "the orbits shrink to the equilibrium at q = [0. 0.], period 6.28318531"),
    End("relative equilibrium", "the orbits shrink to a relative equilibrium at q = [0. 0.]"),
    End("homoclinic", "the period blows up (100, 15 times the shortest)"),
    End("heteroclinic", "the period blows up", 0.1, 7.0, 1e-9, saddles=()),
    End("merged", "joins a family of period T/2", 0.1, 7.0, 1e-9),
    End("canard", "a canard explosion", 0.1, 7.0, 1e-9),
    End("singularity", "the motion comes near a singularity at q = [0. 0.]"),
    End("dead point", "the links are in line, where the coordinates of this family end"),
    End("grazing", "the wall is only just reached"),
]
"""None of them ends the family of loops in the potential of Henon and Heiles, whose kind fits what it says"""


def said_of(family, end, side=0):
    """What `verify` says of one end in place of a family's own."""
    ends = list(family.ends)
    ends[side] = end
    model = build_model(family.system)
    return dict(verified(replace(family, events=(), ends=tuple(ends)), model))[f"end {side % len(ends)}"]


def test_an_end_of_no_kind_is_refused_and_found(tmp_path):
    """When the file is read, by its field; and of a family in memory."""
    family = of.load_family(SHIPPED["quadruple-mode-1"])
    wrong = replace(family.ends[0], kind="retuned")
    path = save_family(replace(family, ends=(wrong,)), tmp_path)
    with pytest.raises(InputError, match=r"ends\[0\].kind: no family ends in 'retuned', did you mean 'returned'\?"):
        of.load_family(path)
    assert CliRunner().invoke(cli, ["verify", str(path)]).exit_code == 2
    assert "no family ends in 'retuned'" in said_of(family, wrong).note


@pytest.mark.parametrize("name", SHIPPED)
def test_an_end_under_another_name_is_found(name):
    """As every kind that there is, by what it says and what it lacks."""
    family = of.load_family(SHIPPED[name])
    for side, end in enumerate(family.ends):
        assert said_of(family, end, side).passed
        for kind in ENDS:
            assert kind == end.kind or not said_of(family, replace(end, kind=kind), side).passed, (end.kind, kind)


@pytest.mark.parametrize("field", ["joined", "saddles"])
def test_what_an_end_cannot_say_is_found(field):
    family = of.load_family(SHIPPED["five-bar-fast"])
    said = said_of(family, replace(family.ends[0], **{field: {} if field == "joined" else ()}))
    assert not said.passed and f"{field}: there is none at an end of kind equilibrium" in said.note


def test_what_is_not_checked_of_an_end_is_said(tmp_path):
    """A step that could not be taken leaves nothing to solve for again."""
    family = of.load_family(SHIPPED["quadruple-mode-1"])
    lost = End("step underflow", "step below 1e-07: no convergence")
    path = save_family(replace(family, events=(), ends=(lost,)), tmp_path)
    answer = CliRunner().invoke(cli, ["verify", str(path)])
    # six changes of stability between points, whose events were left out, and the end
    assert answer.exit_code == 0 and "not checked: a step that failed is not tried again" in answer.output
    assert "7 of them not checked" in answer.output


@pytest.mark.parametrize("end", FALSE, ids=lambda end: end.kind)
def test_an_end_that_is_not_there_is_found(end):
    """By what is computed from the record's orbits, not by its words."""
    family = of.load_family(ROOT / "results" / "families" / "henon-heiles-loop" / "family.json")
    said = said_of(family, end, 1)
    assert not said.passed and "where its reason says" not in said.note


def test_a_step_that_fails_beside_a_saddle_is_called_homoclinic():
    family = of.load_family(ROOT / "results" / "families" / "henon-heiles-straight" / "family.json")
    said = said_of(family, End("step underflow", "step below 1e-07: no convergence"), 1)
    assert not said.passed and "homoclinic" in said.note


def test_orbits_at_rest_beside_a_saddle_are_no_singularity():
    """Most of their period they hardly accelerate, so that the swing between is far above the median in time."""
    family = of.load_family(ROOT / "results" / "families" / "henon-heiles-straight" / "family.json")
    curve = curve_in(family, build_model(family.system))
    assert ends.singularity(curve, settled_on(curve, family.points[-1]), "") is None


def test_only_orbits_that_pass_their_saddle_are_followed_in_long_steps_alone():
    """Before that a family may turn sharply and go on: one of three links did, 0.2 J below its saddle."""
    for name, k, shortest in (("triple-1", 0, QUIET.shortest_step), ("henon-heiles-straight", -1, SLOW.step)):
        family = of.load_family(ROOT / "results" / "families" / name / "family.json")
        curve = curve_in(family, build_model(family.system))
        step = SimpleNamespace(solution=settled_on(curve, family.points[k]), stretch=2.0)
        assert slowness(curve, step.solution)[0] > SLOW.share
        assert ends.shortest_step(SimpleNamespace(curve=curve, settings=QUIET), step) == shortest


def test_the_numbers_of_a_hopf_point_are_solved_for_again():
    """Its parameter, its period and an error bar that says too much; as every other kind."""
    model = normal_form()
    problem = of.Problem(model, of.Guess([np.sqrt(HALF), 0.0], 2 * np.pi))
    family = of.follow_family(problem, "mu", settings=DOWN, model=model)
    end = family.ends[0]

    def said(**changed):
        return dict(verified(replace(family, ends=(replace(end, **changed),)), model))["end 0"].passed

    assert said() and said(error=2 * end.error)
    wrong = [{"parameter": 1e-3}, {"period": 1.001 * end.period}, {"error": 0.0}, {"error": 5e-324}, {"error": None}]
    wrong += [{"kind": kind} for kind in ENDS if kind != end.kind]
    assert [changed for changed in wrong if said(**changed)] == []


def test_an_error_bar_of_a_reading_that_says_too_much_is_found():
    family = of.load_family(ROOT / "results" / "families" / "henon-heiles-loop" / "family.json")
    event = next(event for event in family.events if event.check and event.check.error)
    model = build_model(family.system)
    for share, passes in ((1.0, True), (1e-6, False)):
        sharp = replace(event, check=replace(event.check, value=0.0, error=share * event.check.error))
        said = dict(verified(replace(family, events=(sharp,), ends=()), model))
        assert [check.passed for name, check in said.items() if name.startswith("event")] == [passes]
