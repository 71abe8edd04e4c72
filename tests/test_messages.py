"""Bad input: exit code 2, one sentence with field, value and remedy, no traceback, nothing computed."""

import json
import os

import pytest
from click.testing import CliRunner

from orbitfinder.cli.group import cli
from orbitfinder.records.orbit import orbit_to_document

SYSTEM = '[system]\nkind = "chain"\nlinks = 2\n'
GUESS = "[guess]\nstate = [0.1, 0.2, 0.0, 0.0]\nperiod = 2.4\n"


def with_system(line):
    return SYSTEM + line + "\n" + GUESS


def with_guess(text, links=2):
    return f'[system]\nkind = "chain"\nlinks = {links}\n[guess]\n{text}\n'


def with_find(text):
    return SYSTEM + GUESS + "[find]\n" + text + "\n"


BAD = {
    "not-toml": ("this is = = not", ["not TOML", "line 1", "problem-file.md"]),
    "empty": ("", ["system", "missing"]),
    "system-not-a-table": ("system = 3\n[guess]\nmode = 1\namplitude = 0.1", ["system", "table", "3"]),
    "unknown-key": (with_system("lenght = 1.0"), ["system.lenght", "did you mean 'length'"]),
    "unknown-table": (SYSTEM + GUESS + "[fnid]\n", ["fnid", "did you mean 'find'"]),
    "unknown-guess-key": (with_guess("state=[1.0]\nperoid=2.0"), ["guess.peroid", "did you mean 'period'"]),
    "unknown-expected": (
        SYSTEM + GUESS + "[expected]\nperiods = {value = 1.0, tolerance = 1.0}",
        ["expected.periods", "did you mean 'period'"],
    ),
    "kind-missing": ("[system]\nlinks = 2\n" + GUESS, ["system.kind", "missing", "'chain'"]),
    "kind-unknown": ('[system]\nkind = "chian"\n' + GUESS, ["system.kind", "'chian'", "did you mean 'chain'"]),
    "links-missing": ('[system]\nkind = "chain"\n' + GUESS, ["system.links", "missing", "number of links"]),
    "links-0": (with_guess("mode = 1\namplitude = 0.1", 0), ["system.links", "got 0", "1 to"]),
    "links-negative": (with_guess("mode = 1\namplitude = 0.1", -2), ["system.links", "got -2"]),
    "links-huge": (with_guess("mode = 1\namplitude = 0.1", 10**9), ["system.links", "1000000000", "2000"]),
    "links-bool": (with_guess("mode = 1\namplitude = 0.1", "true"), ["system.links", "True"]),
    "links-fraction": (with_guess("mode = 1\namplitude = 0.1", 2.5), ["system.links", "2.5"]),
    "mass-negative": (with_system("mass = -1.0"), ["system.mass", "-1.0", "greater than 0"]),
    "mass-zero": (with_system("mass = [1.0, 0.0]"), ["system.mass", "0.0", "greater than 0"]),
    "mass-text": (with_system('mass = "1"'), ["system.mass", "'1'", "number"]),
    "length-zero": (with_system("length = 0"), ["system.length", "got 0", "greater than 0"]),
    "length-nan": (with_system("length = nan"), ["system.length", "nan", "finite"]),
    "length-inf": (with_system("length = [1.0, inf]"), ["system.length", "inf", "finite"]),
    "length-count": (with_system("length = [1.0, 1.0, 1.0]"), ["system.length", "3 numbers", "2 links"]),
    "length-empty": (with_system("length = []"), ["system.length", "[]", "one per link"]),
    "inertia-negative": (with_system("inertia = -0.1"), ["system.inertia", "-0.1", "at least 0"]),
    "gravity-inf": (with_system("gravity = inf"), ["system.gravity", "inf", "finite"]),
    "gravity-overflow": (with_system("gravity = 1" + "0" * 400), ["system.gravity", "beyond"]),
    "formulation": (with_system('formulation = "newton"'), ["system.formulation", "'newton'", "recursive"]),
    "no-guess": (SYSTEM, ["guess", "missing", "[guess]"]),
    "two-guesses": (
        with_guess("state = [0.1, 0.2, 0, 0]\nperiod = 2.0\nmode = 1\namplitude = 0.1"),
        ["guess", "exactly one", "state and mode"],
    ),
    "state-without-period": (with_guess("state = [0.1, 0.2, 0, 0]"), ["guess", "state goes with period"]),
    "mode-without-amplitude": (with_guess("mode = 1"), ["guess", "mode goes with amplitude"]),
    "state-count": (with_guess("state = [0.1, 0.2]\nperiod = 2.0"), ["guess.state", "2 numbers", "4"]),
    "state-nan": (with_guess("state = [0.1, nan, 0, 0]\nperiod = 2.0"), ["guess.state", "nan", "finite"]),
    "state-text": (with_guess('state = [0.1, "x", 0, 0]\nperiod = 2.0'), ["guess.state", "'x'", "rad"]),
    "period-zero": (with_guess("state = [0.1, 0.2, 0, 0]\nperiod = 0"), ["guess.period", "got 0", "positive"]),
    "period-negative": (with_guess("state = [0.1, 0.2, 0, 0]\nperiod = -2.0"), ["guess.period", "-2.0"]),
    "period-inf": (with_guess("state = [0.1, 0.2, 0, 0]\nperiod = inf"), ["guess.period", "inf", "finite"]),
    "mode-0": (with_guess("mode = 0\namplitude = 0.1"), ["guess.mode", "got 0"]),
    "mode-3": (with_guess("mode = 3\namplitude = 0.1"), ["guess.mode", "got 3", "between 1 and 2"]),
    "amplitude": (with_guess("mode = 1\namplitude = -0.1"), ["guess.amplitude", "-0.1", "positive"]),
    "csv-outside": (with_guess('csv = "../../etc/passwd"'), ["guess.csv", "outside", "beside"]),
    "csv-absolute": (with_guess('csv = "/etc/passwd"'), ["guess.csv", "outside"]),
    "csv-missing": (with_guess('csv = "nowhere.csv"'), ["guess.csv", "nowhere.csv", "no such file"]),
    "pin-unknown": (with_find("pin = { theta9 = 0.1 }"), ["find.pin", "'theta9'", "theta1"]),
    "pin-nan": (with_find("pin = { energy = nan }"), ["find.pin.energy", "nan", "finite"]),
    "pin-period": (with_find("pin = { period = -1.0 }"), ["find.pin", "-1", "positive"]),
    "pin-not-a-table": (with_find("pin = 3.0"), ["find.pin", "table", "3.0"]),
    "two-pins": (with_find("pin = { energy = -10.0, period = 2.0 }"), ["find.pin", "2 pins", "remove 1"]),
    "energy-unreachable": (with_find("pin = { energy = -100.0 }"), ["find.pin", "-100", "-19.6", "larger"]),
    "segments-0": (with_find("segments = 0"), ["find.segments", "got 0", "at least 1"]),
    "segments-huge": (with_find("segments = 1000000"), ["find.segments", "1000000"]),
    "symmetry": (with_find('symmetry = "brak"'), ["find.symmetry", "'brak'", "brake"]),
    "tolerance": (with_find("tolerance = 0.0"), ["find.tolerance", "0.0"]),
    "free": (with_find('free = ["lenth2"]'), ["find.free", "'lenth2'", "length2"]),
    "winding-count": (with_find("winding = [1]"), ["find.winding", "1 numbers", "2 coordinates"]),
    "winding-symmetry": (with_find('winding = [1, 0]\nsymmetry = "brake"'), ["find.winding", "[1, 0]", "'none'"]),
    "expected-number": (SYSTEM + GUESS + "[expected]\nperiod = 2.0", ["expected.period", "2.0", "tolerance"]),
    "expected-tolerance": (
        SYSTEM + GUESS + "[expected]\nperiod = { value = 2.0, tolerance = -1.0 }",
        ["expected.period.tolerance", "-1.0", "positive"],
    ),
    "search-order": (
        SYSTEM + GUESS + "[search]\nperiod = [3.0, 1.0]",
        ["search.period: must", "smallest below largest", "got [3.0, 1.0]"],
    ),
    "search-count": (SYSTEM + GUESS + "[search]\nperiod = [3.0]", ["search.period", "[3.0]", "largest"]),
    "name-path": ('name = "../../x"\n' + SYSTEM + GUESS, ["name", "'../../x'", "letters"]),
    "name-dots": ('name = "a..b"\n' + SYSTEM + GUESS, ["name", "'a..b'"]),
    "name-hidden": ('name = ".x"\n' + SYSTEM + GUESS, ["name", "'.x'"]),
    "name-markup": ('name = "<b>x</b>"\n' + SYSTEM + GUESS, ["name", "'<b>x</b>'"]),
    "name-empty": ('name = ""\n' + SYSTEM + GUESS, ["name", "''"]),
    "name-long": (f'name = "{"x" * 200}"\n' + SYSTEM + GUESS, ["name", "at most 100"]),
    "title-escape": ('title = "a\\u001b[2Jb"\n' + SYSTEM + GUESS, ["title", "control characters"]),
    "key-escape": ('"a\\u001b[2Jb" = 1\n' + SYSTEM + GUESS, ["unknown key"]),
    "duplicate-key": (with_system("links = 3"), ["not TOML"]),
    "digits": (with_system("a = " + "1" * 5000), ["not TOML", "digits"]),
    "mode-kind": (with_guess("mode = 0\namplitude = 0.1"), ["guess.mode: must be", "got 0"]),
    "amplitude-kind": (with_guess("mode = 1\namplitude = -0.1"), ["guess.amplitude: must be", "got -0.1"]),
    "winding-huge": (with_find(f"winding = [{10**30}, 0]"), ["find.winding[0]", "1e30"]),
    "length-huge": (with_system("length = 1.7e308"), ["system.length: must be finite and below 1e+300", "1.7e+308"]),
    "modes-overflow": (
        '[system]\nkind = "chain"\nlinks = 2\nlength = [1e200, 4e11]\n[guess]\nmode = 1\namplitude = 0.1\n',
        ["guess.mode", "not in double precision"],
    ),
    "bounds-order": (with_find("bounds = { period = [3.0, 1.0] }"), ["find.bounds.period: must", "got [3.0, 1.0]"]),
    "csv-nul": (with_guess('csv = "a\\u0000b"'), ["guess.csv", "no usable path"]),
    "deep": ("a = " + "[" * 20000, ["problem.toml"]),
}


