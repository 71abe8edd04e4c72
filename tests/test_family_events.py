"""Several events within one step of a family: planted symplectic maps with known indices, and real orbits."""

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from orbitfinder.errors import ConvergenceError
from orbitfinder.families.checks import Refuted, check_collision
from orbitfinder.families.events import bifurcations
from orbitfinder.families.folder import follow_family
from orbitfinder.families.passages import exchanged, flips, index_levels, twice
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.run import Interval, Sample
from orbitfinder.families.stability import _krein, matching
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.orbits.floquet import analyse

Family = Callable[[float], np.ndarray]
UNITS = {n: np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]]) for n in (1, 2, 3)}


@dataclass(frozen=True)
class Planted(Interval):
    """An interval of a family of symplectic maps M(s), whose orbits are read and not corrected."""

    family: Family | None = None
    start: float = 0.0

    def computed(self, distance: float) -> Sample:
        """The map at a distance, its indices matched as those of an orbit are."""
        return read(self.family, self.start + distance, self.indices(distance), distance, self.first.about.root)

    def crossed(self, sample: Sample) -> bool:
        """Maps have no equations that another family could cross."""
        return False

    strayed = crossed


def read(family: Family, s: float, expected: np.ndarray | None, distance: float, root: int) -> Sample:
    """A sample of a map: indices, and which multiplier of each has Krein sign +1."""
    matrix = family(s)
    floquet = analyse(matrix)
    indices = floquet.indices
    order = np.arange(indices.size) if expected is None else matching(expected, indices)
    upper = np.exp(1j * np.arccos(np.clip(indices.real / 2, -1, 1)))
    on_circle = (np.abs(indices.imag) < 1e-7) & (np.abs(indices.real) < 2)
    turns = np.where(on_circle, _krein(UNITS[len(matrix) // 2], *np.linalg.eig(matrix), upper), 0)
    about = SimpleNamespace(root=root, floquet=floquet, conservative=True, blur=0.0)
    return Sample(distance, None, None, about, indices[order], turns[order], {})


def one_step(family: Family, low: float, high: float, root: int = 1, trend: np.ndarray | None = None) -> Planted:
    """The interval of one step, its last indices matched to where the first ones are heading."""
    first = read(family, low, None, 0.0, root)
    last = read(family, high, first.indices + (0 if trend is None else trend), high - low, root)
    return Planted(None, first, last, np.zeros(0), np.zeros(0), family=family, start=low)


def named(interval: Planted, most: int = 6) -> list[tuple[str, int, float]]:
    """(kind, order, place) of everything that is found, in order."""
    found = bifurcations(interval, most)
    return sorted(((t.kind, t.order, interval.start + p.distance) for p, t in found), key=lambda one: one[2])


def symplectic(a: float, d: float, c: float) -> np.ndarray:
    """[[A, B], [C, A^T]] with A = [[a, -c], [c, d]], B = diag(1, -1), C = B^-1 (A^2 - 1): its indices are 2 eig A."""
    matrix, b = np.array([[a, -c], [c, d]]), np.diag([1.0, -1.0])
    return np.block([[matrix, b], [b @ (matrix @ matrix - np.eye(2)), matrix.T]])


def colliding(level: float, before: float, width: float = 0.02) -> tuple[Family, float, float]:
    """Indices that meet at s = 0, one of which has passed a level `before` that; the place of either.

    kappa = a + d -+ sqrt((a - d)^2 - 4 c^2) with a - d falling linearly through 2 c and a, so that kappa = level
    where (a - level/2)(d - level/2) + c^2 = 0.
    """

    def family(s: float, shift: float = 0.0) -> np.ndarray:
        return symplectic(shift + width - s, shift - width - 0.0 * s, width)

    gap = before  # a - d - 2 c at the passage of the lower index
    apart = np.sqrt((2 * width + gap) ** 2 - 4 * width**2)
    shift = 0.5 * (level - gap + apart)
    return lambda s: family(s, shift), -gap, 0.0


RESONANCES = [(q, 2 * np.cos(2 * np.pi * k / q)) for q, k in ((3, 1), (4, 1), (5, 1), (5, 2), (6, 1))]


def test_planted_maps_are_symplectic():
    """The construction has the indices it says it has."""
    matrix = symplectic(0.4, -0.2, 0.1)
    assert np.allclose(matrix.T @ UNITS[2] @ matrix, UNITS[2])
    wanted = 2 * np.linalg.eigvals([[0.4, -0.1], [0.1, -0.2]])
    assert np.allclose(np.sort(analyse(matrix).indices.real), np.sort(wanted.real))


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize(("order", "level"), RESONANCES)
def test_resonance_and_collision_in_one_step(order, level, backwards):
    """An index passes a resonance and then leaves the real axis; or comes back to it and then passes one."""
    family, passed, met = colliding(level, 0.02)
    sign = -1.0 if backwards else 1.0
    found = named(one_step(lambda s: family(sign * s), -0.05, 0.05))
    assert ("resonance", order) in {one[:2] for one in found}
    places = {one[0]: one[2] for one in found if one[0] == "collision" or one[1] == order}
    assert places["resonance"] == pytest.approx(sign * passed, abs=1e-9)
    assert places["collision"] == pytest.approx(sign * met, abs=1e-9)
    assert [one[0] for one in found].count("collision") == 1


def test_period_doubling_of_the_half_map_and_collision_in_one_step():
    """The same where the index of a half map passes 0, which is a bifurcation and no mere resonance."""
    family, passed, _ = colliding(0.0, 0.02)
    found = named(one_step(family, -0.05, 0.05, root=2))
    doubled = [one for one in found if one[0] == "period_doubling"]
    assert len(doubled) == 1 and doubled[0][2] == pytest.approx(passed, abs=1e-9)


def turning(height: float) -> Family:
    """Rotation by s and a stretch: multipliers that go through +1 where cos(s) cosh(height) > 1."""
    stretch = np.diag(np.exp([height, -height]))
    return lambda s: np.array([[np.cos(s), np.sin(s)], [-np.sin(s), np.cos(s)]]) @ stretch


def test_resonances_on_both_sides_of_a_strip():
    """kappa passes 2 cos(2 pi / 12), which is q = 6 of a half map, then 2, and both again, in one step."""
    family = turning(0.3)
    found = named(one_step(family, -0.7, 0.7, root=2))
    edge, passed = (np.arccos(value / np.cosh(0.3)) for value in (1.0, np.cos(np.pi / 6)))
    resonant = [one for one in found if one[1] == 6]
    assert [one[2] for one in resonant] == pytest.approx([-passed, passed], abs=1e-9)
    assert [one[2] for one in found if one[0] == "branch_point"] == pytest.approx([-edge, edge], abs=1e-9)
    interval = one_step(family, -0.7, 0.7, root=2)
    assert len(flips(interval.first, interval.last)) == 1


def test_index_beyond_two_for_less_than_a_step():
    """[[a, 1], [a^2 - 1, a]] with 2 a = 2.002 - s^2: beyond +1 and back without turning over."""

    def family(s: float) -> np.ndarray:
        a = 1.001 - 0.5 * s * s
        return np.array([[a, 1.0], [a * a - 1.0, a]])

    found = named(one_step(family, -0.11, 0.12), most=2)
    assert [one[0] for one in found] == ["branch_point"] * 2
    assert [one[2] for one in found] == pytest.approx([-np.sqrt(0.002), np.sqrt(0.002)], abs=1e-9)


def bubble(s: float) -> np.ndarray:
    """Indices 2 (s - s^2...) that pass each other through a short complex stretch |s| < c."""
    return symplectic(0.5 + s, 0.5 - s, 0.03)


def test_collisions_around_a_short_complex_stretch():
    """Real at both ends: two collisions, and the passage of kappa = 1 by each index on its own side."""
    interval = one_step(bubble, -0.1, 0.11)
    found = named(interval)
    assert [one[2] for one in found if one[0] == "collision"] == pytest.approx([-0.03, 0.03], abs=1e-9)
    moved = named(one_step(lambda s: bubble(s) if abs(s) > 1 else symplectic(0.52 + s, 0.52 - s, 0.03), -0.1, 0.11))
    passed = np.sqrt(0.03**2 + 0.02**2)  # (a - 1/2)(d - 1/2) + c^2 = 0
    assert [one[2] for one in moved if one[1] == 6] == pytest.approx([-passed, passed], abs=1e-9)


def test_collisions_around_a_short_real_stretch():
    """Complex at both ends: the indices come back to the axis, one passes q = 3, and they leave it again."""

    def family(s: float) -> np.ndarray:
        half = 0.05 - 2 * s * s  # half of a - d; real where it is above c
        return symplectic(-0.51 + half, -0.51 - half, 0.03)

    found = named(one_step(family, -0.15, 0.16))
    assert [one[2] for one in found if one[0] == "collision"] == pytest.approx([-0.1, 0.1], abs=1e-9)
    passed = np.sqrt((0.05 - np.sqrt(0.03**2 + 0.01**2)) / 2)
    assert [one[2] for one in found if one[1] == 3] == pytest.approx([-passed, passed], abs=1e-9)


def test_events_of_different_pairs_in_one_step():
    """Three indices: two collide while the third passes a resonance and then +1."""
    pair, passed, _ = colliding(0.0, 0.02)
    # in (q1, q2, q3, p1, p2, p3)
    order = [0, 1, 4, 2, 3, 5]

    def family(s: float) -> np.ndarray:
        a = 0.97 + 0.8 * s
        return block_diag(pair(s), [[a, 1.0], [a * a - 1.0, a]])[np.ix_(order, order)]

    found = named(one_step(family, -0.05, 0.05))
    kinds = [(kind, place) for kind, q, place in found if kind != "resonance" or q == 4]
    assert [one[0] for one in kinds] == ["resonance", "collision", "branch_point"]
    assert [one[1] for one in kinds] == pytest.approx([passed, 0.0, 0.0375], abs=1e-9)


def by_brute_force(family: Family, root: int, edge: float, count: int = 2000) -> list[tuple[str, int, float]]:
    """Events between 0 and `edge` by looking everywhere: changes of the sorted real indices."""
    found: list[tuple[str, int, float]] = []
    previous: np.ndarray | None = None
    for s in np.linspace(0.0, edge, count):
        indices = analyse(family(s)).indices
        real = np.sort(indices[np.abs(indices.imag) < 1e-7 * np.maximum(1.0, np.abs(indices))].real)
        if previous is not None and real.size != previous.size:
            found.append(("collision", 1, s))
        elif previous is not None:
            for level, kind, _, q, _ in index_levels(root, 6):
                found += [(kind, q, s)] * int(np.sum((real >= level) != (previous >= level)))
        previous = real
    return found


def walked(family: Family, root: int, edge: float, step: float) -> list[tuple[str, int, float]]:
    """The same by steps, each of them halved where it is refused."""
    found, stack, trend = [], [(k * step, (k + 1) * step) for k in range(round(edge / step))][::-1], None
    while stack:
        low, high = stack.pop()
        try:
            found += named(one_step(family, low, high, root, trend))
        except ConvergenceError:
            stack += [(0.5 * (low + high), high), (low, 0.5 * (low + high))]
    return found


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 8))])
def test_random_families_against_brute_force(seed):
    """Nothing that a search at 2000 places sees is missing from steps of 0.1, on families of two coupled pairs."""
    random = np.random.default_rng(seed)

    def symmetric(size: float) -> np.ndarray:
        entries = random.normal(size=(4, 4)) * size
        return 0.5 * (entries + entries.T)

    first = np.diag(np.tile(random.uniform(-3, 3, 2), 2)) + symmetric(0.2)
    second, third, fourth = np.diag(np.tile(random.normal(size=2), 2)), symmetric(0.2), symmetric(0.1)
    root = 1 + seed % 2

    def family(s: float) -> np.ndarray:
        return np.asarray(expm(UNITS[2] @ (first + s * second)) @ expm(UNITS[2] @ (third + s * fourth)))

    wanted, found = by_brute_force(family, root, 1.5), walked(family, root, 1.5, 0.1)
    for kind, order, place in wanted:
        near = [k for k, one in enumerate(found) if one[:2] == (kind, order) and abs(one[2] - place) < 3e-3]
        assert near, (kind, order, place)
        found.pop(near[0])
    # what is left lies beside a collision, where a search at 2000 places cannot look
    assert len(found) <= 1


