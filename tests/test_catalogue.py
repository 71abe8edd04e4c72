"""Catalogues of published states: a row for each orbit, one problem file for all of them."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.problemfile.read import load_problem_file, rows_of

ROOT = Path(__file__).parents[1]
FILE = ROOT / "problems" / "published" / "three-bodies.toml"
SWING = 'system = { kind = "chain", links = 1 }\nguess = { catalogue = "rows.csv" }\n'


def written(folder: Path, rows: str) -> Path:
    (folder / "rows.csv").write_text(rows)
    (folder / "swing.toml").write_text(SWING)
    return folder / "swing.toml"


def test_rows_are_problems(tmp_path):
    """By name, else by number; a parameter's column is the model's, a state without a column is 0."""
    file = written(tmp_path, "# of nobody\nname, theta1 ,period,gravity\nlow one,1,2.1,9.81\n\nhigh,2.5,3.2,1.62\n")
    assert [str(row).rpartition("#")[2] for row in rows_of(file)] == ["low-one", "high"]
    high = of.load_problem(f"{file}#high")
    assert high.name == "swing-high" and high.guess.period == 3.2 and list(high.guess.state) == [2.5, 0.0]
    assert dict(zip(high.model.parameter_names, high.model.parameter_values, strict=True))["gravity"] == 1.62
    assert of.load_problem(file).name == "swing-low-one"  # the first
    numbered = written(tmp_path, "theta1,period\n1,2.1\n2,2.2\n")
    assert [of.load_problem(row).guess.period for row in rows_of(numbered)] == [2.1, 2.2]
    assert rows_of(FILE.with_name("figure-eight.toml")) == [FILE.with_name("figure-eight.toml")]


def test_run_takes_all_rows_and_says_how_far_they_were(tmp_path, monkeypatch):
    """The period of a swing to 1 rad was printed with four digits, to 2 rad with a misprint."""
    monkeypatch.chdir(tmp_path)
    file = written(tmp_path, "name,theta1,period\nsmall,1,2.138\nlarge,2,2.8\n")
    done = CliRunner().invoke(cli, ["run", str(file), "--no-figures"])
    assert done.exit_code == 0, done.output
    small, large = (of.load_orbit(f"orbits/swing-{name}/orbit.json") for name in ("small", "large"))
    assert "2 of 2 orbits certified" in done.output and "from the catalogue" in done.output
    for orbit, theta, period in ((small, 1.0, 2.138), (large, 2.0, 2.8)):
        moved = max(abs(orbit.state[0] - theta) / theta, abs(orbit.period / period - 1), abs(orbit.state[1]) / theta)
        assert f"{moved:.1e} from the catalogue" in done.output
    one = CliRunner().invoke(cli, ["run", f"{file}#small", "--no-figures", "--json"])
    assert one.exit_code == 0 and '"moved"' in one.output
    shown = CliRunner().invoke(cli, ["show", f"{file}#large"])
    assert shown.exit_code == 0, shown.output


REFUSED = {
    "no-row": ("theta1,period\n", [], "has no rows; give a header and a row"),
    "empty": ("", [], "has no rows"),
    "columns": ("theta1,period\n1,2,3\n", [], "row 1: 3 columns; give 2, as the header names"),
    "number": ("theta1,period\n1,two\n", [], "row 1: could not convert string to float"),
    "finite": ("theta1,period\n1,nan\n", [], "row 1 must be finite"),
    "unknown": ("theta,period\n1,2\n", [], "column 'theta' is unknown, did you mean 'theta1'?; use name, period"),
    "twice": ("theta1,period,theta1\n1,2,1\n", [], "two columns 'theta1'; rename the second"),
    "names": ("name,theta1,period\na,1,2\na,1,2\n", [], "row 2: a second 'a'; rename it"),
    "name": ("name,theta1,period\n../a,1,2\n", [], "row 1"),
    "period": ("theta1\n1\n", [], "row '1' has no period; add a column period in s"),
    "negative": ("theta1,period\n1,-2\n", [], "row '1' has no period"),
    "many": ("theta1,period\n" + "1,2\n" * 1001, [], "has 1001 rows, the limit is 1000; divide it"),
    "other": ("name,theta1,period\na,1,2\n", ["b"], "no row 'b'; it has a"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_wrong_is_named(case, tmp_path):
    rows, asked, said = REFUSED[case]
    file = written(tmp_path, rows)
    done = CliRunner().invoke(cli, ["run", "#".join([str(file), *asked])])
    assert done.exit_code == 2 and "guess.catalogue" in done.output and said in " ".join(done.output.split())
    assert not (tmp_path / "orbits").exists()


def test_other_files_have_no_rows(tmp_path):
    """A row of a file without a catalogue, one outside of the folder, one that is missing or is no text."""
    with pytest.raises(InputError, match="guess.catalogue: missing, so there is no row 'a'"):
        load_problem_file(f"{FILE.with_name('figure-eight.toml')}#a")
    with pytest.raises(InputError, match="only a .toml file has a catalogue"):
        load_problem_file(f"{FILE.with_name('lure.py')}#a")
    for named, said in (("../rows.csv", "lies outside"), ("none.csv", "no such file")):
        file = tmp_path / "swing.toml"
        file.write_text(SWING.replace("rows.csv", named))
        with pytest.raises(InputError, match=said):
            rows_of(file)
    file = written(tmp_path, "")
    (tmp_path / "rows.csv").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="not UTF-8 text"):
        rows_of(file)


@pytest.mark.slow
@pytest.mark.parametrize("row", [str(row) for row in rows_of(FILE)], ids=lambda row: row.rpartition("#")[2])
def test_shipped_rows_are_certified(row):
    """To the digits that were printed: the periods to 2e-4, since it is the energy that is kept."""
    problem = of.load_problem(row)
    orbit = of.find_orbit(problem)
    assert orbit.certificate.passed and np.abs(orbit.state - problem.guess.state).max() < 1e-5
