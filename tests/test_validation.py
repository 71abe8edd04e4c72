"""The validation page: its arithmetic, its failures, and (slow) the page in the repository."""

import json
import math
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks.validation import closed_forms, literature, page, reach, reference_orbits, software
from benchmarks.validation.__main__ import main
from benchmarks.validation.comparison import Comparison, Section, attempted, number
from orbitfinder.errors import ConvergenceError, InputError

ROOT = Path(__file__).parents[1]
DATA = Path(__file__).parent / "data"
PAGE = ROOT / "results" / "validation" / "README.md"


def test_a_row_passes_by_its_difference_only():
    assert number("T", "1.5", 1.5 + 1e-12, 1e-11).passed
    assert not number("T", "1.5", 1.5 + 1e-10, 1e-11).passed
    assert not number("T", "1.5", math.nan, 1e-11).passed
    assert number("T", "1.5", 1.5, 0.0).passed


def test_what_cannot_be_computed_is_a_failed_row():
    """Our own errors become rows; a programming error is not hidden."""

    def fails():
        raise ConvergenceError("no orbit\nthere")

    (row,) = attempted("T", "1.5", fails)
    assert not row.passed and row.note == "no orbit there" and row.ours == "none"
    with pytest.raises(ZeroDivisionError):
        attempted("T", "1.5", lambda: [1 / 0])


def test_failures_stay_in_the_page():
    """A planted failure is counted, marked and explained; absent software is named; cells are escaped."""
    rows = (number("period", "1.5", 1.5, 1e-9), number("a|b <i>", "2.0", 2.1, 1e-9, "why | so"))
    text = page.markdown([Section("One", "a source", rows), Section("Two", "another", (), "not installed")])
    assert "**1 of 2 rows pass.** Not run here: Two." in text
    assert "| a\\|b &lt;i> | 2.0 | 2.1 | 1.0e-01 | 1.0e-09 | **FAIL** why \\| so |" in text
    assert "| One | 2 | 1 | 0 |" in text and "Not run: not installed." in text


def test_closed_forms_are_met():
    """Every elliptic integral to 1e-12, relative."""
    rows = closed_forms.section().rows
    assert len(rows) == 11 and all(row.passed for row in rows), [row for row in rows if not row.passed]


def test_closed_forms_notice_a_wrong_gravity(monkeypatch):
    monkeypatch.setattr(closed_forms, "GRAVITY", 9.81)
    assert not any(row.passed for row in closed_forms.small_oscillations())


def test_the_cycle_and_the_eight_match_the_printed_digits():
    """All digits of the van der Pol period and amplitude, all printed digits of the figure eight."""
    rows = {row.quantity: row for row in [*literature.cycle(1.0), *literature.eight()[:4]]}
    assert {"mu = 1, period", "mu = 1, amplitude", *literature.EIGHT} <= rows.keys()
    assert all(row.passed for row in rows.values()), [row for row in rows.values() if not row.passed]


def test_the_bifurcations_of_henon_heiles_have_the_quoted_energies():
    """All six digits of both, by orbits whose certificate passes; the period guess is that of the quadrature."""
    for one in literature.CASCADE:
        energy, certificate = literature.bifurcation(*one)
        assert energy.passed and certificate.passed
    lowest, period = literature.straight_line(0.75)
    assert lowest**2 / 2 - lowest**3 / 3 == pytest.approx(0.125, abs=1e-14) and lowest < 0
    assert period == pytest.approx(7.54325941267508, abs=1e-9)  # problems/gallery/henon-heiles-straight.toml


def test_missing_reference_files_are_an_input_error(tmp_path):
    with pytest.raises(InputError, match=r"--data: .*report_orbits.json: cannot be read .*give the folder tests/data"):
        reference_orbits.refined(tmp_path)
    result = CliRunner().invoke(main, ["--data", str(tmp_path), "--out", str(tmp_path / "out")])
    assert result.exit_code == 2 and not (tmp_path / "out").exists()


def test_absent_programs_are_said_to_be_absent(monkeypatch, tmp_path):
    monkeypatch.setenv("AUTO_DIR", str(tmp_path))
    assert software.auto().missing.startswith("AUTO-07p with gfortran is not installed") and not software.auto().rows


