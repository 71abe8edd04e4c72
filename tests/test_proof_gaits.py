"""Proofs of orbits with impacts: the walkers by the reference's digits, the wheel's closed form, failures."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("flint")

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.mechanics.hybrid import hybrid
from orbitfinder.problemfile.read import load_problem_file
from orbitfinder.proof.balls import arb, midpoints, precision
from orbitfinder.proof.bordered import false_claims, read_event, replayed_event
from orbitfinder.proof.gaits import course
from orbitfinder.proof.record import entry, replay
from orbitfinder.proof.theorem import Options, provable_model, prove, refine, settings_for
from orbitfinder.records.orbit import read_document
from orbitfinder.records.reading import write_json

pytestmark = pytest.mark.needs("proof")
ROOT = Path(__file__).parents[1]
REFERENCE = {
    part["id"]: part["values"] for part in json.loads((ROOT / "tests/data/hybrid.json").read_text())["entries"]
}


def orbit_of(name):
    """An orbit of problems/hybrid."""
    return of.find_orbit(load_problem_file(ROOT / f"problems/hybrid/{name}.toml").problem)


@pytest.fixture(scope="module")
def walking():
    """The simplest walker's gaits and what is proved of them."""
    orbits = {name: orbit_of(f"simplest-walker-{name}") for name in ("long", "short", "period-2")}
    return {name: (orbit, prove(orbit)) for name, orbit in orbits.items()}


def test_both_gaits_are_proved(walking):
    """The 30 digits of the long gait in the balls, its multipliers too; the short one is unstable."""
    (_, long), (_, short) = walking["long"], walking["short"]
    given = REFERENCE["walker-long"]
    with precision(200):
        for ball, value in ((long.state[0], "theta"), (long.state[2], "thetadot"), (long.period, "T")):
            assert ball.contains(arb(given[value])) and ball.rad() < 1e-14
    assert long.proved and long.stability.verdict == "asymptotically stable" and long.minimal
    pair = long.stability.multipliers[:2]
    assert all(abs(float(mu.real.mid()) + 0.190099841065888) < 1e-9 for mu in pair)
    assert all(abs(abs(float(mu.imag.mid())) - 0.557598776682068) < 1e-9 for mu in pair)
    assert short.proved and short.stability.verdict == "unstable"
    assert float(short.stability.multipliers[0].real.mid()) == pytest.approx(4.00386436, rel=1e-8)


def test_two_steps_are_a_gait_of_their_own(walking):
    """The gait of two steps is proved, with a first step that is not its second; twice the long gait is not minimal."""
    proof = walking["period-2"][1]
    assert proof.proved and proof.segments == 2 and not proof.nodes[0][0].overlaps(proof.nodes[1][0])
    once = walking["long"][0]
    twice = replace(once, period=2 * once.period, system={**once.system, "cycle": ["strike", "strike"]})
    assert "after 1 arc too" in prove(twice).reason


def test_a_wheel_has_the_speed_of_its_closed_form():
    """Rimless, 8 spokes: omega+ by energy and cos^2, the multiplier 1/2."""
    proof = prove(orbit_of("rimless-wheel"))
    assert proof.proved and proof.stability.verdict == "asymptotically stable"
    given = REFERENCE["rimless"]
    speeds = [abs(float(ball.mid())) for ball in proof.state]  # pi / 8 is a double in its graph
    assert any(abs(speed - float(given["omega_plus"])) < 1e-14 for speed in speeds)
    assert abs(float(proof.period.mid()) - float(given["T"])) < 1e-14
    assert abs(float(proof.stability.multipliers[0].real.mid()) - 0.5) < 1e-9


def test_what_is_no_gait_is_not_proved(walking):
    """A state that is off; another slope; a guard that would fire at once, or a hold that would break."""
    orbit, _ = walking["long"]
    assert "not within 1e-09" in prove(replace(orbit, state=orbit.state + 1e-8)).reason
    other = {**orbit.system, "arguments": {"slope": 0.009 * 1.001}}
    assert not prove(replace(orbit, system=other)).proved
    model = load_problem_file(ROOT / "problems/hybrid/simplest-walker-long.toml").model
    modes, (strike,), _ = model.hybrid.given
    bare = hybrid(modes, [replace(strike, allowed=None)], ["strike"], system=model.system)
    assert "could be 0 before the end" in prove(orbit, bare).reason
    (stance,) = modes
    held = replace(stance, holds={"nothing": lambda x, p: x.theta})
    said = prove(orbit, hybrid([held], [strike], ["strike"], system=model.system)).reason
    assert "nothing could become negative" in said


