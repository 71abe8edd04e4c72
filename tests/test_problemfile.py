"""Problem files: what they stand for, and that the reference is written from the schema."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from orbitfinder.errors import InputError
from orbitfinder.mechanics.model import energy
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.guesses.modes import normal_mode, normal_modes
from orbitfinder.problemfile.read import load_problem, load_problem_file
from orbitfinder.problemfile.write import TEMPLATE

ROOT = Path(__file__).parents[1]
REPORT = sorted((ROOT / "problems" / "report").glob("*.toml"))


def written(folder, text, name="problem.toml"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


DOUBLE = '[system]\nkind = "chain"\nlinks = 2\n'


def test_every_entry_arrives(tmp_path):
    path = written(
        tmp_path,
        'name = "a-b_c.d"\ntitle = "T"\nsource = "S"\n'
        '[system]\nkind = "chain"\nlinks = 2\nlength = [1.0, 2]\nmass = 3\ngravity = 9.81\nformulation = "lagrange"\n'
        "[guess]\nstate = [0.1, 0.2, 0, 0]\nperiod = 2.5\n"
        '[find]\npin = { period = 2.5, theta1 = 0.1 }\nsegments = 3\ntolerance = 1e-11\nfree = ["length2"]\n'
        "winding = [0, 0]\n[search]\nperiod = [0.5, 6.0]\n[simulate]\nduration = 3.5\n"
        "[expected]\nperiod = { value = 2.5, tolerance = 1e-9 }\nenergy = { value = -1.0, tolerance = 2.0 }\n",
    )
    loaded = load_problem_file(path)
    problem = loaded.problem
    assert (problem.name, problem.title, problem.source) == ("a-b_c.d", "T", "S")
    assert problem.model.system["length"] == [1.0, 2.0] and problem.model.system["mass"] == [3.0, 3.0]
    assert {one.name: one.value for one in problem.pin} == {"period": 2.5, "theta1": 0.1}
    assert (problem.segments, problem.tolerance, problem.free, problem.winding) == (3, 1e-11, ("length2",), (0, 0))
    assert problem.expected == {"period": (2.5, 1e-9), "energy": (-1.0, 2.0)}
    assert (loaded.search, loaded.duration) == ((0.5, 6.0), 3.5)
    np.testing.assert_array_equal(loaded.start, [0.1, 0.2, 0, 0])


def test_the_name_is_the_files_own_when_left_out(tmp_path):
    path = written(tmp_path, DOUBLE + "[guess]\nmode = 1\namplitude = 0.1\n", "swing.toml")
    assert load_problem(path).name == "swing"


def test_a_search_needs_no_guess(tmp_path):
    """[guess] may be absent when there is a [search]; `load_problem` then says what is missing."""
    path = written(tmp_path, DOUBLE + "[search]\nperiod = [1.0, 3.0]\n")
    loaded = load_problem_file(path)
    assert loaded.problem is None and loaded.model.degrees_of_freedom == 2
    with pytest.raises(InputError, match="guess: missing"):
        load_problem(path)


def test_byte_order_mark_is_harmless(tmp_path):
    path = tmp_path / "bom.toml"
    path.write_bytes(b"\xef\xbb\xbf" + (DOUBLE + "[guess]\nmode = 1\namplitude = 0.1\n").encode())
    assert load_problem(path).model.degrees_of_freedom == 2


@pytest.mark.parametrize("path", REPORT, ids=lambda path: path.stem)
def test_report_files_pin_the_energy_of_the_printed_state(path):
    """The pin is the energy of the printed digits, the period guess the size of the last of them."""
    problem = load_problem(path)
    (pin,) = problem.pin
    assert pin.name == "energy"
    assert pin.value == pytest.approx(energy(problem.model, problem.guess.state), abs=1e-12)
    assert problem.guess.period == abs(problem.guess.state[-1])


def test_linear_mode_of_one_rod():
    """w^2 = m g c / (I + m c^2) = 14.7 for a uniform rod of 1 m."""
    squared, _ = normal_modes(chain(1))
    np.testing.assert_allclose(squared, [9.8 * 0.5 / (1 / 12 + 0.25)], rtol=1e-13)


def test_linear_modes_are_eigenvectors_of_the_equations_of_motion():
    """a(eps u) = -w^2 eps u + O(eps^3), by the accelerations and not by the energies; slowest first."""
    model = chain(4, length=[1.0, 0.7, 1.2, 0.4])
    squared, shapes = normal_modes(model)
    assert np.all(np.diff(squared) > 0)
    eps = 1e-5
    for k in range(4):
        pull = model.acceleration(0, eps * shapes[:, k], np.zeros(4), model.parameter_values).full().ravel()
        np.testing.assert_allclose(pull, -squared[k] * eps * shapes[:, k], rtol=1e-6, atol=1e-9)


def test_mode_guess_has_the_amplitude_asked_for():
    guess = normal_mode(chain(3), 2, 0.25)
    assert np.abs(guess.state[:3]).max() == pytest.approx(0.25)
    assert np.all(guess.state[3:] == 0)
    assert guess.period == pytest.approx(2 * np.pi / np.sqrt(normal_modes(chain(3))[0][1]))


def test_mode_without_gravity_is_refused():
    with pytest.raises(InputError, match="does not oscillate"):
        normal_mode(chain(2, gravity=0.0), 1, 0.1)


def test_mode_about_a_place_that_is_no_equilibrium_is_refused():
    with pytest.raises(InputError, match="not an equilibrium"):
        normal_mode(chain(2), 1, 0.1, equilibrium=[0.3, 0.0])


@pytest.mark.parametrize("header", ["", "t,theta1,theta2,theta1dot,theta2dot\n"])
def test_csv_guess(tmp_path, header):
    """Times start at 0 whatever the file says; the span is the period."""
    (tmp_path / "a.csv").write_text(header + "1.0,0.1,0.2,0,0\n2.0,0.3,0.1,0,0\n\n3.5,0.1,0.2,0,0\n")
    guess = load_problem(written(tmp_path, DOUBLE + '[guess]\ncsv = "a.csv"\n')).guess
    assert guess.period == 2.5
    np.testing.assert_array_equal(guess.times, [0.0, 1.0, 2.5])
    np.testing.assert_array_equal(guess.states[1], [0.3, 0.1, 0, 0])


def test_csv_from_a_symlink_that_leads_outside_is_refused(tmp_path):
    (tmp_path / "outside.csv").write_text("0,0,0,0,0\n1,0,0,0,0\n")
    folder = tmp_path / "inside"
    folder.mkdir()
    (folder / "a.csv").symlink_to(tmp_path / "outside.csv")
    with pytest.raises(InputError, match="outside"):
        load_problem(written(folder, DOUBLE + '[guess]\ncsv = "a.csv"\n'))


PYTHON = """
import orbitfinder as of
from pathlib import Path
Path(__file__).with_name("executed").touch()

