"""The benchmarks: their equations are ours, what is missing is said, and the page is put together from its parts."""

import re
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from conftest import PRINTED

import orbitfinder as of

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))

import breakdown  # noqa: E402
import earlier  # noqa: E402
import first_order  # noqa: E402
import machine  # noqa: E402
import run  # noqa: E402
import turns  # noqa: E402
from peers import auto, auto_forced, octave, program  # noqa: E402
from peers.task import Answer, Unavailable, closure, tasks  # noqa: E402


def test_tasks_are_the_printed_orbits():
    for task in tasks():
        assert tuple(task.state) == PRINTED[task.name].state and task.period == PRINTED[task.name].guessed_period


def test_everybody_is_judged_by_the_certificate(report_orbits):
    task = tasks()[0]
    orbit = report_orbits[task.name]
    assert closure(task, Answer(0.0, orbit.state, orbit.period)) == pytest.approx(orbit.closure, abs=1e-13)
    assert closure(task, Answer(0.0, task.state, task.period)) > 1e-7


def test_equations_given_to_auto_are_those_of_the_chain():
    """Right-hand side T f, its derivatives and the boundary rows, against finite differences and the model."""
    task = tasks()[0]
    rate, slopes, rows, ends = auto.equations(task)
    random = np.random.default_rng(0)
    x, par = random.normal(size=6), random.normal(size=11)
    values = slopes(x, par)
    np.testing.assert_allclose(values[0], rate(x, par))
    for number, size in ((1, 6), (2, 11)):
        matrix = values[number].full().reshape(6, size, order="F")
        for k in range(size):
            step = 1e-6 * np.eye(size)[k]
            pair = [(x + s * step, par) if number == 1 else (x, par + s * step) for s in (1, -1)]
            difference = (rate(*pair[0]).full() - rate(*pair[1]).full()).ravel() / 2e-6
            np.testing.assert_allclose(matrix[:, k], difference, atol=1e-6 * max(1.0, np.abs(difference).max()))
    assert np.abs(rows(task.state, task.state).full()).max() < 1e-12
    assert ends(task.state, task.state)[1].numel() == 8 * 12


def test_equations_given_to_heyoka_are_those_of_the_chain():
    hy = pytest.importorskip("heyoka")
    from peers.taylor import expressions

    x = ca.SX.sym("x", 4)
    rows = ca.vertcat(ca.sin(x[0]) / x[1] - 2 * x[2] ** 2, -ca.cos(x[3]) + 1 / x[0], x[2], 3)
    function = ca.Function("f", [x], [rows])
    variables = hy.make_vars(*(f"x{k}" for k in range(4)))
    compiled = hy.cfunc(expressions(hy, function, variables), variables)
    point = np.array([0.3, 0.7, -0.4, 1.1])
    np.testing.assert_allclose(compiled(point), function(point).full().ravel(), rtol=1e-15)


def test_missing_peers_are_named(monkeypatch):
    task = tasks()[0]
    monkeypatch.setattr(auto, "HOME", Path("nowhere"))
    with pytest.raises(Unavailable, match="AUTO-07p or gfortran is not installed"):
        auto.Auto(task)
    monkeypatch.setattr(octave.shutil, "which", lambda name: None)
    with pytest.raises(Unavailable, match="Octave is not installed"):
        octave.refine(task)


def test_octave_is_ended_in_time():
    if octave.shutil.which("octave") is None:
        pytest.skip("Octave is not installed")
    with pytest.raises(Unavailable, match=r"not finished after 0\.3 s"):
        octave.refine(tasks()[1], limit=0.3)


@pytest.mark.slow
def test_auto_refines_the_printed_digits():
    """AUTO's correction at fixed energy ends at our orbit."""
    task = tasks()[3]
    try:
        peer = auto.Auto(task)
    except Unavailable as error:
        pytest.skip(str(error))
    answer = peer.refine()
    peer.close()
    assert answer.period == pytest.approx(PRINTED[task.name].period, abs=1e-12) and closure(task, answer) < 1e-12


def part(folder: Path, name: str, body: str, limit: float = 60.0) -> run.Part:
    (folder / f"{name}.py").write_text(body)
    return run.Part(name, f"About {name}", limit=limit)