def refused(arguments):
    """The message of a command that must end with exit code 2."""
    result = CliRunner().invoke(cli, [str(argument) for argument in arguments])
    assert result.exit_code == 2, result.output
    assert result.exception is None or isinstance(result.exception, SystemExit)
    assert "Traceback" not in result.output and result.stdout == ""
    assert result.stderr.startswith("Error: ") and result.stderr.count("\n") == 1, result.stderr
    assert "\x1b" not in result.stderr
    return result.stderr


@pytest.mark.parametrize("text, said", BAD.values(), ids=BAD.keys())
def test_bad_problem_file(tmp_path, text, said):
    path = tmp_path / "problem.toml"
    path.write_text(text, encoding="utf-8")
    message = refused(["run", path, "--out", tmp_path / "out"])
    for part in ["problem.toml", *said]:
        assert part in message
    assert not (tmp_path / "out").exists()


CSV = {
    "words": ("t,a\n0,0.1,x,0,0\n", ["line 2", "'x'"]),
    "columns": ("0,0.1,0.2\n1,0.1,0.2\n", ["line 1", "3 columns", "5"]),
    "nan": ("0,0.1,0.2,0,0\n1,nan,0,0,0\n", ["finite"]),
    "order": ("0,0.1,0.2,0,0\n0,0.1,0.2,0,0\n", ["increase"]),
    "short": ("0,0.1,0.2,0,0\n", ["1 row of", "at least 2"]),
    "empty": ("", ["0 rows"]),
}


