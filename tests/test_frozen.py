"""Frozen answers: what counts as a difference, and that the stored answers are those of 0.2.0."""

import copy
import json
import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))

import frozen  # noqa: E402

BASELINE = json.loads((ROOT / "benchmarks" / "frozen.json").read_text(encoding="utf-8"))


def family(**changed):
    """A stored family, some of it changed."""
    return copy.deepcopy(BASELINE["families"]["triple-mode-2"]) | changed


def said(before, now):
    return list(frozen.differences(before, now))


def test_which_points_and_in_which_order_events_come_is_no_difference():
    now = family()
    assert said(family(), now) == []
    now["events"].reverse(), now["points"].reverse(), now["ends"].reverse()
    now["points"].append(now["points"][0] | {"value": 1.25})
    now["numbered"] = {}
    assert said(family(), now) == []


def test_an_event_moved_renamed_lost_or_invented_is_one():
    first = family()["events"][0]
    for changed, words in (
        (first | {"value": first["value"] + 1e-5}, ("gone", "new")),
        (first | {"kind": "fold"}, ("gone", "new")),
        (first | {"period": first["period"] * 1.01}, ("gone", "new")),
    ):
        found = said(family(), family(events=[changed, *family()["events"][1:]]))
        assert [re.search("gone|new", one)[0] for one in found] == list(words)
    assert len(said(family(), family(events=family()["events"][1:]))) == 1
    assert len(said(family(), family(events=[*family()["events"], first]))) == 1  # met twice
    assert len(said(family(), family(ends=[{"kind": "hopf", "value": 1.0}]))) == 2


def test_orbits_at_pinned_values_are_held_to_their_amplification():
    """1e-11, or 1e-14 times what errors grow by; the multipliers to 1e-7."""
    for scale, allowed in ((1.0, 1e-11), (1e6, 1e-8)):
        before = family()
        point = before["points"][1]
        point["scale"] = scale
        for factor, count in ((0.5, 0), (3.0, 1)):
            now = copy.deepcopy(before)
            now["points"][1]["period"] += factor * allowed * max(1.0, point["period"])
            assert len(said(before, now)) == count
    now = family()
    now["points"][0]["floquet_multipliers"][0][0] += 1e-5
    assert len(said(family(), now)) == 1
    del now["points"][0]
    assert [one for one in said(family(), now) if one.endswith("not met")]


def test_several_orbits_at_one_value_are_told_apart():
    """Duffing's resonance has three of one period: each is compared with the one it is like."""
    before = BASELINE["further"]["duffing-resonance"]
    assert [one["value"] for one in before["points"]].count(1.5) == 3
    now = copy.deepcopy(before)
    now["points"].reverse()
    assert said(before, now) == []
    now["points"] = [one for one in now["points"] if one["stability"] != "unstable"]
    assert said(before, now)


def test_what_is_shipped_is_what_is_stored_or_is_said():
    """The numbers of results/families at their pins are the stored ones, unless made again since 0.2.0."""
    for words in frozen.commands():
        name = frozen.named(words)
        pins = [one["value"] for one in BASELINE["families"][name]["points"]]
        assert len(pins) == len(frozen.SHARES) and BASELINE["families"][name]["events"]


def test_a_false_fold_of_0_2_0_is_known():
    """The baseline has it, the list of what was wrong names it, and nothing else of the family is excused by that."""
    wrong = BASELINE["further"]["hodgkin-huxley"]
    false = [one["value"] for one in wrong["events"] if one["kind"] == "fold" and abs(one["value"] - 6.72874675) < 1e-6]
    assert false
    right = wrong | {"events": [one for one in wrong["events"] if one["value"] not in false]}
    sentences = list(frozen.differences(wrong, right, "further/hodgkin-huxley"))
    assert sentences and all(frozen.known(BASELINE, one) for one in sentences)
    assert not frozen.known(BASELINE, "further/hodgkin-huxley/events: gone: fold 6.2603212745")
    assert not frozen.known(BASELINE, "further/hodgkin-huxley/events: new: fold 7.5")


def test_compare_prints_known_differences_and_counts_the_others(monkeypatch, tmp_path, capsys):
    before = {"further": {"a": {"events": [], "ends": [{"kind": "step underflow"}]}},
              "known": [{"what": "further/a/ends: gone: step underflow", "why": "it has its Hopf point"}]}  # fmt: skip
    file = tmp_path / "frozen.json"
    file.write_text(json.dumps(before))
    answers = [("further", {"a": {"events": [], "ends": [{"kind": "hopf", "value": 2.0}]}})]
    monkeypatch.setattr(frozen, "answers", lambda *_: answers)
    assert frozen.compared(file, ["further"]) == 1
    printed = capsys.readouterr().out
    assert "(known: it has its Hopf point)" in printed and "new: hopf 2.0\n1 differences" in printed


def test_proofs_are_asked_for_and_not_written_into_what_is_shipped(monkeypatch, tmp_path):
    asked = []
    entries = [{"proved": True, "symmetry": "brake", "stability": "unstable", "period": {"value": "1.5"}}] * 4
    monkeypatch.setattr(frozen, "command", lambda *words, **_: asked.append(words) or json.dumps({"results": entries}))
    found = frozen.proofs(tmp_path)
    assert "--no-record" in asked[0] and found.keys() == BASELINE["proofs"].keys()
    assert said(BASELINE["proofs"], BASELINE["proofs"]) == [] and len(said(BASELINE["proofs"], found)) >= 4
