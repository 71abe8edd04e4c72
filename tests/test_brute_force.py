"""The brute force beside families: it shares nothing with the library and agrees with the numbers of others."""

import ast
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import inside

from benchmarks import family_events
from benchmarks.brute_force import Follower, System, moved, recorded
from benchmarks.brute_systems import OWN, SHIPPED
from orbitfinder.errors import ConvergenceError
from orbitfinder.records.family import End

ROOT = Path(__file__).parents[1]
DATA = Path(__file__).parent / "data"
KEPT = json.loads((DATA / "brute_force.json").read_text(encoding="utf-8"))
SYSTEMS = {system.name: system for system in (*SHIPPED, *OWN)}


def kept_values(name, kind):
    """The parameters of a kind of event of a family, both directions, in order."""
    directions = KEPT[name]["directions"].values()
    return sorted(one["value"] for each in directions for one in each["events"] if one["kind"] == kind)


def reference(file, entry):
    """An entry of a file of tests/data, by its id."""
    document = json.loads((DATA / file).read_text(encoding="utf-8"))
    return next(one for one in (document["entries"] if isinstance(document, dict) else document) if one["id"] == entry)


def test_it_shares_nothing_with_the_library():
    for name in ("brute_force", "brute_systems"):
        tree = ast.parse((ROOT / "benchmarks" / f"{name}.py").read_text(encoding="utf-8"))
        sources = [
            one for node in ast.walk(tree)
            for one in ([node.module] if isinstance(node, ast.ImportFrom) else
                        [alias.name for alias in node.names] if isinstance(node, ast.Import) else [])
        ]  # fmt: skip
        assert sources and not [one for one in sources if one.split(".")[0] in ("orbitfinder", "casadi")]


def test_every_family_is_kept():
    """Thirteen, six of them shipped; each direction reached its end, and every orbit closes."""
    assert list(KEPT) == list(SYSTEMS) and len(SHIPPED) == 6 and len(OWN) == 7
    for name, one in KEPT.items():
        assert list(map(int, one["directions"])) == list(SYSTEMS[name].directions), name
        for each in one["directions"].values():
            assert each["end"] in ("target", "hopf") and each["orbits"] >= 20 and each["gap"] < 1e-10, name


@pytest.mark.parametrize(
    ("name", "entry", "parameter"),
    [
        ("hodgkin-huxley", "hodgkin-huxley", "I"), ("FitzHugh, AUTO's fhn", "fhn demo", "a"),
        ("circuit, AUTO's tor", "tor, first fold", "nu"),
    ],
)  # fmt: skip
def test_folds_and_doublings_are_those_of_auto(name, entry, parameter):
    """To the digits in which AUTO's runs agree; the folds and doublings that AUTO has are all there are."""
    points = reference("cycles.json", entry)["points"]
    for kind, label in (("fold", "LP"), ("period_doubling", "PD")):
        theirs = sorted(one[parameter] for one in points if one["type"] == label)
        assert kept_values(name, kind) == pytest.approx(theirs, abs=2e-10), kind


def test_tori_of_the_tube_are_those_of_auto():
    """Its branch point is not: AUTO's 1.2352026 is not where the multiplier is 1 (next test)."""
    theirs = [one["L"] for one in reference("cycles.json", "brf")["points"] if one["type"] == "TR"]
    assert kept_values("Brusselator along a tube, AUTO's brf", "torus") == pytest.approx(theirs, abs=1e-8)


TUBE = "Brusselator along a tube, AUTO's brf"


def tube_at(lengths, state, period, start):
    """For each length of the tube the period and the multipliers, the largest first, of the cycle near one at `start`,
    which is corrected by itself."""
    system = replace(SYSTEMS[TUBE], simulate=0.0, state=tuple(state), period=period, start=start)
    for length in lengths:
        follower = Follower(system)
        orbit = follower.first()
        plane = np.zeros(follower.size)
        plane[follower.width + 1] = 1.0
        for value in np.linspace(start, length, 6)[1:]:
            u = orbit.u.copy()
            u[follower.width + 1] = value
            units, extents = follower.scales(u, orbit.widths)
            old = (u[: follower.width].reshape(follower.count, follower.n), follower.rates(u, orbit.widths))
            level = value / units[follower.width + 1]
            orbit = follower.corrected(u, orbit.widths, units, extents, old, plane, level)
        multipliers = np.linalg.eigvals(follower.reduced(orbit))
        yield follower.period(orbit), multipliers[np.argsort(-np.abs(multipliers))]


@pytest.mark.slow
def test_the_branch_point_of_the_tube_lies_between_multipliers_below_and_above_one():
    """Orbits of two lengths beside it, corrected by themselves, have their largest multiplier on either side of 1."""
    kept = KEPT[TUBE]
    (place,) = kept_values(TUBE, "branch_point")
    lengths = (1.2352026, place, place + (place - 1.2352026))
    largest = [abs(values[0]) for _, values in tube_at(lengths, kept["state"], kept["period"], kept["start"])]
    below, at, above = largest
    assert below < 1 - 3e-5 and abs(at - 1) < 1e-8 and above > 1 + 3e-5


