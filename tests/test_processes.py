"""Processes and streams as shells, daemons and strangers' folders leave them."""

import contextlib
import errno
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder._runtime import interrupt, locks
from orbitfinder.cli.group import cli
from orbitfinder.records import reading

ROOT = Path(__file__).parents[1]
COMMAND = [sys.executable, "-m", "orbitfinder"]
SEARCH = ROOT / "problems" / "search" / "triple.toml"
PLANTED = ("struct", "pickle", "socket", "selectors", "multiprocessing", "random", "tempfile")
PENDULUM = """
name = "{name}"
[system]
kind = "chain"
links = 1
[guess]
state = [{angle}, 0.0]
period = 1.8
[find]
pin = {{ theta1 = {angle} }}
"""
pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals and descriptors of POSIX")


def problems(folder, count):
    """Problem files of single pendulums."""
    files = [folder / f"p{k}.toml" for k in range(count)]
    for k, file in enumerate(files):
        file.write_text(PENDULUM.format(name=f"p{k}", angle=0.5 + k / count))
    return files


def started(*words, cwd=ROOT, **options):
    """The real command in a session of its own."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        [*COMMAND, *map(str, words)], cwd=cwd, env=environment | options.pop("env", {}), text=True,
        start_new_session=True, **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options,
    )  # fmt: skip


def until(condition, seconds=60.0):
    """Wait for a condition; False when it did not come."""
    end = time.monotonic() + seconds
    while not (found := condition()) and time.monotonic() < end:
        time.sleep(0.02)
    return bool(found)


def session(leader):
    """Processes of a session that are alive, by what the kernel says."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            words = stat.read_text().rpartition(")")[2].split()
            if int(words[3]) == leader and words[0] != "Z":
                found.append(int(stat.parent.name))
    return found


def at_work(leader, seconds=1.5):
    """Processes of a session, the leader apart, that have worked for so long: spawned, imported, on their first job."""
    found = []
    for process in session(leader):
        with contextlib.suppress(OSError):
            words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
            if process != leader and (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK") > seconds:
                found.append(process)
    return found


proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")


@pytest.mark.parametrize(
    ("command", "way"),
    [
        ("run", "module"),
        pytest.param("search", "installed", marks=pytest.mark.slow),
        pytest.param("run", "installed", marks=pytest.mark.slow),
        pytest.param("search", "module", marks=pytest.mark.slow),
    ],
)
def test_modules_in_the_current_folder_are_not_run(tmp_path, command, way):
    """A stranger's struct.py beside a problem file is not the library's; the workers' first imports are tried too."""
    for name in PLANTED:
        (tmp_path / f"{name}.py").write_text(f"open('RAN', 'a').write('{name}\\n')\nraise SystemExit(7)\n")
    files = problems(tmp_path, 2)
    words = {
        "run": ("run", *files, "--jobs", 2, "--no-figures"),
        "search": ("search", SEARCH, "--starts", 4, "--workers", 2, "--atlas", "z.sqlite"),
    }[command]
    script = "import sys; sys.path.remove(''); from orbitfinder.__main__ import main; main()"
    command = {"installed": [sys.executable, "-c", script], "module": COMMAND}[way]
    done = subprocess.run(
        [*command, *map(str, words)], cwd=tmp_path, capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)}, timeout=120,
    )  # fmt: skip
    assert not (tmp_path / "RAN").exists(), (tmp_path / "RAN").read_text()
    assert done.returncode == 0, done.stderr


def test_a_matplotlibrc_of_the_current_folder_is_not_read(tmp_path):
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\nsavefig.dpi: 1\n")
    running = started("run", *problems(tmp_path, 1), cwd=tmp_path)
    out, err = running.communicate(timeout=120)
    assert running.returncode == 0, err
    assert (tmp_path / "orbits" / "p0" / "phase_portraits.png").is_file(), out


