"""Structures by their matrices: the equations that are meant, from arrays and files alike, and the mistakes in them."""

import json
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy import sparse
from scipy.interpolate import CubicHermiteSpline
from scipy.io import mmwrite

import orbitfinder as of
from orbitfinder.errors import InputError
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.problemfile.read import load_problem_file

ROOT = Path(__file__).parents[1]
FILE = ROOT / "problems" / "structures" / "masses-20.toml"
ROAD = {entry["id"]: entry for entry in json.loads((ROOT / "tests" / "data" / "road.json").read_text())}
ELEMENTS = {
    "tip": {"kind": "cubic", "at": "q3", "stiffness": 0.7},
    "between": {"kind": "cubic", "at": "q2", "to": "q1", "stiffness": "shared"},
    "stop": {"kind": "stop", "at": "q3", "stiffness": 50.0, "gap": 0.4, "side": -1, "smoothing": 0.01},
    "clearance": {"kind": "gap", "at": "q1", "to": "q3", "stiffness": 30.0, "gap": 0.2, "smoothing": 0.02},
    "rub": {"kind": "friction", "at": "q2", "limit": 0.3, "smoothing": 0.05},
}
FORCING = {"at": {"q1": 1.0, "q3": -0.5}, "amplitude": 0.3, "frequency": 1.2, "phase": 0.4}
STIFF = np.array([[3.0, -1.0, 0.0], [-1.0, 2.5, -1.0], [0.0, -1.0, 2.0]])
DAMP = np.array([[0.1, 0.3, 0.0], [-0.3, 0.1, 0.0], [0.0, 0.0, 0.2]])
MASSES = {"diagonal": np.diag([1.0, 2.0, 3.0]), "full": np.array([[2.0, 0.3, 0.1], [0.3, 1.5, 0.2], [0.1, 0.2, 1.0]])}


def built(**changed):
    given = {"mass": MASSES["full"], "damping": DAMP, "stiffness": STIFF, "elements": ELEMENTS, "forcing": FORCING}
    return of.structure(**{**given, "parameters": {"shared": 0.4}, **changed})


def ramp(x, w):
    return (x + np.sqrt(x**2 + w**2)) / 2


@pytest.mark.parametrize("mass", MASSES)
def test_accelerations_are_those_of_the_matrices_and_elements(mass):
    """Against the equations written down once more, at states on both sides of every corner."""
    model, random = built(mass=MASSES[mass]), np.random.default_rng(1)
    for t in (0.0, 0.7):
        q, v = random.normal(size=(2, 3))
        right = 0.3 * np.cos(1.2 * t + 0.4) * np.array([1.0, 0.0, -0.5]) - DAMP @ v - STIFF @ q
        right[2] -= 0.7 * q[2] ** 3
        spring = 0.4 * (q[1] - q[0]) ** 3
        right += spring * np.array([1.0, -1.0, 0.0])
        right[2] += 50.0 * ramp(-q[2] - 0.4, 0.01)
        hit = 30.0 * (ramp(q[0] - q[2] - 0.2, 0.02) - ramp(q[2] - q[0] - 0.2, 0.02))
        right -= hit * np.array([1.0, 0.0, -1.0])
        right[1] -= 0.3 * np.tanh(v[1] / 0.05)
        found = model.acceleration(t, q, v, model.parameter_values).full().ravel()
        assert found == pytest.approx(np.linalg.solve(MASSES[mass], right), rel=1e-12, abs=1e-12)


def test_the_energy_is_what_the_elements_pull_from():
    """M a = -dV/dq where nothing else acts, so the energy is an invariant and modes are found."""
    free = {name: one for name, one in ELEMENTS.items() if one["kind"] != "friction"}
    model = built(damping=None, forcing=None, elements=free)
    q, p = ca.SX.sym("q", 3), model.parameter_values
    slope = ca.Function("slope", [q], [ca.gradient(model.potential(q, p), q)])
    place = np.array([0.5, -0.3, -0.6])
    pulled = MASSES["full"] @ model.acceleration(0, place, [0, 0, 0], p).full().ravel()
    assert pulled == pytest.approx(-slope(place).full().ravel(), rel=1e-11)
    assert model.conservative and [one.name for one in model.invariants] == ["energy"]


