"""Equilibria as records like others: tables, FILE#K, pages with the cycles that are born there, notebooks."""

import csv
import json
import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.families.point import FamilySettings
from orbitfinder.records.family import End, save_family
from orbitfinder.records.registry import load
from orbitfinder.show.rest import most_moved
from orbitfinder.site.build import SiteSettings, build_site
from orbitfinder.site.gather import gather
from orbitfinder.site.pages import spread

NASTY = '</script><b onclick="1">'


def run(*words, code=0):
    result = CliRunner().invoke(cli, [*map(str, words)])
    assert result.exit_code == code, result.output
    return result.output


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The Brusselator's equilibria and the cycles from its Hopf point, and a family of the equilibria's name."""
    out = tmp_path_factory.mktemp("rest")
    rest = of.follow_equilibria(of.systems.brusselator(rate=1.8), [1.0, 1.8], "rate", until=2.4, name="chemistry")
    of.save_equilibria(rest, out / "equilibria" / "chemistry" / "equilibria.json")
    settings = FamilySettings(points=6)
    born = of.switch_branch(rest, 0)
    cycles = of.follow_family(born, settings=settings, out=out / "families", name="cycles")
    namesake = replace(cycles, name="chemistry", source={"kind": "orbit", "name": "chemistry"})
    save_family(namesake, out / "families" / "chemistry")
    return out


@pytest.fixture(scope="module")
def file(folder):
    return folder / "equilibria" / "chemistry" / "equilibria.json"


@pytest.fixture(scope="module")
def site(folder):
    return build_site(gather([folder]), SiteSettings())[0].files


def data_of(files, page):
    """What the script of a page works with."""
    text = files[f"data/{page}.js"].decode()
    return json.loads(re.fullmatch(r'orbitfinder\.put\("[a-z]+",(.*)\);\n', text)[1])


def test_a_table_has_the_closed_form_in_every_row(file, tmp_path):
    """u = 1, v = b, and the eigenvalues of [[b - 1, 1], [-b, -1]]."""
    written, happened, ends = run("export", file, "--to", "csv", "-o", tmp_path).split()
    (hopf,) = csv.DictReader(Path(happened).read_text().splitlines())
    assert hopf["kind"] == "hopf" and abs(float(hopf["rate"]) - 2) < 1e-9 and abs(float(hopf["frequency"]) - 1) < 1e-9
    assert "reached rate" in Path(ends).read_text()
    rows = [*csv.DictReader(Path(written).read_text().splitlines())]
    assert [*rows[0]] == ["index", "rate", "u", "v", "eigenvalue_1_re", "eigenvalue_1_im", "eigenvalue_2_re",
                          "eigenvalue_2_im", "stability", "residual", "certified"]  # fmt: skip
    points = of.load_equilibria(file).points
    assert len(rows) == len(points) and [float(row["rate"]) for row in rows] == [point.value for point in points]
    for k, row in enumerate(rows):
        b = float(row["rate"])
        found = [complex(float(row[f"eigenvalue_{i}_re"]), float(row[f"eigenvalue_{i}_im"])) for i in (1, 2)]
        wanted = np.linalg.eigvals([[b - 1, 1.0], [-b, -1.0]])
        assert np.allclose(sorted(found, key=np.imag), sorted(wanted, key=np.imag), atol=1e-12)
        assert np.allclose([float(row["u"]), float(row["v"])], [1.0, b], rtol=1e-14) and int(row["index"]) == k
        assert row["stability"] == ("stable" if b < 2 else "unstable") and row["certified"] == "True"


def test_show_gives_the_commands_that_follow_a_hopf_point(file, tmp_path):
    (hopf,) = json.loads(run("show", file, "--json"))["results"][0]["events"]
    assert "cycles of the period are born" in hopf["what"] and len(hopf["follow"]) == 2
    for command in hopf["follow"]:
        run(*shlex.split(command)[1:], "--points", 2, "--no-figures", "--out", tmp_path)


def test_json_has_the_rows_and_null_for_what_is_unknown(file, tmp_path):
    rest = of.load_equilibria(file)
    unknown = replace(rest, points=(replace(rest.points[0], residual=float("nan")), *rest.points[1:]))
    of.save_equilibria(unknown, tmp_path / "equilibria.json")
    written = run("export", tmp_path / "equilibria.json", "--to", "json", "-o", tmp_path / "out").split()[0]
    rows = json.loads(Path(written).read_text())
    assert rows[0]["residual"] is None and [row["v"] for row in rows] == [point.state[1] for point in rest.points]


def test_a_table_replaces_no_record_and_other_formats_say_what_they_hold(file, tmp_path):
    of.save_equilibria(replace(of.load_equilibria(file), name="equilibria"), tmp_path / "equilibria.json")
    before = (tmp_path / "equilibria.json").read_bytes()
    said = run("export", tmp_path / "equilibria.json", "--to", "json", code=2)
    assert "equilibria.json is a record, which a table would replace; give another folder" in said
    assert (tmp_path / "equilibria.json").read_bytes() == before
    assert "c files hold orbits, and chemistry is a table; use one of csv, parquet, json" in run(
        "export", file, "--to", "c", "-o", tmp_path, code=2
    )


def test_one_equilibrium_of_a_file_is_shown_verified_and_drawn(file, tmp_path):
    rest = of.load_equilibria(file)
    (part,) = load(f"{file}#3").points
    assert part.value == rest.points[3].value and np.array_equal(part.state, rest.points[3].state)
    shown = run("show", f"{file}#3")
    assert f"value               {part.value:.12g}" in shown and "eigenvalues" in shown
    assert "chemistry-3): certified" in run("verify", f"{file}#3")
    assert run("plot", f"{file}#3", "-o", tmp_path).strip().endswith("equilibria.png")
    assert "#99: no such equilibria in the file" in run("verify", f"{file}#99", code=2)
    assert "equilibria, not an orbit; give an orbit.json" in run("prove", f"{file}#3", code=2)
    assert "which `animate` does not take" in run("animate", file, code=2)
    assert "--switch 0" in run("show", file)


def test_a_state_that_is_none_is_rejected_alone(file, tmp_path):
    rest = of.load_equilibria(file)
    moved = replace(rest.points[3], state=rest.points[3].state + np.array([0.0, 1e-9]))
    wrong = replace(rest, points=(*rest.points[:3], moved, *rest.points[4:]))
    of.save_equilibria(wrong, tmp_path / "equilibria.json")
    assert "REJECTED by rates" in run("verify", f"{tmp_path / 'equilibria.json'}#3", code=1)
    run("verify", f"{tmp_path / 'equilibria.json'}#2")


def test_records_that_do_not_belong_together_are_refused_by_name(file, tmp_path):
    rest, path = of.load_equilibria(file), tmp_path / "equilibria.json"
    ragged = (replace(rest.points[0], eigenvalues=rest.points[0].eigenvalues[:1]), *rest.points[1:])
    of.save_equilibria(replace(rest, points=ragged), path)
    with pytest.raises(InputError, match="all of one number of components and eigenvalues"):
        of.load_equilibria(path)
    longer = [replace(one, state=np.append(one.state, 0.0)) for one in rest.points]
    of.save_equilibria(replace(rest, points=tuple(longer), events=()), path)
    for words in (("verify",), ("plot", "-o", tmp_path), ("export", "--to", "csv", "-o", tmp_path),
                  ("page", "-o", tmp_path / "site")):  # fmt: skip
        said = run(words[0], path, *words[1:], code=2).splitlines()[-1]
        assert "state: 3 numbers for 2 components of the state; " in said and ("equili" in said or "chemis" in said)


def test_a_page_has_the_numbers_of_its_points_and_events(site, file):
    rest, data = of.load_equilibria(file), data_of(site, "equilibria/chemistry")
    assert [point["value"] for point in data["points"]] == [point.value for point in rest.points]
    assert data["names"] == ["u", "v"] and data["up"] == most_moved(rest) == 1
    (event,) = data["events"]
    assert event["kind"] == "hopf" and event["lyapunov"] == rest.events[0].lyapunov and event["check"]["passed"]
    page = site["equilibria/chemistry.html"].decode()
    assert "supercritical Hopf point" in page and "cycles are born on the side where the pair grows" in page
    assert "orbitfinder continue equilibria/chemistry/equilibria.json --switch 0" in page
    loads = [*re.findall(r'(?:src|href)="\.\./([^"#]+)"', page)]
    assert all(name in site for name in loads) and sum(len(site[name]) for name in loads) < 3e6


def test_cycles_and_their_hopf_point_are_linked_and_drawn_beside_each_other(site, folder):
    """Least and largest values of a cycle by an integrator of SciPy."""
    page = site["equilibria/chemistry.html"].decode()
    assert '<a href="../families/cycles.html">cycles</a>' in page and "families/chemistry" not in page
    back = site["families/cycles.html"].decode()
    assert '<a href="../equilibria/chemistry.html#event=0">chemistry, hopf 0</a>' in back
    assert "Branches followed" not in site["families/chemistry.html"].decode()  # another's name is no parent
    (drawn,) = data_of(site, "equilibria/chemistry")["cycles"]
    family = of.load_family(folder / "families" / "cycles" / "family.json")
    assert len(drawn["places"]) == len(family.points)
    point, b = family.points[-1], family.points[-1].value

    def rates(_, x):
        return [1 + x[0] ** 2 * x[1] - (b + 1) * x[0], b * x[0] - x[0] ** 2 * x[1]]

    path = solve_ivp(rates, (0, point.period), point.state, rtol=1e-10, atol=1e-10, max_step=point.period / 500).y
    assert drawn["places"][-1][:2] == [b, f"../families/cycles.html#point={len(family.points) - 1}"]
    assert np.allclose(drawn["low"][-1], path.min(axis=1), rtol=1e-2)
    assert np.allclose(drawn["high"][-1], path.max(axis=1), rtol=1e-2)


def test_the_gallery_has_a_card_with_the_curve(site):
    index = site["index.html"].decode()
    assert 'href="equilibria/chemistry.html"' in index and "Equilibria, families and atlases" in index
    assert index.count("<svg") == 1 and "rate: supercritical Hopf" in index


def test_a_page_says_how_many_there_are(folder, tmp_path):
    said = run("page", folder, "-o", tmp_path / "site")
    assert "2 families, 1 equilibrium curve, " in said
    assert "1 equilibrium curve, " in run("page", folder / "equilibria", "-o", tmp_path / "site")


def test_of_many_points_some_are_kept_and_those_where_the_stability_changes(file, tmp_path):
    rest = of.load_equilibria(file)
    values, hopf = np.linspace(1.8, 2.4, 2001), rest.events[0]
    many = tuple(replace(rest.points[0], value=b, state=np.array([1.0, b]), arclength=b, stability=
                         "stable" if b < 2 else "unstable") for b in values)  # fmt: skip
    index = int(np.flatnonzero(values < 2)[-1])
    event = replace(hopf, index=index, arclength=2.0)
    of.save_equilibria(replace(rest, points=many, events=(event,)), tmp_path / "equilibria.json")
    files = build_site(gather([tmp_path / "equilibria.json"]))[0].files
    numbers = [point["number"] for point in data_of(files, "equilibria/chemistry")["points"]]
    assert numbers[0] == 0 and numbers[-1] == 2000 and {index, index + 1} <= {*numbers} and len(numbers) <= 602
    assert len(files["data/equilibria/chemistry.js"]) < 5e5


def test_nothing_in_a_file_becomes_markup(file, tmp_path):
    rest = of.load_equilibria(file)
    nasty = replace(rest, name=NASTY, parameter=NASTY, system={"kind": "python", "function": "none"},
                    ends=(End(NASTY, NASTY),), events=(replace(rest.events[0], kind=NASTY, criticality=""),),
                    )  # fmt: skip
    of.save_equilibria(nasty, tmp_path / "equilibria.json")
    files = build_site(gather([tmp_path / "equilibria.json"]))[0].files
    assert not any(b"<b onclick" in text for name, text in files.items() if name.endswith((".html", ".js")))
    assert "<b onclick" not in nasty._repr_html_()


def test_a_notebook_draws_the_curve_and_names_its_events(file):
    rest = of.load_equilibria(file)
    shown = rest._repr_html_()
    assert shown.count("<polyline") == 2 and shown.count("stroke-dasharray") == 1 and shown.count("<title>") == 1
    assert "supercritical hopf at 2" in shown and "rate = 2" in shown
    assert ">v<" in shown and ">x2<" in replace(rest, system={"kind": "python", "function": "none"})._repr_html_()


def test_points_without_energy_are_picked_along_the_whole_family(folder):
    points = of.load_family(folder / "families" / "cycles" / "family.json").points
    assert np.isnan(points[0].energy) and len(spread(points, 4)) > 2
