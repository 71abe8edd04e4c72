"""A time limit ends whatever runs inside it, in Python and in CasADi, and says how far the work had come."""

import json
import signal
import threading
import time
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder._runtime import limit
from orbitfinder.atlas import workers as task
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError, InputError, LimitError
from orbitfinder.families.folder import follow_family
from orbitfinder.integrate.cvodes import IntegratorSettings, build_flow, end_state, sample
from orbitfinder.loops import ipopt as nlp
from orbitfinder.problemfile.read import load_problem
from orbitfinder.records.family import load_family, read_journal

PROBLEMS = Path(__file__).parents[1] / "problems"
ENDLESS = 1e7
"""s of a pendulum's motion, days of work"""


def endless():
    """A flow that CVODES may follow for as long as it likes."""
    return build_flow(of.chain(1), settings=IntegratorSettings(max_steps=10**9))


def test_the_earliest_of_nested_limits_holds_and_none_is_no_limit():
    with of.limited(None):
        assert limit.left() == np.inf
    with of.limited(5.0), of.limited(50.0):
        assert limit.left() <= 5.0
        with of.limited(1.0):
            assert limit.left() <= 1.0
        assert limit.left() > 1.0
    assert limit.left() == np.inf


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan")])
def test_a_limit_that_means_nothing_is_refused(seconds):
    with pytest.raises(InputError, match="limit: must be a positive number of seconds"), of.limited(seconds):
        pass


@pytest.mark.parametrize("call", [end_state, lambda *given: sample(*given, 3)], ids=["end", "samples"])
def test_a_long_integration_is_cut_off_and_no_alarm_is_left(call):
    """CVODES is inside one C call all the while; what it says of the alarm is not what the user reads."""
    before, began = signal.getsignal(signal.SIGALRM), time.monotonic()
    with pytest.raises(LimitError, match=r"^stopped after 0.2 s \(limit\)$"), of.limited(0.2):
        call(endless(), np.array([1.0, 0.0]), ENDLESS)
    assert time.monotonic() - began < 5.0
    assert signal.getsignal(signal.SIGALRM) is before
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_an_alarm_at_the_end_of_a_block_leaves_none_running(monkeypatch):
    """It ended the process (exit code -14) when it rang between the last call and the end of the timer."""
    before, calls = signal.getsignal(signal.SIGALRM), []

    def late(which, seconds, again=0.0):
        if seconds == 0.0:
            signal.getsignal(signal.SIGALRM)(signal.SIGALRM, None)
        calls.append(seconds)

    monkeypatch.setattr(signal, "setitimer", late)
    with pytest.raises(LimitError), limit.limited(0.05), limit.alarm():
        time.sleep(0.06)
    assert len(calls) == 2 and calls[1] == 0.0 and signal.getsignal(signal.SIGALRM) == before


def test_somebody_elses_alarm_is_left_alone():
    rung = []
    before = signal.signal(signal.SIGALRM, lambda *_: rung.append(1))
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        with of.limited(60.0):
            end_state(build_flow(of.chain(1)), np.array([1.0, 0.0]), 1.0)
            time.sleep(0.1)
        assert rung
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("threaded", [False, True], ids=["main thread", "another thread"])
def test_a_search_is_cut_off_with_how_far_it_came(threaded, monkeypatch):
    """Patience without end stands in for a search that keeps moving; between IPOPT's iterations any thread looks."""
    monkeypatch.setattr(nlp, "PATIENCE", 10**9)
    problem = impossible(of.SolveSettings(limit=1.5, max_iterations=10**6))
    said = []

    def work():
        with pytest.raises(LimitError) as caught:
            of.find_orbit(*problem)
        said.append(str(caught.value))

    began = time.monotonic()
    if threaded:
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
    else:
        work()
    assert time.monotonic() - began < 30.0
    assert said[0].startswith("stopped after 1.5 s (limit): shooting, iteration ")
    assert "largest defect " in said[0]