def test_page_is_put_together(tmp_path, monkeypatch):
    """A part that works is quoted, one that fails, hangs or is missing is named, and the others go on."""
    monkeypatch.setattr(run, "HERE", tmp_path)
    monkeypatch.setattr(run, "OUT", tmp_path)
    page = f"open({str(tmp_path / 'good.md')!r}, 'w').write('# Good\\n\\nintroduction\\n\\n| a |\\n|---|\\n| 7 |\\n')"
    parts = [
        part(tmp_path, "good", page),
        part(tmp_path, "bad", "raise SystemExit('no luck')"),
        part(tmp_path, "slow", "import time; time.sleep(60)", limit=0.5),
        run.Part("absent", "About nothing"),
    ]
    monkeypatch.setattr(run, "PARTS", tuple(parts))
    said = {one.name: run.run(one) for one in parts}
    assert said["good"].endswith(" s") and "failed (no luck)" in said["bad"]
    assert "ended after 0.5 s" in said["slow"] and said["absent"] == "not run: no such script"
    text = run.assembled(said, ["the machine"])
    assert "## About good" in text and "| 7 |" in text and "introduction" not in text and "About bad" in text
    (tmp_path / "README.md").write_text(text)
    assert {name: run.standing(tmp_path / "README.md")[name] for name in ("good", "bad")} == {
        name: said[name] for name in ("good", "bad")
    } and run.standing(tmp_path / "none.md") == {}
    assert run.measured_on(tmp_path / "README.md") == ["the machine"] and run.measured_on(tmp_path / "none.md") == []


def test_the_breakdown_times_functions_that_are_there():
    stages = {**breakdown.STAGES, "linear algebra": (breakdown.newton, "eliminated")}
    assert [name for name, (module, function) in stages.items() if not callable(getattr(module, function, None))] == []


@pytest.mark.slow
def test_every_script_says_how_it_is_called():
    """With --help, and without doing anything: a script that takes no notice of it overwrites its page."""
    scripts = [file for file in sorted((ROOT / "benchmarks").glob("*.py")) if "__main__" in file.read_text()]
    for script in scripts:
        done = subprocess.run([sys.executable, script, "--help"], capture_output=True, text=True, timeout=120)
        assert done.returncode == 0 and done.stdout.startswith(f"usage: {script.name} [-h]"), script.name + done.stderr
    assert len(scripts) > 30


def test_machine_is_described_without_paths():
    text = " ".join([machine.processor(), machine.versions("heyoka"), machine.load(), *run.conditions("load 0")])
    assert "casadi" in text and str(ROOT) not in text and "/usr" not in text
    assert machine.said_by("no-such-program") == "" and machine.package("no-such-package") is None


def test_first_order_systems_are_written_twice():
    """Rates by hand are the library's; Newton closes an orbit of Rössler's, and finds none where there is none."""
    for name, field in first_order.GALLERY.items():
        model = getattr(of.systems, name.replace("-", "_"))()
        x = 0.3 + 0.1 * np.arange(len(model.state_names))
        ours = model.rate(0.0, x, model.parameter_values).full().ravel()
        assert field(x) == pytest.approx(ours, rel=1e-13, abs=1e-13), name
    one = first_order.closed(first_order.rossler, np.array([-3.9, 5.6, 0.03]), 5.88)
    assert one.period == pytest.approx(5.881088455553877, abs=1e-12) and one.closure < 1e-12
    assert first_order.closed(lambda u: np.array([u[1], u[0]]), np.array([1.0, 0.2]), 1.0) is None
    assert first_order.words(4) == ["LR", "LLR", "LRR", "LLLR", "LLRR", "LRRR"]


def test_methods_take_turns_and_failures_are_rows():
    """The first turn is not counted, the least of the others is; what fails says why and is not asked again."""
    order, taken = [], iter([0.1, 5.0, 3.0, 4.0])

    def good():
        order.append("good")
        return next(taken), len(order)

    def bad():
        order.append("bad")
        raise ValueError("no luck")

    found = turns.in_turns({"good": good, "bad": bad}, range(3))
    assert order == ["good", "bad", "good", "good", "good"] and found["good"] == (3.0, 5)
    assert isinstance(found["bad"], Unavailable) and str(found["bad"]) == "ValueError: no luck"
    failed = turns.Run(failed="no luck")
    assert failed.told == "failed" and turns.plain([failed])[0]["seconds"] is None


def test_a_family_is_read_inside_the_clock():
    oscillator = of.systems.forced_duffing(frequency=0.8)
    orbit = of.find_orbit(of.Problem(oscillator, of.Guess([0.5, 0.0], 2.5 * np.pi)))
    began = turns.processor_time()
    seconds, family = turns.followed(orbit, "frequency", until=0.85, certify=False)
    assert 0 < seconds * len(family.points) <= turns.processor_time() - began
    assert family.points[-1].value == 0.85 and {point.closure for point in family.points} == {0.0}