@pytest.mark.parametrize("text, said", CSV.values(), ids=CSV.keys())
def test_bad_trajectory(tmp_path, text, said):
    (tmp_path / "a.csv").write_text(text)
    path = tmp_path / "problem.toml"
    path.write_text(with_guess('csv = "a.csv"'))
    message = refused(["run", path, "--out", tmp_path / "out"])
    for part in ["guess.csv", "a.csv", *said]:
        assert part in message


@pytest.fixture
def good(tmp_path):
    path = tmp_path / "good.toml"
    path.write_text(with_guess("mode = 1\namplitude = 0.1", 1))
    return path


@pytest.mark.parametrize("command", ["run", "simulate", "verify"])
def test_missing_file(tmp_path, command):
    assert "no such file" in refused([command, tmp_path / "nowhere.toml"])


@pytest.mark.parametrize("command", ["run", "simulate", "verify"])
def test_folder_for_a_file(tmp_path, command):
    assert "folder" in refused([command, tmp_path])


def test_not_utf8(tmp_path):
    path = tmp_path / "latin.toml"
    path.write_bytes(b'title = "caf\xe9"')
    assert "not UTF-8" in refused(["run", path])


def test_not_a_regular_file(tmp_path):
    path = tmp_path / "pipe.toml"
    os.mkfifo(path)
    assert "not a regular file" in refused(["run", path])