@proc
@pytest.mark.parametrize(
    ("command", "number"),
    [
        pytest.param("search", signal.SIGKILL, marks=pytest.mark.slow),
        ("run", signal.SIGTERM),
        pytest.param("search", signal.SIGTERM, marks=pytest.mark.slow),
        pytest.param("run", signal.SIGKILL, marks=pytest.mark.slow),
    ],
)
def test_workers_do_not_outlive_their_parent(tmp_path, number, command):
    words = {
        "run": ("run", *problems(tmp_path, 60), "--jobs", 2, "--no-figures", "--out", tmp_path / "o"),
        "search": ("search", SEARCH, "--starts", 9999, "--workers", 2, "--atlas", tmp_path / "z.sqlite"),
    }[command]
    running = started(*words)
    assert until(lambda: len(session(running.pid)) >= 4)  # two workers, the tracker
    until((tmp_path / ("o/p1" if command == "run" else "z.sqlite")).exists, 20)
    assert until(lambda: len(at_work(running.pid)) >= 2, 60)  # a half-spawned Python has a traceback of its own
    os.kill(running.pid, number)
    _, err = running.communicate(timeout=30)
    assert until(lambda: not session(running.pid), 10), session(running.pid)
    assert running.returncode == -number
    assert "Traceback" not in err


@proc
@pytest.mark.parametrize("command", ["search", "run"])
@pytest.mark.parametrize("after", [0.3, 0.6, 1.2, 2.0])
def test_two_interrupts_leave_no_traceback(tmp_path, command, after):
    """Ctrl-C twice, at moments at which workers are starting."""
    words = {
        "run": ("run", *problems(tmp_path, 60), "--jobs", 2, "--no-figures", "--out", tmp_path / "o"),
        "search": ("search", SEARCH, "--starts", 9999, "--workers", 2, "--atlas", tmp_path / "z.sqlite"),
    }[command]
    running = started(*words)
    time.sleep(after)
    os.killpg(running.pid, signal.SIGINT)
    time.sleep(0.05)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(running.pid, signal.SIGINT)
    _, err = running.communicate(timeout=60)
    assert running.returncode in (130, -signal.SIGINT) and (after < 0.5 or "Traceback" not in err), err
    assert until(lambda: not session(running.pid), 10)


def test_a_signal_in_a_destructor_is_kept_and_not_printed(capfd):
    """Nothing can be raised there: Python would print a traceback, and the signal would be lost."""

    class Falling:
        def __del__(self):
            signal.raise_signal(signal.SIGINT)
            for _ in range(10):  # where Python looks at signals
                pass

    with pytest.raises(KeyboardInterrupt), interrupt.watch():
        Falling()
        interrupt.check()
    assert "Traceback" not in capfd.readouterr().err


def test_a_worker_that_dies_costs_its_job(tmp_path):
    """The others are done, and the command says what became of this one."""
    files = problems(tmp_path, 6)
    running = started("run", *files, "--jobs", 2, "--no-figures", "--out", tmp_path / "o", stderr=subprocess.DEVNULL)
    children = Path(f"/proc/{running.pid}/task/{running.pid}/children")
    if not children.exists():
        pytest.skip("needs /proc")
    (tmp_path / "o").mkdir(exist_ok=True)

    def workers():
        return [k for k in children.read_text().split() if b"spawn_main" in Path(f"/proc/{k}/cmdline").read_bytes()]

    assert until(workers)
    os.kill(int(workers()[0]), signal.SIGKILL)
    out, _ = running.communicate(timeout=120)
    assert running.returncode == 1 and out.count("the process that worked on it died") == 1
    assert out.count(": certified, ") == 5


@pytest.mark.parametrize(
    "close", ["<&- >&- 2>&-", *(pytest.param(one, marks=pytest.mark.slow) for one in ("2>&-", ">&- 2>&-", "<&-"))]
)
def test_closed_streams_change_nothing(tmp_path, close):
    """As daemons start their children."""
    (file,) = problems(tmp_path, 1)
    line = f"'{sys.executable}' -m orbitfinder run '{file}' --out '{tmp_path / 'o'}' --no-figures {close}"
    done = subprocess.run(line, shell=True, cwd=ROOT, timeout=120, capture_output=True)
    assert done.returncode == 0 and (tmp_path / "o" / "p0" / "orbit.json").is_file()


