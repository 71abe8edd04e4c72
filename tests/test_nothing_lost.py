"""What is finished stays however a command is stopped, what does not answer is left, a full disk is said of its file.

Stopped from within: a real signal, or the deadline moved to now, at a chosen look of the computation at its limit.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner
from conftest import database

import orbitfinder as of
from orbitfinder._runtime import keeping, limit
from orbitfinder.cli.group import cli
from orbitfinder.continuation import follow as driver
from orbitfinder.continuation.problem import solved
from orbitfinder.control.controller import load_controller
from orbitfinder.control.optimum import load_optima
from orbitfinder.errors import InputError
from orbitfinder.records import journal as journals
from orbitfinder.records.family import load_family
from orbitfinder.structures.section import load_section
from orbitfinder.structures.torus import load_tori

ROOT = Path(__file__).parents[1]
LOOP = ROOT / "results" / "gallery" / "henon-heiles-loop" / "orbit.json"
TRIPLE = ROOT / "results" / "orbits" / "triple-1" / "orbit.json"
SPRING = ROOT / "problems" / "gallery" / "spring-pendulum-swing.toml"
OSCILLATOR = ROOT / "problems" / "control" / "maintained-oscillator.toml"
DOUBLE = ROOT / "problems" / "examples" / "double-mode-2.toml"
STOPS = [signal.SIGINT, signal.SIGTERM, "limit"]
QUICK = [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow), "limit"]
SAID = {signal.SIGINT: "Interrupted", signal.SIGTERM: "Interrupted", "limit": "(limit)"}
CODES = {signal.SIGINT: 130, signal.SIGTERM: 130, "limit": 1}


def ran(*words):
    return CliRunner().invoke(cli, [str(word) for word in words])


def stopped_at(monkeypatch, module, name, count, how):
    """Let a signal come, or the deadline be past, when a function is called for the count-th time."""
    whole, calls = getattr(module, name), []

    def called(*arguments, **named):
        calls.append(1)
        if len(calls) == count and how == "limit":
            limit._deadline.get().end = 0.0
            limit.check()
        elif len(calls) == count:
            signal.raise_signal(how)
        return whole(*arguments, **named)

    monkeypatch.setattr(module, name, called)


def sure(certificate):
    return certificate is not None and certificate.passed


@pytest.mark.parametrize("how", QUICK)
def test_tori_that_were_found_stay(tmp_path, monkeypatch, how):
    stopped_at(monkeypatch, driver, "advanced", 2, how)
    done = ran("torus", LOOP, "--until", "0.2071", "--limit", 3600, "-o", tmp_path)
    file = tmp_path / "henon-heiles-loop-tori" / "tori.json"
    assert done.exit_code == CODES[how] and SAID[how] in done.stderr, done.output
    assert f"what is finished is kept in {file}" in done.stderr
    found = load_tori(file)
    assert len(found.tori) == 2 and found.end == "stopped" and all(sure(one.certificate) for one in found.tori)


@pytest.mark.parametrize("how", [pytest.param(signal.SIGINT, marks=pytest.mark.slow), *QUICK[1:]])
def test_optima_that_were_found_stay(tmp_path, monkeypatch, how):
    from orbitfinder.control import optima

    stopped_at(monkeypatch, optima, "certified", 3, how)
    words = ("--parameter", "damping", "--until", "0.4", "--limit", 3600, "--no-figures", "-o", tmp_path)
    done = ran("continue", OSCILLATOR, *words)
    file = tmp_path / "maintained-oscillator" / "optima.json"
    assert done.exit_code == CODES[how] and f"is kept in {file}" in done.stderr, done.output
    found = load_optima(file)
    assert len(found) == 2 and found.end == "stopped" and all(sure(one.certificate) for one in found)


@pytest.mark.parametrize("how", QUICK)
def test_swept_orbits_stay(tmp_path, monkeypatch, how):
    from orbitfinder.orbits import sweep

    stopped_at(monkeypatch, sweep._Study, "_row", 3, how)
    done = ran("sweep", SPRING, "--parameter", "stiffness=29,30,31,32", "--limit", 3600, "-o", tmp_path)
    assert done.exit_code == CODES[how], done.output
    folder = tmp_path / "spring-pendulum-swing"
    rows = json.loads((folder / "sweep.json").read_text())["rows"]
    certified = [row for row in rows if row["certified"]]
    assert len(certified) == 2 and (folder / "sweep.csv").is_file()
    files = sorted(folder.glob("*/orbit.json"))
    assert len(files) == 2 and all(of.load_orbit(one).certificate.passed for one in files)
    if how == "limit":  # a table of all values, as before, with the reason at those that are missing
        assert len(rows) == 4 and "2 of 4 values are done" in rows[-1]["reason"]
    else:
        assert f"is kept in {folder / 'sweep.json'}" in done.stderr


@pytest.mark.parametrize("how", QUICK)
def test_the_crossings_of_a_section_stay(tmp_path, monkeypatch, how):
    from orbitfinder.structures import crossings

    stopped_at(monkeypatch, crossings._Run, "step", 400, how)
    words = ("--energy", -14, "--plane", "theta1=0", "--seeds", 5, "--returns", 1000, "--limit", 3600)
    done = ran("section", DOUBLE, *words, "-o", tmp_path)
    file = tmp_path / "double-mode-2" / "section.json"
    assert done.exit_code == CODES[how] and f"is kept in {file}" in done.stderr, done.output
    found = load_section(file)
    assert 5 < found.returns < 5000 and not found.regular.any()  # of none it is known
    assert abs(found.states[:, 0]).max() < 1e-12


@pytest.mark.parametrize("how", QUICK)
def test_a_controller_stays_when_its_trial_is_stopped(tmp_path, monkeypatch, how):
    from orbitfinder.control import basin

    stopped_at(monkeypatch, basin, "disturbed", 1, how)
    done = ran("stabilise", TRIPLE, "--motors", 1, "--limit", 3600, "-o", tmp_path)
    file = tmp_path / "triple-1" / "controller.json"
    assert done.exit_code == CODES[how] and f"is kept in {file}" in done.stderr, done.output
    found = load_controller(file)
    assert found.stabilised and sure(found.certificate) and found.basin is None


@pytest.mark.parametrize("how", QUICK)
def test_a_merge_keeps_the_atlases_it_has_taken(tmp_path, monkeypatch, how):
    from orbitfinder.atlas import merge

    model, books = of.chain(1), [tmp_path / f"{k}.sqlite" for k in range(3)]
    for k, book in enumerate(books, 1):
        of.search(model, -3.0, (0.5, 2.5), book, starts=6, workers=0, shard=f"{k}/3")
    stopped_at(monkeypatch, merge, "_joined", 3, how)
    with of.limited(3600.0):
        done = ran("atlas", "merge", *books, "--atlas", tmp_path / "out.sqlite")
    assert done.exit_code == CODES[how], done.output
    monkeypatch.undo()
    two = of.merge_atlases(books[:2], tmp_path / "two.sqlite")
    with database(tmp_path / "out.sqlite") as kept:
        assert kept.execute("SELECT count(*) FROM starts").fetchone()[0] == two.starts > 0
    assert of.merge_atlases(books, tmp_path / "out.sqlite").starts == 6


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_family_that_is_interrupted_has_its_file(tmp_path, monkeypatch, how):
    from orbitfinder.families import folder

    stopped_at(monkeypatch, folder, "append", 4, how)
    words = ("--parameter", "energy", "--direction", "forward", "--no-figures", "-o", tmp_path)
    done = ran("continue", LOOP, *words)
    assert done.exit_code == 130 and "Interrupted" in done.stderr, done.output
    assert len(load_family(tmp_path / "henon-heiles-loop" / "family.json").points) == 4


def test_a_section_of_a_hybrid_system_can_be_read_again(tmp_path):
    """Of its motions no growth is known, which is infinite here and was refused as damaged."""
    done = ran("section", ROOT / "problems/hybrid/bouncing-ball.toml", "--seeds", 3, "--returns", 5, "-o", tmp_path)
    (file,) = tmp_path.glob("*/section.json")
    assert done.exit_code == 0 and not load_section(file).regular.any()


def test_the_file_of_an_earlier_run_is_not_written_over_by_less(tmp_path, monkeypatch):
    words = ("torus", LOOP, "--no-figures", "-o", tmp_path, "--points")
    assert ran(*words, 3).exit_code == 0
    file = tmp_path / "henon-heiles-loop-tori" / "tori.json"
    before = file.read_bytes()
    monkeypatch.setattr(journals, "read_lines", lambda path, what: None)  # without its journal it begins anew
    stopped_at(monkeypatch, driver, "advanced", 2, signal.SIGINT)
    done = ran(*words, 9)
    beside = file.with_name("tori-stopped.json")
    assert f"is kept in {beside}" in done.stderr and len(load_tori(beside).tori) == 2
    assert file.read_bytes() == before


OTHERS = {
    "continue": (["continue", LOOP, "--points", 3, "--no-figures"], ["--parameter", "period"],
                 "family.jsonl: settings.parameter: energy there, period asked for"),
    "curve": (["continue", "nerve/nerve/equilibria.json", "--curve", 0, "--points", 3, "--no-figures", "--name", "same",
               "--parameters"], ["current,rate"], "equilibria.jsonl: "),
    "equilibria": (["equilibria", ROOT / "problems/gallery/brusselator.toml", "--parameter", "rate", "--points", 4,
                    "--until"], [1.5], "equilibria.jsonl: until: the other way there"),
    "optima": (["continue", OSCILLATOR, "--parameter", "damping", "--at", 0.3, "--no-figures"],
               ["--parameter", "stiffness"], "optima.jsonl: "),
    "section": (["section", DOUBLE, "--energy", -14, "--seeds", 2, "--returns", 5, "--plane"], ["theta1=0"],
                "section.jsonl: returns of.0: theta2=0 there, theta1=0 asked for"),
}  # fmt: skip
"""A command, what is asked for the second time, and how the refusal begins"""
FIRST = {"equilibria": [3.5], "section": ["theta2=0"], "curve": ["current,b"]}
"""What is asked for first where the command does not say it"""


@pytest.mark.parametrize("verb", OTHERS)
def test_another_request_writes_over_nothing(tmp_path, verb, monkeypatch):
    """They began their journal anew, and wrote over what a finished one had led to."""
    monkeypatch.chdir(tmp_path)
    if verb == "curve":
        ran("equilibria", ROOT / "problems/gallery/fitzhugh-nagumo.toml", "--parameter", "current", "--until",
            1.6, "--name", "nerve", "-o", "nerve")  # fmt: skip
    words, other, message = OTHERS[verb]
    first = ran(*words, *FIRST.get(verb, ()), "-o", tmp_path)
    files = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    assert files and first.exit_code in (0, 1), first.output
    done = ran(*words, *other, "-o", tmp_path)
    assert done.exit_code == 2 and message in done.stderr, done.output
    assert "what is computed there is not written over: give another folder (--out), or delete" in done.stderr
    assert files == {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}


TORI = ("torus", LOOP, "--no-figures", "--points", 5, "-o")
OPTIMA = ("continue", OSCILLATOR, "--parameter", "damping", "--until", 0.24, "--no-figures", "-o")


@pytest.fixture(scope="module")
def calm(lend):
    """What the two commands write that nobody stops."""

    def make(folder):
        assert ran(*TORI, folder).exit_code == ran(*OPTIMA, folder).exit_code == 0

    return lend("calm", make, __file__)


@pytest.mark.parametrize("how", QUICK)
def test_stopped_tori_go_on(calm, tmp_path, monkeypatch, how):
    """From where the signal came or the time was over: the same command ends with the file of an undisturbed run."""
    with monkeypatch.context() as patch:
        stopped_at(patch, driver, "advanced", 3, how)
        assert ran(*TORI, tmp_path, "--limit", 3600).exit_code == CODES[how]
    solves = []
    monkeypatch.setattr(driver, "solved", lambda *given: (solves.append(1), solved(*given))[1])
    assert ran(*TORI, tmp_path).exit_code == 0 and len(solves) == 2
    whole, stopped = (folder / "henon-heiles-loop-tori" / "tori.json" for folder in (calm, tmp_path))
    assert whole.read_bytes() == stopped.read_bytes()


@pytest.mark.parametrize("how", [pytest.param(signal.SIGINT, marks=pytest.mark.slow), *QUICK[1:]])
def test_stopped_optima_go_on(calm, tmp_path, monkeypatch, how):
    """The third, of which the certificate was not finished, is the first that is solved again."""
    from orbitfinder.control import optima

    with monkeypatch.context() as patch:
        stopped_at(patch, optima, "certified", 3, how)
        assert ran(*OPTIMA, tmp_path, "--limit", 3600).exit_code == CODES[how]
    found, whole = [], optima.certified
    monkeypatch.setattr(optima, "certified", lambda *given: (found.append(given[0].name[-1]), whole(*given))[1])
    monkeypatch.setattr(optima, "optimum", None)
    assert ran(*OPTIMA, tmp_path).exit_code == 0
    whole, stopped = (
        [
            {**point, "provenance": None}
            for point in json.loads((folder / OSCILLATOR.stem / "optima.json").read_text())["points"]
        ]
        for folder in (calm, tmp_path)
    )
    assert found == [str(k) for k in range(2, len(whole))] and whole == stopped


def test_nothing_finished_is_said(tmp_path, monkeypatch):
    from orbitfinder.structures import tori

    stopped_at(monkeypatch, tori, "_from_orbit", 1, signal.SIGINT)
    done = ran("torus", LOOP, "-o", tmp_path)
    assert "Interrupted: nothing was finished yet, nothing half-written." in done.stderr
    assert not list(tmp_path.rglob("*.json"))


def test_what_comes_is_written_within_a_share_of_the_time(tmp_path, monkeypatch):
    """Also before a kill: not at every result, but when the writing has paid for itself."""
    clock, files = [0.0], []
    monkeypatch.setattr(keeping.time, "monotonic", lambda: clock[0])

    def write(part, path):
        clock[0] += 1.0
        files.append(part)
        path.write_text(str(part))

    with keeping.kept(tmp_path / "a.json", write):
        for k in range(50):
            keeping.finished(lambda k=k: k)
            clock[0] += 1.0
    assert files == [0, 20, 40]
    keeping.finished(lambda: 1 / 0)  # outside it costs nothing


# --- what does not return to Python

HANG = """
import ctypes, sys
import orbitfinder.problemfile.read as read
def hang(*_):
    sys.stderr.write("hangs\\n")
    libc, mutex = ctypes.CDLL(None), ctypes.create_string_buffer(256)
    libc.pthread_mutex_init(mutex, None)
    while True:  # the second time waits for the first, which no signal ends
        libc.pthread_mutex_lock(mutex)
