"""Brute-force bifurcation diagrams against doublings and folds that other programs computed."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.records.registry import load
from orbitfinder.structures.bifurcation import family_samples, verified

PROBLEMS = Path(__file__).parents[1] / "problems"
CASCADE = PROBLEMS / "maps" / "pendulum-cascade.toml"
DOUBLED = 1.0663728624552  # by a Taylor integration of 140 bits, see the problem file
TORQUES = np.array([1.062, 1.0675, 1.068, 1.0685])


def pendulum():
    return of.load_problem(CASCADE)


@pytest.fixture(scope="module")
def family():
    return of.follow_family(pendulum(), "torque", until=1.07)


@pytest.fixture(scope="module")
def made():
    return of.bifurcation(pendulum(), torque=TORQUES, transient=160, samples=24)


def test_a_driven_pendulum_doubles_where_its_family_does(made, family):
    """Once round before, twice after; the square of the branches' distance vanishes at the doubling."""
    assert made.repeats.ravel().tolist() == [1, 2, 2, 2] and made.plane == "once a period of the forcing"
    apart = [np.diff(np.sort(made.samples(k)[-2:]))[0] ** 2 for k in (1, 2, 3)]
    there = np.interp(0.0, *np.polynomial.Polynomial.fit(apart, TORQUES[1:], 2).linspace(2, [0.0, apart[-1]]))
    (event,) = (event for event in family.events if event.kind == "period_doubling")
    assert event.parameter == pytest.approx(DOUBLED, abs=1e-11) and there == pytest.approx(event.parameter, abs=1e-5)


def test_families_go_through_the_samples(made, family, tmp_path, monkeypatch):
    """Where the cycle is stable it is what motions settle to; its picture has the samples, the cycles, the doubling."""
    heights = family_samples(made, family)
    assert heights.shape == (len(family.members), 1) and not np.isnan(heights).any()
    exact = of.find_orbit(replace(pendulum(), model=of.systems.forced_pendulum(**arguments(1.062))))
    assert made.samples(0) == pytest.approx(exact.state[0], abs=1e-8)
    kept = {}
    monkeypatch.setattr("orbitfinder.show.bifurcation.save_png", lambda figure, path: kept.setdefault("it", figure))
    of.sections.draw_bifurcation(made, tmp_path / "it.png", families=[family])
    words = [text.get_text() for text in kept["it"].legends[0].get_texts()]
    assert {"samples", "cycles", "period doubling", "stable", "unstable"} == set(words)
    axes = kept["it"].axes[0]
    assert axes.get_xlabel() == "torque" and "1.0664" in {text.get_text() for text in axes.texts}
    with pytest.raises(InputError, match="followed in torque of another system; give one of this"):
        family_samples(replace(made, system=made.system | {"arguments": arguments(1.0) | {"length": 2.0}}), family)


def arguments(torque):
    return pendulum().model.system["arguments"] | {"torque": torque}


@pytest.mark.parametrize(
    ("file", "parameter", "values", "coordinate", "once", "doubling"),
    [
        ("gallery/rossler", "c", (2.6, 3.0), "x", 1, 2.832445028),
        ("families/lorenz-doubling", "rho", (235.0, 226.0), "z", 2, 229.4067085614),
    ],
)
def test_maxima_of_autonomous_systems(file, parameter, values, coordinate, once, doubling):
    """Before a known doubling the maxima are those of one turn, after it of two; and the crossings of a plane too."""
    problem = of.load_problem(PROBLEMS / f"{file}.toml")
    given = {parameter: values}
    top = of.bifurcation(problem, given, coordinate=coordinate, transient=120, samples=24)
    order = np.argsort(values)
    assert top.repeats[order].ravel().tolist() == [once, 2 * once] and min(values) < doubling < max(values)
    assert top.plane == f"maxima of {coordinate}" and verified(top, problem.model).passed
    if file.startswith("gallery"):
        cut = of.bifurcation(problem, given, plane="y=0", coordinate="x", transient=120, samples=24)
        assert cut.repeats.tolist() == top.repeats.tolist() and np.allclose(cut.states[:, 1], 0.0)
        a, b, c = 0.2, 0.2, 3.0
        motion = solve_ivp(lambda t, s: [-s[1] - s[2], s[0] + a * s[1], b + s[2] * (s[0] - c)], (0, 12), top.states[-2],
                           method="LSODA", rtol=1e-11, atol=1e-12, max_step=0.001)  # fmt: skip
        x = motion.y[0]
        peaks = x[1:-1][(x[1:-1] > x[:-2]) & (x[1:-1] > x[2:])]
        assert peaks[:2] == pytest.approx(top.samples(1)[-1:].tolist() + top.samples(1)[-2:-1].tolist(), abs=1e-5)


def test_sweeps_both_ways_show_what_is_bistable():
    """Between the folds of a driven Duffing oscillator; the lower one, by 140 bits, is at 1.3242362007706."""
    model = of.systems.forced_duffing(stiffness=1.0, cubic=1.0, damping=0.1, force=0.3, frequency=1.5)
    axis = [1.30, 1.32, 1.33, 1.36, 1.4]
    made = of.bifurcation(model, frequency=axis, state=[0.9, 0.0], sweep="both", transient=80, samples=8)
    up, down = (np.array([made.samples(k, run)[-1] for k in range(5)]) for run in (0, 1))
    assert np.allclose(up[:2], down[:2], atol=1e-3) and np.all(up[:2] > 0.9)  # beyond the fold both are high
    one = of.bifurcation(model, frequency=axis, state=[-0.4, 0.0], sweep="down", transient=80, samples=8)
    low = np.array([one.samples(k)[-1] for k in range(5)])
    assert np.all(low[2:] < -0.3) and np.all(up[2:] > 0.9) and np.allclose(low[:2], up[:2], atol=1e-3)


