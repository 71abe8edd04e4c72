"""Multipliers of any range: eigenvalues of a product of matrices, their errors, and families near the saddles."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.families.folder import follow_family
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.stability import Spectrum, asymplectic
from orbitfinder.integrate.compiled import compiling
from orbitfinder.integrate.march import March
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanisms.chain import chain
from orbitfinder.mechanisms.library import lorenz
from orbitfinder.orbits.evidence import tour
from orbitfinder.orbits.floquet import judged, symplectic_unit
from orbitfinder.orbits.guesses.modes import mode_problem
from orbitfinder.orbits.product import SPREAD, product
from orbitfinder.problemfile.read import load_problem
from orbitfinder.records.family import FamilyPoint, load_family, plain, restored

RANGE = np.array([120.0, 80.0, 40.0, 10.0, -10.0, -40.0, -80.0, -120.0])
"""Decades of the eigenvalues of the reference's chains: 8 x 8, 60 factors, 1e+-120"""


def orthogonal_chain(rng, decades=RANGE, count=60):
    """Factors Q_{k+1} D Q_k^T about random orthogonal frames, whose product has the eigenvalues 10^decades."""
    frames = [np.linalg.qr(rng.normal(size=(decades.size,) * 2))[0] for _ in range(count)]
    part = np.diag(10 ** (decades / count))
    return [after @ part @ before.T for before, after in zip(frames, [*frames[1:], frames[0]], strict=True)]


def twisted(slope, growth, shear, sway):
    """A unit circle with period 2 pi about which a transverse plane turns over once: multipliers -exp(2 pi slope),
    -exp(2 pi growth) and exp(-4 pi) exactly, of eigenvectors that a `shear` brings together; under way errors grow and
    shrink again by exp(2 sway)."""

    def field(_, at, p):
        x, y, around = at.x, at.y, 1 - at.x**2 - at.y**2
        turn = [around * x - y, x + around * y]
        v, w, mean, apart = at.u - x / 2, at.v - y / 2, (p.a + growth) / 2, (growth - p.a) / 2 + sway * x
        twist = shear * apart
        return [
            *turn,
            -w / 2 + mean * v + apart * (x * v + y * w) - twist * (x * w + w - y * v) + turn[0] / 2,
            v / 2 + mean * w + apart * (y * v - x * w) - twist * (x * v - v + y * w) + turn[1] / 2,
        ]

    return of.ode(field, ("x", "y", "u", "v"), {"a": slope})


@pytest.mark.parametrize("slope", [0.0, 1e-7])
def test_a_check_reads_multipliers_factor_by_factor(slope):
    """Multiplied out the certificate's map has lost the second, to 8e-7 once, of which a doubling was denied."""
    lap = tour(twisted(slope, 2.0, 10.0, 8.0), np.array([1.0, 0.0, 0.5, 0.0]), 2 * np.pi, np.zeros(4, int))
    exact = np.array([-np.exp(4 * np.pi), -np.exp(2 * np.pi * slope), np.exp(-4 * np.pi)])
    off = np.abs(lap.multipliers() / exact - 1.0)
    assert off.max() < 3e-8, off
    lost = np.abs(np.linalg.eigvals(lap.map())[:, None] / exact - 1.0).min(axis=0)
    assert lost.max() > 2 * off.max(), (lost, off)
    doubted = lap.multipliers(np.random.default_rng(0), 1e-13)
    assert 1e-11 < np.abs(doubted / exact - 1.0).max() < 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_known_chains_over_240_decades(seed):
    """Every eigenvalue to 1e-11, where the multiplied product is wrong by more than 200 decades."""
    factors = orthogonal_chain(np.random.default_rng(seed))
    found = product(factors)
    relative = np.abs(found.values / 10**RANGE - 1)
    assert relative.max() < 1e-11
    assert np.all(relative < 10 * found.errors(np.full(60, 1e-15))) and found.errors(np.full(60, 1e-15)).max() < 1e-8
    lost = np.abs(np.linalg.eigvals(np.linalg.multi_dot(factors[::-1]))).min()
    assert lost > 1e-40 or lost < 1e-150


