"""Ordinary Python with records: equality, sets, copies, slices, columns by name, empty tables, refusals of a format."""

import copy
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import orbitfinder as of
from orbitfinder._runtime import limit
from orbitfinder.cli.console import time_left
from orbitfinder.errors import InputError
from orbitfinder.families.branches import Branch
from orbitfinder.families.folder import _request
from orbitfinder.families.point import FamilySettings
from orbitfinder.records.certificate import Certificate, refused
from orbitfinder.records.family import Event, load_family
from orbitfinder.records.registry import load_orbit

RESULTS = Path(__file__).parents[1] / "results"
FAMILY = RESULTS / "families" / "triple-1" / "family.json"
ORBIT = next(iter(sorted((RESULTS / "orbits").glob("*/orbit.json"))))


def few(family):
    """Its first orbits."""
    return replace(family, points=family.points[:5], events=family.events[:2])


@pytest.fixture(scope="module")
def short():
    """Three orbits of a driven oscillator."""
    model = of.systems.forced_duffing(1.0, 0.0, 0.2, 0.1, 0.9)
    return of.follow_family(of.Problem(model, of.Guess([0.3, 0.1], 2 * np.pi / 0.9)), "frequency", points=1)


@pytest.mark.parametrize("load", [lambda: load_orbit(ORBIT), lambda: few(load_family(FAMILY)),
                                  lambda: load_family(FAMILY).points[3], lambda: load_family(FAMILY).events[0]],
                         ids=["orbit", "family", "point", "event"])  # fmt: skip
def test_records_are_equal_to_their_copies_and_have_a_hash(load):
    one, again = load(), load()
    for other in (again, copy.copy(one), copy.deepcopy(one), pickle.loads(pickle.dumps(one))):
        assert one == other and hash(one) == hash(other) and len({one, other}) == 1
        assert other in [one] and [one].index(other) == 0
    assert one != "text" and one is not None


def test_records_with_one_number_changed_are_others():
    """Of the last digit of a state, an entry of a dict, nan and a number; nan is nan."""
    orbit = load_orbit(ORBIT)
    for changed in (
        {"state": np.nextafter(orbit.state, np.inf)}, {"system": {**orbit.system, "kind": "other"}}, {"energy": np.nan},
        {"period": orbit.period + 1e-9}, {"name": "another"}, {"nodes": orbit.nodes[:-1]},
    ):  # fmt: skip
        other = replace(orbit, **changed)
        assert other != orbit and other == copy.deepcopy(other)
    assert replace(orbit, record="elsewhere/orbit.json") == orbit
    listed = [orbit, replace(orbit, name="another")]
    listed.remove(orbit)
    assert [one.name for one in listed] == ["another"]


def test_slices_and_columns_of_a_family(short):
    """A slice is a list of orbits with samples; every column of the table is known to `values`."""
    assert [point.index for point in short[1:3]] == [1, 2] and [point.index for point in short[::-2]] == [2, 0]
    assert short[1:3][0].samples.shape[0] > 100 and short[9:] == [] and short[1] == short[1:2][0]
    table = short.table()
    for name in ("amplitude_x", "min_x", "max_x", "largest_multiplier", "period", "closure"):
        assert np.array_equal(short.values(name), table[name])
    with pytest.raises(InputError, match="unknown 'amplitude_y'"):
        short.values("amplitude_y")


def test_tables_without_rows_have_the_types_of_those_with_rows(short):
    point = short.points[1]
    event = Event("turn", 1, point.arclength, point.value, point.state, point.period, point.energy, "period",
                  shooting_nodes=point.shooting_nodes, mesh=point.mesh, free=point.free)  # fmt: skip
    full, empty = replace(short, events=(event,)).table("events"), short.table("events")
    for name in ("kind", "detail", "criticality", "certified", "order", "point", "period"):
        column = np.asarray(empty[name])
        assert len(column) == 0 and column.dtype.kind == np.asarray(full[name]).dtype.kind, name


@pytest.mark.parametrize("to", ["parquet", "json"])
def test_a_table_format_is_refused_for_an_orbit_by_name(to, tmp_path):
    with pytest.raises(InputError, match=f"to: {to} files hold tables, and .* is an orbit; use one of csv, auto"):
        of.export_orbit(load_orbit(ORBIT), to, tmp_path)


def test_a_branch_has_a_title_of_its_own():
    """A halo family is not headed "Planar Lyapunov orbit": it says which event of which family it comes from."""
    family = load_family(FAMILY)
    start = type("Start", (), {"curve": type("Curve", (), {"test": None})})()
    for number, words in ((5, "Planar, branch at event 5"), ("end", "Planar, branch at end")):
        branch = Branch(start, family.name, family.events[5], number, 1, "triple-1-5-1", "Planar")
        assert _request(branch, FamilySettings(), (), {})[1]["title"] == words
    untitled = Branch(start, family.name, family.events[5], 5, 1, "triple-1-5-1")
    assert "title" not in _request(untitled, FamilySettings(), (), {})[1]


def test_the_time_left_is_no_more_than_the_limit_leaves():
    """ "192 s left" under --limit 150."""
    with limit.limited(5.0):
        said = time_left(0.0)(1e-9, 1e9)
    assert float(said.removeprefix(", ").removesuffix(" s left")) <= 5.0


def test_certificates_that_do_not_know_a_number_are_equal():
    """A refused check has nan for its value, another object in each file that is read."""
    one, two = (Certificate((refused("closure", ValueError("lost"), float(text)),)) for text in ("nan", "NaN"))
    assert one == two and hash(one) == hash(two) and one != Certificate(())
