"""The table of slow tests in docs/explanation/testing.md: read from what pytest prints, kept where it was not run."""

import re
import sys
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


def test_a_row_has_seconds_the_longest_and_the_result():
    row = slow_tests.read("test_a.py", 3, PRINTED)
    assert row == "| test_a.py | 3 | 16 | test_long[one] 15 s | 1 failed, 2 passed |"


def test_rows_are_kept_and_a_changed_file_is_not_measured():
    row = slow_tests.read("test_a.py", 3, PRINTED)
    page = "\n".join(
        ["before", slow_tests.BEGIN, *slow_tests.table({"test_a.py": 3}, {"test_a.py": row}), slow_tests.END]
    )
    before, rows, after = slow_tests.kept(page + "\nafter")
    assert (before, rows, after) == ("before\n", {"test_a.py": row}, "\nafter")
    assert slow_tests.table({"test_a.py": 3}, rows)[-1] == row
    lines = slow_tests.table({"test_a.py": 4, "test_b.py": 1}, rows)
    assert lines[-2:] == ["| test_a.py | 4 | not measured | | |", "| test_b.py | 1 | not measured | | |"]


def test_the_page_has_a_row_for_every_file_with_slow_tests():
    _, rows, after = slow_tests.kept(slow_tests.PAGE.read_text(encoding="utf-8"))
    marked = {
        file.name for file in (ROOT / "tests").glob("test_*.py") if "mark.slow" in file.read_text(encoding="utf-8")
    }
    assert after and {name for name in marked if re.match(r"test_(?!slow_tests)", name)} <= rows.keys()
