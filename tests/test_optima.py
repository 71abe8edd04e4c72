"""Families of optima: round turning points, through changes of the active constraints, to motions that cost nothing."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.control import optima
from orbitfinder.control.program import optimum
from orbitfinder.control.stationary import Stationary, Varying
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.mechanics.controls import with_controls

PICK = (of.Task("x", 0.5, equals=1.0), of.Task("xdot", 0.5, equals=0.0))


def pick(stiffness: float, intervals: int, limit: float | None = None, **parts) -> of.Problem:  # type: ignore[no-untyped-def]
    """Rest at -1, rest at 1, back after 2 s."""
    model = of.systems.driven_oscillator(stiffness)
    model = model if limit is None else with_controls(model, ["force"], {"force": limit})
    return of.Problem(model, of.Guess([-1.0, 0.0], 2.0), of.pin(x=-1.0, xdot=0.0, period=2.0), name="pick",
                      control=of.Control("force**2", "linear", intervals, tasks=PICK, **parts))  # fmt: skip


def maintained() -> of.Problem:
    """A damped oscillator whose mean square is held."""
    return of.Problem(
        of.systems.driven_oscillator(1.0, 0.2), of.Guess([1.0, 0.0], 6.3), name="maintained",
        control=of.Control("force**2", "fourier", 8, 1, average=True, guess={"force": 0.01},
                           tasks=(of.Task("x**2 / size", "mean", equals=0.5),), numbers={"size": 1.0}),
    )  # fmt: skip


STIFFNESS, DAMPING, PERIOD, WEIGHT = 1.0, 0.2, 5.0, 3.0


def tilted() -> of.Problem:
    """A driven oscillator that chooses its amplitude A: cost kappa A^2 + A^4 / 4 - weight A^2 / 2 + tilt A."""
    return of.Problem(
        of.systems.driven_oscillator(STIFFNESS, DAMPING), of.Guess([1.6, 0.0], PERIOD),
        of.pin(xdot=0.0, period=PERIOD), name="tilted",
        control=of.Control("force**2", "fourier", 8, 1, average=True, guess={"force": 0.1},
                           final="0.25 * x**4 - 0.5 * weight * x**2 + tilt * x",
                           numbers={"weight": WEIGHT, "tilt": 1.6}),
    )  # fmt: skip


def turning() -> float:
    """The tilt at which A^3 - q A + tilt = 0 has a double root."""
    omega = 2 * np.pi / PERIOD
    gain = (STIFFNESS - omega**2) ** 2 + (DAMPING * omega) ** 2
    q = WEIGHT - 2 / (1 / STIFFNESS**2 + 2 / gain)
    return float(2 / 3 * q * np.sqrt(q / 3))


def certified(found: of.Optima) -> bool:
    return all(one.certificate is not None and one.certificate.passed for one in found)


@pytest.fixture(scope="module")
def folded() -> of.Optima:
    return of.follow_optima(tilted(), "tilt", until=3.0, points=10)


def test_a_family_turns_back_where_the_cubic_has_a_double_root(folded: of.Optima) -> None:
    """Closed form; before the turn a least, beyond it the cost falls in one direction; all are roots of the cubic."""
    assert certified(folded)
    (fold,) = [one for one in folded.changes if one.kind == "fold"]
    assert fold.value == pytest.approx(turning(), rel=1e-11)
    assert set(folded.descents[: fold.index + 1]) == {0} and set(folded.descents[fold.index + 1 :]) == {1}
    assert np.all(np.diff(folded.values[: fold.index + 1]) > 0) and np.all(np.diff(folded.values[fold.index + 1 :]) < 0)
    q = (turning() * 1.5) ** (2 / 3) * 3 ** (1 / 3)
    for value, orbit in zip(folded.values, folded, strict=True):
        a = orbit.state[0]
        assert a**3 - q * a + value == pytest.approx(0.0, abs=1e-9)
        assert orbit.control is not None and orbit.control["numbers"] == {"weight": WEIGHT, "tilt": value}
        said = str(orbit.provenance["optimum"])
        assert said.startswith("local") == (folded.descents[folded.points.index(orbit)] == 0)


def test_beyond_the_turn_the_solver_finds_another_motion(folded: of.Optima) -> None:
    """Past the fold no optimum is near: IPOPT from the last one lands on the other branch."""
    last = max(folded.values)
    problem, control = tilted(), tilted().control
    assert control is not None
    beyond = replace(control, numbers={"weight": WEIGHT, "tilt": last + 0.05})
    other = of.find_orbit(replace(problem, control=beyond))
    assert other.state[0] < -1 < 0 < folded[-1].state[0]


def test_a_weight_that_was_changed_is_rejected(folded: of.Optima) -> None:
    """The record's control is the best for its weight and for no other."""
    one = folded[0]
    assert one.control is not None
    claimed = dict(one.control) | {"numbers": {"weight": WEIGHT * 1.01, "tilt": 1.6}}
    failures = of.certify(replace(one, control=claimed)).failures
    assert "stationarity" in failures and "cost" in failures