def impossible(settings: of.SolveSettings) -> tuple[of.Problem, of.SolveSettings]:
    """A spherical pendulum asked for less energy than it has at rest."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    kinetic, potential = (v[0] ** 2 + (ca.sin(q[0]) * v[1]) ** 2) / 2, -9.8 * ca.cos(q[0])
    model = of.lagrange(kinetic, potential, of.Symbols(q, v), names=["theta", "phi"], angles=[False, True])
    return of.Problem(model, of.Guess([0.5, 0.0, 0.0, 1.5], 1.5), of.pin(energy=-30.0)), settings


def test_a_search_that_gets_nowhere_is_given_up():
    """100 iterations before; the sentence names the best defect, the patience, and what to do."""
    seen = []
    with pytest.raises(ConvergenceError, match=r"did not fall in 20 iterations.*the pin asks for -30 J"):
        of.find_orbit(*impossible(of.SolveSettings()), seen.append)
    assert max(event.iteration for event in seen if event.stage == "shooting") < 80


def test_every_command_takes_a_limit():
    for name, command in cli.commands.items():
        if not hasattr(command, "commands"):
            assert "--limit" in [opt for one in command.params for opt in one.opts], name


def test_a_command_whose_options_are_refused_leaves_no_limit_behind():
    """The limit is told before the other options are read; it was left to the garbage collector."""
    CliRunner().invoke(cli, ["continue", "orbit.json", "--points", "few"])
    assert limit.left() == np.inf and not limit.running


@pytest.mark.parametrize("seconds", ["0.05", "1e-06"])
def test_run_reports_the_search_that_took_too_long(tmp_path, seconds):
    """Also where the time is over before the file is read; the other file is run."""
    files = [str(PROBLEMS / name) for name in ("gallery/quintuple-pendulum-whip.toml", "report/triple-1.toml")]
    done = CliRunner().invoke(cli, ["run", *files, "--limit", seconds, "--out", str(tmp_path), "--json"])
    assert done.exit_code == 1, done.output
    results = json.loads(done.stdout)["results"]
    assert [found["name"] for found in results] == ["quintuple-pendulum-whip", "triple-1"]
    assert results[0]["status"] == "failed" and results[0]["message"].startswith(f"stopped after {seconds} s (limit)")


def test_verify_stops_with_a_sentence():
    orbit = str(PROBLEMS.parent / "results" / "orbits" / "triple-1" / "orbit.json")
    done = CliRunner().invoke(cli, ["verify", orbit, "--limit", "0.001"])
    assert (done.exit_code, done.stderr) == (1, "Error: stopped after 0.001 s (limit)\n")


def test_a_family_that_is_cut_off_keeps_its_points(tmp_path):
    """The journal, and family.json with all of it; the same call goes on."""
    duffing = load_problem(PROBLEMS / "gallery" / "duffing.toml")
    count = []

    def late(_: object) -> None:
        count.append(1)
        if len(count) == 5:
            limit._deadline.get().end = 0.0

    with pytest.raises(LimitError, match=r"\(limit\): 5 steps kept in .*duffing; the same"), of.limited(3600.0):
        follow_family(duffing, points=6, out=tmp_path, progress=late)
    cut = load_family(tmp_path / "duffing" / "family.json")
    assert len(cut.points) == 1 + sum(len(one.points) for one in read_journal(tmp_path / "duffing").batches) > 4
    assert len(follow_family(duffing, points=6, out=tmp_path).points) > len(cut.points)


def test_a_start_that_takes_too_long_is_a_failed_start(monkeypatch):
    """And the limit of the whole search ends the search."""
    one = task.prepared(task.Request({"kind": "chain", "links": 2}, task.Target(-15.0, (0.5, 4.0)), 1).text())
    monkeypatch.setattr(task, "LONGEST_START", 1e-4)
    assert task.perform(one, 1, [task.Job(0)], [])[0].reason == "error: LimitError"
    with pytest.raises(LimitError), of.limited(1e-5):
        task.perform(one, 1, [task.Job(0)], [])
