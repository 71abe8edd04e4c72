"""How near the true orbit is: which directions are free, what round-off hides, and what a certificate then says."""

import json
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from test_certificate_holes import check, flat, record

import orbitfinder as of
from orbitfinder.errors import ConvergenceError
from orbitfinder.families import verified
from orbitfinder.families.checks import Refuted
from orbitfinder.orbits import closure, evidence
from orbitfinder.orbits.certify import certify
from orbitfinder.orbits.evidence import tour
from orbitfinder.orbits.measure import resolved
from orbitfinder.records.codec import plain, typed
from orbitfinder.records.family import Batch, Reading

ROOT = Path(__file__).parents[1]
CYCLE, PERIOD = [2.008619860874844, 0.0], 6.663286859323132
"""Of van der Pol's oscillator at mu = 1"""


def beside(rates, **more):
    """Van der Pol's oscillator with other states beside it."""
    return of.equations(rates={"x": "v", "v": "(1-x^2)*v-x", **rates}, **more)


@pytest.mark.parametrize("rate", ["1e-2", "1e-6", "1e-9", "5e-10", "3e-11", "1e-12"])
@pytest.mark.parametrize("off", [0.0, 1e-8, 1e-5, 7e-4])
def test_a_slow_state_counts(rate, off):
    """z' = -k (z - 1) comes back to 2e-14 from anywhere, and closes at z = 1 alone."""
    model = beside({"z": f"-({rate})*(z-1)"})
    certificate = certify(flat(model, [*CYCLE, 1.0 + off], PERIOD), model)
    distance = check(certificate, "distance")
    assert distance.passed == (off == 0.0) and (off == 0.0 or distance.value > off)
    assert off or certificate.passed


@pytest.mark.parametrize("off", [0.0, 2e-8, 1e-7, -4e-7])
def test_a_gap_elsewhere_excuses_no_slow_state(off):
    """y' = 20 (x - y) leaves a gap of 1.7e-13, z' = -1e-12 (z - 1) one of 7e-12 times what it is off."""
    model = beside({"y": "20*(x-y)", "z": "-(1e-12)*(z-1)"})
    settled = of.simulate(model, [*CYCLE, 0.0, 1.0], 3 * PERIOD).states[-1]
    certificate = certify(flat(model, [*CYCLE, settled[2], 1.0 + off], PERIOD), model)
    distance = check(certificate, "distance")
    assert distance.passed == (off == 0.0) and (off == 0.0 or distance.value > abs(off) / 2)
    assert off or certificate.passed


@pytest.mark.parametrize("rate", ["1e-9", "1e-12", "1e-17"])
def test_what_a_further_condition_fixes_does_not_count_across_it(rate):
    """How well the least determined direction is known says nothing of the others: of z, nothing of x and v."""
    closes = tour(beside({"z": f"-({rate})*(z-1)"}), np.array([*CYCLE, 1.0007]), PERIOD, np.zeros(3, int)).closes
    assert closes.across < 1e-12 and closes.distance > 7e-4


@pytest.mark.parametrize("rate", ["1e-15", "1e-17"])
def test_a_state_that_no_digits_determine_is_not_certified(rate):
    """Its multiplier is 1 to round-off, and nothing that the equations keep says where it belongs."""
    model = beside({"z": f"-({rate})*(z-1)"})
    certificate = certify(flat(model, [*CYCLE, 1.0007], PERIOD), model)
    assert "distance" in certificate.failures and check(certificate, "distance").value == np.inf


@pytest.mark.parametrize("rate", ["1e-2", "1e-8", "1e-11"])
def test_slow_states_that_feel_each_other_count(rate):
    """A slow pair whose gaps nearly cancel: a' = k (b - a), b' = k (a - b) - k (a + b - 2) / 1000."""
    model = beside({"a": f"({rate})*(b-a)", "b": f"({rate})*(a-b)-({rate})*(a+b-2)/1000"})
    assert rate == "1e-11" or certify(flat(model, [*CYCLE, 1.0, 1.0], PERIOD), model).passed  # 7e-14 from free
    assert "distance" in certify(flat(model, [*CYCLE, 1.00001, 1.00001], PERIOD), model).failures


FREE = {
    "a parameter": ({"p": "0"}, [0.7]),
    "a sum": ({"a": "b-a", "b": "a-b"}, [0.5, 0.5]),
    "copies": ({"y": "-v"}, [-CYCLE[0] + 0.25]),
}