def test_a_reader_that_goes_away_does_not_change_the_exit_code(tmp_path):
    (file,) = problems(tmp_path, 1)
    reading, writing = os.pipe()
    os.close(reading)
    running = started("run", file, "--out", tmp_path / "o", "--no-figures", stdout=writing)
    os.close(writing)
    _, err = running.communicate(timeout=120)
    assert running.returncode == 0 and "Traceback" not in err and "Broken" not in err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_a_full_disk_behind_a_stream_is_a_sentence(tmp_path, stream):
    """Nothing of it is a traceback; what cannot be said at all is said by the exit code."""
    (file,) = problems(tmp_path, 1)
    with open("/dev/full", "w") as full:
        running = started("run", file, "--out", tmp_path / "o", "--no-figures", **{stream: full})
        out, err = running.communicate(timeout=120)
    assert "Traceback" not in (out or "") + (err or "") and "Exception" not in (err or "")
    if stream == "stdout":
        assert running.returncode == 2 and "standard output: No space left on device" in err
    else:
        assert running.returncode == 0 and "certified" in out


@pytest.mark.parametrize(
    "environment",
    [
        pytest.param({"ORBITFINDER_CACHE": "~nosuchuser/x"}, marks=pytest.mark.slow),
        {"HOME": "", "ORBITFINDER_CACHE": ""},
    ],
)
def test_without_a_home_nothing_is_compiled_and_nothing_fails(tmp_path, environment):
    """A container's user has no home and no entry in passwd."""
    (file,) = problems(tmp_path, 1)
    running = started("run", file, "--out", tmp_path / "o", "--no-figures", "--compile", "on", env=environment)
    _, err = running.communicate(timeout=120)
    assert running.returncode == 0, err
    running = started("doctor", env=environment)
    out, err = running.communicate(timeout=120)
    assert "Traceback" not in err and "Set ORBITFINDER_CACHE to a folder of your own" in " ".join(out.split()), err


