"""The command line: exit codes, what is written where, what goes to which stream, interrupts."""

import inspect
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.cli.jobs import check_writable, one_line
from orbitfinder.problemfile.proposals import propose
from orbitfinder.records.orbit import save_orbit
from orbitfinder.records.reading import finite
from orbitfinder.records.registry import load_orbit
from orbitfinder.site.build import SiteSettings

ROOT = Path(__file__).parents[1]
TRIPLE = ROOT / "problems" / "report" / "triple-1.toml"
COMMAND = [sys.executable, "-m", "orbitfinder"]

PENDULUM = """
name = "swing"
[system]
kind = "chain"
links = 1
[guess]
state = [1.0, 0.0]
period = 1.7
[find]
pin = { theta1 = 1.0 }
"""
WRONG = PENDULUM.replace("swing", "wrong") + "[expected]\nperiod = { value = 1.0, tolerance = 1e-6 }\n"
HOPELESS = """
name = "hopeless"
[system]
kind = "chain"
links = 2
[guess]
state = [0.3, -0.5, 0.0, 0.0]
period = 0.05
[find]
pin = { energy = -5.0 }
segments = 2
"""


def process(*arguments, **options):
    """The real command in a process of its own."""
    return subprocess.run(
        [*COMMAND, *map(str, arguments)], capture_output=True, text=True, cwd=ROOT, timeout=300, check=False, **options
    )


def invoke(*arguments):
    return CliRunner().invoke(cli, [str(argument) for argument in arguments])


def problem(folder, text, name="problem.toml"):
    path = folder / name
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """One full run of a report problem: the process and its output folder."""
    out = tmp_path_factory.mktemp("cli") / "orbits"
    return process("run", TRIPLE, "--out", out), out


def test_run_writes_orbit_samples_and_figures(ran):
    done, out = ran
    assert done.returncode == 0, done.stderr
    assert {path.name for path in (out / "triple-1").iterdir()} == {
        "orbit.json", "orbit.npz", "time_histories.png", "phase_portraits.png",
        "swept_configuration.png", "energy_error.png",
    }  # fmt: skip
    orbit = load_orbit(out / "triple-1" / "orbit.json")
    assert orbit.period == pytest.approx(1.65533898831464, abs=1e-10)
    assert orbit.certificate.passed and len(orbit.samples) > 100


def test_result_goes_to_stdout_and_plain_progress_to_stderr(ran):
    """Without a terminal: one line an iteration, no escape codes, nothing of IPOPT or SUNDIALS."""
    done, _ = ran
    assert "triple-1: certified, period 1.65533898831" in done.stdout
    lines = done.stderr.splitlines()
    assert any(line.startswith("triple-1: shooting 0, defect ") for line in lines)
    assert all(line.startswith("triple-1: ") for line in lines), done.stderr
    assert "\x1b" not in done.stdout + done.stderr


def test_verify_from_the_file_alone(ran, tmp_path):
    """The JSON is enough: it is verified in another folder, without its samples."""
    path = problem(tmp_path, (ran[1] / "triple-1" / "orbit.json").read_text(), "copied.json")
    done = invoke("verify", path)
    assert done.exit_code == 0 and "certified" in done.stdout
    assert "closure" in done.stdout and "FAILED" not in done.stdout


@pytest.mark.parametrize(
    ("field", "change"),
    [("period", lambda T: T * 1.001), ("energy", lambda E: E + 1e-6), ("stability", lambda _: "elliptic")],
)
def test_verify_names_the_failing_checks(ran, tmp_path, field, change):
    document = json.loads((ran[1] / "triple-1" / "orbit.json").read_text())
    document[field] = change(document[field])
    path = problem(tmp_path, json.dumps(document), "edited.json")
    done = invoke("verify", path)
    assert done.exit_code == 1 and "REJECTED" in done.stdout and "FAILED" in done.stdout
    told = invoke("verify", path, "--json")
    failing = [c["name"] for c in json.loads(told.stdout)["results"][0]["checks"] if not c["passed"]]
    assert told.exit_code == 1 and "record" in failing
    assert all(name in done.stdout for name in failing)


def test_verify_json_is_one_document(ran):
    path = ran[1] / "triple-1" / "orbit.json"
    document = json.loads(invoke("verify", path, path, "--json").stdout)
    assert document["format"] == "orbitfinder/verify" and document["passed"] and len(document["results"]) == 2