def test_a_shorter_family_than_autos_fails(tmp_path):
    """Planted families: one reaches further than AUTO did, one less far, the others are not there."""
    for name, energy in (("triple-mode-1", -3.0), ("triple-mode-2", 18.0)):
        (tmp_path / name).mkdir()
        points, ends = [{"energy": -40.0}, {"energy": energy - 1}], [{"kind": "homoclinic"}]
        family = {"points": points, "events": [{"energy": energy}], "system": {"links": 3}, "ends": ends}
        (tmp_path / name / "family.json").write_text(json.dumps(family))
    rows = {row.quantity: row for row in reach.section(DATA, tmp_path).rows}
    assert rows["triple-mode-1"].passed and rows["triple-mode-1"].ours == "41.100000000"
    assert not rows["triple-mode-2"].passed
    assert rows["triple-mode-2"].difference == pytest.approx(62.1 - 63.000509059)
    absent = rows["quadruple-mode-2"]
    assert not absent.passed and absent.note == "not computed" and absent.published == "105.65232244" and len(rows) == 9
    assert reach.section(DATA, tmp_path / "none").missing.startswith("there is no")


def test_auto_output_is_read(tmp_path):
    """Points of fort.7 by their last two columns, the last solution of fort.8 by the lengths it declares."""
    (tmp_path / "fort.7").write_text("   0  header 1 2\n  -1  1  9  1  0.0  3.5  -2.5\n  -1  2  0  0  0.1  3.6  -2.4\n")
    assert software.read_branch(tmp_path / "fort.7") == [(3.5, -2.5), (3.6, -2.4)]
    head = "1 1 9 1 2 1 2 9 {} 1 4 36"
    first = [head.format(3), "0.0 1.0 2.0", "1.0 1.0 2.0", "9 9 9"]
    long = [head.format(4), "0.0 1 2 3 4 5 6", "7 8", "1.0 1 2 3 4 5 6", "7 8"]
    (tmp_path / "fort.8").write_text("\n".join([*first, *long]) + "\n")
    assert software.read_state(tmp_path / "fort.8", 8).tolist() == [1, 2, 3, 4, 5, 6, 7, 8]


def test_the_page_in_the_repository_is_complete():
    """It names every section with its rows, and its verdicts follow from its own numbers."""
    text = PAGE.read_text(encoding="utf-8")
    rows = re.findall(r"^\| (.+?) \| .* \| ([-+.\de]+|nan) \| ([-+.\de]+) \| (PASS|\*\*FAIL\*\*)", text, re.MULTILINE)
    passed = sum(verdict == "PASS" for *_, verdict in rows)
    assert f"**{passed} of {len(rows)} rows pass.**" in text and len(rows) >= 90
    for quantity, difference, allowed, verdict in rows:
        within = abs(float(difference)) <= float(allowed) * 1.06  # both were rounded to two digits
        assert within == (verdict == "PASS"), quantity
    for title in ("The course report's orbits", "Nonlinear normal modes", "Closed forms", "Arenstorf", "heyoka"):
        assert title in text


@pytest.mark.slow
def test_the_page_in_the_repository_is_what_the_program_writes(tmp_path):
    """The same rows with the same verdicts; heyoka and AUTO are compared where they are at home."""
    families = ROOT / "results" / "families"
    result = CliRunner().invoke(main, ["--data", str(DATA), "--out", str(tmp_path), "--families", str(families)])
    assert result.exit_code in (0, 1)
    written, kept = (verdicts(one.read_text(encoding="utf-8")) for one in (tmp_path / "README.md", PAGE))
    elsewhere = {title for title in written if title.startswith(("heyoka", "AUTO"))}
    assert len(written) - len(elsewhere) >= 9
    for title in written.keys() - elsewhere:
        assert written[title] == kept[title], title


def verdicts(text):
    """Title of each section -> (quantity, verdict) of its rows."""
    found = {}
    for part in text.split("\n## ")[1:]:
        rows = re.findall(r"^\| (.+?) \|.*\| (PASS|\*\*FAIL\*\*)", part, re.MULTILINE)
        found[part.partition("\n")[0]] = rows
    return found


def test_a_comparison_is_plain_data():
    row = Comparison("T", "1", "1.0", 0.0, 1e-3)
    assert row.passed and hash(row) == hash(Comparison("T", "1", "1.0", 0.0, 1e-3))