read.load_problem_file = hang
from orbitfinder.__main__ import main
main()
"""
BOUND = 4.0
"""s: a second's grace, and what a machine at work may need"""


@contextlib.contextmanager
def hanging(*words):
    """A command that builds its model in one endless call of C, in which Python answers no signal; once it is there."""
    with subprocess.Popen(
        [sys.executable, "-c", HANG, *map(str, words)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    ) as running:  # fmt: skip
        try:
            while "hangs" not in running.stderr.readline():
                assert running.poll() is None
            yield running
        finally:
            running.kill()


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="needs POSIX signals")
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)]
)
def test_a_signal_ends_what_does_not_return_to_python(tmp_path, number, code):
    with hanging("run", SPRING, "-o", tmp_path) as running:
        time.sleep(0.3)  # it is in the call by now, and not in the writing of its line
        began = time.monotonic()
        running.send_signal(number)
        _, err = running.communicate(timeout=30)
    assert 1.0 < time.monotonic() - began < BOUND and running.returncode == code, err
    assert err == "Interrupted\n"


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="needs POSIX signals")
@pytest.mark.parametrize("command", [pytest.param("run", marks=pytest.mark.slow), "sweep"])
def test_the_limit_ends_what_does_not_return_to_python(tmp_path, command):
    more = ("--parameter", "stiffness=30") if command == "sweep" else ("--json",)
    with hanging(command, SPRING, "-o", tmp_path, "--limit", 3, *more) as running:
        began = time.monotonic()
        out, err = running.communicate(timeout=30)
    assert time.monotonic() - began < 3 + BOUND and running.returncode == 1, err
    assert err == "Error: stopped after 3 s (limit)\n"
    if command == "run":
        assert json.loads(out) == {"format": "orbitfinder/error", "error": "stopped after 3 s (limit)"}