def test_rejected_result_is_not_called_an_orbit(tmp_path):
    done = invoke("run", problem(tmp_path, WRONG), "--out", tmp_path / "out")
    assert done.exit_code == 1
    assert "rejected" in done.stdout and "expected_period" in done.stdout
    assert {path.name for path in (tmp_path / "out" / "wrong").iterdir()} == {"rejected.json", "rejected.npz"}
    assert not json.loads((tmp_path / "out" / "wrong" / "rejected.json").read_text())["certificate"]["passed"]
    assert invoke("verify", tmp_path / "out" / "wrong" / "rejected.json").exit_code == 1


def test_a_certified_result_replaces_a_rejected_one(tmp_path):
    invoke("run", problem(tmp_path, WRONG), "--out", tmp_path)
    done = invoke("run", problem(tmp_path, PENDULUM.replace("swing", "wrong")), "--out", tmp_path, "--no-figures")
    assert done.exit_code == 0
    assert {path.name for path in (tmp_path / "wrong").iterdir()} == {"orbit.json", "orbit.npz"}


def test_search_without_success_writes_nothing(tmp_path):
    done = invoke("run", problem(tmp_path, HOPELESS), "--out", tmp_path / "out", "--json")
    document = json.loads(done.stdout)
    assert done.exit_code == 1 and not document["passed"]
    assert document["results"][0]["status"] == "failed" and document["results"][0]["message"]
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_jobs_side_by_side_give_what_one_after_the_other_gives(tmp_path):
    """Three problems in two processes, one of them rejected: exit code 1, the others certified."""
    files = [problem(tmp_path, PENDULUM, "a.toml"), problem(tmp_path, WRONG, "b.toml")]
    files.append(problem(tmp_path, PENDULUM.replace("swing", "third").replace("1.0", "0.5"), "c.toml"))
    done = process("run", *files, "--out", tmp_path / "out", "--jobs", "2", "--json", "--no-figures")
    assert done.returncode == 1, done.stderr
    results = {one["name"]: one for one in json.loads(done.stdout)["results"]}
    assert {name: one["status"] for name, one in results.items()} == {
        "swing": "certified", "wrong": "rejected", "third": "certified",
    }  # fmt: skip
    alone = invoke("run", files[0], "--out", tmp_path / "alone", "--json", "--no-figures")
    assert json.loads(alone.stdout)["results"][0]["period"] == results["swing"]["period"]


def test_trusted_python_file(tmp_path):
    text = (
        "import orbitfinder as of\n"
        "def problem():\n"
        "    return of.Problem(of.chain(1), of.Guess([1.0, 0.0], 1.7), pin=of.pin(theta1=1.0), name='swing')\n"
    )
    done = invoke("run", problem(tmp_path, text, "p.py"), "--trust", "--out", tmp_path / "out", "--no-figures")
    assert done.exit_code == 0 and (tmp_path / "out" / "swing" / "orbit.json").is_file()


def test_what_a_trusted_program_found_is_verified_followed_and_shown_by_that_program(tmp_path, monkeypatch):
    """At a freed parameter too, which its problem() knows nothing of; never without --trust."""
    text = (
        "import casadi as ca\nimport orbitfinder as of\n"
        "q, v, p = ca.SX.sym('q'), ca.SX.sym('v'), ca.SX.sym('p')\n"
        "model = of.lagrange(v**2 / 2, p * q**2 / 2 + q**4 / 4, of.Symbols(q, v, p, ('k',), (1.0,)), names=['x'])\n"
        "def problem():\n"
        "    pins = of.pin(x=1.0, period=4.5)\n"
        "    return of.Problem(model, of.Guess([1.0, 0.0], 4.6), pins, free=('k',), name='spring')\n"
    )
    monkeypatch.chdir(tmp_path)
    assert invoke("run", problem(tmp_path, text, "hard.py"), "--trust", "--no-figures").exit_code == 0
    found = json.loads(Path("orbits/spring/orbit.json").read_text())
    assert found["system"]["function"] == "problem" and found["system"]["arguments"]["k"] != 1.0
    refused = invoke("verify", "orbits/spring/orbit.json")
    assert refused.exit_code == 2 and "'hard' is a program that is not part of orbitfinder" in refused.stderr
    assert invoke("verify", "orbits/spring/orbit.json", "--trust").exit_code == 0
    follow = ("continue", "orbits/spring/orbit.json", "--parameter", "k", "--points", "1", "--no-figures", "--trust")
    assert invoke(*follow).exit_code == 0
    assert invoke("verify", "families/spring/family.json#0", "--trust").exit_code == 0
    (tmp_path / "hard.py").write_text(text.replace("q**4 / 4", "q**4 / 5"))
    assert invoke("verify", "orbits/spring/orbit.json", "--trust").exit_code == 1  # another spring is not that one