def test_steps_on_which_indices_cannot_be_told_apart_are_refused():
    """Indices matched across each other at a resonance, though they keep apart: a shorter step is asked for.

    Half-way they are expected nearer to where they began: changed places exactly, they would be expected in one point.
    """
    interval = one_step(lambda s: symplectic(0.51 + 0.0 * s, 0.49, 0.002), 0.0, 0.1)
    last = interval.last
    crossed = 0.98 * last.indices[::-1] + 0.02 * last.indices
    swapped = Sample(0.1, None, None, last.about, crossed, np.zeros(2, int), {})
    with pytest.raises(ConvergenceError, match="cannot be told apart"):
        bifurcations(Planted(None, interval.first, swapped, np.zeros(0), np.zeros(0), family=interval.family), 6)


def test_exchanged_signatures_are_no_strip():
    """Two indices of opposite signature that pass each other have not turned over, whatever the labels say."""
    before, after = np.array([1.60 + 0j, 1.62 + 0j]), np.array([1.61 + 0j, 1.63 + 0j])
    turns = np.array([1, -1])
    assert exchanged(before, turns, after, -turns) == [(0, 1)]
    assert exchanged(before, turns, after, turns) == []


def test_matching_keeps_the_order_of_indices_that_move_together():
    """Sums of distances are equal for both assignments; the one without a crossing is taken."""
    before = np.array([0.1 + 0j, 0.2 + 0j])
    for found in ([0.3 + 0j, 0.4 + 0j], [0.4 + 0j, 0.3 + 0j]):
        assert np.array_equal(np.array(found)[matching(before, np.array(found))], [0.3, 0.4])


