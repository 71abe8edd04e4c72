"""The doctor tells a sound installation from a broken one; completion scripts complete."""

import json
import os
import shutil
import subprocess
import sys
import tomllib
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli import casadi_bugs, doctor
from orbitfinder.cli.group import cli


def invoke(*arguments):
    return CliRunner().invoke(cli, list(arguments))


def named(name):
    return next(one for one in doctor.examine() if one.name == name)


def test_this_installation_is_usable():
    """Exit code 0, every essential finding ok, the main job done and compared with the exact period."""
    result = invoke("doctor")
    lines = result.stdout.splitlines()
    assert result.exit_code == 0 and lines[-1] == "Usable." and "BROKEN" not in result.stdout
    for name in ("casadi cvodes", "casadi idas", "casadi ipopt"):
        assert any(line.split() == ["ok", *name.split(), "plugin", "loads"] for line in lines)
    assert any("pendulum at 1 rad certified" in line for line in lines)


def test_json_is_one_document():
    document = json.loads(invoke("doctor", "--json").stdout)
    assert document["format"] == "orbitfinder/doctor" and document["usable"] is True
    assert {"casadi ipopt", "main job", "C compiler", "cache"} <= {one["name"] for one in document["findings"]}


def test_a_missing_plugin_is_essential(monkeypatch):
    import casadi

    monkeypatch.setattr(casadi, "has_integrator", lambda name: name != "idas")
    result = invoke("doctor")
    assert result.exit_code == 1 and "Not usable: see what is marked BROKEN." in result.stdout
    line = next(line for line in result.stdout.splitlines() if "casadi idas" in line)
    assert line.split()[0] == "BROKEN" and "plugin missing" in line


def test_a_package_that_cannot_be_imported_is_essential(monkeypatch):
    monkeypatch.setitem(sys.modules, "rich", None)
    finding = named("rich")
    assert finding.status == doctor.BROKEN and finding.detail.startswith("cannot be imported: ModuleNotFoundError")


def test_a_wrong_result_of_the_main_job_is_essential(monkeypatch):
    """A period off by 1e-9 is reported, not waved through; so is an exception."""
    right = of.find_orbit

    def wrong(problem):
        orbit = right(problem)
        return replace(orbit, period=orbit.period * (1 + 1e-9))

    monkeypatch.setattr(of, "find_orbit", wrong)
    finding = doctor._main_job()
    assert finding.status == doctor.BROKEN and "off the elliptic integral by 1e-09" in finding.detail

    def fail(_):
        raise RuntimeError("no solver")

    monkeypatch.setattr(of, "find_orbit", fail)
    assert doctor._main_job().detail == "RuntimeError: no solver"


def test_without_compiler_and_cache(monkeypatch, tmp_path):
    """Both are optional: said, with a remedy, and still usable."""
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("CC", "no-such-compiler")
    monkeypatch.setenv("ORBITFINDER_CACHE", str(blocked))
    found = {one.name: one for one in doctor.tools()}
    assert found["C compiler"].status == doctor.MISSING and "no-such-compiler" in found["C compiler"].detail
    assert "runs interpreted" in found["C compiler"].remedy
    assert found["cache"].status == doctor.NOTE and "ORBITFINDER_CACHE" in found["cache"].remedy


def test_extras_say_what_is_missing(monkeypatch):
    required = ["casadi>=3", "pytest>=8; extra == 'test'", 'no-such-distribution; extra == "proof"']
    monkeypatch.setattr(metadata, "requires", lambda _: required)
    found = {one.name: one for one in doctor.extras()}
    assert found["extra test"].status == doctor.OK
    assert found["extra proof"].status == doctor.MISSING
    assert found["extra proof"].remedy == "pip install 'orbitfinder[proof]', for prove and refine"