def test_simulate_reports_the_energy_drift(tmp_path):
    done = invoke("simulate", TRIPLE, "--duration", "2", "--json", "--out", tmp_path)
    document = json.loads(done.stdout)
    assert done.exit_code == 0 and document["duration"] == 2.0
    assert document["energy"] == pytest.approx(-38.351098574646194, abs=1e-12)
    assert 0 <= document["energy_drift"] < 1e-9
    table = np.loadtxt(document["written"], delimiter=",", skiprows=1)
    assert table.shape == (document["samples"], 7) and table[-1, 0] == 2.0
    np.testing.assert_array_equal(table[-1, 1:], list(document["end"].values()))


def test_simulated_csv_is_a_guess(tmp_path):
    """What simulate writes, [guess] csv reads."""
    source = problem(tmp_path, PENDULUM)
    invoke("simulate", source, "--duration", "1.7561", "--out", tmp_path)
    text = PENDULUM.replace("state = [1.0, 0.0]\nperiod = 1.7", 'csv = "simulation.csv"')
    done = invoke("run", problem(tmp_path / "swing", text), "--out", tmp_path / "out", "--no-figures")
    assert done.exit_code == 0, done.output


def test_simulate_in_words():
    done = invoke("simulate", TRIPLE, "--duration", "0.5")
    assert done.exit_code == 0
    assert "energy drift" in done.stdout and "theta3dot" in done.stdout


def test_simulate_calls_a_change_of_energy_what_it_is():
    """A dissipative system's energy does not drift, it changes; the JSON says which."""
    van_der_pol = Path(TRIPLE).parents[1] / "gallery" / "van-der-pol.toml"
    done = invoke("simulate", van_der_pol, "--duration", "3")
    assert "energy change" in done.stdout and "drift" not in done.stdout and "does not conserve" in done.stdout
    document = json.loads(invoke("simulate", van_der_pol, "--duration", "3", "--json").stdout)
    assert document["energy_conserved"] is False and document["energy_change"] > 0.1
    assert "energy_drift" not in document


FOREIGN = "from orbitfinder.systems import FUNCTIONS\ndef make(cubic):\n    return FUNCTIONS['duffing'](1.0, cubic)\n"


@pytest.mark.parametrize(
    "commands",
    [
        (["plot"], ["animate"], ["export", "--to", "c"]),
        pytest.param((["prove"], ["refine", "--digits", "20"]), marks=pytest.mark.needs("proof"), id="proofs"),
    ],
)
def test_commands_run_foreign_systems_only_with_trust(tmp_path, monkeypatch, commands):
    """Every command looks beside the orbit, then in the current folder; without --trust nothing of it is run."""
    (tmp_path / "mine.py").write_text(FOREIGN)
    text = (
        '[system]\nkind = "python"\nmodule = "mine"\nfunction = "make"\narguments = { cubic = 1.0 }\n'
        "[guess]\nstate = [1.0, 0.0]\nperiod = 4.8\n[find]\npin = { x = 1.0 }\n"
    )
    done = invoke("run", problem(tmp_path, text), "--trust", "--out", tmp_path / "out", "--no-figures")
    assert done.exit_code == 0, done.output
    (orbit,) = (tmp_path / "out").glob("*/orbit.json")
    refused = invoke("verify", orbit)
    assert refused.exit_code == 2 and "'mine' is a program" in refused.stderr and "--trust" in refused.stderr
    missing = invoke("verify", orbit, "--trust")
    assert missing.exit_code == 2 and "cannot be imported" in missing.stderr
    monkeypatch.chdir(tmp_path)
    assert invoke("verify", orbit, "--trust").exit_code == 0
    for words in commands:
        assert "--trust" in invoke(*words, orbit).stderr
        taken = invoke(*words, orbit, "--trust")
        assert taken.exit_code == 0, taken.output
    for more, unread in ((), True), (("--trust",), False):  # a page says that it was not run
        assert invoke("page", orbit, "-o", "site", *more).exit_code == 0
        (shown,) = (tmp_path / "site" / "orbits").glob("*.html")
        assert ("it was not run; read it, then add --trust" in shown.read_text()) == unread
    (orbit.parent / "mine.py").write_text(FOREIGN.replace("1.0, cubic", "2.0, cubic"))
    other = invoke("verify", orbit, "--trust")
    assert other.exit_code == 1 and "closure" in other.stdout