@pytest.mark.parametrize("kind", FREE)
def test_what_the_equations_keep_is_free(kind):
    rates, state = FREE[kind]
    model = beside(rates)
    assert certify(flat(model, [*CYCLE, *state], PERIOD), model).passed


CLOCK, STEADY = {"x": "v", "v": "-2*x-0.2*v+c"}, 1 / (1 + 0.2j)
"""x'' + 0.2 x' + 2 x = c, solved by Re(STEADY exp(i t))"""


@pytest.mark.parametrize("leak", ["0", "1e-9", "1e-12"])
def test_a_clock_drives_until_it_runs_down(leak):
    """Its radius is free as long as the equations keep it."""
    model = of.equations(rates=CLOCK | {"c": f"-s-{leak}*c", "s": f"c-{leak}*s"})
    certificate = certify(flat(model, [STEADY.real, -STEADY.imag, 1.0, 0.0], 2 * np.pi), model)
    assert certificate.passed == (leak == "0") and check(certificate, "distance").passed == (leak == "0")


@pytest.mark.parametrize("leak", ["1e-9", "1e-12"])
def test_what_the_equations_lose_is_not(leak):
    """A sum that runs down."""
    model = beside({"a": "b-a", "b": f"a-b-{leak}*b"})
    assert "distance" in certify(flat(model, [*CYCLE, 0.5, 0.5], PERIOD), model).failures


def test_a_mirror_tells_orbits_that_hardly_differ(monkeypatch):
    """Triple 2 at 4e5 J: the gap of an orbit a little aside grows with 6e-13 of how far that is. What a longer period
    changes the end of a part by is that of differences of its motion."""
    family, ends = of.load_family(ROOT / "results" / "families" / "triple-2" / "family.json"), []

    def measured(gap, rows, transitions, states, late, *precise):
        slope = (3 * states[-1] - 4 * states[-2] + states[-3]) / 2 * (len(states) - 1)
        ends.append(np.abs(late - slope).max() / np.abs(slope).max())
        return closure.distance(gap, rows, transitions, states, late, *precise)

    monkeypatch.setattr(evidence, "distance", measured)
    assert check(certify(family.points[0], of.chain(3)), "distance").value < 1e-12
    assert ends and max(ends) < 1e-2


def test_multipliers_that_underflow_are_taken_in_logarithms():
    """exp(-754) of a fast state: the determinant is 0, and its logarithm the divergence."""
    model = of.equations(rates={"x": "v", "v": "-x", "y": "-120*y"})
    missed, known = tour(model, np.array([1.0, 0.0, 0.0]), 2 * np.pi, np.zeros(3, int)).divergence()
    assert missed < known < 1e-2


def test_stability_that_changes_without_an_event_is_unknown(caplog, monkeypatch):
    family = of.load_family(ROOT / "results" / "families" / "henon-heiles-loop" / "family.json")
    assert not family.unknown
    silent = replace(family, events=tuple(event for event in family.events if event.kind == "turn"))
    assert silent.unknown and "with no certified event between" in silent.unknown[0]

    stable, unstable = (replace(family.points[0], stability=name) for name in ("elliptic", "unstable"))
    for after, word in ((unstable, "unknown"), (stable, "none")):
        batch = answered(Refuted("the family turns there"), after, stable, monkeypatch)
        assert not batch.events and not batch.undecided
        assert f"and is {word}: the family turns there" in caplog.messages[-1]


def answered(said, after, before, monkeypatch):
    """A step with an event of which this is said, a reading or an error."""

    def check(*_):
        if isinstance(said, Exception):
            raise said
        return said

    monkeypatch.setattr(verified, "reading", check)
    event = of.load_family(ROOT / "results" / "families" / "henon-heiles-loop" / "family.json").events[0]
    return verified.checked(None, Batch(1, (after,), (event,)), 1.0, "energy", before)


@pytest.mark.parametrize(("said", "none"), [
    (ConvergenceError("the corrector stalled"), False),
    (ConvergenceError("the orbit closes to 4.8e-08 where errors grow 1.7 times, which is too little"), False),
    (Reading(0.57, 0.92, False), False),
    (Reading(0.57, 0.01, False), True),
    (Refuted("no other family leads through it"), True),
])  # fmt: skip
def test_only_a_check_that_decides_says_none(said, none, caplog, monkeypatch):
    """What no check decides is unknown: in the log, in the family, and by the exit code that it makes."""
    family = of.load_family(ROOT / "results" / "families" / "henon-heiles-loop" / "family.json")
    batch = answered(said, family.points[0], family.points[0], monkeypatch)
    assert not batch.events and f"and is {'none' if none else 'unknown'}: " in caplog.messages[-1]
    assert batch.undecided == (() if none else (caplog.messages[-1],))
    again = typed(Batch, json.loads(json.dumps(plain(batch))), "")
    assert again.undecided == batch.undecided and replace(family, undecided=batch.undecided).unknown == batch.undecided