@pytest.mark.slow
def test_tori_of_the_tube_are_within_error_bars_and_those_on_the_branch_are_beside_autos():
    """AUTO's lie on the same curve, with its period to all digits, and have the pair off the unit circle; where
    orbitfinder puts them it is on it, by brute force too."""
    settings = family_events.FamilySettings(certify=False, directions="forward")
    problem = family_events.problem_of(TUBE, KEPT[TUBE])
    family = family_events.follow_family(problem, "L", until=2.0, points=300, settings=settings)
    place, *tori = (one for one in family.events if one.kind in ("branch_point", "torus"))
    theirs = [one for one in reference("cycles.json", "brf")["points"] if one["type"] == "TR"]
    assert inside(tori[0], theirs[0]["L"], 5e-10) and inside(tori[1], theirs[1]["L"], 5e-9)
    assert inside(place, *kept_values(TUBE, "branch_point"), 1e-10)
    branch = family_events.of.switch_branch(family, family.events.index(place), model=problem.model)
    family = family_events.follow_family(branch, until=2.0, points=150, settings=settings)
    theirs = [one for one in reference("cycles.json", "brf")["points"] if one["type"].startswith("TR on")]
    tori = [one for one in family.events if one.kind == "torus"]
    for event, their, off, rank in zip(tori, theirs, (4e-5, 7e-7), (0, 2), strict=True):
        near = family.points[event.index]
        (period, away), (own, on) = tube_at((their["L"], event.parameter), near.state, near.period, near.value)
        assert period == pytest.approx(their["period"], abs=6e-8) and abs(own - event.period) <= event.period_error
        assert event.error < 2e-10 and abs(abs(on[rank]) - 1) < 1e-11 and abs(abs(away[rank]) - 1) > off


def test_doublings_and_folds_are_those_of_140_bits():
    names = {"lorenz-doubling": ("lorenz-pd", "period_doubling", ["PD1_r"])}
    for name, (entry, kind, keys) in names.items():
        theirs = [float(reference("curves.json", entry)["values"][key]) for key in keys]
        assert kept_values(name, kind) == pytest.approx(theirs, abs=1e-9)
    folds = reference("curves.json", "duffing-folds")["values"]["F0.3"].values()
    assert kept_values("duffing-resonance", "fold") == pytest.approx(sorted(map(float, folds)), abs=1e-12)
    pen = float(reference("curves.json", "pen-pd-locus")["values"]["eps0.1"]["I"])
    assert kept_values("coupled-pendula", "period_doubling") == pytest.approx([pen], abs=1e-12)