def test_the_limit_counts_the_building_of_the_model(tmp_path, monkeypatch):
    """What reading takes of it the search has not."""
    from orbitfinder.cli import jobs

    job = jobs.ProblemJob(SPRING, "a", tmp_path, False, False, limit=5.0, spent=4.999)
    began, outcome = time.monotonic(), jobs.run_job(job)
    assert outcome.status == "failed" and outcome.message == "stopped after 5 s (limit)"
    assert time.monotonic() - began < 5.0


# --- a full disk

FULL = {
    "run": ["run", SPRING, "--no-figures"],
    "simulate": ["simulate", DOUBLE, "--duration", 5],
    "sweep": ["sweep", SPRING, "--parameter", "stiffness=30"],
    "continue": ["continue", LOOP, "--points", 1, "--no-figures"],
    "optima": ["continue", OSCILLATOR, "--parameter", "damping", "--at", 0.3, "--no-figures"],
    "torus": ["torus", LOOP, "--points", 1, "--no-figures"],
    "section": ["section", DOUBLE, "--energy", -14, "--seeds", 2, "--returns", 30],
    "stabilise": ["stabilise", TRIPLE, "--motors", 1, "--disturbances", 0],
    "export": ["export", TRIPLE, "--to", "csv"],
    "plot": ["plot", TRIPLE],
    "animate": ["animate", TRIPLE, "--size", 64],
    "page": ["page", TRIPLE, "--no-verify"],
    "problems": ["problems", "copy", "all"],
    "search": ["search", ROOT / "problems/search/triple.toml", "--starts", 1, "--workers", 0],
    "atlas": ["atlas", "export", ROOT / "results/atlas/rossler.sqlite"],
}