def test_output_folder_is_a_file(tmp_path, good):
    (tmp_path / "out").write_text("in the way")
    message = refused(["run", good, "--out", tmp_path / "out"])
    assert "--out" in message and "cannot write" in message and "choose a folder" in message


def test_output_of_one_problem_is_a_file(tmp_path, good):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "good").write_text("in the way")
    assert "cannot write" in refused(["run", good, "--out", tmp_path / "out"])


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes everywhere")
def test_output_folder_read_only(tmp_path, good):
    (tmp_path / "out").mkdir(mode=0o500)
    assert "Permission denied" in refused(["run", good, "--out", tmp_path / "out"])


def test_one_name_twice(tmp_path, good):
    other = tmp_path / "folder"
    other.mkdir()
    (other / "good.toml").write_text(good.read_text())
    message = refused(["run", good, other / "good.toml", "--out", tmp_path / "out"])
    assert "name: 'good'" in message and "rename" in message


def test_nothing_is_run_when_one_file_is_bad(tmp_path, good):
    refused(["run", good, tmp_path / "nowhere.toml", "--out", tmp_path / "out"])
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("option", "value"), [("--until", "nan"), ("--until", "inf"), ("--at", "nan,1")])
def test_a_family_has_no_end_at_nan(tmp_path, option, value):
    result = CliRunner().invoke(cli, ["continue", "any.toml", option, value, "--out", str(tmp_path / "out")])
    assert result.exit_code == 2 and option in result.stderr and "finite" in result.stderr
    assert not list(tmp_path.iterdir())


def test_animations_of_an_unknown_kind_make_no_folder(tmp_path):
    message = refused(["animate", "any.json", "-o", tmp_path / "x.avi"])
    assert ".avi" in message and ".gif or .mp4" in message and not list(tmp_path.iterdir())


def test_python_file_without_trust(tmp_path):
    (tmp_path / "p.py").write_text("raise SystemExit('executed')")
    assert "--trust" in refused(["run", tmp_path / "p.py"])


@pytest.mark.parametrize("duration", ["0", "-1", "nan", "inf"])
def test_bad_duration(good, duration):
    assert "--duration" in refused(["simulate", good, "--duration", duration])