def test_a_ball_that_bounces_and_starts_by_lot():
    problem = of.load_problem(PROBLEMS / "hybrid" / "bouncing-ball.toml")
    made = of.bifurcation(problem, amplitude=[0.0119, 0.012], transient=160, samples=10)
    assert made.plane == "after bounce" and made.repeats.tolist() == [[1], [1]] and verified(made, problem.model).passed
    exact = of.find_orbit(problem)
    assert made.states[-1] == pytest.approx(exact.state, abs=1e-7)
    given = {"damping": [0.4, 0.5], "transient": 20, "samples": 8}
    model = of.systems.forced_pendulum(torque=0.5)
    one, two = (of.bifurcation(model, state=[0.1, 0.0], starts=3, seed=4, **given) for _ in range(2))
    assert np.array_equal(one.states, two.states) and one.repeats.shape == (2, 3) and len(np.unique(one.starts)) == 6
    again = of.bifurcation(model, starts=one.starts, **given)
    assert np.array_equal(again.states, one.states)


def test_records_are_read_and_doctored_ones_refused(made, tmp_path):
    file = of.sections.save_bifurcation(made, tmp_path / "bifurcation.json")
    again, model = load(file), pendulum().model
    assert again.counts == made.counts == "4 values, 4 motions: 1 repeat after 1 return, 3 repeat after 2 returns"
    assert np.array_equal(again.states, made.states) and verified(again, model).passed
    rows = made.table()
    assert np.array_equal(rows["theta"], made.states[:, 0]) and rows["torque"][-1] == TORQUES[-1]
    assert set(rows["repeats"][rows["torque"] > 1.067]) == {2}
    moved, said = made.states.copy(), made.repeats.copy()
    moved[:, 0] += 1e-6
    said[0] = 2
    assert set(verified(replace(made, states=moved), model).failures) >= {"returns"}
    assert "repeats" in verified(replace(made, repeats=said), model).failures
    late = replace(made, times=made.times * 2)  # of every other return
    assert not verified(late, model).passed
    document = json.loads(file.read_text())
    for entry, value in (("coordinate", "z"), ("sweep", "sideways"), ("state_names", ["theta"])):
        file.write_text(json.dumps(document | {entry: value}))
        with pytest.raises(InputError):
            of.sections.load_bifurcation(file)


def test_stopped_runs_shards_and_more_values_give_the_same_bits(made, tmp_path):
    """The command: what is done is not done again, what shards have done is taken from there."""
    words = ["bifurcation", str(CASCADE), "--transient", "160", "--samples", "24", "-o", str(tmp_path), "--json"]
    torques = f"torque={','.join(map(str, TORQUES))}"
    for k in (1, 2):
        run = CliRunner().invoke(cli, [*words, "--parameter", torques, "--shard", f"{k}/2", "--no-figures"])
        assert run.exit_code == 0 and str(Path(f"{k}-of-2") / "pendulum-cascade") in run.output, run.output
    whole = CliRunner().invoke(cli, [*words, "--parameter", torques])
    document = json.loads(whole.stdout)
    assert whole.exit_code == 0 and document["counts"] == made.counts and len(document["written"]) == 2
    there = load(document["written"][0])
    assert np.array_equal(there.states, made.states) and np.array_equal(there.repeats, made.repeats)
    journal = tmp_path / "pendulum-cascade" / "bifurcation.jsonl"
    assert len(journal.read_text().splitlines()) == 1  # what was asked, and nothing done
    done = []
    of.bifurcation(pendulum(), torque=[*TORQUES[:2], 1.05], transient=160, samples=24, out=tmp_path / "1-of-2",
                   progress=lambda *each: done.append(each))  # fmt: skip
    assert (
        done == [(3, 3)]
        and len((tmp_path / "1-of-2" / "pendulum-cascade" / "bifurcation.jsonl").read_text().splitlines()) == 3
    )
    refused = CliRunner().invoke(cli, [*words, "--parameter", torques, "--shard", "1/2", "--sweep", "up"])
    assert refused.exit_code == 2 and "leave one of them out" in refused.output
    assert "4 values, 4 motions" in CliRunner().invoke(cli, ["show", document["written"][0]]).stdout


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"torques": [1.0, 1.1]}, "unknown 'torques'.*did you mean"),
        ({"torque": [1.0], "damping": [0.1]}, "single parameter, got 2"),
        ({"torque": ["x"]}, "list of numbers"),
        ({"torque": [np.nan]}, "finite"),
        ({"torque": [1.0], "coordinate": "phi"}, "unknown 'phi'"),
        ({"torque": [1.0], "plane": "theta=0"}, "once a period of its forcing"),
        ({"torque": [1.0], "sweep": "left"}, "none of none, up"),
        ({"torque": [1.0], "samples": 2}, "samples: must be between 4"),
        ({"torque": [1.0], "starts": 0}, "starts: must be between 1"),
        ({"torque": [1.0], "state": [1.0]}, "state: need 2"),
    ],
)
def test_what_cannot_be_is_refused(given, words):
    with pytest.raises(InputError, match=words):
        of.bifurcation(pendulum(), **given)


def test_systems_that_keep_their_energy_settle_to_nothing():
    with pytest.raises(InputError, match="conserves its energy.*`section` shows them"):
        of.bifurcation(of.chain(2), gravity=[9.8], state=[0.1, 0.1, 0.0, 0.0])
    with pytest.raises(InputError, match="state: missing"):
        of.bifurcation(of.systems.rossler(), c=[2.0])