def problem():
    return of.Problem(of.chain(1), of.Guess([0.5, 0.0], 1.7), pin=of.pin(theta1=0.5), name="swing")
"""


def test_python_files_are_executed_only_with_trust(tmp_path):
    path = written(tmp_path, PYTHON, "swing.py")
    with pytest.raises(InputError, match="--trust"):
        load_problem(path)
    assert not (tmp_path / "executed").exists()
    assert load_problem(path, trust=True).name == "swing"
    assert (tmp_path / "executed").exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "define a function problem"),
        ("def problem(): return 3", "returned int"),
        ("def problem(): raise RuntimeError('no luck')", "RuntimeError: no luck"),
        ("def problem(:", "SyntaxError"),
        (PYTHON.replace('"swing"', '"../swing"'), "name: must consist"),
    ],
)
def test_python_files_that_do_not_work(tmp_path, text, said):
    with pytest.raises(InputError, match=said):
        load_problem(written(tmp_path, text, "p.py"), trust=True)


def test_template_is_a_valid_problem(tmp_path):
    problem = load_problem(written(tmp_path, TEMPLATE.format(name="mine"), "mine.toml"))
    assert problem.name == "mine" and problem.pin[0].value == -43.9


def test_reference_is_up_to_date():
    """docs/problem-file.md is what the schema says, through the documented command; no row lacks its meaning."""
    made = subprocess.run(
        [sys.executable, "docs/problem_file.py"], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert (ROOT / "docs" / "problem-file.md").read_text(encoding="utf-8") == made.stdout
    assert "|  |" not in made.stdout