def test_threads_keep_the_terminal(capfd):
    """Four threads find orbits; what they and others print arrives, and the descriptors are those from before."""
    before = [os.fstat(k).st_ino for k in (1, 2)]
    problem = of.Problem(of.chain(1), of.Guess([1.0, 0.0], 1.8), of.pin(theta1=1.0))
    found = []

    def find(k):
        for j in range(4):
            found.append(of.find_orbit(problem).period)
            sys.stdout.write(f"thread {k} orbit {j}\n")  # print would write the end of the line apart

    threads = [threading.Thread(target=find, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [os.fstat(k).st_ino for k in (1, 2)] == before
    lines = capfd.readouterr().out.splitlines()
    assert sorted(lines) == [f"thread {k} orbit {j}" for k in range(4) for j in range(4)]
    assert len(found) == 16 and max(found) - min(found) < 1e-11


def test_a_refiner_may_be_shared_by_threads():
    """Each refinement is the one that it would have been alone."""
    problem = of.Problem(of.chain(2), of.Guess([0.3, 0.4, 0.0, 0.0], 2.0), of.pin(theta1=0.3))
    refiner = of.Refiner(problem)
    angles = [0.2 + 0.01 * k for k in range(24)]
    alone = [refiner.refine(pin=of.pin(theta1=a)).period for a in angles]
    together = dict[float, float]()

    def refine(some):
        for a in some:
            together[a] = refiner.refine(pin=of.pin(theta1=a)).period

    threads = [threading.Thread(target=refine, args=(angles[k::4],)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [together.get(a) for a in angles] == alone


@pytest.mark.slow
def test_two_continuations_do_not_share_a_folder(tmp_path):
    """One does it, the other is told; the journal has every line once, and the next one goes on from it."""
    files = [tmp_path / "family.toml"]
    text = PENDULUM.format(name="swing", angle=0.5)
    files[0].write_text(text)
    words = ("continue", files[0], "--points", 40, "--out", tmp_path / "f", "--no-figures")
    pair = [started(*words), started(*words)]
    ends = [(one.communicate(timeout=120), one.returncode) for one in pair]
    assert sorted(code for _, code in ends) in ([0, 2], [0, 0]), ends  # both, where the first was done too soon
    for (_, err), code in ends:
        assert code == 0 or "another process is writing there" in err
    lines = (tmp_path / "f" / "swing" / "family.jsonl").read_bytes().splitlines()
    assert len(lines) == len(set(lines)) > 10
    with locks.alone_in(tmp_path / "f" / "swing"):
        refused = started(*words)
        assert "another process is writing there" in refused.communicate(timeout=60)[1] and refused.returncode == 2
    assert not list((tmp_path / "f" / "swing").glob(".*"))


@pytest.mark.parametrize(
    "verb", ["continue", "export", pytest.param("prove", marks=pytest.mark.needs("proof")), "plot", "run"]
)
def test_a_full_disk_is_a_sentence(tmp_path, monkeypatch, pendulum_orbit, verb):
    """Every file is put in its place by a rename; when that fails the command says so and what there was stays."""
    file = of.save_orbit(pendulum_orbit, tmp_path / "orbit.json")
    before = file.read_bytes()
    words = {
        "continue": ["continue", file, "--points", "3", "--out", tmp_path / "f"],
        "export": ["export", file, "--to", "csv", "--out", tmp_path / "e"],
        "prove": ["prove", file],
        "plot": ["plot", file, "-o", tmp_path / "figures"],
        "run": ["run", *problems(tmp_path, 1), "--out", tmp_path / "o"],
    }[verb]

    def full(source, target, **_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target))

    monkeypatch.setattr(os, "replace", full)
    done = CliRunner().invoke(cli, [str(word) for word in words])
    assert done.exit_code == 2 and "No space left on device" in done.stderr and "Traceback" not in done.output, done
    assert file.read_bytes() == before and not list(tmp_path.rglob(".*"))


@pytest.mark.needs("proof")
def test_a_proof_is_not_begun_that_cannot_be_recorded(tmp_path, monkeypatch, pendulum_orbit):
    file = of.save_orbit(pendulum_orbit, tmp_path / "orbit.json")

    def refused(**_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("orbitfinder.cli.jobs.tempfile.TemporaryFile", refused)
    monkeypatch.setattr("orbitfinder.proof.theorem.prove", None)
    done = CliRunner().invoke(cli, ["prove", str(file)])
    assert done.exit_code == 2 and "--record: cannot write in" in done.stderr


def test_a_lock_is_held_by_one(tmp_path):
    path = tmp_path / "lock"
    with locks.held(path) as first, locks.held(path) as second:
        assert first and not second
    with locks.held(path) as again:
        assert again
    assert not path.exists()


def test_a_lock_file_that_leads_elsewhere_is_not_followed(tmp_path):
    (tmp_path / "victim").write_text("precious")
    (tmp_path / "lock").symlink_to(tmp_path / "victim")
    with pytest.raises(OSError), locks.held(tmp_path / "lock"):
        pass
    assert (tmp_path / "victim").read_text() == "precious"


AS_ON_WINDOWS = """
import fcntl, sys, types
from pathlib import Path
import orbitfinder.errors

def locking(handle, how, size):
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise PermissionError(13, "Permission denied") from None

sys.modules["msvcrt"], sys.modules["fcntl"] = types.SimpleNamespace(locking=locking, LK_NBLCK=2), None
sys.platform = "win32"
from orbitfinder._runtime import locks
path = Path(sys.argv[1])
with locks.held(path) as mine, locks.held(path) as another:
    print(mine, another)
with locks.held(path) as again:
    print(again, path.exists())
print(path.exists())
"""


def test_the_lock_of_windows_is_held_by_one_at_a_time(tmp_path):
    """With msvcrt in fcntl's place; without either everybody held it."""
    words = [sys.executable, "-c", AS_ON_WINDOWS, str(tmp_path / "lock")]
    said = subprocess.run(words, capture_output=True, text=True, check=True, cwd=ROOT).stdout
    assert said.split() == ["True", "False", "True", "True", "False"]


def test_a_file_that_somebody_reads_is_replaced_a_moment_later(tmp_path, monkeypatch):
    """Windows replaces no file that is open; elsewhere a refusal is one at once."""
    replace, refusals = os.replace, [PermissionError(errno.EACCES, "Permission denied")] * 2

    def busy(source, target):
        if refusals:
            raise refusals.pop()
        replace(source, target)

    monkeypatch.setattr(os, "replace", busy)
    with pytest.raises(PermissionError):
        reading.write_json(tmp_path / "one.json", [1])
    monkeypatch.setattr(reading, "BUSY", 5.0)
    assert reading.write_json(tmp_path / "one.json", [2]).read_text() == "[\n 2\n]\n"
    assert len(list(tmp_path.iterdir())) == 1 and not refusals