def test_the_conditions_are_those_of_finite_differences() -> None:
    """The derivatives of the conditions, theta a number and theta what a task asks."""
    for problem, what in ((tilted(), "number"), (pick(4.0, 6, 20.0), "task")):
        control = problem.control
        assert control is not None
        program, solution = optimum(problem, control, 1e-10)
        varying = Varying(1.0, task=0, slopes=(1.0, 1.0))
        if what == "number":
            program = type(program)(problem, control, program.parts.steps, ("tilt",))
            varying = Varying(1.6, unknown="tilt")
        system = Stationary(program, solution, varying)
        point = system.started()
        active, names = point.active, list(point.active)
        assert np.abs(system._system(point.z, point.y, active)[0]).max() < 1e-9
        random = np.random.default_rng(1)
        dz, dy = random.normal(size=point.z.size), np.zeros(point.y.size)
        dy[names] = random.normal(size=len(names))
        near = [system._system(point.z + h * dz, point.y + h * dy, active)[0] for h in (1e-5, -1e-5)]
        exact = system._system(point.z, point.y, active)[1] @ np.concatenate([dz, dy[names]])
        np.testing.assert_allclose((near[0] - near[1]) / 2e-5, exact, rtol=1e-6, atol=1e-6 * np.abs(exact).max())


@pytest.mark.parametrize(
    ("parameter", "until", "value"),
    [
        ("damping", 0.1, lambda one: 0.1**2 * (1 - 0.1**2 / 4) / 2),
        ("task 1", 0.8, lambda one: 0.2**2 * (1 - 0.2**2 / 4) / 2 * 1.6),
        ("size", 1.5, lambda one: 0.2**2 * (1 - 0.2**2 / 4) / 2 * 1.5),
    ],
)
def test_the_kept_amplitude_costs_what_the_closed_form_says(parameter, until, value) -> None:  # type: ignore[no-untyped-def]
    """c^2 (k - c^2 / 4) / 2 along damping, what the task asks, and a number of the control."""
    found = of.follow_optima(maintained(), parameter, [until])
    assert certified(found) and len(found) == 1
    assert found.costs[0] == pytest.approx(value(until), rel=1e-10) and found.descents == (0,)


def test_the_family_goes_through_the_motion_that_costs_nothing() -> None:
    """At stiffness (2 pi / T)^2 the spring does it alone; beyond, it costs again. The end is where it was asked to."""
    found = of.follow_optima(pick(8.0, 10), "stiffness", [8.0, 11.0])
    (free,) = found.changes
    assert free.kind == "costless" and free.value == pytest.approx(np.pi**2, rel=1e-10) and free.cost < 1e-18
    assert certified(found) and min(found.costs) > 0.1 and found.end == "stiffness reached 11"


Calm = tuple[of.Optima, list[bytes], int]


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> Calm:
    """A family of optima that nobody disturbs, the lines of its journal, and how much was solved for it."""
    with pytest.MonkeyPatch.context() as patch:
        solves, folder = counted(patch), tmp_path_factory.mktemp("calm")
        found = of.follow_optima(pick(4.0, 8, 7.0), "limit force", until=2.0, points=25, out=folder)
        return found, (folder / "pick" / "optima.jsonl").read_bytes().splitlines(keepends=True), len(solves)


