"""Journals of sweeps, sections and trials: what they have is not computed again, and a damaged one is named.

What is computed is counted at its innermost: rows refined, steps of motions, samples of a trial.
"""

from pathlib import Path

import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.control import basin
from orbitfinder.errors import InputError
from orbitfinder.orbits import sweep
from orbitfinder.orbits.refine import Refiner
from orbitfinder.records.journal import append_line, packed, read_lines, unpacked
from orbitfinder.structures import crossings
from orbitfinder.structures import sections as section


def counted(monkeypatch, owner, name):
    """The calls of a function from now on."""
    whole, calls = getattr(owner, name), []
    monkeypatch.setattr(owner, name, lambda *given, **named: (calls.append(1), whole(*given, **named))[1])
    return calls


def stopped_at(monkeypatch, owner, name, count):
    """Ctrl-C comes when a function is called for the count-th time."""
    whole, calls = getattr(owner, name), []

    def called(*given, **named):
        calls.append(1)
        if len(calls) == count:
            raise KeyboardInterrupt
        return whole(*given, **named)

    monkeypatch.setattr(owner, name, called)


@pytest.fixture(scope="module")
def duffing():
    return of.Problem(of.systems.duffing(), of.Guess([0.8, 0.0], 5.0), of.pin(x=0.8), symmetry="brake", name="duffing")


def orbits(swept):
    return [None if one.orbit is None else (one.orbit.name, one.orbit.period, one.orbit.samples.tobytes(),
            one.orbit.times.tobytes(), one.orbit.certificate) for one in swept.rows]  # fmt: skip


def test_a_sweep_goes_on(duffing, tmp_path, monkeypatch):
    """Also over values that are not reached, and with more values; nothing is refined or searched for again."""
    cubics = [3.0, 2.0, -0.3, 0.5, -1.6, -2.0]
    calm = of.sweep(duffing, cubic=cubics)
    with monkeypatch.context() as patch:
        stopped_at(patch, sweep._Study, "_row", 5)
        with pytest.raises(KeyboardInterrupt):
            of.sweep(duffing, cubic=cubics, out=tmp_path)
    rows, found = (counted(monkeypatch, *one) for one in ((sweep._Study, "_row"), (sweep, "find_orbit")))
    again = of.sweep(duffing, cubic=cubics, out=tmp_path)
    assert (len(rows), len(found)) == (2, 0)
    assert orbits(again) == orbits(calm) and again.records == calm.records
    refined = counted(monkeypatch, Refiner, "refine")
    assert of.sweep(duffing, cubic=cubics, out=tmp_path).records == calm.records and not refined
    more = of.sweep(duffing, cubic=[*cubics, 4.0], out=tmp_path)
    assert len(rows) == 3 and more.records == of.sweep(duffing, cubic=[*cubics, 4.0]).records
    del rows[:]
    fewer = of.sweep(duffing, cubic=[2.0, -1.6], out=tmp_path)  # the last is tried again, from elsewhere
    assert len(rows) == 1 and fewer.orbits[0].name == "duffing-0001" and not fewer.rows[1].certified
    kept = (tmp_path / "duffing" / "sweep.jsonl").read_bytes()
    with pytest.raises(InputError, match=r"sweep.jsonl: values.0: cubic there, stiffness asked for; .* another folder"):
        of.sweep(duffing, stiffness=[1.1], out=tmp_path)
    assert len(rows) == 1 and (tmp_path / "duffing" / "sweep.jsonl").read_bytes() == kept


def test_processes_go_on(duffing, tmp_path, monkeypatch):
    cubics = [0.5, 1.0, 1.5, 2.0, 2.5]
    calm = of.sweep(duffing, cubic=cubics, workers=2)
    hired = counted(monkeypatch, sweep.processes, "hired")
    of.sweep(duffing, cubic=cubics[:3], out=tmp_path)
    assert of.sweep(duffing, cubic=cubics, workers=2, out=tmp_path).certified == 5 and len(hired) == 1
    assert of.sweep(duffing, cubic=cubics, workers=2, out=tmp_path).certified == 5 and len(hired) == 1
    (tmp_path / "duffing" / "sweep.jsonl").unlink()
    for _ in range(2):
        assert orbits(of.sweep(duffing, cubic=cubics, workers=2, out=tmp_path)) == orbits(calm)


def arrays(cut):
    return [getattr(cut, name).tobytes() for name in ("states", "times", "seeds", "starts", "growth")]