def test_every_extra_is_named_with_its_use_and_its_command(monkeypatch):
    """Those that pyproject.toml declares; with nothing installed each says how, and no line is over 80."""
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
    declared = project["optional-dependencies"]
    assert set(declared) == set(doctor.EXTRAS)
    monkeypatch.setattr(doctor, "declared_extras", lambda: declared)
    monkeypatch.setattr(doctor, "_installed", lambda _: False)
    said = [line for one in doctor.examine() for line in doctor.report(one)]
    assert all(len(line) <= 80 or " " not in line[doctor.INDENT :] for line in said)  # a path is not broken
    for extra, use in doctor.EXTRAS.items():
        assert f"pip install 'orbitfinder[{extra}]', for {use}" in " ".join(" ".join(said).split())


def test_known_defects_are_what_the_documentation_says():
    """The trials run; each one present is met by what orbitfinder does instead."""
    found = {finding.name: finding for finding in doctor.defects()}
    assert set(found) == {"integrator Jacobian", "algebraic derivative", "over-determined NLP"}
    for finding in found.values():
        assert finding.status in (doctor.OK, doctor.NOTE) and "could not be tried" not in finding.detail


def test_a_defect_that_a_release_repaired_is_reported_absent(monkeypatch):
    monkeypatch.setattr(casadi_bugs, "TRIALS", (("name", "reference", lambda: (False, "fine"), "instead"),))
    (finding,) = doctor.defects()
    assert finding.status == doctor.OK and finding.detail == "CasADi: defect absent (reference)"


def test_a_trial_that_cannot_run_is_a_note(monkeypatch):
    def fail():
        raise RuntimeError("first\nno such plugin")

    monkeypatch.setattr(casadi_bugs, "TRIALS", (("name", "reference", fail, "instead"),))
    (finding,) = doctor.defects()
    assert finding.status == doctor.NOTE and "could not be tried: no such plugin" in finding.detail


def test_our_own_derivative_is_right_where_casadis_is_wrong():
    """The Jacobian of `flow.end` with three freed parameters against central differences."""
    model = of.chain(2)
    free = ("length1", "length2", "mass2", "gravity")
    flow, state = of.flows.build_flow(model, free=free), np.array([0.4, -0.3, 0.2, 0.5])
    p = model.parameter_values[[model.parameter_index(name) for name in free]]
    found = flow.derivatives(0.0, state, 1.0, [], p)[1].full()[:, 4:]
    steps = 1e-4 * np.eye(4)
    ends = [(flow.end(0.0, state, 1.0, [], p + h), flow.end(0.0, state, 1.0, [], p - h)) for h in steps]
    differences = np.column_stack([(up - down).full().ravel() / 2e-4 for up, down in ends])
    assert np.abs(found - differences).max() < 1e-6  # CasADi's derivative of the trial is off by 0.3


@pytest.mark.parametrize("shell", doctor.completion.params[0].type.choices)
def test_completion_scripts_belong_to_their_shell(shell):
    result = invoke("completion", shell)
    assert result.exit_code == 0 and f"_ORBITFINDER_COMPLETE={shell}_complete" in result.stdout


def test_unknown_shell_is_refused():
    assert invoke("completion", "tcsh").exit_code == 2


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_bash_accepts_the_script_and_completes_commands():
    """The script is valid bash, and the program answers the request that it makes."""
    script = invoke("completion", "bash").stdout
    subprocess.run(["bash", "-n"], input=script, text=True, check=True)
    request = {"_ORBITFINDER_COMPLETE": "bash_complete", "COMP_WORDS": "orbitfinder ver", "COMP_CWORD": "1"}
    code = "from orbitfinder.cli.group import cli; cli(prog_name='orbitfinder')"
    environment = os.environ | request
    answer = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert answer.stdout.split() == ["plain,verify"]


def commands(group=cli, path=()):
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from commands(command, (*path, name))
        yield (*path, name)


@pytest.mark.parametrize("path", list(commands()), ids=" ".join)
def test_every_command_explains_itself(path):
    """--help of each command has a sentence, help for every option and an example that starts with its name."""
    result = invoke(*path, "--help")
    command = cli
    for name in path:
        command = command.commands[name]
    assert result.exit_code == 0 and result.stdout.isprintable() is False
    assert "Example" in result.stdout and f"orbitfinder {' '.join(path)}" in result.stdout.split("Example", 1)[1]
    bare = [one.name for one in command.params if isinstance(one, click.Option) and not one.help]
    assert not bare, f"options without help: {bare}"