@pytest.mark.parametrize("power", [3, 5])
def test_an_action_is_resolved_by_its_own_convergence(power):
    """|sin|^p has a kink in its p-th derivative; exp(sin) has none, and is resolved by as many samples."""
    values = {}
    for function in (lambda t: np.abs(np.sin(t)) ** power, lambda t: np.exp(np.sin(t))):
        means = [function(2 * np.pi * (np.arange(64 // by) * by + 0.3) / 64).mean() for by in (1, 2, 4)]
        values[resolved(*means)] = means
    assert set(values) == {False, True} and values[True][0] == pytest.approx(1.2660658777520084, abs=1e-14)


@pytest.mark.parametrize(("kind", "rate"), [("a slow cubic", "1e-8"), ("a pair that cancels", "5e-3")])
def test_a_sample_of_planted_errors(kind, rate, monkeypatch):
    """benchmarks/planted.py plants some 1,900 beside multipliers near 1."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    from planted import slow

    plants = islice(slow(np.random.default_rng(0), [kind], [rate], 1), 2)
    assert [(certify(plant.orbit, plant.model).passed, right) for plant, right in plants] == [(True,) * 2, (False,) * 2]


@pytest.mark.slow
@pytest.mark.parametrize(
    "rates", [{"x": "v", "v": "-x-0.5*abs(v)*v+0.5*v"}, {"x": "v", "v": "-abs(x)*x+0.3*(1-x^2)*v"}]
)
def test_fields_with_a_kink_in_a_derivative_are_certified(rates):
    orbit = of.find_orbit(of.Problem(of.equations(rates=rates), of.Guess([1.6, 0.0], 5.6)))
    assert orbit.certificate.passed


@pytest.mark.slow
def test_a_slow_bursters_round_off_is_not_a_feature():
    """h moves by 3e-5 of itself: steps are as exact as that lets them be."""
    orbit = of.find_orbit(of.load_problem(ROOT / "tests" / "data" / "slow-burst.toml"))
    assert orbit.period == pytest.approx(9738.30923, abs=1e-5) and orbit.certificate.passed
    for component, off in enumerate((1e-8, 1e-8, 1e-6, 1e-8, 1e-8)):  # only h's round-off is more than the picture's
        wrong = orbit.nodes + off * np.ptp(orbit.samples, axis=0) * np.eye(5)[component]
        assert not check(certify(replace(orbit, nodes=wrong)), "nodes").passed


def test_what_long_double_may_tell_needs_a_compiler(monkeypatch):
    """A record that was certified in long double may be refused where there is none."""
    model = beside({"z": "-1e-2*(z-1)"})
    monkeypatch.setenv("CC", "no-such-compiler-here")
    notes = [check(certify(flat(model, [*CYCLE, 1.0 + off], PERIOD), model), "distance").note for off in (0.0, 1e-8)]
    assert ["needs a C compiler" in note for note in notes] == [False, True]


@pytest.mark.parametrize("off", [0.0, 1e-3])
def test_what_stands_still_is_measured_in_its_own_size(off):
    """A conical pendulum, whose angle from the vertical stays: where it passes a mirror is looked for all the same."""
    model, rate = of.systems.spherical_pendulum(), np.sqrt(9.8 / np.cos(0.6))
    orbit = record(model, [0.6, 0.0, 0.0, rate], 2 * np.pi / rate * (1 + off), winding=(0, 1))
    assert check(certify(orbit, model), "distance").passed == (off == 0.0)


@pytest.mark.parametrize("off", [1e-3, 1e-6, 1e-8])
def test_what_hardly_moves_is_measured_beside_what_does(off):
    """Beside a conical pendulum: the angle from the vertical moves by `off`, its rate by what round-off leaves of g."""
    model, rate = of.systems.spherical_pendulum(), np.sqrt(9.8 / np.cos(0.6))
    orbit = record(model, [0.6 + off, 0.0, off, rate], 2 * np.pi / rate, winding=(0, 1))
    assert not certify(orbit, model).passed
