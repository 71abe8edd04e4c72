"""What a release says of itself is true: versions, recipe, forms, what is of others, checksums of the results."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import orbitfinder

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))

import checksums  # noqa: E402

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
IN_CLONE = pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no clone")
CONDA_NAMES = {"matplotlib": "matplotlib-base", "lazy-loader": "lazy_loader"}


def read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def test_one_version_everywhere():
    """pyproject.toml, the package, the citation, the recipe, and a heading with notes in the changelog."""
    version = PROJECT["version"]
    assert orbitfinder.__version__ == version
    assert re.search(r"^version: (\S+)$", read("CITATION.cff"), re.M)[1] == version
    assert re.search(r'^  version: "(\S+)"$', read("conda/recipe.yaml"), re.M)[1] == version
    notes = read("CHANGELOG.md").partition(f"\n## [{version}]")[2].partition("\n## [")[0]
    assert len(notes) > 1000 and {"### Added", "### Changed", "### Fixed"} <= set(notes.splitlines())


@pytest.mark.needs("docs")
def test_the_recipe_asks_for_what_pyproject_asks():
    """Same dependencies with the same bounds, by conda-forge's names; same Python, same build system, same command."""
    import yaml

    recipe = yaml.safe_load(read("conda/recipe.yaml"))
    wanted = [re.fullmatch(r"([\w-]+)(\S+)", line).groups() for line in PROJECT["dependencies"]]
    asked = [f"{CONDA_NAMES.get(name, name)} {bounds}" for name, bounds in wanted]
    assert recipe["requirements"]["run"] == ["python >=${{ python_min }}", *asked]
    assert f">={recipe['context']['python_min']}" == PROJECT["requires-python"]
    build = tomllib.loads(read("pyproject.toml"))["build-system"]["requires"]
    assert [line.replace(" ", "") for line in recipe["requirements"]["host"][2:]] == build
    (command,) = (f"{name} = {place}" for name, place in PROJECT["scripts"].items())
    assert recipe["build"]["python"]["entry_points"] == [command]
    assert recipe["about"]["license_file"] == PROJECT["license-files"]
    assert all((ROOT / name).is_file() for name in PROJECT["license-files"])


@pytest.mark.needs("docs")
def test_forms_and_workflows_are_yaml_with_what_forges_ask_for():
    """Each form has a name, a description and fields; bugs and wrong answers want the doctor's output."""
    import yaml

    forms = {
        path.stem: yaml.safe_load(path.read_text()) for path in (ROOT / ".github/ISSUE_TEMPLATE").glob("[0-9]*.yml")
    }
    assert len(forms) == 4
    for name, form in forms.items():
        fields = [one["id"] for one in form["body"] if one["type"] != "markdown"]
        assert form["name"] and form["description"] and len(set(fields)) == len(fields) > 0
        assert ("doctor" in fields) == ("bug" in name or "wrong" in name)
    jobs = yaml.safe_load(read(".github/workflows/ci.yml"))["jobs"]
    supported = [line.rpartition(" ")[2] for line in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", line)]
    assert jobs["check"]["strategy"]["matrix"]["python"] == supported
    scripts = [step["run"] for name in ("check", "oldest") for step in jobs[name]["steps"] if "run" in step]
    assert scripts == [".ci/run", ".ci/minimal"] and all((ROOT / one).is_file() for one in scripts)
    assert jobs["elsewhere"]["strategy"]["matrix"]["system"] == ["macos-latest", "windows-latest"]


def test_the_supported_versions_of_python_are_the_same_everywhere():
    """Classifiers, README, badge (tests/test_readme.py), pages, the doctor, the recipe, the scripts."""
    versions = [line.rpartition(" ")[2] for line in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", line)]
    assert versions == [f"3.{minor}" for minor in range(11, 16)]
    said = f"Python {versions[0]} to {versions[-1]}"
    pages = ("README.md", "CONTRIBUTING.md", "docs/how-to/install.md", "docs/tutorials/first-orbit.md", ".ci/package")
    assert all(said in read(name) for name in (*pages, "orbitfinder/cli/doctor.py"))
    assert f'python_min: "{versions[0]}"' in read("conda/recipe.yaml") and "3.1[1-5]) ;;" in read(".ci/package")


@IN_CLONE
def test_what_is_of_others_is_declared():
    """Every vendored file is in a row of THIRD_PARTY.md, with the licence beside it and the version that it states."""
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in read("THIRD_PARTY.md").splitlines()]
    rows = [row for row in rows if len(row) == 5 and row[0].startswith("`")]
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
        "\n"
    )
    vendored = [name for name in listed if re.search(r"\.min\.(js|css)$|\.(woff2?|ttf|otf|wasm)$", name)]
    vendored = [name for name in vendored if not name.startswith("results/site/")]
    assert "orbitfinder/site/assets/plotly-basic.min.js" in vendored
    for name in vendored:
        (row,) = (row for row in rows if name.startswith(row[0].strip("`")))
        licence = Path(re.search(r"`(.+)`", row[3])[1])
        assert (ROOT / licence).is_file() and (
            licence.parent == Path(name).parent or licence.parent in Path(name).parents
        )
        assert not name.endswith(".js") or row[2] in read(name)


@pytest.mark.skipif(not (ROOT / "results").is_dir(), reason="an sdist has no results")
def test_the_checksums_of_the_results_are_true():
    """`python benchmarks/checksums.py` was run after anything in results/ was made again."""
    assert not checksums.differences(ROOT / "results")


def test_a_changed_a_missing_and_a_new_file_are_told(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(checksums, "RESULTS", tmp_path)
    for name in ("a", "b", "c"):
        (tmp_path / name).write_text(name)
    monkeypatch.setattr(sys, "argv", ["checksums.py"])
    assert checksums.main() == 0 and not checksums.differences(tmp_path)
    (tmp_path / "a").write_text("other")
    (tmp_path / "b").unlink()
    (tmp_path / "d").write_text("d")
    (tmp_path / "c-wal").write_text("what SQLite leaves while it reads")
    monkeypatch.setattr(sys, "argv", ["checksums.py", "--check"])
    assert checksums.main() == 1
    assert capsys.readouterr().out.splitlines()[-3:] == ["a: changed", "b: missing", "d: not listed"]


def test_the_oldest_that_is_admitted_is_what_pyproject_says():
    """Every dependency has a lower bound, so that `.ci/minimal` can install it."""
    every = [*PROJECT["dependencies"], *(one for extra in PROJECT["optional-dependencies"].values() for one in extra)]
    assert not [one for one in every if not re.match(r"[\w-]+(\[\w+\])?>=\d", one)]
