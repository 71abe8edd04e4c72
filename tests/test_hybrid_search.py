"""Searches of hybrid systems: what a scan by hand finds, states that resets make, courses, resumed and sharded runs."""

import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.atlas.sections import EventSection
from orbitfinder.atlas.signature import distance, same_orbit, signature_of
from orbitfinder.atlas.starts import Target, context_of, make_start
from orbitfinder.atlas.store import Atlas
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.mechanics.model import energy
from orbitfinder.records.registry import load_orbit

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))

from hybrid_search import Oscillator, gap, machines, met, scanned  # noqa: E402

IMPACTS = ROOT / "problems" / "search" / "impact-oscillator.toml"
FORCED = 2 * np.pi / 2.7
BOUNCES = {"v": (-1.5, 0.0), "phase": (0.0, 2 * np.pi)}
LIMPING = np.array([-0.53682858, 0.78468016, 2.39640849, 1.63947126])
"""in the wedge at E = 5, right after the left wall: right, right, left"""


def oscillator():
    return of.systems.impact_oscillator(frequency=2.7, restitution=0.7)


def searched(book, *more):
    """The command on the problem file, in this process."""
    said = CliRunner().invoke(cli, ["search", str(IMPACTS), "--workers", "0", "--atlas", str(book), *more])
    assert said.exit_code == 0, said.output
    return said.output


def rows(book):
    """The orbits of an atlas: periods, actions and states."""
    with Atlas(book) as atlas:
        found = [atlas.orbit(row.id) for row in atlas.rows()]
    return sorted((one.period, one.action, *one.state) for one in found)


@pytest.mark.slow
def test_a_search_resumed_and_in_shards_is_one_search(tmp_path):
    """What two runs and what two shards find is what one run finds, each certified and closed by the closed form."""
    whole, parts = tmp_path / "whole.sqlite", [tmp_path / f"{k}.sqlite" for k in (1, 2)]
    searched(whole, "--starts", "2")
    said = searched(whole, "--starts", "4")
    assert "any energy: 2 starts" in said
    assert "any energy: 0 starts" in searched(whole, "--starts", "4")
    for k, part in enumerate(parts):
        searched(part, "--starts", "4", "--shard", f"{k + 1}/2")
    merged = of.merge_atlases(parts, tmp_path / "merged.sqlite")
    found = rows(whole)
    assert merged.orbits == len(found) >= 2 and np.array_equal(rows(tmp_path / "merged.sqlite"), found)
    by_hand = Oscillator()
    for k in range(len(found)):
        orbit = load_orbit(f"{whole}#{k + 1}")
        count = round(orbit.period / FORCED)
        assert orbit.period == pytest.approx(count * FORCED, abs=1e-11)
        assert list(orbit.system["cycle"]) == ["hit"] * count and orbit.winding == (0, 0, count)
        assert np.abs(gap(by_hand, orbit.state[1:, None], count)).max() < 1e-10
        assert of.certify(orbit).passed
    verified = CliRunner().invoke(cli, ["verify", f"{whole}#1"])
    assert verified.exit_code == 0 and "certified" in verified.output
    shown = CliRunner().invoke(cli, ["atlas", "show", str(whole), "1"])
    assert "events                hit" in shown.output


@pytest.mark.slow
@pytest.mark.parametrize("number, size, starts", [(0, 20, 60), (1, 8, 60)])
def test_a_search_finds_all_that_a_scan_finds(tmp_path, number, size, starts):
    """The impact oscillator and the compass gait, up to three cycles."""
    one, book = machines()[number], tmp_path / "atlas.sqlite"
    file = ROOT / "problems" / "search" / f"{one.name}.toml"
    asked = ["search", str(file), "--starts", str(starts), "--workers", "0", "--atlas", str(book)]
    assert CliRunner().invoke(cli, asked).exit_code == 0
    with np.errstate(all="ignore"):
        known = [one.closer(each) for count in (1, 2, 3) for each in scanned(one.once, count, size)]
    with Atlas(book) as atlas:
        orbits = [atlas.orbit(row.id) for row in atlas.rows()]
    assert len(known) == (4, 5)[number]
    assert all(met(one.once, one.chosen, each, orbits) for each in known)


def test_states_drawn_are_those_that_resets_make():
    """Of the simplest walker two numbers make four; of a runner the energy is held; of the compass gait both feet are
    on the ground, in the range asked for."""
    random = np.random.default_rng(3)
    walker = EventSection.of(
        of.systems.simplest_walker(), {"theta": (0.1, 0.3), "thetadot": (-0.3, -0.1)}, 1, (1, 9), 0.0
    )
    theta, phi, rate, swing = walker.drawn(random)
    assert 0.1 < theta < 0.3 and -0.3 < rate < -0.1
    assert (phi, swing) == pytest.approx((2 * theta, (1 - np.cos(2 * theta)) * rate), abs=1e-12)
    model = of.systems.slip_runner(attack=0.384)
    runner = EventSection.of(model, {"y": (0.93, 1.3), "xdot": (3.0, 7.0)}, 1, (0.1, 2.0), 1784.8)
    for state in (runner.drawn(random) for _ in range(4)):
        assert energy(model, state) == pytest.approx(1784.8, rel=1e-12)
        assert state[0] == 0.0 and abs(state[3]) < 1e-12 and 3 < state[2] < 7
    section = EventSection.of(of.systems.compass_gait(), {"stance": (0.2, 0.3), "swingdot": (-1, 1)}, 1, (0.1, 2), 0.0)
    stance, swing, *_ = section.drawn(random)
    assert 0.2 < stance < 0.3 and stance + swing == pytest.approx(-2 * 0.0524, abs=1e-14)


