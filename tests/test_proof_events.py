"""Folds, doublings and branch points proved as zeros of bordered systems: closed forms, numbers of 140 bits, false
records, a replay without any evaluator of floats."""

import json
import shutil
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("flint")

from no_evaluators import printed

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.proof.balls import arb, arb_mat, precision
from orbitfinder.proof.bordered import events, false_claims, invertible, prove_event, read_event, replayed_event
from orbitfinder.proof.program import derived
from orbitfinder.proof.series import BALLS

pytestmark = pytest.mark.needs("proof")
ROOT = Path(__file__).parents[1]
EVENTS = ROOT / "results" / "proofs" / "events"
NUMBERS = {one["id"]: one["values"] for one in json.loads((ROOT / "tests/data/curves.json").read_text())["entries"]}
FOLDS, DOUBLING = NUMBERS["duffing-folds"]["F0.5"], NUMBERS["driven-pendulum"]["PD1"]
STRAIGHT = ROOT / "results" / "families" / "henon-heiles-straight" / "family.json"


def inside(ball, number, width=1e-16):
    """Whether a narrow recorded ball holds a number."""
    return abs(Decimal(ball["value"]) - Decimal(number)) < Decimal(ball["radius"]) < width


@pytest.mark.parametrize(
    ("name", "number", "kind", "side"),
    [
        ("duffing-0", FOLDS["upper"], "fold", "smaller"),
        ("duffing-2", FOLDS["lower"], "fold", "larger"),
        ("pendulum-0", Decimal(DOUBLING) * Decimal("2.25"), "period_doubling", ""),
    ],
)
def test_recorded_events_hold_the_numbers_of_140_bits(name, number, kind, side):
    """Duffing's folds at force 0.5 and the driven pendulum's first doubling, its torque 9/4 of gamma there."""
    record = read_event(EVENTS / f"{name}.json")
    assert record.proved and (record.kind, record.side) == (kind, side) and inside(record.value, number)


REPLAY = """
import sys
from no_evaluators import forbid
from orbitfinder.proof.bordered import false_claims, read_event, replayed_event
forbid()
for file in sys.argv[1:]:
    record = read_event(file)
    again = replayed_event(record)
    print(again.kind, false_claims(record, again))
"""


def test_events_are_replayed_in_another_process_without_evaluators():
    """NumPy's functions, DOP853 and CasADi's evaluation of numbers raise there; graphs alone are made."""
    files = [EVENTS / f"{name}.json" for name in ("duffing-2", "pendulum-0", "henon-heiles-straight-14")]
    said = printed(REPLAY, *files)
    assert said.splitlines() == ["fold []", "period_doubling []", "branch_point []"]


@pytest.fixture(scope="module")
def replays():
    """A recorded fold and the same proved again."""
    record = read_event(EVENTS / "duffing-2.json")
    return record, replayed_event(record)


@pytest.mark.parametrize("name", ["value", "period", "state", "tangent"])
def test_claims_that_are_not_proved_are_named(replays, name):
    """A ball moved by 1e-9 or shrunk to nothing; another kind, side or contraction."""
    record, again = replays
    whole = getattr(record, name)
    ball = whole if isinstance(whole, dict) else whole[0]
    for wrong in ({"value": str(Decimal(ball["value"]) + Decimal("1e-9"))}, {"radius": 1e-40}):
        other = {**ball, **wrong}
        false = replace(record, **{name: other if isinstance(whole, dict) else (other, *whole[1:])})
        assert [one.partition(":")[0] for one in false_claims(false, again)] == [name]
    for words in ({"kind": "period_doubling"}, {"side": "smaller"}, {"contraction": 1e-12}):
        assert [one.partition(":")[0] for one in false_claims(replace(record, **words), again)] == [*words]


def test_records_of_other_equations_are_rejected(replays):
    """A constant changed by 1e-3, another closing of y, a period gone back in time, the centre moved, another
    parameter, an elongation that is pi more in the end."""
    record, _ = replays
    rest = np.reshape(record.centre[5:-1], (3, 6))[::-1] - [0, 0, 0, 0, 0, 2 * np.pi]
    back = {"cycles": -1, "centre": (*record.centre[:5], *rest.ravel().tolist(), -record.centre[-1])}
    assert "the period could be none" in replayed_event(replace(record, **back)).reason
    assert "what is no angle" in replayed_event(replace(record, constants=(2, 0))).reason
    system = {**record.system, "arguments": {**record.system["arguments"], "damping": 0.1 * 1.001}}
    moved = (record.centre[0] + 1e-6, *record.centre[1:])
    changes = [{"system": system}, {"twist": (-1, -1)}, {"centre": moved}, {"parameter": "cubic"}]
    for change in changes:
        assert not replayed_event(replace(record, **change)).proved, change
    for change in ({"centre": record.centre[:-1]}, {"twist": (1, -1)}, {"parameter": "energy"}, {"turns": ()}):
        with pytest.raises(InputError, match="do not fit the system|events are proved in"):
            replayed_event(replace(record, **change))


@pytest.fixture(scope="module")
def rings():
    """r' = r (m + r^2 - r^4), round in 2 pi: two circles that meet at m = -1/4, r^2 = 1/2."""

    def field(_, x, p):
        s = x.x**2 + x.y**2
        growth = p.m + s - s**2
        return [growth * x.x - x.y, growth * x.y + x.x]

    model = of.ode(field, ("x", "y"), {"m": -0.2})
    radius = np.sqrt((1 + np.sqrt(0.2)) / 2)
    problem = of.Problem(model, of.Guess([radius, 0.0], 2 * np.pi), name="rings")
    settings = of.FamilySettings(directions="backward", points=12)
    return model, of.follow_family(problem, "m", until=-0.26, settings=settings)