def test_a_limit_becomes_active_and_then_leaves_no_way_on(calm: Calm) -> None:
    """Limits are met one after the other, named; the smallest limit is that of bang-bang, below which none can."""
    found, *_ = calm
    assert certified(found) and set(found.descents) == {0}
    first = found.changes[0]
    free = of.follow_optima(pick(4.0, 8), "stiffness", [4.0])
    most = np.abs(free[0].control["coefficients"]).max()  # type: ignore[index]
    assert first.kind == "active" and first.value == pytest.approx(most, rel=1e-9)
    assert "force at phase 0 at its highest" in first.detail
    last, least = found[-1].control, found.values[-1]
    assert last is not None and last["limits"]["force"][1] == least and "leave no way on" in found.end
    used = np.abs(last["coefficients"][0])
    assert np.all((used < 1e-8) | (np.abs(used - least) < 1e-8 * least)) and found.costs[-1] > found.costs[0] + 1
    of.find_orbit(pick(4.0, 8, 1.001 * least))
    with pytest.raises(ConvergenceError, match="no motion does what is asked"):
        of.find_orbit(pick(4.0, 8, 0.999 * least))


def alike(one: of.Optima, other: of.Optima) -> bool:
    """Whether two families are the same to the last bit, but for the time that they took."""
    numbers = [
        (found.name, found.values.tolist(), found.costs.tolist(), found.descents, found.changes, found.end,
         [(point.name, point.state.tolist(), point.certificate) for point in found])
        for found in (one, other)
    ]  # fmt: skip
    return numbers[0] == numbers[1]


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is solved from now on, in this test."""
    return counted(monkeypatch)


def counted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is solved from now on: "first" by IPOPT, "point" by a corrector, "certificate"."""
    done: list[str] = []
    for owner, name, what in ((optima, "optimum", "first"), (optima, "certified", "certificate"),
                              (Stationary, "corrected", "point")):  # fmt: skip
        whole = getattr(owner, name)
        monkeypatch.setattr(
            owner, name, lambda *given, _whole=whole, _what=what: (done.append(_what), _whole(*given))[1]
        )
    return done


@pytest.mark.parametrize("lines", [6, *(pytest.param(lines, marks=pytest.mark.slow) for lines in (1, 4, -1))])
def test_a_journal_cut_anywhere_ends_the_same(calm: Calm, tmp_path: Path, solved: list[str], lines: int) -> None:
    """Before, at and beyond a corner and where equations were stated anew; what it has is not solved again."""
    undisturbed, whole, count = calm
    lines %= len(whole)  # how many depends on the processor: the last steps before the end are round-off
    journal = tmp_path / "pick" / "optima.jsonl"
    journal.parent.mkdir()
    journal.write_bytes(b"".join(whole[:lines]) + whole[lines][:99])
    again = of.follow_optima(pick(4.0, 8, 7.0), "limit force", until=2.0, points=25, out=tmp_path)
    assert len(whole) > 8 and alike(again, undisturbed) and len(journal.read_bytes().splitlines()) == len(whole)
    assert ("first" in solved) == (lines == 1) and len(solved) <= count - (lines > 1) * lines


MORE = ({"until": 0.3}, {"until": 0.23}, {"until": 0.3, "points": 3}, {"until": 0.19})


@pytest.mark.slow
def test_a_family_goes_on_farther_nearer_and_the_other_way(tmp_path: Path, solved: list[str]) -> None:
    """What is known of what is asked is not solved again, and the rest is as if all had been asked at once."""
    of.follow_optima(maintained(), "damping", until=0.24, points=2, out=tmp_path)
    for asked in MORE:
        solved.clear()
        found = of.follow_optima(maintained(), "damping", **asked, out=tmp_path)
        count, first = len(solved), "first" in solved
        assert alike(found, of.follow_optima(maintained(), "damping", **asked)) and not first
        assert count < len(solved) - count
    solved.clear()
    assert of.follow_optima(maintained(), "damping", until=0.23, out=tmp_path).end == "damping reached 0.23"
    assert not solved
    with pytest.raises(
        InputError, match=r"damping: 0\.2 there, 0\.19 asked for; .*not written over: give another folder"
    ):
        of.follow_optima(maintained(), "damping", [0.19], out=tmp_path)
    assert not solved  # another question