def test_times_against_an_earlier_checkout(monkeypatch):
    """Ratios of two processes that stay, the difference of latencies, a commit, and what fails."""
    name = "torus"
    taken = {earlier.ROOT: (0.2, 1), Path("elsewhere"): (1.0, 1)}

    @contextmanager
    def worker(where, _):
        yield lambda: taken[where]

    monkeypatch.setattr(earlier, "worker", worker)
    monkeypatch.setattr(earlier, "latency", lambda where: taken[where])
    both = {"ours": earlier.ROOT, "earlier": Path("elsewhere")}
    row = earlier.measured(name, both, 1)
    assert (row["ratio"], row["wanted"], row["met"]) == (0.2, 0.25, True) and "| 0.20 | 0.25 | yes |" in earlier.line(
        row
    )
    taken[earlier.ROOT] = (1.7, 1)
    assert earlier.measured(name, both, 1)["met"] is False
    row = earlier.measured("latency", both, 1)
    assert (
        row["difference"] == pytest.approx(0.7)
        and row["met"] is False
        and "| 0.70 s | 0.6 s | no |" in earlier.line(row)
    )
    assert earlier.measured(name, {"ours": earlier.ROOT}, 1)["met"] is None
    with pytest.raises(SystemExit, match="no-such: neither a folder nor a commit"), earlier.checkout_of("no-such"):
        pass


def test_every_page_has_a_row_in_the_table_of_contents():
    folder = ROOT / "results" / "benchmarks"
    pages = {page.name for page in folder.glob("*.md")} - {"README.md"}
    assert pages == set(re.findall(r"\| \[(\w+\.md)\]", (folder / "README.md").read_text()))


def test_a_page_keeps_the_rows_that_a_run_leaves_out():
    def row(name, seconds):
        return {"row": name, "ours": turns.Run(seconds=seconds), "ratio": 1.0, "wanted": 1.0, "met": None}

    names = ["refine triple-1", "torus", "latency"]
    whole = earlier.page([row(name, 0.002) for name in names], 3)
    part = earlier.page([row("torus", 0.005)], 3, whole.replace("| torus |", "| gone |\n| torus |"))
    assert [text.split(" | ")[:2] for text in part.splitlines() if text.startswith("| ") and "ms" not in text] == [
        ["| refine triple-1", "2"], ["| torus", "5"], ["| latency", "2"]
    ]  # fmt: skip
    assert "Of this run: torus; the other rows are of runs before it." in part
    assert "Of this run" not in whole and "Of this run" not in earlier.page([row("torus", 0.1)], 3)


def test_work_that_fails_in_a_checkout_is_told(tmp_path):
    """A checkout without the package, or with another's, is no silent comparison of ours with ourselves."""
    with earlier.worker(tmp_path, "torus") as ask, pytest.raises(Unavailable, match="no checkout of orbitfinder"):
        ask()


def test_auto_missing_is_told(monkeypatch):
    monkeypatch.setattr(program, "AUTO", Path("nowhere"))
    with pytest.raises(SystemExit, match="AUTO-07p is needed in nowhere"):
        program.needed()


def test_auto_goes_over_both_folds(tmp_path):
    """Its points are those it counts, with all digits; a run that it refuses is told."""
    try:
        program.needed()
    except SystemExit as error:
        pytest.skip(str(error))
    import resonance

    orbit = of.find_orbit(of.Problem(of.systems.forced_duffing(**resonance.NUMBERS), of.Guess([0.5, 0.0], 2.5 * np.pi)))
    samples = of.simulate(of.systems.forced_duffing(**resonance.NUMBERS), orbit.state, orbit.period)
    peer = auto_forced.AutoForced(tmp_path, resonance.NUMBERS, np.column_stack([samples.times, samples.states]), 2.5)
    curve = peer.go((20, 4), 400, 0.3)[1]
    assert curve.folds == pytest.approx([1.7797195242985731, 1.3242362007705656], abs=1e-7)
    assert len(curve.points) == len(peer.program.table()) and curve.points[-1, 4] == pytest.approx(2.5, abs=1e-6)
    with pytest.raises(Unavailable, match="AUTO-07p: "):
        peer.program.run((20, 4), ICP=[1, 11], NDIM=-1)


def test_every_script_is_named_where_somebody_looks():
    """In the index of `run.py`, on a page of the documentation, or as the help of another script or a test."""
    texts = {path: path.read_text(encoding="utf-8") for folder, kind in (("benchmarks", "*.py"), ("tests", "*.py"),
             ("docs", "*.md"), ("results", "*.md")) for path in (ROOT / folder).rglob(kind)}  # fmt: skip
    listed = {part.name for part in run.PARTS} | {*run.ELSEWHERE, *run.PRINTED}
    for path in sorted((ROOT / "benchmarks").glob("*.py")):
        name = path.stem
        used = re.compile(rf"benchmarks(?:[./]| import ){name}\b|^\s*(?:from {name} import|import {name}\b)", re.M)
        assert name in listed or any(used.search(text) for other, text in texts.items() if other != path), name
    page = (ROOT / "results" / "benchmarks" / "README.md").read_text(encoding="utf-8")
    assert all(f"| {heading} | | printed |" in page for heading in run.PRINTED.values())
