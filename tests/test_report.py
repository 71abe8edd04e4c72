"""The report's reproduction: its numbers, its figures, its resumption."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orbitfinder.integrate.cvodes import IntegratorSettings, build_flow, sample
from orbitfinder.mechanisms.chain import chain
from orbitfinder.reproduce import runner
from orbitfinder.reproduce.facts import ORBITS
from orbitfinder.reproduce.orbits import printed_closure
from orbitfinder.reproduce.runs import HORIZONTAL_REST, growth, simulate, stretching

COMMITTED = Path(__file__).parents[1] / "results" / "report"


@pytest.mark.parametrize("method", ["newton-euler", "lagrange", "recursive", "dae"])
def test_energy_drift_of_every_method(method: str) -> None:
    """From horizontal rest over 10 s every method keeps the energy to 1e-9 J."""
    assert simulate(method, 10.0).drift <= 1e-9


def test_stabilised_dae_stays_on_its_constraints() -> None:
    """With Baumgarte terms the native DAE keeps |phi| below 1e-11 m over 10 s."""
    from orbitfinder.reproduce.runs import STABILISED

    assert simulate("dae", 10.0, STABILISED).phi.max() <= 1e-11


def test_methods_agree_to_12_seconds_and_separate_before_20() -> None:
    """Pairs differ by less than 1e-5 rad to 12 s and by more than 1 rad between 16 and 20 s."""
    runs = [simulate(method, 21.0) for method in ("lagrange", "newton-euler", "dae")]
    times = runs[0].times
    for first, second in ((0, 1), (0, 2), (2, 1)):
        distance = np.abs(runs[first].states[:, :3] - runs[second].states[:, :3]).max(axis=1)
        assert distance[times <= 12].max() < 1e-5
        assert 16 < times[distance > 1][0] < 20


def test_growth_finds_a_known_rate() -> None:
    """An exact exponential's rate is recovered."""
    times = np.linspace(0, 20, 400)
    assert growth(times, 1e-13 * np.exp(1.3 * times))[0] == pytest.approx(1.3, rel=1e-6)


def test_stretching_is_what_two_neighbours_do() -> None:
    """A tangent vector grows as the distance of two motions that start together, however often it is rescaled."""
    flow = build_flow(chain(3), settings=IntegratorSettings(1e-13, 1e-13))
    ends = [sample(flow, HORIZONTAL_REST + shift, 3.0, 2)[-1] for shift in (0.0, 1e-7 / np.sqrt(6.0))]
    grown = np.log(np.linalg.norm(ends[1] - ends[0]) / 1e-7)
    assert stretching(3.0, 1.0)[-1] == pytest.approx(grown, abs=1e-4)
    assert stretching(3.0, 0.25)[3::4] == pytest.approx(stretching(3.0, 1.0), abs=1e-6)


@pytest.mark.parametrize(("printed", "known"), list(zip(ORBITS, (6.2e-6, 8.5e-4, 5.1e-6, 5.1e-7), strict=True)))
def test_printed_digits_close_as_measured_before(printed, known: float) -> None:
    """The printed digits return to the distances that the design measured (2-norm)."""
    assert printed_closure(printed)[0] == pytest.approx(known, rel=0.02)


def _part(calls: list[str], name: str):
    def compute(folder: Path) -> dict[str, object]:
        calls.append(name)
        return {"value": 1.5}

    return compute


def test_finished_parts_are_not_redone(tmp_path, monkeypatch) -> None:
    """An interrupted reproduction goes on with the first unfinished part; a damaged record is redone."""
    calls: list[str] = []
    for part in runner.PARTS:
        module = __import__(part.module, fromlist=["x"])
        monkeypatch.setattr(module, part.function, _part(calls, part.name))
    monkeypatch.setattr("orbitfinder.reproduce.runner.write_page", lambda folder, numbers: None)
    first = runner.reproduce(tmp_path)
    assert calls == [part.name for part in runner.PARTS]
    (tmp_path / "numbers" / "energy.json").write_text("{ damaged")
    (tmp_path / "numbers" / "orbits.json").unlink()
    calls.clear()
    assert runner.reproduce(tmp_path) == first
    assert calls == ["energy", "orbits"]


def test_committed_page_matches_committed_numbers(tmp_path) -> None:
    """results/report/README.md is what the page writer makes of results/report/numbers/."""
    from orbitfinder.reproduce.runner import write_page

    numbers = {
        part.name: json.loads((COMMITTED / "numbers" / f"{part.name}.json").read_text())["numbers"]
        for part in runner.PARTS
    }
    write_page(tmp_path, numbers)
    assert (tmp_path / "README.md").read_text() == (COMMITTED / "README.md").read_text()


def test_committed_page_shows_only_files_that_are_there() -> None:
    """Every picture and link of the page exists beside it."""
    import re

    text = (COMMITTED / "README.md").read_text()
    targets = re.findall(r"\]\(([^)]+)\)", text)
    assert len(targets) > 20
    assert [name for name in targets if not (COMMITTED / name).is_file()] == []


ROUNDING = {"drift", "relative_drift", "phi", "phidot", "closure", "pair_defect", "largest_to_12_s"}
"""Numbers that are round-off, or what chaos has made of it: of another processor's they have the size alone"""
GROWING = {"rate", "first_above_1_rad", "lyapunov"}
"""How fast chaos makes it larger, and when it is 1: they differ between processors by 2 % (measured)"""


def alike(found: Any, known: Any, name: str = "") -> bool:
    """Whether a number is the committed one, as far as another processor can tell."""
    if isinstance(known, dict):
        return found.keys() == known.keys() and all(alike(found[key], known[key], key) for key in known)
    if isinstance(known, list):
        return len(found) == len(known) and all(alike(*both, name) for both in zip(found, known, strict=True))
    if not isinstance(known, float):
        return found == known
    if name in ROUNDING:
        return known / 10 - 1e-12 <= found <= 10 * known + 1e-12
    return found == pytest.approx(known, rel=0.05 if name in GROWING else 1e-7)


@pytest.mark.slow
def test_reproduction_repeats_its_numbers(tmp_path) -> None:
    """A fresh reproduction gives the committed numbers again, the derivation times apart."""
    numbers = runner.reproduce(tmp_path)
    for part in runner.PARTS:
        if part.name != "derivation":
            committed = json.loads((COMMITTED / "numbers" / f"{part.name}.json").read_text())["numbers"]
            assert alike(json.loads(json.dumps(numbers[part.name])), committed), part.name


def test_numbers_that_are_not_the_committed_ones_are_told() -> None:
    """A period off in its seventh digit, a drift of ten times, an orbit that is missing."""
    orbit = {"period": 1.25, "certified": True, "drift": 1e-10}
    known = {"orbit": orbit, "rate": 1.4}
    assert alike(known | {"orbit": orbit | {"period": 1.25 + 1e-8, "drift": 5e-10}, "rate": 1.42}, known)
    for changed in (orbit | {"period": 1.2500002}, orbit | {"drift": 2e-9}, orbit | {"certified": False}, {}):
        assert not alike(known | {"orbit": changed}, known)
    assert not alike(known | {"rate": 1.5}, known)