def test_init_writes_a_problem_and_never_over_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert invoke("init", "mine").exit_code == 0
    before = (tmp_path / "mine.toml").read_text()
    again = invoke("init", "mine.toml")
    assert again.exit_code == 2 and "left alone" in again.stderr
    assert (tmp_path / "mine.toml").read_text() == before


def test_what_init_writes_certifies(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    invoke("init", "mine")
    assert invoke("run", "mine.toml", "--no-figures").exit_code == 0
    assert (tmp_path / "orbits" / "mine" / "orbit.json").is_file()


@pytest.mark.parametrize("command", [[], ["run"], ["verify"], ["simulate"], ["init"]])
def test_help_has_examples(command):
    done = invoke(*command, "--help")
    assert done.exit_code == 0 and "Example" in done.stdout and "orbitfinder" in done.stdout


def test_help_loads_nothing_heavy():
    """`orbitfinder --help` must not wait for CasADi, NumPy, SciPy, pydantic, rich or matplotlib."""
    code = (
        "import sys\nfrom orbitfinder.cli.group import cli\n"
        "cli(['--help'], standalone_mode=False)\n"
        "heavy = {'casadi', 'scipy', 'matplotlib', 'pydantic', 'rich'} & sys.modules.keys()\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr


def wait_for(path, running):
    """Return once a file exists; fail when the process ends first."""
    while not path.exists():
        assert running.poll() is None, running.communicate()
        time.sleep(0.01)


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("jobs", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_interrupt_exits_130_and_leaves_whole_files_only(tmp_path, jobs):
    """Ctrl-C in the middle of many problems: finished results stay and load, nothing else is there."""
    files = [problem(tmp_path, PENDULUM.replace("swing", f"p{k}"), f"p{k}.toml") for k in range(60)]
    out = tmp_path / "out"
    running = subprocess.Popen(
        [*COMMAND, "run", *map(str, files), "--out", str(out), "--jobs", jobs],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, start_new_session=True,
    )  # fmt: skip
    wait_for(out / "p0" / "orbit.json", running)
    os.killpg(running.pid, signal.SIGINT)
    stdout, stderr = running.communicate(timeout=120)
    assert running.returncode == 130, stderr
    assert "Interrupted" in stderr and "Traceback" not in stderr and stdout == ""
    for path in out.rglob("*.json"):
        assert load_orbit(path).period > 0
    assert len(list(out.rglob("orbit.json"))) < 60
    assert not [path for path in out.rglob("*") if path.name.startswith(".")]


def test_live_display_on_a_terminal(tmp_path):
    """On a terminal the progress is drawn live, although the solver captures descriptor 2."""
    pty = pytest.importorskip("pty")
    leader, follower = pty.openpty()
    path = problem(tmp_path, PENDULUM)
    running = subprocess.Popen(
        [*COMMAND, "run", str(path), "--out", str(tmp_path / "out"), "--no-figures", "--json"],
        stdout=subprocess.PIPE, stderr=follower, cwd=ROOT, env=os.environ | {"TERM": "xterm", "COLUMNS": "120"},
    )  # fmt: skip
    os.close(follower)
    shown = b""
    try:
        while chunk := os.read(leader, 4096):
            shown += chunk
    except OSError:  # Linux reports the closed terminal so
        pass
    finally:
        os.close(leader)
    stdout, _ = running.communicate(timeout=120)
    assert running.returncode == 0 and json.loads(stdout)["passed"]
    for part in (b"iteration", b"defect", b"elapsed", b"shooting", b"swing"):
        assert part in shown


def test_writability_is_asked_of_the_file_system(tmp_path):
    check_writable(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir() and not list((tmp_path / "a" / "b").iterdir())


def test_messages_are_one_printable_line():
    assert one_line("a\n  b\x1b[2Jc\td") == "a b [2Jc d"


@pytest.mark.parametrize("command", [("continue",), ("plot", "-o", "FOLDER"), ("animate",), ("export", "--to", "csv")])
def test_names_that_lead_out_of_the_folder_are_refused(command, tmp_path, report_orbits):
    """A name in an orbit.json becomes part of a path."""
    file = save_orbit(report_orbits["triple-1"], tmp_path / "orbit.json")
    document = json.loads(file.read_text())
    file.write_text(json.dumps(document | {"name": "../../away"}))
    (tmp_path / "other.json").write_text(file.read_text())
    name, *options = [str(tmp_path) if word == "FOLDER" else word for word in command]
    files = [str(file), str(tmp_path / "other.json")] if name == "plot" else [str(file)]
    result = CliRunner().invoke(cli, [name, *files, *options])
    assert result.exit_code == 2
    assert "name: must consist of letters" in result.output


def test_shared_options_are_written_once():
    """--json and --trust stand in one module; the commands take them from there."""
    modules = (ROOT / "orbitfinder" / "cli").glob("*.py")
    texts = {path.name: path.read_text("utf-8") for path in modules}
    written = [where for where, text in texts.items() for name in ("json", "trust") if f'"--{name}", is_flag' in text]
    assert written == ["options.py", "options.py"]


def test_json_has_null_for_what_is_no_number():
    """NaN and infinities at any depth become null, everything else stays."""
    found = finite({"a": [1.5, float("nan"), (float("inf"), "x")], "b": {"c": -float("inf")}, "d": None})
    assert found == {"a": [1.5, None, [None, "x"]], "b": {"c": None}, "d": None}


COMPUTING = {"run", "verify", "simulate", "guess", "sweep", "continue", "search", "prove", "refine", "reproduce",
             "bifurcation", "connect", "diagram", "doctor", "equilibria", "manifold", "map", "phase", "section", "show",
             "stabilise", "torus"}  # fmt: skip


def test_every_computing_command_answers_in_json_and_every_out_has_its_letter():
    """--json wherever something is computed, and -o is --out wherever something is written."""
    options = {name: {word for one in command.params for word in one.opts} for name, command in cli.commands.items()}
    assert {name for name, words in options.items() if "--json" in words} == COMPUTING
    assert all("-o" in words for words in options.values() if "--out" in words)


def test_options_begin_with_the_defaults_of_what_they_are_passed_on_to():
    """A number or switch of a command has the default of the library's parameter or setting of its name."""
    asked = {
        "torus": (of.follow_tori, of.TorusSettings), "continue": (of.FamilySettings,), "section": (of.section,),
        "manifold": (of.manifold,), "connect": (of.connect,), "sweep": (of.sweep,), "search": (of.search,),
        "stabilise": (of.basin,), "guess": (propose,), "page": (SiteSettings,),
    }  # fmt: skip
    shown, known = {}, {}
    for name, functions in asked.items():
        parameters = {key: one for function in functions for key, one in inspect.signature(function).parameters.items()}
        for one in cli.commands[name].params:
            if isinstance(one.default, int | float) and one.name in parameters:
                shown[name, one.name], known[name, one.name] = one.default, parameters[one.name].default
    assert len(shown) > 20 and shown == known


def test_continue_answers_in_json(tmp_path):
    file = problem(tmp_path, PENDULUM)
    words = ("--points", 3, "--direction", "forward", "--no-figures", "--json", "-o", tmp_path / "families")
    result = invoke("continue", file, *words)
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    path = tmp_path / "families" / "swing" / "family.json"
    assert document["format"] == "orbitfinder/continue" and document["written"] == [str(path)]
    assert document["points"] == len(json.loads(path.read_text())["points"]) == 4
    assert document["certified"] == 2 and document["ends"] == [
        {"kind": "point limit", "reason": "3 points were asked for"}
    ]


@pytest.mark.parametrize(("certified", "code"), [(True, 0), (False, 1)])
def test_reproduce_answers_in_json(tmp_path, monkeypatch, certified, code):
    def parts(out, fresh, told):
        told("finished", 1, 1)
        return {"orbits": {"triple-1": {"certified": certified}}}

    monkeypatch.setattr("orbitfinder.reproduce.runner.reproduce", parts)
    result = invoke("reproduce", "--json", "-o", tmp_path)
    document = json.loads(result.stdout)
    assert result.exit_code == code and document["passed"] is certified and document["page"].endswith("README.md")


def test_a_model_is_built_once_for_a_run(tmp_path, monkeypatch):
    from orbitfinder.mechanics import kind as catalogue

    built, build = [], catalogue.build_model
    for place in ("orbitfinder.mechanics.kind", "orbitfinder.problemfile.read"):
        monkeypatch.setattr(f"{place}.build_model", lambda *given: built.append(given) or build(*given))
    assert invoke("run", problem(tmp_path, PENDULUM), "--no-figures", "--out", tmp_path).exit_code == 0
    assert len(built) == 1


def test_the_default_of_resolve_is_that_of_the_settings():
    """Said by the help, and an allowed value of the option."""
    (option,) = [one for one in cli.get_command(None, "continue").params if one.name == "resolve"]
    default = of.FamilySettings().narrowest
    assert option.help.endswith(f"[default: {default}]") and option.type.convert(repr(default), option, None) == default