def test_every_start_is_its_number():
    target = Target(0.0, (0.5, 15.0), BOUNCES, 3)
    one, other = context_of(oscillator(), target), context_of(oscillator(), target)
    for index in range(5):
        first, second = make_start(one, 3, index), make_start(other, 3, index)
        assert (first.strategy, first.course, first.period) == (second.strategy, second.course, second.period)
        assert np.array_equal(first.state, second.state) and set(first.course) == {"hit"}


def test_a_course_may_be_another_than_the_cycle():
    """A ball that bounces twice off one wall: found, recorded, certified, and told from its mirror image."""
    wedge = of.systems.gravity_wedge()
    ranges = {"x": (-3.0, 0.0), "y": (0.5, 5.0), "xdot": (0.0, 3.0), "ydot": (-3.0, 3.0)}
    section = EventSection.of(wedge, ranges, 2, (1.0, 16.0), 5.0)
    _, first = section.passes(LIMPING, 1)
    assert first.events == ("right", "right", "left")
    orbit = section.orbit(LIMPING, first.time, first.events)
    assert orbit.system["cycle"] == ["right", "right", "left"] and of.certify(orbit).passed
    assert of.certify(orbit, wedge).passed  # a Model with the stated cycle
    mirror = section.orbit(np.array([-1.1593412, 1.69460433, 0.0, 2.57114592]), orbit.period, ("left", "right", "left"))
    one, other = signature_of(orbit, wedge), signature_of(mirror, wedge)
    assert one.numbers == pytest.approx(other.numbers, rel=1e-9) and not same_orbit(one, other)
    assert distance(one, other) > 0.1


def test_orbits_are_told_apart_from_any_event_on():
    """A doubled cycle is the single one; started at its other impact, an orbit is itself; two of one period are two."""
    section = EventSection.of(oscillator(), BOUNCES, 3, (0.5, 15.0), 0.0)
    with np.errstate(all="ignore"):
        known = [each for count in (1, 2, 3) for each in scanned(Oscillator(), count, 12)]
    assert [len(one.passes) for one in known] == [1, 2, 3, 3]

    def found(one, begin, times=1):
        state = np.append(0.0, one.passes[begin])
        return section.orbit(state, times * one.period, ("hit",) * (times * len(one.passes)))

    single = found(known[0], 0, 2)
    assert list(single.system["cycle"]) == ["hit"] and single.period == pytest.approx(FORCED, abs=1e-12)
    model = oscillator()
    signs = [[signature_of(found(one, k), model) for k in range(2)] for one in known[1:]]
    assert all(same_orbit(one, other) for one, other in signs)
    assert not any(same_orbit(signs[k][0], signs[j][0]) for k, j in ((0, 1), (1, 2)))
    assert signs[1][0].period == pytest.approx(signs[2][0].period, abs=1e-12)
    with pytest.raises(ConvergenceError, match="period outside the range"):
        EventSection.of(oscillator(), BOUNCES, 3, (3.0, 15.0), 0.0).orbit(single.state, single.period, ("hit",))


@pytest.mark.parametrize(
    "model, more, message",
    [
        (of.systems.compass_gait, {}, "search.section: missing; give ranges of what the state is right after 'strike'"),
        (of.systems.compass_gait, {"section": {"stanze": (0, 1)}}, "search.section: unknown 'stanze', did you mean"),
        (of.systems.compass_gait, {"section": {"stance": (1, 0)}}, "search.section.stance: must be two increasing"),
        (of.systems.compass_gait, {"section": {"stance": (0, 0)}}, "search.section.stance: must be .smallest, larg"),
        (of.systems.compass_gait, {"section": {"stance": (0, 1)}, "cycles": 0}, "search.cycles: must be between 1"),
        (of.systems.bouncing_ball, {"section": {"y": (9.0, 9.5)}}, "search.section: no state after 'bounce' is found"),
        (lambda: of.chain(2), {"section": {"theta1": (0, 1)}, "energies": -10.0}, "search.section: is of hybrid"),
        (of.systems.slip_runner, {"section": {"y": (1, 1.2)}}, "energy: missing"),
    ],
)
def test_what_cannot_be_searched_is_said(tmp_path, model, more, message):
    energies = more.pop("energies", None)
    with pytest.raises(InputError, match=message):
        of.search(model(), energies, (0.5, 2.0), tmp_path / "a.sqlite", starts=1, workers=0, **more)


def test_sweeps_go_warm_from_orbit_to_orbit():
    """Of several arcs, by a physical parameter and by the energy; durations of arcs are no parameters."""
    runner = of.load_problem(ROOT / "problems/hybrid/slip-runner-stable.toml")
    stiff = of.sweep(runner, stiffness=[19000.0, 20000.0, 21000.0])
    again = of.find_orbit(of.load_problem(ROOT / "problems/hybrid/slip-runner-stable.toml"))
    assert stiff.certified == 3 and stiff.orbits[1].period == pytest.approx(again.period, abs=1e-12)
    wedge = of.sweep(of.load_problem(ROOT / "problems/hybrid/gravity-wedge.toml"), energy=[4.0, 6.0])
    exact = [4 * np.sin(0.6) * np.sqrt(2 * e / (1 + 2 * np.cos(0.6) ** 2)) for e in (4.0, 6.0)]
    assert [one.period for one in wedge.orbits] == pytest.approx(exact, abs=1e-11)
    with pytest.raises(InputError, match="share_1: neither a physical parameter of this system nor pinned"):
        of.sweep(runner, share_1=[0.3, 0.4])