@pytest.mark.filterwarnings("ignore")
def test_a_family_of_numbers_that_overflow(tmp_path):
    """A start whose variations are no numbers is an answer, not a traceback of the linear algebra."""
    path = tmp_path / "problem.toml"
    path.write_text(with_guess("state = [2.2e6, 0.2, 0.0, 0.0]\nperiod = 1e-300"))
    result = CliRunner().invoke(cli, ["continue", str(path), "--out", str(tmp_path / "out")])
    assert result.exit_code == 1 and "not finite" in result.stderr and isinstance(result.exception, SystemExit)


def test_csv_in_a_circle_of_links(tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    path = tmp_path / "problem.toml"
    path.write_text(with_guess('csv = "loop"'))
    said = refused(["run", path])  # before Python 3.13 it is seen when the path is resolved, then when it is opened
    assert "guess.csv: " in said and ("Symlink loop" in said or "symbolic links" in said)


ORBIT = {"format": "orbitfinder/orbit", "version": 1, "name": "x"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "corrupt"),
        ('{"format": "orbitfinder/orbit", "ver', "truncated"),
        ("[1, 2]", "format"),
        ('{"format": "something/else"}', "'something/else'"),
        (json.dumps(ORBIT | {"version": 99}), "99"),
        (json.dumps(ORBIT), "missing"),
        ("\x00\x01\x02", "corrupt"),
    ],
)
def test_bad_orbit_file(tmp_path, text, said):
    path = tmp_path / "orbit.json"
    path.write_text(text)
    message = refused(["verify", path])
    assert "orbit.json" in message and said in message


@pytest.fixture(scope="module")
def document(pendulum_orbit):
    return orbit_to_document(pendulum_orbit)


EDITS = {
    "state-short": ({"state": [1.0]}, "1 number in state"),
    "state-long": ({"state": [1.0, 0.0, 0.0, 0.0]}, "4 numbers in state"),
    "state-nested": ({"state": [[1.0, 0.0]]}, "state"),
    "state-text": ({"state": ["a", "b"]}, "malformed"),
    "state-huge": ({"state": [1e308, 0.0]}, "up to 1e+300"),
    "winding": ({"winding": [0, 0]}, "2 in winding"),
    "unfolding": ({"unfolding": ["x"]}, "malformed"),
    "expected": ({"expected": {"colour": {"value": 1.0, "tolerance": 1.0}}}, "'colour' is nothing that an orbit"),
    "provenance": ({"provenance": 3}, "malformed"),
    "kind": ({"system": {"kind": "x"}}, "'x'"),
    "system-key": ({"system": {"kind": "chain", "links": 1, "colour": 2}}, "colour"),
    "multipliers": ({"floquet_multipliers": [1.0]}, "malformed"),
    "nodes": ({"nodes": [[1.0], [1.0, 2.0]]}, "malformed"),
}


@pytest.mark.parametrize("edit, said", EDITS.values(), ids=EDITS.keys())
def test_orbit_file_whose_entries_do_not_fit(tmp_path, document, edit, said):
    path = tmp_path / "orbit.json"
    path.write_text(json.dumps(document | edit))
    message = refused(["verify", path])
    assert "orbit.json" in message and said in message


def test_error_as_json(tmp_path):
    """With --json standard output is one document even when the input is bad."""
    result = CliRunner().invoke(cli, ["run", str(tmp_path / "nowhere.toml"), "--json"])
    assert result.exit_code == 2
    document = json.loads(result.stdout)
    assert document["format"] == "orbitfinder/error" and "nowhere.toml" in document["error"]
    assert "no such file" in result.stderr


@pytest.mark.parametrize("name", ["../x", ".x", "a/b", ""])
def test_init_with_a_bad_name(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    assert "NAME" in refused(["init", name])
    assert not list(tmp_path.iterdir())
