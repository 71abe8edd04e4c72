"""benchmarks/slow_tests.py: what pytest prints is read, runs are kept, the budget of the quick tests holds."""

import sys
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))

import slow_tests  # noqa: E402

PRINTED = """..F
============ slowest durations ============
12.31s call     tests/test_a.py::test_long[one]
3.00s setup    tests/test_a.py::test_long[one]
0.40s call     tests/test_a.py::test_short
FAILED tests/test_a.py::test_short
1 failed, 2 passed, 28 deselected in 17.05s
"""
FAILED = {"file": "test_a.py", "tests": 3, "commit": "2b", "kernels": "", **slow_tests.read(PRINTED)}
PASSED = {**FAILED, "commit": "1a", "result": "3 passed", "passed": True, "seconds": 20}


def test_a_run_has_seconds_the_longest_and_the_result():
    assert (FAILED["seconds"], FAILED["longest"]) == (16, "test_long[one] 15 s")
    assert (FAILED["result"], FAILED["passed"]) == ("1 failed, 2 passed", False)
    assert FAILED["failed"] == ["test_short"]
    assert slow_tests.read("12 passed in 3 s")["passed"] and not slow_tests.read("Killed")["passed"]


def test_the_table_has_the_last_run_and_the_commit_that_last_passed():
    journal = [PASSED, FAILED]
    assert slow_tests.table({"test_a.py": 3}, journal)[2:] == [
        "| test_a.py | 3 | 16 | test_long[one] 15 s | 1 failed, 2 passed | 1a |"
    ]
    assert slow_tests.table({"test_a.py": 4, "test_b.py": 1}, journal)[2:] == [
        "| test_a.py | 4 | not run | | | 1a |",
        "| test_b.py | 1 | not run | | |  |",
    ]
    page = slow_tests.replaced(f"before\n{slow_tests.BEGIN}\nold\n{slow_tests.END}\nafter", ["new"])
    assert page == f"before\n{slow_tests.BEGIN}\nnew\n{slow_tests.END}\nafter"


def test_a_part_begins_with_what_waited_longest():
    journal = [PASSED, {**PASSED, "file": "test_b.py", "seconds": 5}, {**FAILED, "file": "test_c.py", "seconds": 5}]
    counts = {"test_a.py": 3, "test_b.py": 1, "test_c.py": 1, "test_d.py": 40}
    assert slow_tests.waiting(counts, journal, 30.0) == ["test_c.py", "test_a.py", "test_b.py"]
    assert slow_tests.waiting(counts, journal, 12.0) == ["test_c.py", "test_b.py"]
    ended = {**FAILED, "file": "test_d.py", "seconds": 12, "result": slow_tests.ENDED}
    assert slow_tests.waiting({"test_d.py": 1}, [ended], 12.0) == []
    assert slow_tests.waiting({"test_d.py": 1}, [ended], 24.0) == ["test_d.py"]


def test_what_takes_too_long_is_ended_with_all_that_it_started(monkeypatch, tmp_path):
    """No process of a test is left behind."""
    program, left = tmp_path / "python", tmp_path / "left"
    program.write_text(f"#!/bin/sh\n(sleep 0.5; touch '{left}') &\nwait\n")
    program.chmod(0o755)
    monkeypatch.setattr(slow_tests.sys, "executable", str(program))
    assert slow_tests.pytest(limit=0.1) == ""
    time.sleep(0.6)
    assert not left.exists()
    assert slow_tests.pytest(limit=10.0) == "" and left.exists()


def test_what_is_above_its_budget_is_named():
    budget = {"quick": [{"name": "tests/test_a.py::test_false", "seconds": 5.0, "reason": "false orbits"}], "slow": []}
    times = {"tests/test_a.py::test_false": 12.9, "tests/test_b.py::test_b": 4.9, "tests/test_c.py::test_c": 5.1}
    assert slow_tests.over(times, budget) == ["tests/test_c.py::test_c: 5.1 s of processor time, allowed are 1 s"]
    entries = [{"name": f"{k}", "seconds": 2.0, "reason": ""} for k in range(12)]
    # A machine that takes three times as long with all of them, and more with one
    slower = {f"{k}": 6.0 for k in range(11)}
    assert slow_tests.over(slower | {"11": 20.9, "b": 14.9}, {"quick": entries, "slow": []}) == []
    assert slow_tests.over(slower | {"11": 21.1, "b": 15.1}, {"quick": entries, "slow": []}) == [
        "11: 21.1 s of processor time, allowed are 2 s where all take 3.0 times as long",
        "b: 15.1 s of processor time, allowed are 1 s where all take 3.0 times as long",
    ]
    large = {"quick": [{"name": f"{k}", "seconds": 3.0, "reason": ""} for k in range(61)], "slow": []}
    assert slow_tests.over({}, large) == ["tests/budget.toml: 61 entries, 183 s; at most 60, 150 s"]


def test_what_is_above_a_second_is_slow_with_all_that_uses_it():
    measured = {
        "seconds": {
            "t::long[a]": 3.0,
            "t::long[b]": 0.1,
            "t::every[a]": 2.0,
            "t::every[b]": 2.0,
            "fixture: t::made": 4.0,
        },
        "uses": {
            "t::long[a]": [],
            "t::long[b]": [],
            "t::every[a]": [],
            "t::every[b]": [],
            "t::user": ["fixture: t::made"],
        },
    }
    budget = {"quick": [], "slow": ["t::known"]}
    assert slow_tests.marked(measured, budget) == ["t::every", "t::known", "t::long[a]", "t::user"]
    budget["quick"] = [{"name": "fixture: t::made", "seconds": 4.0, "reason": ""}]
    assert "t::user" not in slow_tests.marked(measured, budget)


def test_the_budget_is_kept():
    """At most sixty tests above a second and 150 s of processor time in the quick set, each with its reason."""
    budget = tomllib.loads(slow_tests.BUDGET.read_text(encoding="utf-8"))
    assert not slow_tests.over({}, budget) and all(entry["reason"] for entry in budget["quick"])
    files = {name.removeprefix("fixture: ").partition("::")[0] for name in budget["slow"]}
    files |= {entry["name"].removeprefix("fixture: ").partition("::")[0] for entry in budget["quick"]}
    assert all((ROOT / file).is_file() for file in files)


def test_the_page_has_a_row_for_every_file_with_slow_tests():
    page = slow_tests.PAGE.read_text(encoding="utf-8")
    slow = tomllib.loads(slow_tests.BUDGET.read_text(encoding="utf-8"))["slow"]
    marked = {name.partition("::")[0].removeprefix("tests/") for name in slow} | {
        file.name
        for file in (ROOT / "tests").glob("test_*.py")
        if ".".join(("mark", "slow")) in file.read_text(encoding="utf-8")
    }
    assert not [name for name in sorted(marked) if f"\n| {name} |" not in page]