def test_a_fold_of_circles_by_its_closed_form(rings):
    """An autonomous system: the parameter, radius and period are exact; the same at a place where there is no fold."""
    model, family = rings
    number = next(k for k, event in enumerate(family.events) if event.kind == "fold")
    proof = prove_event(family, number, model)
    assert proof.proved and proof.side == "larger" and inside(proof.value, "-0.25"), proof.reason
    assert inside(proof.period, "6.28318530717958647692528676655900576839")
    assert sum(float(ball["value"]) ** 2 for ball in proof.state) == pytest.approx(0.5, abs=1e-15)
    point = family.points[0]
    place = {"index": 0, "parameter": point.value, "state": point.state, "period": point.period, "free": point.free}
    planted = prove_event(replace(family, events=(replace(family.events[number], **place),)), 0, model)
    assert not planted.proved and ("no such event" in planted.reason or "no orbit near" in planted.reason)


def test_commands_prove_and_replay_an_event(tmp_path):
    """`prove --event` writes the record beside the family, `verify --proof` replays it; bad input is named."""
    file, run = shutil.copy(STRAIGHT, tmp_path / "family.json"), CliRunner().invoke
    said = run(cli, ["prove", str(file), "--event", "14"])
    assert said.exit_code == 0 and "branch point at energy = 0.1615515151108136106" in said.output, said.output
    record = tmp_path / "event-14-proof.json"
    again = run(cli, ["verify", "--proof", str(record)])
    assert again.exit_code == 0 and "proof replayed" in again.output, again.output
    shown = run(cli, ["show", str(record)])
    assert shown.exit_code == 0 and "branch_point" in shown.output
    events.save(replace(read_event(record), kind="fold"), record)
    wrong = run(cli, ["verify", "--proof", str(record)])
    assert wrong.exit_code == 1 and "REJECTED: kind: recorded 'fold'" in wrong.output
    for number, message in (("0", "0 is a resonance"), ("999", "counted from 0, got 999"), ("16", "no orbit near")):
        refused = run(cli, ["prove", str(file), "--event", number, "--no-record"])
        assert refused.exit_code in (1, 2) and message in refused.output + str(refused.exception), refused.output


def test_a_family_must_go_on_at_what_is_no_fold(monkeypatch):
    """The orbits' own equations are shown to be regular at a doubling, which a singular matrix of balls is not."""
    assert not invertible(arb_mat([[1, arb(1, 0.1)], [1, 1]])) and invertible(arb_mat([[2, arb(1, 0.1)], [1, 1]]))
    monkeypatch.setattr("orbitfinder.proof.bordered.invertible", lambda slopes: False)
    again = replayed_event(read_event(EVENTS / "pendulum-0.json"))
    assert not again.proved and "could not be shown to go on" in again.reason
    monkeypatch.setattr("orbitfinder.proof.bordered.has_symmetry", lambda *_: False)
    again = replayed_event(read_event(EVENTS / "henon-heiles-straight-14.json"))
    assert not again.proved and "could not be shown to keep the energy" in again.reason


def test_slopes_of_numbers_are_exact():
    """CasADi makes 8/3 of the slope of 8 z / 3, and a float of it: numbers are kept apart until they are balls."""
    z = ca.SX.sym("z")
    graph = 8 * z / 3 + z**3 / 5 + z**0.3
    code = derived("slopes", [z], graph, lambda graph: [ca.jacobian(graph, z), ca.jacobian(ca.jacobian(graph, z), z)])
    with precision(160):
        first, second = (result[0] for result in code.run([[arb(2)]], BALLS))
        power = arb(0.3) * arb(2) ** (arb(0.3) - 1)
        exact = arb(8) / 3 + arb(12) / 5 + power, arb(12) / 5 + (arb(0.3) - 1) * power / 2
        assert all(
            ball.overlaps(value) and ball.rad() < 1e-40 for ball, value in zip((first, second), exact, strict=True)
        )


@pytest.mark.slow
def test_a_doubling_of_lorenz_is_that_of_140_bits():
    """Autonomous, 8/3 exactly: with a float for a slope of it the ball would lie 8e-16 beside."""

    def field(_, x, p):
        return [10 * (x.y - x.x), x.x * (p.r - x.z) - x.y, x.x * x.y - 8 * x.z / 3]

    model = of.ode(field, ("x", "y", "z"), {"r": 250.0})
    problem = of.Problem(model, of.Guess([-47.1114, -18.5885, 328.3983], 0.4601), name="lorenz")
    family = of.follow_family(problem, "r", until=229.3, settings=of.FamilySettings(points=20))
    number = next(k for k, event in enumerate(family.events) if event.kind == "period_doubling")
    proof = prove_event(family, number, model)
    assert proof.proved and inside(proof.value, NUMBERS["lorenz-pd"]["PD1_r"], 1e-15), proof.value
    assert inside(proof.period, NUMBERS["lorenz-pd"]["PD1_T"])


@pytest.mark.slow
@pytest.mark.parametrize("file", sorted(EVENTS.glob("*.json")), ids=lambda file: file.stem)
def test_recorded_events_replay(file):
    """All that are shipped."""
    record = read_event(file)
    assert not false_claims(record, replayed_event(record))
