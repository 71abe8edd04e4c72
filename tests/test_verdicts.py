"""Verdicts on stability: none is "asymptotically stable" without a bound, and `verify` recomputes those of families."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.families.verified import verified
from orbitfinder.orbits import hill
from orbitfinder.orbits.balance import begun, states_of
from orbitfinder.orbits.hill import exponents
from orbitfinder.records.family import load_family, save_family

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))
import verdicts as counted  # noqa: E402 - a script

DAMPING, CUBIC, TURN = 5e-4, 0.9, np.array([1.0, -1.0])
ALONE = of.FamilySettings(directions="forward", method="balance", points=3, events=False, certify=False)


def hung(count, frequency=1.0, force=1.6):
    """A driven mass on a soft spring, a second one hung on it by a cubic spring, and idle ones."""
    springs = np.array([0.35, 1.934, *np.linspace(20.0, 60.0, count - 2)])
    model = of.structure(
        np.eye(count), DAMPING * np.eye(count), np.diag(springs),
        {"a": {"kind": "cubic", "at": "q2", "to": "q1", "stiffness": CUBIC}},
        {"at": "q1", "amplitude": force, "frequency": frequency},
    )  # fmt: skip
    return of.Problem(model, of.guesses.linear_response(model), method="balance", name="hung")


def largest(state, frequency, force=1.6):
    """The largest multiplier of the two masses that move, by SciPy; the others only decay."""
    n = state.size // 2
    springs = np.array([0.35, 1.934])

    def rates(t, z):
        q, v, d = z[:2], z[2:4], z[1] - z[0]
        pull = np.array([force * np.cos(frequency * t), 0.0]) - DAMPING * v - springs * q + CUBIC * d**3 * TURN
        slope = 3 * CUBIC * d * d * np.array([[1.0, -1.0], [-1.0, 1.0]])
        matrix = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag(springs) - slope, -DAMPING * np.eye(2)]])
        return np.r_[v, pull, (matrix @ z[4:].reshape(4, 4)).ravel()]

    start = np.r_[state[:2], state[n : n + 2]]
    end = solve_ivp(rates, (0, 2 * np.pi / frequency), np.r_[start, np.eye(4).ravel()], "DOP853",
                    rtol=1e-10, atol=1e-12).y[:, -1]  # fmt: skip
    assert np.abs(end[:4] - start).max() < 1e-7
    return np.abs(np.linalg.eigvals(end[4:].reshape(4, 4))).max()


@pytest.mark.parametrize(
    ("frequency", "force"),
    [(1.0, 1.6), pytest.param(1.01, 1.6, marks=pytest.mark.slow), pytest.param(1.0, 1.5, marks=pytest.mark.slow)],
)
def test_what_grows_beside_a_large_motion_is_not_called_stable(frequency, force):
    """41 masses of which one pair grows by 6.2 and more a period: averaging of first order took them for stable."""
    point = begun(hung(41, frequency, force), "")
    about = exponents(point.problem, point.w)
    assert about.stability == "unstable"
    true = largest(states_of(point, np.zeros(1))[0], frequency, force)
    assert np.abs(about.multipliers).max() == pytest.approx(true, rel=1e-7)
    assert true > 1.5
    if (frequency, force) == (1.0, 1.6):
        assert true == pytest.approx(6.223235, abs=1e-6)


def test_averaging_says_what_its_next_order_is_where_that_is_not_small(monkeypatch):
    """The same two masses as structures of over 100 coordinates are judged."""
    monkeypatch.setattr(hill, "ALL", 1)
    point = begun(hung(2), "")
    about = exponents(point.problem, point.w)
    assert about.stability == "undecided"
    assert "the next order of averaging is 2 of the first" in about.why


def test_every_multiplier_of_up_to_a_hundred_coordinates_is_known():
    """Of linear springs they are those of the matrices."""
    count, frequency = 60, 0.7
    springs = np.linspace(1.0, 9.0, count)
    model = of.structure(np.eye(count), 0.05 * np.eye(count), np.diag(springs), {},
                         {"at": "q1", "amplitude": 0.1, "frequency": frequency})  # fmt: skip
    point = begun(of.Problem(model, of.guesses.linear_response(model), method="balance"), "")
    about = exponents(point.problem, point.w)
    assert (about.stability, about.multipliers.size) == ("asymptotically stable", 120)
    sizes = np.exp(-0.025 * 2 * np.pi / frequency)
    assert np.abs(about.multipliers) == pytest.approx(np.full(120, sizes), rel=1e-8)


@pytest.fixture(scope="module")
def few():
    """Three points of Duffing's oscillator by shooting, and their model."""
    model = of.systems.forced_duffing(frequency=0.6)
    settings = replace(ALONE, method=None)
    family = of.follow_family(of.Problem(model, of.guesses.linear_response(model)), "frequency", settings=settings)
    return family, model


