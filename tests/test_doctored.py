"""Records doctored number by number and word by word, under a fresh digest: refused, found, or without a claim.

Every number times 1.001, one more, negated, nan, infinite, 5e-324 and 1e300; every word another one. What reads the
file refuses it in a sentence, or a check fails; no other exception, and no warning. What passes is in a list below.
"""

import copy
import json
import math
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.errors import OrbitfinderError
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.verified import point_checks, verified
from orbitfinder.mechanics.kind import build_model
from orbitfinder.orbits.certify import certify
from orbitfinder.records.ends import ENDS
from orbitfinder.records.family import End, load_family, plain
from orbitfinder.records.orbit import digest
from orbitfinder.records.reading import content_digest, typed
from orbitfinder.records.registry import load_orbit

ROOT = Path(__file__).parents[1]
GALLERY = ROOT / "results" / "gallery"
ORBITS = {
    "smooth": ROOT / "results" / "orbits" / "quadruple-2" / "orbit.json",
    "relative": GALLERY / "figure-eight-turning" / "orbit.json",
    "forced": GALLERY / "forced-duffing-lower" / "orbit.json",
    "first-order": GALLERY / "van-der-pol" / "orbit.json",
    "hybrid": ROOT / "docs" / "gallery" / "orbits" / "hybrid-bouncing-ball.json",
}
FAMILY = ROOT / "results" / "families" / "henon-heiles-loop" / "family.json"
KINDS = (*ORBITS, "point", "family")
ASIDE = {"format", "version", "record", "dense", "certificate", "provenance", "proof"}
"""What is made anew when a record is written, or not read"""
NAMES = {"name", "title", "source", "reason", "role", "multiplier_method"}
"""Words for people; of a sentence only how it begins, and what was asked for, is checked"""
COURSE = {"index", "arclength", "step", "wall_time", "weights"}
"""How a run went: where its points were put, and in which measure"""
UNREAD = {"scale", "defect", "multiplier_errors"}
"""What a point's errors grow by, and are: certificates use their own"""
BARS = {"error", "tolerance"}
"""A larger one says less"""
KNOWN = 1e-6
"""A change below it may be within an error: of multipliers so much is allowed, of all else less"""
WRONG = {
    "1.001 times": lambda value: 1.001 * value,
    "one more": lambda value: value + 1,
    "negated": lambda value: -value,
    "nan": lambda value: math.nan,
    "infinite": lambda value: math.inf,
    "5e-324": lambda value: 5e-324,
    "1e300": lambda value: 1e300,
}


def leaves(document, path=()):
    """Every number and word with its path; of a list the first and the last."""
    for key in document if isinstance(document, dict) else sorted({0, len(document) - 1}):
        inner = document[key]
        if isinstance(inner, dict) or (isinstance(inner, list) and inner):
            yield from leaves(inner, (*path, key))
        elif isinstance(inner, (int, float, str)) and not isinstance(inner, bool):
            yield (*path, key), inner


def claims_less(path, value, changed):
    """Whether the changed entry claims nothing, or no more than is true."""
    words = {key for key in path if isinstance(key, str)}
    if words & (NAMES | COURSE | UNREAD):
        return True
    if isinstance(value, str) or not abs(changed - value) >= KNOWN:
        return not isinstance(value, str) and math.isfinite(changed)
    return path[-1] in BARS and changed > value


def doctored(document, aside):
    """Everything that is done to a document: in words, with the document that comes of it."""
    for path, value in leaves(document):
        if aside & set(path[:1]):
            continue
        ways = {"another word": lambda word: f"{word}-other"} if isinstance(value, str) else WRONG
        for what, change in ways.items():
            changed = change(value)
            if changed == value or claims_less(path, value, changed):
                continue
            wrong = copy.deepcopy(document)
            inner = wrong
            for key in path[:-1]:
                inner = inner[key]
            inner[path[-1]] = changed
            yield f"{'.'.join(map(str, path))} {what}: {value!r:.20}", wrong


def orbit_passes(path):
    return certify(load_orbit(path)).passed


def point_passes(path):
    family, orbit = load_family(path), load_orbit(f"{path}#0")
    return point_checks(family, 0, certify(orbit), build_model(family.system)).passed


