"""Other programs' own examples: the closed forms behind them, rows that pass, planted numbers that must fail."""

import copy
import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.validation import auto_demos, page, peers
from orbitfinder.errors import ConvergenceError, InputError

DATA = Path(__file__).parent / "data"
FOUND = json.loads((DATA / peers.FILE).read_text(encoding="utf-8"))


def failed(section):
    return [row.quantity for row in section.rows if not row.passed]


def test_every_number_says_where_it_is_from():
    """Each source names its repository, each set of numbers path and commit; AUTO names its version."""
    assert "0.9.2" in FOUND["auto"]["program"] and set(FOUND["auto"]["labels"]) == set(auto_demos.DEMOS)
    assert FOUND["auto"]["precision"] == auto_demos.PRECISION
    for name in ("bifurcationkit", "coco", "heyoka", "capd", "uposham"):
        source = FOUND[name]
        assert source["repository"].startswith("https://github.com/")
        sets = [source] if "path" in source else [one for one in source.values() if not isinstance(one, str)]
        for one in sets if name != "coco" else [source]:
            for each in one if isinstance(one, list) else [one]:
                assert len(each["commit"]) == 40 and (name == "coco" or each["path"])
    assert all("path" in FOUND["coco"][one] for one in ("linode", "impact", "piecewise"))


def test_the_cycle_of_two_fields_is_that_of_its_closed_form():
    """The radius and the time of each half, from a simulation in polar coordinates."""
    radius, period = peers.halves(1.0, 2.0, 1.5)
    right = solve_ivp(
        lambda a, y: np.array([y[0] * (2 - y[0]), 1.0]) / (1.5 + 2 - y[0]),
        (0, math.pi),
        [radius, 0.0],
        rtol=1e-12,
        atol=1e-13,
    ).y[:, -1]
    left = solve_ivp(lambda t, r: r * (1 - r), (0, math.pi), [right[0]], rtol=1e-12, atol=1e-13).y[0, -1]
    assert left == pytest.approx(radius, abs=1e-10) and math.pi + right[1] == pytest.approx(period, abs=1e-10)


def test_the_impact_oscillator_returns_to_its_closed_form():
    """From just after the impact it meets the stop one turn later, at the speed that the impact reverses."""
    speed, phase = peers.bounce(1.0)
    end = solve_ivp(
        lambda t, y: [y[1], math.cos(t + phase) - 0.1 * y[1] - y[0]],
        (0, 2 * math.pi),
        [1.0, speed],
        rtol=1e-12,
        atol=1e-13,
    ).y[:, -1]
    assert end == pytest.approx([1.0, -speed / 0.8], abs=1e-9)


def test_heyokas_rows_pass_and_wrong_digits_fail():
    """All of heyoka's notebook; a multiplier off by ten of its last digit is told."""
    assert failed(peers.heyoka(FOUND["heyoka"])) == []
    planted = copy.deepcopy(FOUND["heyoka"])
    planted["spatial"][0] = "0.984479870"
    assert failed(peers.heyoka(planted)) == ["multiplier across the plane, real part"]


def test_a_saddle_of_uposham_and_one_at_another_energy():
    """The first row of the coupled Hamiltonian; named with another energy, period and place are wrong."""
    one = copy.deepcopy(FOUND["uposham"])
    one |= {"coupled": one["coupled"][:1], "uncoupled": [], "deleonberne": []}
    assert failed(peers.uposham(one)) == []
    one["coupled"][0]["row"][0] = "0.11"
    assert len(failed(peers.uposham(one))) == 3


def test_an_enclosure_is_met_only_from_inside():
    assert peers.enclosed("T", ["1.0", "1.5"], 1.49).passed and not peers.enclosed("T", ["1.0", "1.5"], 1.51).passed


def test_a_point_on_a_section():
    """Of the unit circle, from a point near it: to round-off, though the step is no short one."""
    place = peers.on_section(lambda _, x: [x[1], -x[0]], np.array([math.sin(0.1), math.cos(0.1)]), 0, 0.0)
    assert place == pytest.approx([0.0, 1.0], abs=1e-14)


def test_a_label_that_is_not_met_is_a_failed_row():
    """An event that our family lacks fails its own row, and those after it, and none before."""

    def events():
        raise ConvergenceError("no branch was found")
        yield

    rows = peers._labels("pen", FOUND["auto"]["labels"]["pen"][:1], 1e-4, events)
    assert [row.passed for row in rows] == [False] and "no branch was found" in rows[0].note


def test_without_the_numbers_it_says_so(tmp_path):
    with pytest.raises(InputError, match=r"peers.json: cannot be read .*give the folder tests/data"):
        peers.sections(tmp_path)


@pytest.mark.slow
def test_all_rows_pass():
    """A stiff reaction among them."""
    sections = peers.sections(DATA)
    assert sum(len(section.rows) for section in sections) >= 90
    assert [row for section in sections for row in section.rows if not row.passed] == []
    assert "Steinmetz-Larter" in page.markdown(sections)


@pytest.mark.slow
@pytest.mark.skipif(not auto_demos.available(), reason="AUTO-07p with gfortran is not installed")
def test_auto_prints_here_what_was_captured():
    """The same labels in the same order, to AUTO's own precision."""
    for name, labels in auto_demos.captured().items():
        kept = FOUND["auto"]["labels"][name]
        assert [one["kind"] for one in labels] == [one["kind"] for one in kept]
        for one, other in zip(labels, kept, strict=True):
            for key in one.keys() - {"kind"}:
                assert one[key] == pytest.approx(
                    other[key], abs=FOUND["auto"]["precision"][name] * (1 + abs(other[key]))
                )