@pytest.mark.needs("proof")
def test_any_product_agrees_with_two_thousand_bits():
    """Random factors, complex pairs and clusters among them, against ball arithmetic; every error is within its bar."""
    import flint

    rng, before = np.random.default_rng(3), flint.ctx.prec
    flint.ctx.prec = 2000
    try:
        for size, count, span in ((2, 7, 0), (3, 24, 30), (4, 12, 0), (5, 9, 60), (6, 34, 60), (7, 10, 5), (8, 13, 0)):
            factors = [rng.normal(size=(size, size)) * 10 ** (rng.uniform(-1, 1, size) * span / count / 3)
                       for _ in range(count)]  # fmt: skip
            total = flint.acb_mat(np.eye(size).tolist())
            for one in factors:
                total = flint.acb_mat(one.tolist()) * total
            logs = [complex(one.log().real.mid(), one.log().imag.mid()) for one in total.eig(algorithm="approx")]
            found = product(factors)
            apart = np.log(found.values.astype(complex))[:, None] - np.array(logs)[None]
            apart = np.abs(apart.real) + np.abs(np.exp(1j * apart.imag) - 1)
            assert sorted(apart.argmin(axis=1)) == list(range(size))
            assert np.all(apart.min(axis=1) < 10 * found.errors(np.full(count, 1e-15)))
            assert apart.min(axis=1).max() < 1e-8
    finally:
        flint.ctx.prec = before


def test_an_error_bar_is_what_perturbed_factors_make():
    """Factors moved by 1e-9 of their norms move each eigenvalue by at most its bar, and by a thousandth of it."""
    rng = np.random.default_rng(7)
    factors = orthogonal_chain(rng, np.array([9.0, 4.0, -4.0, -9.0]), 20)
    found = product(factors)
    bars = found.errors(np.full(20, 1e-9))
    moved = np.zeros((50, 4))
    for row in moved:
        blows = [rng.normal(size=(4, 4)) for _ in factors]
        other = [one + 1e-9 * np.linalg.norm(one, 2) * blow / np.linalg.norm(blow, 2)
                 for one, blow in zip(factors, blows, strict=True)]  # fmt: skip
        row[:] = np.abs(product(other).values / found.values - 1)
    assert np.all(moved.max(axis=0) < bars) and np.all(moved.max(axis=0) > 1e-3 * bars)


def test_eigenvectors_of_a_product_and_its_powers():
    """P v = mu v of a product that can be multiplied out, complex pairs included."""
    rng = np.random.default_rng(5)
    factors = [rng.normal(size=(5, 5)) for _ in range(6)]
    found, whole = product(factors), np.linalg.multi_dot(factors[::-1])
    np.testing.assert_allclose(whole @ found.vectors, found.vectors * found.values, atol=1e-10 * np.abs(whole).max())


def test_what_is_not_symplectic_is_measured():
    """A symplectic matrix misses by round-off, one that an error of 1e-9 was added to by about that."""
    unit, rng = symplectic_unit(2), np.random.default_rng(2)
    half = rng.normal(size=(2, 2))
    shear = np.block([[np.eye(2), half + half.T], [np.zeros((2, 2)), np.eye(2)]])
    matrix = shear @ shear.T
    assert asymplectic(matrix, unit, unit) < 1e-15
    assert 1e-11 < asymplectic(matrix + 1e-9 * np.linalg.norm(matrix) * rng.normal(size=(4, 4)), unit, unit) < 1e-8


def test_multipliers_that_resets_have_made_zero_are_not_known_relative_to_themselves():
    """One or two of them, among which there is no eigenvector for each."""
    for matrix in (np.diag([2.0, 0.0]), np.array([[2.0, 0, 0], [0, 0, 1], [0, 0, 0]])):
        values, vectors = np.linalg.eig(matrix)
        about = Spectrum(judged(values, False), 1, values, values, (), matrix, values, vectors, False)
        assert about.errors[-1] == 1.0 and np.all(np.isfinite(about.errors))


@pytest.fixture(scope="module")
def steep():
    """The fast mode of the triple pendulum, from rest to where a multiplier passes 1e12."""
    settings = FamilySettings(directions="forward", events=False, certify=False)
    return follow_family(mode_problem(chain(3), 3), until=44.0, settings=settings)


def found_anew(point):
    """The same orbit from its state alone, on a mesh of its own."""
    problem = Problem(chain(3), Guess(point.state, point.period), symmetry=point.symmetry)
    settings = FamilySettings(directions="forward", events=False, certify=False, points=1)
    with compiling("off"):
        return follow_family(problem, settings=settings).points[0]


def test_every_multiplier_of_a_family_has_an_error_up_to_1e12(steep):
    """Reciprocal pairs to 1e-6 all along, the slow way only where it is needed, and every error told."""
    assert np.abs(steep.points[-1].floquet_multipliers).max() > 1e12
    for point in steep.points:
        mu, errors = point.floquet_multipliers, point.multiplier_errors
        wide = np.abs(mu).max() ** 2 > SPREAD
        assert point.multiplier_method == ("periodic QR" if wide else "product")
        assert errors.shape == mu.shape and np.all(errors > 0) and np.all(errors < 1e-6)
        assert point.pair_defect < 1e-6
        assert np.abs(np.sort_complex(1 / mu) / np.sort_complex(mu) - 1).max() < 1e-6


