"""Every sentence about stability along every shipped family: what events say agrees with the orbits beside them."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from orbitfinder.families.happening import sentence
from orbitfinder.records.family import BECOMES, assemble, load_family

RESULTS = Path(__file__).parents[1] / "results" / "families"
FAMILIES = sorted(RESULTS.glob("*/family.json"))


def agrees(family):
    """The verdicts along a family, of points and on both sides of events, in order of arclength: each event begins with
    what was there and ends with what is there next; details say the same; sentences too."""
    members = sorted(enumerate(family.members), key=lambda pair: pair[1].arclength)
    known, last = "", None
    for k, member in members:
        if k < len(family.points):
            undecided = {"", "marginal"} & {known, member.stability}  # as a point on a bifurcation is
            assert undecided or (known == "unstable") == (member.stability == "unstable"), (k, known)
            known, last = member.stability, None
            continue
        k -= len(family.points)
        before, after = family.sides[k]
        if member.arclength == last:  # of the same orbit
            assert (before, after) == sides
        elif before and known:
            assert (before == "unstable") == (known == "unstable"), k
        if member.detail in BECOMES:
            assert (before == "unstable", after == "unstable") == (
                member.detail == BECOMES[0],
                member.detail == BECOMES[1],
            )
            assert f"{before} before it, {after} after it" in sentence(family, k)
        changing = f"; {before} before it, {after} after it"
        assert (" before it" in sentence(family, k)) == (before != after) == (changing in sentence(family, k))
        known, last, sides = after, member.arclength, (before, after)


@pytest.mark.parametrize("file", FAMILIES, ids=lambda file: file.parent.name)
def test_what_events_say_agrees_with_the_orbits_beside_them(file):
    family = load_family(file)
    agrees(family)
    count = sum(event.detail in BECOMES for event in family.events)
    assert sum(a != b for a, b in family.sides if "unstable" in (a, b)) >= count


def test_a_change_on_the_part_before_the_start_is_told_in_the_order_of_the_points():
    """The shipped record was followed backwards there, and said so: "becomes unstable" of -36.688."""
    family = load_family(RESULTS / "triple-1" / "family.json")
    assert {round(e.parameter, 6): e.detail for e in family.events if e.detail in BECOMES} == {
        -36.688008: "becomes stable", -38.489693: "becomes unstable"
    }  # fmt: skip


def test_an_event_after_a_change_in_one_interval_is_after_it():
    """Two events between an elliptic and an unstable point: before the second orbits are unstable already."""
    family = load_family(RESULTS / "triple-mode-2" / "family.json")
    k = next(k for k, event in enumerate(family.events) if event.detail == BECOMES[1] and event.arclength > 0)
    change = family.events[k]
    end = family.points[change.index + 1].arclength
    later, earlier = (
        replace(change, kind="turn", detail="period", arclength=place)
        for place in (
            0.5 * (change.arclength + end),
            change.arclength - 0.5 * (change.arclength - family.points[change.index].arclength),
        )
    )
    mended = replace(family, events=(*family.events[:k], earlier, change, later, *family.events[k + 1 :]))
    assert mended.sides[k] == (mended.sides[k + 1][0],) * 2 and mended.sides[k + 2] == ("unstable", "unstable")
    assert "before it" not in sentence(mended, k) and "before it" not in sentence(mended, k + 2)