def test_arcs_last_some_time(walking):
    """Backwards in time the flow is as regular, and no motion of the machine."""
    orbit, proof = walking["long"]
    with precision(106):
        cycle = course(provable_model(orbit))
        for sign, said in ((1, ""), (-1, "could last no time")):
            box = [*proof.nodes[0], sign * proof.period]
            fault = cycle.fault([cycle.arcs[0].passed(box, midpoints(box), Options())])
            assert said in fault and bool(said) is bool(fault)


def test_a_gait_is_recorded_and_replayed(walking, tmp_path, monkeypatch):
    """In the orbit.json; what is changed in it is rejected."""
    orbit, proof = walking["long"]
    recorded = entry(proof)
    assert replay(orbit, recorded)[1] == []
    for name, value in (("stability", "unstable"), ("box_radius", 1e-3), ("steps", 3), ("contraction", 1e-12)):
        assert replay(orbit, recorded | {name: value})[1], name
    moved = [{**ball, "value": str(float(ball["value"]) + 1e-9)} for ball in recorded["state"]]
    assert replay(orbit, recorded | {"state": moved})[1]
    monkeypatch.chdir(tmp_path)
    of.save_orbit(orbit, "orbit.json")
    run = CliRunner().invoke
    said = run(cli, ["prove", "orbit.json"])
    assert said.exit_code == 0 and "asymptotically stable" in said.output, said.output
    assert "proof replayed" in run(cli, ["verify", "--proof", "orbit.json"]).output
    document = read_document(Path("orbit.json"))
    document["proof"]["multipliers"] = document["proof"]["multipliers"][::-1][:2]
    write_json(Path("orbit.json"), document)
    assert run(cli, ["verify", "--proof", "orbit.json"]).exit_code == 1


def test_the_first_doubling_of_the_walker_is_proved(walking):
    """At slope 0.01508843794: the record is replayed, and lies between the long gait's multipliers at both sides."""
    record = read_event(ROOT / "results/proofs/events/walker-0.json")
    assert record.proved and record.kind == "period_doubling" and record.contraction < 1e-3
    assert abs(float(record.value["value"]) - 0.0150884379411168) < 1e-13 and float(record.value["radius"]) < 1e-15
    again = replayed_event(record)
    assert false_claims(record, again) == []
    least = []
    for apart in (-1e-6, 1e-6):
        model = of.systems.simplest_walker(slope=float(record.value["value"]) + apart)
        guess = of.Guess([float(ball["value"]) for ball in record.state], float(record.period["value"]))
        orbit = of.find_orbit(of.Problem(model, guess))
        least.append(orbit.floquet_multipliers.real.min())
    assert least[0] > -1 > least[1]  # stable below, a flip above
    doctored = replace(record, value={**record.value, "value": "0.0150884379412"})
    assert any(claim.startswith("value") for claim in false_claims(doctored, again))
    moved = replace(record, centre=(record.centre[0] + 1e-6, *record.centre[1:]))
    assert not replayed_event(moved).proved
    other = {**record.system, "arguments": {"slope": 0.009}, "cycle": ["strike", "strike"]}
    with pytest.raises(InputError, match="numbers do not fit the system"):
        replayed_event(replace(record, system=other))


def test_what_is_not_covered_is_refused():
    """What conserves an energy through its events; many digits."""
    with pytest.raises(InputError, match="conserves energy through its events"):
        prove(orbit_of("gravity-wedge"))
    orbit = orbit_of("rimless-wheel")
    with pytest.raises(InputError, match="without any, not 'brake'"):
        prove(orbit, options=Options(symmetry="brake"))
    with pytest.raises(InputError, match="of systems with events only orbits are proved"):
        refine(orbit, settings_for(20), 20)
    assert np.isfinite(orbit.period)