@pytest.mark.skipif(not hasattr(signal, "SIGXFSZ"), reason="needs limits of the size of files")
@pytest.mark.parametrize("verb", FULL)
def test_every_verb_names_the_file_that_could_not_be_written(tmp_path, verb):
    """All but three said `standard output: File too large`."""
    import resource

    into = {"search": ["--atlas", tmp_path / "a.sqlite"], "atlas": ["-o", tmp_path / "a.json"],
            "problems": ["-o", tmp_path]}.get(verb, ["-o", tmp_path / "out"])  # fmt: skip
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300, before[1]))
    try:
        done = ran(*FULL[verb], *into)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert done.exit_code == 2 and isinstance(done.exception, SystemExit), done.output
    said = done.stderr.strip().splitlines()[-1]
    assert str(tmp_path) in said and "standard output" not in said, said
    assert not [one for one in tmp_path.rglob("*") if one.is_file() and one.name.endswith((".json", ".npz", ".png"))]


# --- smaller things that hid or lost something


@pytest.mark.slow
def test_the_environment_names_no_backend(tmp_path):
    """`MPLBACKEND=nonsense`: a traceback, though no command ever opens a window."""
    words = [sys.executable, "-m", "orbitfinder", "plot", str(TRIPLE), "-o", str(tmp_path)]
    env = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "nonsense"}
    done = subprocess.run(words, capture_output=True, text=True, env=env, check=False)
    assert done.returncode == 0 and list(tmp_path.glob("*.png")), done.stderr