def test_it_is_rebuilt_from_its_description_and_followed():
    model = built()
    again = build_model(json.loads(json.dumps(model.system)))
    point = (0.3, [0.1, 0.5, -0.6], [0.2, 0.1, 0.0])
    assert np.array_equal(*(one.acceleration(*point, one.parameter_values).full() for one in (model, again)))
    faster = with_parameters(model, {"frequency": 2.0, "shared": 0.9})
    assert faster.system["parameters"] == {"shared": 0.9, "frequency": 2.0}
    assert float(faster.forcing_period(faster.parameter_values)) == pytest.approx(np.pi)
    assert np.array_equal(build_model(faster.system).parameter_values, faster.parameter_values)


def test_the_slopes_of_large_structures_are_sparse():
    size = 1000
    rod = sparse.diags([-np.ones(size - 1), 2 * np.ones(size), -np.ones(size - 1)], offsets=[-1, 0, 1])
    model = of.structure(sparse.eye(size), 0.1 * sparse.eye(size), rod)
    q, v = (ca.SX.sym(name, size) for name in "qv")
    assert ca.jacobian(model.acceleration(0, q, v, []), q).nnz() == 3 * size - 2
    assert model.acceleration.n_instructions() < 15 * size


def test_files_hold_the_same_matrices(tmp_path):
    """Matrix Market, sparse and dense npz; a problem file finds them beside it, and its records need them no more."""
    mmwrite(tmp_path / "m.mtx", sparse.coo_array(MASSES["full"]), symmetry="symmetric", precision=17)
    np.savez(tmp_path / "c.npz", DAMP)
    sparse.save_npz(tmp_path / "k.npz", sparse.csr_array(STIFF))
    model = built(mass=tmp_path / "m.mtx", damping=str(tmp_path / "c.npz"), stiffness=tmp_path / "k.npz")
    assert model.system == built().system
    text = """
name = "three"
[system]
kind = "structure"
mass = "m.mtx"
damping = "c.npz"
stiffness = [[3.0, -1.0, 0.0], [-1.0, 2.5, -1.0], [0.0, -1.0, 2.0]]
forcing = { at = "q1", amplitude = 0.3, frequency = 1.2 }
[guess]
linear = true
"""
    (tmp_path / "three.toml").write_text(text)
    loaded = load_problem_file(tmp_path / "three.toml")
    (tmp_path / "m.mtx").unlink()
    assert build_model(loaded.model.system).state_names == ("q1", "q2", "q3", "q1dot", "q2dot", "q3dot")
    orbit = of.find_orbit(loaded.problem)  # linear: the guess is the orbit
    assert orbit.certificate.passed
    assert np.abs(orbit.state - loaded.problem.guess.state).max() < 1e-12
    for name, changed, said in (
        ("outside", text.replace("m.mtx", "../m.mtx"), "system.mass: '../m.mtx' lies outside the problem file"),
        ("gone", text, "m.mtx: no such file"),
        ("words", text.replace('"c.npz"', '"words.toml"'), "system.damping: words.toml is not a matrix"),
    ):  # fmt: skip
        (tmp_path / f"{name}.toml").write_text(changed)
        if name == "words":
            mmwrite(tmp_path / "m.mtx", sparse.coo_array(MASSES["full"]), symmetry="symmetric", precision=17)
        with pytest.raises(InputError) as error:
            load_problem_file(tmp_path / f"{name}.toml")
        assert said in str(error.value), str(error.value)