def doctored(family, k, word):
    return replace(
        family, points=(*family.points[:k], replace(family.points[k], stability=word), *family.points[k + 1 :])
    )


def failed(family, model):
    return [check.name for _, check in verified(family, model) if not check.passed]


@pytest.mark.parametrize("word", ["unstable", "marginal", "elliptic"])
@pytest.mark.parametrize("k", [0, 1, 2])
def test_a_doctored_verdict_of_a_family_is_refused(few, k, word):
    assert failed(*few) == []
    assert failed(doctored(few[0], k, word), few[1]) == ["verdicts"]


@pytest.fixture(scope="module")
def many():
    """Three points of 41 masses by balance."""
    problem = hung(41)
    return of.follow_family(problem, "frequency", until=1.05, settings=ALONE), problem.model


def test_a_family_by_balance_says_so_at_every_point(many):
    """The first points of the case that `verify` let pass: each has a multiplier of 6 or more."""
    for point in many[0].points:
        assert (point.stability, point.floquet_multipliers.size) == ("unstable", 82)
        assert np.abs(point.floquet_multipliers).max() == pytest.approx(largest(point.state, point.value), rel=1e-6)


@pytest.mark.slow
def test_a_doctored_verdict_of_a_family_by_balance_is_refused(many):
    assert failed(*many) == []
    for k in range(3):
        assert failed(doctored(many[0], k, "asymptotically stable"), many[1]) == ["verdicts"]
    every = replace(many[0], points=tuple(replace(p, stability="asymptotically stable") for p in many[0].points))
    assert failed(every, many[1]) == ["verdicts"]
    assert failed(doctored(many[0], 1, "undecided"), many[1]) == ["verdicts"]


@pytest.mark.slow
def test_the_family_that_verify_let_pass(tmp_path):
    """From the command line: where the orbit becomes stable a branch point is located, and a point, the family and the
    doctored family are verified as they are."""
    family = of.follow_family(hung(41), "frequency", until=1.05, out=tmp_path,
                              settings=replace(ALONE, points=16, events=True, certify=True))  # fmt: skip
    for point in family.points:
        assert (point.stability == "unstable") == (largest(point.state, point.value) > 1)
    assert [(event.kind, round(event.parameter, 6)) for event in family.events] == [
        ("branch_point", 1.048038), ("stability_change", 1.048038),
    ]  # fmt: skip
    path = tmp_path / "hung" / "family.json"
    assert CliRunner().invoke(cli, ["verify", str(path), f"{path}#0", f"{path}#2"]).exit_code == 0
    save_family(doctored(load_family(path), 2, "asymptotically stable"), path.parent)
    answer = CliRunner().invoke(cli, ["verify", str(path)])
    assert answer.exit_code == 1 and "verdicts" in answer.output
    again = replace(family, events=(*family.events, family.events[-1]))
    assert failed(again, hung(41).model) == ["changes"]


@pytest.mark.slow
def test_a_hundred_structures_whose_springs_harden_by_half():
    """10 to 80 coordinates: no verdict is against the monodromy, and at most one in five is left open."""
    senses = [counted.sense(*each) for each in counted.structures(100)]
    orbits = [sense for sense in senses if sense != "no orbit"]
    assert len(orbits) >= 80 and "wrong" not in orbits
    assert 5 * sum(sense in counted.LESS for sense in orbits) <= len(orbits)
    assert orbits.count("right") >= 80