@pytest.mark.slow
def test_a_section_goes_on(tmp_path, monkeypatch):
    """From a step of the motions and one of their neighbours; with more and with fewer seeds and returns."""
    ask = {"energy": 0.1, "plane": "x=0", "name": "loop"}
    system = of.systems.henon_heiles()
    calm, large = (of.section(system, **ask, seeds=k, returns=n) for k, n in ((5, 30), (7, 40)))
    steps = counted(monkeypatch, crossings._Run, "step")
    of.section(system, **ask, seeds=5, returns=30)
    whole = len(steps)
    for count in (whole // 3, whole // 3):
        with monkeypatch.context() as patch:
            stopped_at(patch, crossings._Run, "step", count)
            with pytest.raises(KeyboardInterrupt):
                of.section(system, **ask, seeds=5, returns=30, out=tmp_path)
    del steps[:]
    assert arrays(of.section(system, **ask, seeds=5, returns=30, out=tmp_path)) == arrays(calm)
    assert 0.3 * whole < len(steps) < 0.6 * whole
    del steps[:]
    assert arrays(of.section(system, **ask, seeds=5, returns=30, out=tmp_path)) == arrays(calm) and not steps
    assert arrays(of.section(system, **ask, seeds=7, returns=40, out=tmp_path)) == arrays(large)
    del steps[:]
    assert arrays(of.section(system, **ask, seeds=5, returns=30, out=tmp_path)) == arrays(calm) and not steps


def test_a_section_of_events_goes_on(tmp_path, monkeypatch):
    problem = of.load_problem(Path(__file__).parents[1] / "problems/hybrid/bouncing-ball.toml")
    calm = of.section(problem, seeds=4, returns=5)
    made = counted(monkeypatch, section, "Automaton")
    of.section(problem, seeds=3, returns=5, out=tmp_path)
    assert arrays(of.section(problem, seeds=4, returns=5, out=tmp_path)) == arrays(calm) and len(made) == 4


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_trial_goes_on(tmp_path, monkeypatch, noise):
    pendulum = of.chain(1)
    up = of.find_orbit(of.Problem(pendulum, of.Guess([1.0, 0.0], 2.2), of.pin(theta1=1.0), symmetry="brake"))
    held = of.stabilise(up, ["torque1"])
    ask = {"sizes": [0.01, 0.1], "disturbances": 3, "rate": 16, "noise": noise}
    calm, short = (repr(vars(basin.basin(held, **ask, periods=k).basin)) for k in (30, 20))
    with monkeypatch.context() as patch:
        stopped_at(patch, basin._Trial, "sample", 16 * 7 + 1)
        with pytest.raises(KeyboardInterrupt):
            of.basin(held, **ask, periods=30, out=tmp_path)
    samples = counted(monkeypatch, basin._Trial, "sample")
    assert repr(vars(of.basin(held, **ask, periods=20, out=tmp_path).basin)) == short and len(samples) == 16 * 14
    assert repr(vars(of.basin(held, **ask, periods=30, out=tmp_path).basin)) == calm and len(samples) == 16 * 24


def test_damaged_journals_are_named(duffing, tmp_path):
    of.sweep(duffing, cubic=[1.0, 2.0], out=tmp_path)
    file = tmp_path / "duffing" / "sweep.jsonl"
    sound = file.read_bytes()
    file.write_bytes(sound.replace(b'"after"', b'"afte"', 1))
    with pytest.raises(InputError, match=r"sweep.jsonl: line 3: not what was written, .*; restore a copy, or delete"):
        of.sweep(duffing, cubic=[1.0, 2.0], out=tmp_path)
    file.write_bytes(sound[:-9])  # cut short by a kill
    assert of.sweep(duffing, cubic=[1.0, 2.0], out=tmp_path).certified == 2
    lines = read_lines(file, "")[0]
    for wrong in ({"way": None}, {"row": {}}, {"orbit": {}}, {"samples": "3:A"}, {"samples": "4:"}, {"after": "x"}):
        file.write_bytes(sound)
        append_line(file, lines[3] | wrong)
        with pytest.raises(InputError, match="sweep.jsonl: line 5: .*; restore a copy, or delete the file to start"):
            of.sweep(duffing, cubic=[1.0, 2.0], out=tmp_path)


def test_packed_numbers_are_the_same():
    matrix = np.random.default_rng(1).normal(size=(5, 3)) * np.array([1e-300, 1.0, np.inf])
    assert unpacked(packed(matrix), 3).tobytes() == matrix.tobytes() and unpacked("4:", 4).shape == (0, 4)