SYMMETRIC = "%%matrixmarket Matrix coordinate real symmetric\n% rows from 1\n"


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        (f"{SYMMETRIC}2 2 3\n1 1 2.0D3\n2 1 -1.0d0\n\n2 2 +2e3\n", [[2000, -1], [-1, 2000]]),  # as Fortran writes
        (f"{SYMMETRIC}2 2 3\n1 1 2\n1 2 -1\n2 2 3\n", [[2, -1], [-1, 3]]),  # the upper triangle
        (f"{SYMMETRIC}2 2 4\n1 1 2\n1 1 1\n2 1 -1\n2 2 3\n", [[3, -1], [-1, 3]]),  # not assembled
        ("%%MatrixMarket matrix array double symmetric\n2 2\n2\n-1\n3\n", [[2, -1], [-1, 3]]),
        ("%%MatrixMarket matrix array real general\n2 2\n2 0\n1\n3\n", [[2, 1], [0, 3]]),
        ("%%MatrixMarket matrix coordinate integer skew-symmetric\r\n2 2 1\r\n2 1 4\r\n", [[0, -4], [4, 0]]),
        (f"{SYMMETRIC}2 2 4\n1 1 2\n2 1 -1\n1 2 -1\n2 2 3\n", "symmetric, yet it has 1,2 and 2,1"),
        (f"{SYMMETRIC}2 2 2\n0 0 2\n1 1 3\n", "an entry lies outside 2 x 2; rows and columns count from 1"),
        (f"{SYMMETRIC}2 2 3\n1 1 2\n2 2 3\n", "it has 2 entries, not 3"),
        (f"{SYMMETRIC}2 2 1\n1 1 2,5\n", "could not convert string to float: '2,5'"),
        (f"{SYMMETRIC}2 2 1\n1 1 2 0.1\n", "a line of it is not a row, a column and a number"),
        ("%%MatrixMarket matrix coordinate pattern symmetric\n2 2 1\n1 1\n", "pattern symmetric' is not matrix"),
    ],
)
def test_other_programs_files_are_what_they_mean_or_refused(written, meant):
    """Read into the damping, which need not be symmetric; SciPy takes the first for 2 and adds the seventh up."""
    if isinstance(meant, list):
        model = of.structure(np.eye(2), written, np.eye(2))
        pulled = [model.acceleration(0, [0, 0], v, []).full().ravel() for v in np.eye(2)]
        assert np.array_equal(np.transpose(pulled), -np.array(meant))
    else:
        with pytest.raises(InputError) as error:
            of.structure(np.eye(2), written, np.eye(2))
        assert "damping: text is not a matrix (" in str(error.value) and meant in str(error.value), str(error.value)


def test_the_frequency_of_the_load_may_be_shared():
    model = built(forcing=FORCING | {"frequency": "omega"}, parameters={"shared": 0.4, "omega": 1.2})
    assert "omega" in model.parameter_names and "frequency" not in model.parameter_names
    assert float(model.forcing_period([*model.parameter_values])) == pytest.approx(2 * np.pi / 1.2)
    point = (0.3, [0.1, 0.5, -0.6], [0.2, 0.1, 0.0])
    values = [one.acceleration(*point, one.parameter_values).full() for one in (model, built())]
    assert values[0] == pytest.approx(values[1], rel=1e-14)