def test_a_point_with_too_few_indices_is_refused():
    """It ended in an UnboundLocalError."""
    family, orbit = load_family(FAMILY), load_orbit(f"{FAMILY}#5")
    cut = replace(family, points=(replace(family.points[5], indices=family.points[5].indices[:-1]),))
    assert point_checks(cut, 0, certify(orbit), build_model(family.system)).failures == ("indices",)


def family_passes(path):
    family = load_family(path)
    return all(check.passed for _, check in verified(family, build_model(family.system)))


def sound(kind):
    """A record as a document, what is not doctored in it, its digest, and whether a file of it passes."""
    if kind in ORBITS:
        return json.loads(ORBITS[kind].read_text(encoding="utf-8")), ASIDE, digest, orbit_passes
    document = json.loads(FAMILY.read_text(encoding="utf-8"))
    del document["dense"]
    if kind == "point":
        alone = document | {"points": document["points"][5:6], "events": [], "ends": []}
        return alone, ASIDE | {"system", "curve", "source", "parameter"}, content_digest, point_passes
    return document | {"events": document["events"][:2]}, ASIDE | {"points", "source"}, content_digest, family_passes


@pytest.fixture(scope="module")
def ended():
    """A family that shrinks to a Hopf point, one that grows to a saddle, and one that two others join."""
    quiet = FamilySettings(certify=False, events=False)
    model = of.ode(lambda _, x, p: [p.mu * x.x - x.y - x.x * (x.x**2 + x.y**2), x.x + (p.mu - x.x**2 - x.y**2) * x.y],
                   ["x", "y"], {"mu": 0.5})  # fmt: skip
    cycle = of.Problem(model, of.Guess([np.sqrt(0.5), 0.0], 2 * np.pi))
    swing = of.Problem(of.chain(1), of.Guess([0.5, 0.0], 1.64))
    driven = of.follow_family(of.load_problem(ROOT / "problems" / "families" / "driven-pendulum.toml"), "torque",
                              until=1.2, settings=replace(quiet, events=True))  # fmt: skip
    lopsided = of.follow_family(of.switch_branch(driven, 0), settings=quiet)
    return {
        "hopf": (of.follow_family(cycle, "mu", settings=replace(quiet, directions="backward"), model=model), model),
        "homoclinic": (of.follow_family(swing, settings=replace(quiet, directions="forward")), of.chain(1)),
        "merged": (lopsided, build_model(lopsided.system)),
    }


@pytest.mark.parametrize("kind", ["hopf", "homoclinic", "merged"])
def test_what_an_end_says_is_solved_for_again(kind, ended):
    """Every number and word of it, and every other kind; an angle of pi is one of -pi."""
    family, model = ended[kind]
    end = family.ends[-1]

    def sound(entry):
        try:
            ends = (*family.ends[:-1], typed(End, entry, ""))
        except ValueError:
            return False
        return list(verified(replace(family, events=(), ends=ends), model))[-1][1].passed

    assert end.kind == kind and sound(plain(end))
    assert [other for other in ENDS if other != kind and sound(plain(replace(end, kind=other)))] == []
    passing = [what for what, wrong in doctored(plain(end), {"kind", "reason"}) if sound(wrong)]
    assert [what for what in passing if not ("saddles" in what and "state.0 negated" in what)] == []


def passed(kind, tmp_path, share):
    """What passes of everything, or of every so many, that is done to a record; the sound one passes."""
    document, aside, seal, passes = sound(kind)
    path = tmp_path / "record.json"

    def written(wrong):
        bare = {name: entry for name, entry in wrong.items() if name != "record"}
        path.write_text(json.dumps(bare | {"record": seal(bare)}), encoding="utf-8")
        return passes(path)

    assert written(document)
    for what, wrong in islice(doctored(document, aside), 0, None, share):
        try:
            if written(wrong):
                yield what
        except OrbitfinderError:
            continue


@pytest.mark.parametrize("kind", KINDS)
def test_some_of_what_is_doctored_is_found(kind, tmp_path):
    """Every nineteenth, so that every way to do it comes up."""
    assert list(passed(kind, tmp_path, 19)) == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_all_that_is_doctored_is_found(kind, tmp_path):
    assert list(passed(kind, tmp_path, 1)) == []