def test_twice_the_steps_change_no_multiplier_beyond_its_error(steep):
    """Of the steepest orbit, whose multiplied matrix has lost its smallest multiplier altogether."""
    point = steep.points[-1]
    finer = found_anew(point)
    assert finer.mesh.size > 2 * point.mesh.size and finer.value == pytest.approx(point.value, rel=1e-13)
    change = np.abs(point.floquet_multipliers / finer.floquet_multipliers - 1)
    assert np.all(change < 3 * point.multiplier_errors) and point.multiplier_errors.max() < 1e-8
    lost = np.linalg.eigvals(tour(chain(3), point.state, point.period, np.zeros(3, int)).map())
    assert np.abs(lost).min() > 10 * np.abs(point.floquet_multipliers).min()


def test_errors_tell_of_matrices_that_are_wrong(steep, monkeypatch):
    """Matrices with errors of 1e-8 are less symplectic by that, and every error says so."""
    rng, varied = np.random.default_rng(1), March.varied_each
    right = found_anew(steep.points[-1])

    def spoilt(march, *arguments, **options):
        found = []
        for path in varied(march, *arguments, **options):
            noise = 1e-8 * np.abs(path.transitions).max(axis=(1, 2), keepdims=True)
            blow = noise * rng.normal(size=path.transitions.shape)
            found.append(replace(path, transitions=path.transitions + blow))
        return found

    monkeypatch.setattr(March, "varied_each", spoilt)
    wrong = found_anew(steep.points[-1])
    assert np.all(wrong.multiplier_errors > 1e4 * right.multiplier_errors)
    assert np.all(np.abs(wrong.floquet_multipliers / right.floquet_multipliers - 1) < wrong.multiplier_errors)


def test_errors_and_method_are_kept_and_older_points_are_read_without(steep):
    point = steep.points[-1]
    document = json.loads(json.dumps(plain(point)))
    again = restored(FamilyPoint, document)
    np.testing.assert_array_equal(again.multiplier_errors, point.multiplier_errors)
    assert again.multiplier_method == "periodic QR"
    older = restored(FamilyPoint, {k: v for k, v in document.items() if not k.startswith("multiplier_")})
    assert older.multiplier_errors.size == 0 and older.multiplier_method == ""


def test_a_contracting_loop_keeps_its_small_multiplier():
    """Of Lorenz' shortest loop the multipliers' product is exp of the field's divergence times the period."""
    guess = Guess(np.array([-13.763610682134, -19.578751942452, 27.0]), 1.5586522107162)
    settings = FamilySettings(directions="forward", events=False, points=1)
    point = follow_family(Problem(lorenz(), guess), "rho", settings=settings).points[0]
    assert point.multiplier_method == "periodic QR" and not point.indices.size
    expected = np.exp(-(10 + 1 + 8 / 3) * point.period)
    assert np.prod(point.floquet_multipliers).real == pytest.approx(expected, rel=1e-9)
    assert np.all(point.multiplier_errors < 1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("name", [f"triple-mode-{k}" for k in (1, 2, 3)] + [f"quadruple-mode-{k}" for k in (2, 3, 4)])
def test_normal_modes_up_to_their_saddles(name, tmp_path):
    """Reciprocal pairs to 1e-6 up to 1e12 and beyond, every multiplier with its error, events as they were recorded."""
    problem = load_problem(Path(__file__).parents[1] / f"problems/families/{name}.toml")
    family = follow_family(problem, "energy", out=tmp_path, settings=FamilySettings(points=600, directions="forward"))
    known = load_family(Path(__file__).parents[1] / f"results/families/{name}/family.json")
    assert family.ends[0].kind == "homoclinic"
    assert np.abs(family.points[-1].floquet_multipliers).max() > 1e15
    for point in family.points:
        assert point.multiplier_errors.shape == point.floquet_multipliers.shape
        assert point.multiplier_errors.max() < 1e-6 and point.pair_defect < 1e-6
    found = [(one.kind, one.order, one.period) for one in family.events]
    for event in known.events:  # an avoided crossing is a minimum of a distance: known to the root of what a root is
        near = 1e-5 if event.kind == "avoided_crossing" else 1e-6
        assert any(kind == event.kind and order == event.order and abs(period - event.period) < near
                   for kind, order, period in found)  # fmt: skip
