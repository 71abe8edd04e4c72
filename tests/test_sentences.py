"""Every sentence about stability along every shipped family: what events say agrees with the orbits beside them."""

import base64
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from orbitfinder import systems
from orbitfinder.families.happening import sentence
from orbitfinder.records.codec import plain
from orbitfinder.records.family import BECOMES, Batch, Journal, assemble, load_family, reverted, save_family
from orbitfinder.site import pages
from orbitfinder.site.landscape import landscape

RESULTS = Path(__file__).parents[1] / "results" / "families"
FAMILIES = sorted(RESULTS.glob("*/family.json"))


def agrees(family):
    """The verdicts along a family, of points and on both sides of events, in order of arclength: each event begins with
    what was there and ends with what is there next; details say the same; sentences too."""
    members = sorted(enumerate(family.members), key=lambda pair: pair[1].arclength)
    known, last, sides = "", None, ("", "")
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


def test_a_change_on_the_part_before_the_start_is_told_in_the_order_of_the_points(tmp_path):
    """Older files tell it as it was followed, away from the start: "becomes unstable" of -36.688, and are read right;
    so are journals, whose steps backwards tell it so."""
    family = load_family(RESULTS / "triple-1" / "family.json")
    known = {-36.688008: "becomes stable", -38.489693: "becomes unstable"}
    assert {round(e.parameter, 6): e.detail for e in family.events if e.detail in BECOMES} == known
    older = [*map(reverted, family.events)]
    assert older[6].detail == "becomes unstable" and older[6].arclength < 0
    again = load_family(save_family(replace(family, events=tuple(older)), tmp_path))
    assert [event.detail for event in again.events] == [event.detail for event in family.events]
    header = {
        "origin": plain(family.points[0]),
        "name": "a",
        "system": {},
        "parameter": "energy",
        "curve": family.curve,
    }
    ahead = replace(family.events[6], arclength=1.0)
    journal = Journal(header, (Batch(-1, (), (older[6],)), Batch(1, (), (ahead,))))
    assert [event.detail for event in assemble(journal).events] == ["becomes stable"] * 2


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


def picked(family):
    """The items of its page, without motions."""
    return pages.family_items(family, SimpleNamespace(member=lambda *_: None), [])


@pytest.mark.parametrize("file", FAMILIES, ids=lambda file: file.parent.name)
def test_stretches_of_a_page_end_where_stability_changes(file):
    """Every sentence of a family's page: a stretch has the verdicts of its points and no change of stability inside."""
    family = load_family(file)
    for item in picked(family):
        assert "becomes" not in item["says"] and "becomes" not in item["event"]
        if item["event"]:
            assert item["says"].endswith(sentence(family, item["number"]) + ".")
            assert item["stability"] == (family.sides[item["number"]][0] or item["stability"])
            continue
        changes = [event.arclength for event in family.events if event.detail in BECOMES]
        inside = [place for place in changes if place == item["arclength"]] or changes
        low = max((place for place in inside if place <= item["arclength"]), default=-float("inf"))
        high = min((place for place in inside if place >= item["arclength"]), default=float("inf"))
        said = item["says"].partition(": orbits ")[2].partition(", whose period")[0].split(" or ")
        assert item["stability"] in said
        near = {point.stability for point in family.points if low <= point.arclength <= high}
        assert set(said) <= near and ("unstable" in said) + any(v not in ("unstable", "marginal") for v in said) <= 1


def test_nouns_of_events():
    """ "From the becomes stable at ..." and "the fold energy at energy" are no English."""
    family = load_family(RESULTS / "triple-1" / "family.json")
    words = {event.words for event in family.events}
    assert {"gain of stability", "loss of stability", "fold in energy", "turn in period", "resonance q = 3"} <= words


def test_orbits_without_an_energy_have_none_on_a_page():
    """Of a neuron: no energy and no action, in no sentence, no list, no item."""
    family = load_family(RESULTS / "triple-1" / "family.json")
    mechanical = pages.family_values(family, picked(family))
    assert "energy" in mechanical["summary"] and mechanical["levels"] and picked(family)[0]["action"] is not None
    nan = float("nan")
    neuron = replace(family, parameter="I", points=tuple(replace(each, energy=nan) for each in family.points),
                     events=tuple(replace(each, energy=nan) for each in family.events))  # fmt: skip
    values = pages.family_values(neuron, items := picked(neuron))
    assert "energy" not in values["summary"] and not values["levels"] and values["useful"] == ["value", "arclength"]
    assert all(item["action"] is None for item in items)


def test_the_line_of_equal_energy_through_saddles_is_straight():
    """Henon and Heiles' at 1/6 are three straight lines; a page was 0.018 beside them."""
    made = landscape(systems.henon_heiles(), {"centre": [0.0, 0.0], "spans": [2.0, 2.0]}, many=True)
    down, right = np.array(made["down"]), np.array(made["right"])
    over = np.frombuffer(base64.b64decode(made["data"]), "<f4").astype(float).reshape(down.size, right.size) - 1 / 6
    y, x = np.meshgrid(-down, right, indexing="ij")
    worst = []
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        cut = (over[a] < 0) != (over[b] < 0)
        share = over[a][cut] / (over[a] - over[b])[cut]
        px, py = (each[a][cut] + share * (each[b] - each[a])[cut] for each in (x, y))
        lines = [py + 0.5, (py - 1 + np.sqrt(3) * px) / 2, (py - 1 - np.sqrt(3) * px) / 2]
        inside = np.maximum(np.abs(px), np.abs(py)) < 1.5
        worst.append(np.abs(lines).min(axis=0)[inside].max())
    assert max(worst) < 0.006