@pytest.mark.parametrize(
    ("name", "entry"),
    [("hodgkin-huxley", "eq-hh"), ("Morris-Lecar", "eq-ml-hopf-class"), ("Brusselator", "eq-brusselator")],
)
def test_families_end_at_the_hopf_points_of_50_digits(name, entry):
    ends = [one for one in KEPT[name]["directions"].values() if one["end"] == "hopf"]
    theirs = {float(one["parameter"]): float(one["period"]) for one in reference("road.json", entry)["values"]["hopf"]}
    for one in ends:
        value = min(theirs, key=lambda each: abs(each - one["value"]))
        assert (one["value"], one["period"]) == pytest.approx((value, theirs.pop(value)), rel=1e-11)
    assert not theirs


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Rossler", "hodgkin-huxley"])
def test_what_is_kept_is_what_it_computes(name):
    """The same events and ends again."""
    for key, one in recorded(SYSTEMS[name])["directions"].items():
        before = KEPT[name]["directions"][key]
        assert [each["kind"] for each in one["events"]] == [each["kind"] for each in before["events"]]
        values = [each["value"] for each in (*one["events"], one)]
        assert values == pytest.approx([each["value"] for each in (*before["events"], before)], abs=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("name", SYSTEMS)
def test_finer_steps_move_no_event(name):
    """Twice the steps, a third more pieces, twice the orbits: the same events, within half of what a match allows."""
    assert moved(SYSTEMS[name]) < family_events.VALUE / 2


def test_a_planted_fold_and_torus_are_where_they_were_put():
    """r' = r (c + r^2 - r^4): folds at c = -1/4, r^2 = 1/2; Hopf point at c = 0; period 2 pi throughout."""

    def rate(_, x, c, s):
        growth = c + (r := x[0] ** 2 + x[1] ** 2) - r**2
        return np.array([growth * x[0] - x[1], growth * x[1] + x[0]])

    radius = np.sqrt(0.5 + np.sqrt(0.25 + 0.2))
    found = recorded(System("planted", rate, (radius, 0.0), 2 * np.pi, 0.2, (-0.5, 0.5), "c", (-1,), pieces=12))
    (family,) = found["directions"].values()
    assert [one["kind"] for one in family["events"]] == ["fold", "stability_change"] and family["end"] == "hopf"
    assert family["events"][0]["value"] == pytest.approx(-0.25, abs=1e-13)
    assert (family["value"], family["period"]) == pytest.approx((0.0, 2 * np.pi), abs=1e-12)


# ---- the comparison ----------------------------------------------------------------------------------


def event(kind, value, period=2.0, detail=""):
    return SimpleNamespace(kind=kind, detail=detail, parameter=value, period=period)


TRUTH = [{"kind": "fold", "value": 1.5, "period": 2.0}, {"kind": "torus", "value": 1.7, "period": 2.0}]


def test_missed_and_invented_are_counted_apart():
    """An event at another place, of another kind, on another branch or met twice is invented, the true one missed."""

    def counted(*events):
        return [len(one) for one in family_events.matched(TRUTH, list(events))]

    assert counted(("torus", 1.7, 2.0), ("fold", 1.5 + 1e-9, 2.0)) == [2, 0, 0]
    for wrong in (("fold", 1.5 + 1e-6, 2.0), ("branch_point", 1.5, 2.0), ("fold", 1.5, 2.1)):
        assert counted(wrong) == [0, 2, 1]
    assert counted(("fold", 1.5, 2.0), ("fold", 1.5, 2.0)) == [1, 1, 1]


def test_events_are_named_as_brute_force_names_them():
    names = [("fold", "mu", "fold"), ("fold", "period", "turn"), ("turn", "period", "turn"), ("resonance", "", ""),
             ("torus", "", "torus")]  # fmt: skip
    assert [family_events.named(event(kind, 1.0, detail=detail), "mu") for kind, detail, _ in names] == [
        name for *_, name in names
    ]


def told(events, kind, value):
    end = End(kind, "a reason")
    return SimpleNamespace(events=events, ends=(end,), points=(SimpleNamespace(value=value, arclength=0.0),))


@pytest.mark.slow
def test_the_fold_of_a_canard_is_found():
    """Along it the parameter moves by a few hundred round-offs in a twentieth of a step."""
    row = family_events.judged("FitzHugh, AUTO's fhn", KEPT["FitzHugh, AUTO's fhn"], 1)
    assert "fold 0.430518245" in row.agreed and row.right and not (row.missed or row.invented)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "direction"), [(name, int(key)) for name in KEPT for key in KEPT[name]["directions"]])
def test_nothing_is_missed_and_nothing_invented(name, direction):
    row = family_events.judged(name, KEPT[name], direction)
    assert row.right and not (row.missed or row.invented)


def test_a_false_fold_a_lost_end_and_a_failure_are_in_the_page(monkeypatch):
    """Planted families of the oscillator in SI, whose truth is no event and the Hopf point 0."""
    name = "oscillator in SI"
    answers = iter([told([event("fold", 0.256875, 0.06, "mu")], "step underflow", 0.3), told([], "hopf", 1e-10)])
    monkeypatch.setattr(family_events.of, "follow_family", lambda *_, **__: next(answers))
    wrong, right = (family_events.judged(name, KEPT[name], -1) for _ in range(2))
    assert wrong.invented == ("fold 0.256875",) and not wrong.right and not wrong.missed
    assert right.right and not right.invented

    def fails(*_, **__):
        raise ConvergenceError("nothing there")

    monkeypatch.setattr(family_events.of, "follow_family", fails)
    (row, *_) = family_events.rows_of(["duffing-resonance"])
    assert len(row.missed) == 4 and row.ended == "ConvergenceError: nothing there" and not row.right
    text = family_events.page([wrong, right, row])
    assert "3 directions: 0 events agree, 4 missed, 1 invented; 1 of 3 ends agree" in text and "fold 0.256875" in text


@pytest.mark.parametrize("name", SYSTEMS)
def test_problems_are_the_equations_of_brute_force(name):
    """Rates by CasADi, as orbitfinder is given them, against those by NumPy, beside the kept orbit."""
    model, system = family_events.problem_of(name, KEPT[name]).model, SYSTEMS[name]
    x, values = np.array(KEPT[name]["state"]) + 0.1, model.parameter_values
    assert (system.parameter in model.parameter_names) == (system.energy is None)
    value = values[list(model.parameter_names).index(system.parameter)] if system.energy is None else 0.0
    half = len(x) // 2
    ours = (
        model.rate(0.37, x, values).full().ravel() if model.rates is not None else
        [*x[half:], *model.acceleration(0.37, x[:half], x[half:], values).full().ravel()]
    )  # fmt: skip
    theirs = np.real(system.rate(0.37, x.astype(complex), value, 0.0))
    assert np.ravel(ours) == pytest.approx(theirs, rel=1e-11, abs=1e-12)