def test_optima_are_saved_loaded_drawn_and_members_verified(tmp_path: Path, folded: of.Optima) -> None:
    path = of.save_optima(folded, tmp_path / "optima.json")
    again = of.load_optima(path)
    assert again.changes == folded.changes and again.descents == folded.descents and again.end == folded.end
    np.testing.assert_array_equal(again.values, folded.values)
    np.testing.assert_array_equal(again.costs, folded.costs)
    assert of.certify(of.load_orbit(f"{path}#2")).passed
    table, known = again.tables(), folded.tables()["points"]  # the motions integrated again, and as they are known
    assert (
        np.array_equal(table["points"]["cost"], folded.costs) and table["events"]["point"][0] == folded.changes[0].index
    )
    assert np.allclose(table["points"]["amplitude_x"], known["amplitude_x"], rtol=1e-5)
    assert np.array_equal(table["points"][folded.parameter], folded.values) and all(known["certified"])
    assert of.save_optima_figure(again, tmp_path).stat().st_size > 5000
    assert "10 points, 10 of them certified" in folded.counts
    document = json.loads(path.read_text())
    for broken in ({"values": [1.0]}, {"points": []}, {"version": 9}, {"changes": [{"kind": "fold"}]}):
        path.write_text(json.dumps(document | broken))
        with pytest.raises(InputError, match="malformed entry|version"):
            of.load_optima(path)


def test_continue_follows_a_controlled_problem(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = "problems/control/maintained-oscillator.toml"
    out = ["--out", str(tmp_path), "--json"]
    done = CliRunner().invoke(cli, ["continue", file, "--parameter", "damping", "--at", "0.2,0.19", *out])
    assert done.exit_code == 0, done.output
    said, told = json.loads(done.stdout), capfd.readouterr().err.splitlines()
    assert said["costs"] == pytest.approx([d**2 * (1 - d**2 / 4) / 2 for d in (0.2, 0.19)], rel=1e-10)
    assert [" s left" in line for line in told if "cost" in line] == [True, False]
    assert {Path(one).name for one in said["written"]} == {"optima.json", "optima.png"}
    given = ["--parameter", "damping"]
    wrong_ones = {"--parameter": ["--until", "1"], "--until": given, "--direction": [*given, "--direction", "both"]}
    for words, wrong in wrong_ones.items():
        wrong = [*wrong, "--until", "1"] if words == "--direction" else wrong
        refused = CliRunner().invoke(cli, ["continue", file, *wrong, *out])
        assert refused.exit_code == 2 and words in refused.output


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: of.follow_optima(pick(4.0, 6), "task 3", [1.0]), "'task 3' is no pin and no physical parameter"),
        (lambda: of.follow_optima(pick(4.0, 6), "limit force", [1.0]), "is no pin"),
        (lambda: of.follow_optima(pick(4.0, 6), "stiffness"), "give finite values of stiffness, or until"),
        (lambda: of.follow_optima(pick(4.0, 6), "stiffness", [np.nan]), "give finite values"),
        (lambda: of.follow_optima(maintained(), "mass", until=0.0), "until: mass cannot become 0: "),
        (lambda: of.follow_optima(maintained(), "period", [-1.0]), "values: period: must be positive, got -1"),
        (lambda: of.follow_optima(pick(4.0, 6), "stiffness", [4.0], points=0), "points: must be at least 1"),
        (lambda: of.follow_optima(pick(4.0, 6, 9.0), "limit force", [-1.0]), "a range cannot end at -1"),
        (lambda: of.Control("u", numbers={"a b": 1.0}), "'a b' cannot be a name"),
        (lambda: of.Control("u", numbers={"a": np.inf}), "control.numbers.a: must be a finite number"),
        (lambda: of.find_orbit(pick(4.0, 6, numbers={"x": 1.0})), "'x' is a name of the system already"),
    ],
)  # fmt: skip
def test_what_cannot_be_followed_is_said(make, words: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=re.escape(words)):
        make()