# ---- a real family: an oscillation in x, and two coupled pairs of multipliers beside it -------------------


def oscillator():
    """V = x^2/2 + a y^2/2 + b z^2/2 + c x^2 y z: on y = z = 0, x = A cos t, whatever a.

    Variations are coupled by c A^2 cos(2 t) / 2, so that sqrt(a) + sqrt(b) near 2 collides.
    """
    q, v, p = ca.SX.sym("q", 3), ca.SX.sym("v", 3), ca.SX.sym("p")
    b, c = (2 - 0.345) ** 2, 0.15
    potential = 0.5 * q[0] ** 2 + 0.5 * p * q[1] ** 2 + 0.5 * b * q[2] ** 2 + c * q[0] ** 2 * q[1] * q[2]
    symbols = Symbols(q, v, p, ["a"], [0.325**2])
    return lagrange(ca.dot(v, v) / 2, potential, symbols, names=["x", "y", "z"])


@pytest.mark.slow
def test_real_family_with_resonance_and_collision_in_one_step(tmp_path):
    """Long steps find what short ones do, the resonance in the same step as a collision included."""
    problem = Problem(oscillator(), Guess(np.array([0.5, 0, 0, 0, 0, 0]), 2 * np.pi), pin(energy=0.125), name="line")
    found = []
    for step in (0.15, 0.03):
        settings = FamilySettings(longest_step=step, first_step=step, certify=False, directions="forward")
        family = follow_family(
            problem, "a", until=0.13, out=tmp_path / str(step), settings=settings, model=problem.model
        )
        found.append([(event.kind, event.detail, event.parameter) for event in family.events])
    assert [one[:2] for one in found[0]] == [one[:2] for one in found[1]]
    assert [one[2] for one in found[0]] == pytest.approx([one[2] for one in found[1]], abs=1e-8)
    assert {one[0] for one in found[0]} >= {"resonance", "collision"}


@pytest.mark.parametrize(("bottom", "below"), [(-1e-5, True), (1e-12, False), (0.2, False)])
def test_a_dip_between_two_orbits_is_found_in_few_looks(bottom, below):
    """Where a smooth measure is below 0 on one part in 300 of a step, and where it only comes near."""
    seen = []

    def measure(place: float) -> float:
        seen.append(place)
        return 4 * (place - 0.62) ** 2 * (1 + 0.5 * place) + bottom

    interval = SimpleNamespace(first=0.0, length=1.0, sample=lambda distance: distance)
    place = twice(interval, measure, thorough=True)
    assert (place is not None) == below and len(set(seen)) <= 9
    assert place is None or abs(place - 0.62) < 2e-3


def test_what_an_event_itself_refutes_asks_no_orbit_beside_it():
    """What is a collision in something is none, whatever the orbits about it are."""
    with pytest.raises(Refuted, match="do not meet"):
        check_collision(None, SimpleNamespace(detail="energy", order=1))