def test_modes_of_a_linkage_that_moves_no_mass_are_refused(monkeypatch):
    """LAPACK's complaint of a mutated file was a traceback."""
    from orbitfinder.orbits.guesses import modes

    whole = modes.stationary_terms
    monkeypatch.setattr(modes, "stationary_terms", lambda *given: (*whole(*given)[:3], 0 * whole(*given)[3]))
    with pytest.raises(InputError, match=r"guess.mode: no modes at .*; give a state and a period"):
        of.load_problem(ROOT / "problems" / "linkages" / "five-bar-slow-mode.toml")


def test_a_command_that_found_nothing_leaves_no_empty_folder(tmp_path):
    orbit = ROOT / "results" / "gallery" / "henon-heiles-near-the-saddle" / "orbit.json"
    done = ran("connect", orbit, "-o", tmp_path / "a" / "b")
    assert done.exit_code == 1 and "take one of the same family" in done.stderr and not list(tmp_path.iterdir())
    (tmp_path / "mine").mkdir()
    ran("connect", orbit, "-o", tmp_path / "mine")
    assert [one.name for one in tmp_path.iterdir()] == ["mine"]


def test_a_section_of_one_degree_of_freedom_is_drawn_with_its_orbit(tmp_path):
    """`axes: need two different components, got xdot, xdot`, though none were given and there are no others."""
    orbit = ROOT / "results" / "gallery" / "van-der-pol" / "orbit.json"
    done = ran("section", orbit, "--seeds", 3, "--returns", 50, "-o", tmp_path)
    assert done.exit_code == 0 and (tmp_path / "van-der-pol" / "section.png").is_file(), done.output


def test_an_atlas_in_place_of_a_problem_is_called_one():
    book = ROOT / "results" / "atlas" / "rossler.sqlite"
    done = ran("continue", book)
    assert done.exit_code == 2 and f"{book}: an atlas database; give one orbit of it by its id: {book}#1" in done.stderr