def element(**given):
    return {"elements": {"tip": {"kind": "cubic", "at": "q1", "stiffness": 1.0} | given}, "parameters": {}}


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"mass": np.eye(2)}, "stiffness: shape (3, 3), but mass is 2 x 2"),
        ({"mass": np.eye(3)[:2]}, "mass: shape (2, 3); a square matrix is wanted"),
        ({"mass": "missing.mtx"}, "mass: missing.mtx: no such file"),
        ({"mass": np.diag([1.0, 0.0, 1.0])}, "mass: no mass moves with q2"),
        ({"mass": np.ones((3, 3))}, "mass: not positive definite"),
        ({"mass": "%%MatrixMarket matrix coordinate real general\n3 3 1\n4 1 1.0"}, "mass: text is not a matrix ("),
        ({"stiffness": np.triu(STIFF)}, "stiffness: not symmetric: entries 1,2 and 2,1 are -1 and 0"),
        ({"stiffness": np.full((3, 3), np.nan)}, "stiffness: has entries that are not finite"),
        ({"stiffness": [["a"]]}, "stiffness: no matrix of numbers"),
        (
            {"stiffness": STIFF * (1 + 0.1j)},
            "stiffness: no matrix of numbers (complex128 entries: make damping viscous)",
        ),
        (element(kind=["cubic"]), "elements.tip.kind: unknown ['cubic'], did you mean 'cubic'?"),
        (element(kind="stop", gap=0.1, smoothing=0.1, stiffness=-1.0), "elements.tip.stiffness: must not be negative"),
        (element(stiffness="q1") | {"parameters": {"q1": 1.0}}, "names: 'q1' would name two things"),
        ({"elements": {"tip": "cubic"}}, "elements: expected names with a table, {name: ...} each"),
        ({"forcing": FORCING | {"at": ["q1", "q2"]}}, "forcing.at: ['q1', 'q2'] is no coordinate"),
        ({"forcing": FORCING | {"at": {}}}, "forcing.at: {} is no coordinate"),
        (element(kind="cubik"), "elements.tip.kind: unknown 'cubik', did you mean 'cubic'?"),
        (element(at="q9"), "elements.tip.at: 'q9' is no coordinate"),
        (element(to="q1"), "elements.tip.to: 'q1' at both ends"),
        (element(gap=1.0), "elements.tip.gap: a cubic element takes at, to, stiffness"),
        (element(stiffness=None), "elements.tip.stiffness: missing; give a number"),
        (element(stiffness="k"), "elements.tip.stiffness: 'k' is no shared parameter"),
        (element(kind="stop", gap=0.1, smoothing=0.0), "elements.tip.smoothing: must be positive, got 0.0"),
        (element(kind="stop", gap=0.1, smoothing=0.1, side=2), "elements.tip.side: must be 1 or -1, got 2"),
        ({"forcing": FORCING | {"frequency": 0.0}}, "forcing.frequency: must be positive, got 0.0"),
        ({"forcing": FORCING | {"at": "x"}}, "forcing.at: 'x' is no coordinate; there are q1, q2, q3"),
        ({"parameters": {"shared": 1.0, "shred": 1.0}}, "parameters: nothing uses 'shred'"),
        ({"names": ["a", "b"]}, "names: 2 given for 3 coordinates"),
    ],
)
def test_mistakes_are_sentences(changed, said):
    with pytest.raises(InputError) as error:
        built(**changed)
    assert said in str(error.value), str(error.value)


def test_what_rests_has_no_linear_response():
    with pytest.raises(InputError, match="guess.linear: this system is not driven"):
        of.guesses.linear_response(built(forcing=None))
    undamped = of.structure(np.eye(1), None, np.eye(1), forcing={"at": "q1", "amplitude": 1.0, "frequency": 1.0})
    with pytest.raises(InputError, match="guess.linear: harmonic 1 of the drive is in resonance"):
        of.guesses.linear_response(undamped)


@pytest.mark.slow
def test_shipped_masses_answer_as_a_harmonic_balance_says():
    """Twenty masses by shooting; the amplitude by a program outside this project, to 15 harmonics."""
    problem = load_problem_file(FILE).wanted
    orbit = of.find_orbit(problem)
    assert orbit.certificate.passed and orbit.stability == "asymptotically stable"
    (known,) = (one for one in ROAD["chain-20"]["values"] if one["w"] == 0.148)
    first = CubicHermiteSpline(orbit.times, orbit.samples[:, 0], orbit.samples[:, 20])
    swing = max(abs(first(turn)) for turn in first.derivative().roots(extrapolate=False))
    assert swing == pytest.approx(float(known["amp_x1_H15"]), abs=1e-8)
