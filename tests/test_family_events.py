"""Several events within one step of a family: planted symplectic maps with known indices, and real orbits."""

from collections.abc import Callable
from dataclasses import replace
from math import gcd

import casadi as ca
import numpy as np
import pytest
from maps import Map, bouncing, diagonal, halved, planted, symplectic
from scipy.linalg import expm

import orbitfinder as of
from orbitfinder.families.stability import matching
from orbitfinder.families.verified import verified
from orbitfinder.integrate.march import March
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.orbits.floquet import analyse

UNIT = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
Event = tuple[str, int, float]
"""Kind, order, place"""


def events_of(family, low: float) -> list[Event]:
    """Everything that is found, in order, each checked; what else happens where the verdict changes is not counted."""
    assert not family.unknown and all(event.check.passed for event in family.events)
    return [(one.kind, one.order, one.parameter - 1.0 + low) for one in family.events if one.kind != "stability_change"]


def named(family: Map, low: float, high: float, degrees: int = 2, system=bouncing, **options) -> list[Event]:
    """The same of one step."""
    found = planted(system(family, degrees, low), high - low, **options)
    assert len(found.points) == 2
    return events_of(found, low)


def meeting(a: ca.MX, d: ca.MX, c: float) -> ca.MX:
    """[[a, -c], [c, d]], whose eigenvalues meet where |a - d| = 2 c."""
    return ca.blockcat([[a, -c], [c, d]])


def colliding(level: float, before: float, width: float = 0.02) -> tuple[Map, float, float]:
    """Indices 2 eig A that meet at s = 0, one of which has passed a level `before` that: A(s); the place of either.

    kappa = a + d -+ sqrt((a - d)^2 - 4 c^2) with a - d falling linearly through 2 c and a, so that kappa = level
    where (a - level/2)(d - level/2) + c^2 = 0.
    """
    gap = before  # a - d - 2 c at the passage of the lower index
    apart = np.sqrt((2 * width + gap) ** 2 - 4 * width**2)
    shift = 0.5 * (level - gap + apart)
    return lambda s: meeting(shift + width - s, shift - width - 0.0 * s, width), -gap, 0.0


RESONANCES = [(q, 2 * np.cos(2 * np.pi * k / q)) for q, k in ((3, 1), (4, 1), (5, 1), (5, 2), (6, 1))]


def test_planted_maps_are_symplectic():
    """The construction has the indices it says it has."""
    matrix = ca.evalf(symplectic(meeting(0.4, -0.2, 0.1))).full()
    assert np.allclose(matrix.T @ UNIT @ matrix, UNIT)
    wanted = 2 * np.linalg.eigvals([[0.4, -0.1], [0.1, -0.2]])
    assert np.allclose(np.sort(analyse(matrix).indices.real), np.sort(wanted.real))


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize(("order", "level"), RESONANCES)
def test_resonance_and_collision_in_one_step(order, level, backwards):
    """An index passes a resonance and then leaves the real axis; or comes back to it and then passes one."""
    family, passed, met = colliding(level, 0.02)
    sign = -1.0 if backwards else 1.0
    found = named(lambda s: symplectic(family(sign * s)), -0.05, 0.05)
    assert ("resonance", order) in {one[:2] for one in found}
    places = {one[0]: one[2] for one in found if one[0] == "collision" or one[1] == order}
    assert places["resonance"] == pytest.approx(sign * passed, abs=1e-9)
    assert places["collision"] == pytest.approx(sign * met, abs=1e-9)
    assert [one[0] for one in found].count("collision") == 1


def test_period_doubling_of_the_half_map_and_collision_in_one_step():
    """The same where the index of a half map passes 0, which is a bifurcation and no mere resonance: of q'' = -K q the
    indices of the half map are -2 cos(sqrt(eig K)), which is 0 where K - (pi/2)^2 has the eigenvalue 0."""
    family, passed, _ = colliding(0.0, 0.02)
    unlike = np.diag([1.0, -1.0])

    def quadratic(s):
        return ca.diagcat(unlike @ ((np.pi / 2) ** 2 * np.eye(2) + family(s)), unlike)

    found = named(quadratic, -0.05, 0.05, system=halved)
    doubled = [one for one in found if one[0] == "period_doubling"]
    assert len(doubled) == 1 and doubled[0][2] == pytest.approx(passed, abs=1e-9)


def test_resonances_on_both_sides_of_a_strip():
    """kappa = -2 cos(sqrt(s^2 - h^2)) passes -2 cos(pi / 6), which is q = 6 of a half map, then -2, and both again, in
    one step: of the pair that turns over in between another multiplier has the Krein sign +1."""
    height = 0.3
    family = planted(halved(lambda s: diagonal(s + height, s - height), 1, -0.7), 1.4)
    found, edge, passed = events_of(family, -0.7), height, np.hypot(height, np.pi / 6)
    resonant = [one for one in found if one[1] == 6]
    assert [one[2] for one in resonant] == pytest.approx([-passed, passed], abs=1e-9)
    assert [one[2] for one in found if one[0] == "branch_point"] == pytest.approx([-edge, edge], abs=1e-9)
    first, last = family.points
    assert any(first.krein) and first.krein == tuple(-one for one in last.krein)


def test_index_beyond_two_for_less_than_a_step():
    """[[a, 1], [a^2 - 1, a]] with 2 a = 2.002 - s^2: beyond +1 and back without turning over."""

    def family(s):
        a = 1.001 - 0.5 * s * s
        return ca.blockcat([[a, 1.0], [a * a - 1.0, a]])

    found = named(family, -0.11, 0.12, 1, resonances=2)
    assert [one[0] for one in found] == ["branch_point"] * 2
    assert [one[2] for one in found] == pytest.approx([-np.sqrt(0.002), np.sqrt(0.002)], abs=1e-9)


@pytest.mark.parametrize("middle", [0.5, 0.52])
def test_collisions_around_a_short_complex_stretch(middle):
    """Real at both ends: two collisions, and the passage of kappa = 1 by each index on its own side."""
    found = named(lambda s: symplectic(meeting(middle + s, middle - s, 0.03)), -0.1, 0.11)
    assert [one[2] for one in found if one[0] == "collision"] == pytest.approx([-0.03, 0.03], abs=1e-9)
    if middle == 0.52:
        passed = np.sqrt(0.03**2 + 0.02**2)  # (a - 1/2)(d - 1/2) + c^2 = 0
        assert [one[2] for one in found if one[1] == 6] == pytest.approx([-passed, passed], abs=1e-9)


def test_collisions_around_a_short_real_stretch():
    """Complex at both ends: the indices come back to the axis, one passes q = 3, and they leave it again."""

    def family(s):
        half = 0.05 - 2 * s * s  # half of a - d; real where it is above c
        return symplectic(meeting(-0.51 + half, -0.51 - half, 0.03))

    found = named(family, -0.15, 0.16)
    assert [one[2] for one in found if one[0] == "collision"] == pytest.approx([-0.1, 0.1], abs=1e-9)
    passed = np.sqrt((0.05 - np.sqrt(0.03**2 + 0.01**2)) / 2)
    assert [one[2] for one in found if one[1] == 3] == pytest.approx([-passed, passed], abs=1e-9)


def test_events_of_different_pairs_in_one_step():
    """Three indices: two collide while the third passes a resonance and then +1."""
    pair, passed, _ = colliding(0.0, 0.02)
    # in (q1, q2, q3, p1, p2, p3)
    order = [0, 1, 4, 2, 3, 5]

    def family(s):
        a = 0.97 + 0.8 * s
        return ca.diagcat(symplectic(pair(s)), ca.blockcat([[a, 1.0], [a * a - 1.0, a]]))[order, order]

    kinds = [one for one in named(family, -0.05, 0.05, 3) if one[0] != "resonance" or one[1] == 4]
    assert [one[0] for one in kinds] == ["resonance", "collision", "branch_point"]
    assert [one[2] for one in kinds] == pytest.approx([passed, 0.0, 0.0375], abs=1e-9)


def levels(root: int, most: int):
    """(index, kind, order) where a multiplier of the root map is a root of unity: those of order up to `most`."""
    yield 2.0, "branch_point", 1
    yield (-2.0, *(("period_doubling", 2) if root == 1 else ("branch_point", 1)))
    if root == 2:
        yield 0.0, "period_doubling", 2
    for q in range(3, most + 1):
        for k in (k for k in range(1, q * root // 2 + 1) if gcd(k, q) == 1):
            yield 2 * np.cos(2 * np.pi * k / (q * root)), "resonance", q


def by_brute_force(family: Callable[[float], np.ndarray], root: int, edge: float, count: int = 2000) -> list[Event]:
    """Events between 0 and `edge` by looking everywhere: changes of the sorted real indices."""
    found: list[Event] = []
    previous: np.ndarray | None = None
    for s in np.linspace(0.0, edge, count):
        indices = analyse(family(s)).indices
        real = np.sort(indices[np.abs(indices.imag) < 1e-7 * np.maximum(1.0, np.abs(indices))].real)
        if previous is not None and real.size != previous.size:
            found.append(("collision", 1, s))
        elif previous is not None:
            for level, kind, q in levels(root, 6):
                found += [(kind, q, s)] * int(np.sum((real >= level) != (previous >= level)))
        previous = real
    return found


def exponential(matrix: ca.MX) -> ca.MX:
    """exp of a matrix of symbols of a size up to 10, by its series at a 64th of it."""
    total = np.eye(4)
    for k in range(12, 0, -1):
        total = np.eye(4) + matrix / 64 @ total / k
    for _ in range(6):
        total = total @ total
    return total


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 8))])
def test_random_families_against_brute_force(seed):
    """Nothing that a search at 2000 places sees is missing from steps of 0.1, on families of two coupled pairs."""
    random = np.random.default_rng(seed)

    def symmetric(size: float) -> np.ndarray:
        entries = random.normal(size=(4, 4)) * size
        return 0.5 * (entries + entries.T)

    first = np.diag(np.tile(random.uniform(-3, 3, 2), 2)) + symmetric(0.2)
    second, third, fourth = np.diag(np.tile(random.normal(size=2), 2)), symmetric(0.2), symmetric(0.1)
    if seed % 2:
        first, second = first + third, second + fourth
        wanted = by_brute_force(lambda s: -expm(UNIT @ (first + s * second)), 2, 1.5)
        problem = halved(lambda s: first + s * second, 2)
    else:

        def family(s, exp):
            return exp(UNIT @ (first + s * second)) @ exp(UNIT @ (third + s * fourth))

        wanted = by_brute_force(lambda s: family(s, expm), 1, 1.5)
        problem = bouncing(lambda s: family(s, exponential), 2)
    walked = planted(problem, 1.5, step=0.1)
    assert len(walked.points) <= 16
    found = events_of(walked, 0.0)
    for kind, order, place in wanted:
        near = [k for k, one in enumerate(found) if one[:2] == (kind, order) and abs(one[2] - place) < 3e-3]
        assert near, (kind, order, place)
        found.pop(near[0])
    # what is left lies beside a collision, where a search at 2000 places cannot look
    assert len(found) <= 1


def test_indices_that_come_near_at_a_resonance_and_keep_apart_pass_nothing(caplog):
    """1 -+ 0.004 where they are nearest: they part where they were heading for each other, so that they can be matched
    across each other. Nothing is even seen there that a check then has to deny."""

    def family(s):
        return symplectic(ca.blockcat([[0.5 + s, 0.002], [0.002, 0.5 - s]]), 1.0)

    assert events_of(planted(bouncing(family, 2, -0.06), 0.12, step=0.02), -0.06) == [] and not caplog.records


def test_exchanged_signatures_are_no_strip(caplog):
    """Two indices of opposite signature that pass each other have not turned over, whatever their order says."""
    family = planted(bouncing(lambda s: symplectic(diagonal(0.805 + s, 0.805 - s)), 2, -0.005), 0.01)
    first, last = family.points
    assert sorted(first.krein) == sorted(last.krein) and any(first.krein)
    assert events_of(family, -0.005) == [] and not caplog.records


def test_matching_keeps_the_order_of_indices_that_move_together():
    """Sums of distances are equal for both assignments; the one without a crossing is taken."""
    before = np.array([0.1 + 0j, 0.2 + 0j])
    for found in ([0.3 + 0j, 0.4 + 0j], [0.4 + 0j, 0.3 + 0j]):
        assert np.array_equal(np.array(found)[matching(before, np.array(found))], [0.3, 0.4])


def passing(width, sign=-1.0):
    """Two indices that pass each other at 0.62, or come as near as 2 `width` (of one signature), or collide."""

    def family(s):
        a, d = (0.3 + slope * (s - 0.62) for slope in (0.5, -0.5))
        return symplectic(ca.blockcat([[a, sign * width], [width, d]]), sign)

    return family


@pytest.mark.parametrize(("width", "collides"), [(1 / 1200, True), (0.0, False)])
def test_a_dip_between_two_orbits_is_found(width, collides):
    """Indices that exchange signatures are complex on one part in 300 of a step, or pass each other."""
    found = named(passing(width), 0.0, 1.0, resonances=2)
    met = [place for kind, _, place in found]
    assert met == (pytest.approx([0.62 - 2 * width, 0.62 + 2 * width], abs=1e-9) if collides else [])


def test_few_looks_tell_that_there_is_no_dip(monkeypatch):
    """Where signatures are exchanged nine orbits are looked at, of two marches each at most, and else none."""
    marched, varied = [], March.varied_each
    monkeypatch.setattr(March, "varied_each", lambda *given: marched.append(1) or varied(*given))
    counts = []
    for sign in (1.0, -1.0):
        marched.clear()
        assert named(passing(0.0, sign), 0.0, 1.0, resonances=2) == []
        counts.append(len(marched))
    assert 0 < counts[1] - counts[0] <= 2 * 9


def test_what_an_event_itself_refutes_is_said_of_it():
    """What is a collision in something is none, whatever the orbits about it are."""
    problem = bouncing(lambda s: symplectic(colliding(0.3, 0.02)[0](s)), 2, -0.05)
    family = planted(problem, 0.1)
    event = next(one for one in family.events if one.kind == "collision")
    for other, said in ((event, ""), (replace(event, detail="energy"), "two stability indices do not meet there")):
        checks = [one for _, one in verified(replace(family, events=(other,), ends=()), problem.model)]
        (check,) = (one for one in checks if one.name == "collision")
        assert check.passed == (not said) and said in check.note


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
    problem = of.Problem(
        oscillator(), of.Guess(np.array([0.5, 0, 0, 0, 0, 0]), 2 * np.pi), of.pin(energy=0.125), name="line"
    )
    found = []
    for step in (0.15, 0.03):
        settings = of.FamilySettings(longest_step=step, first_step=step, certify=False, directions="forward")
        family = of.follow_family(
            problem, "a", until=0.13, out=tmp_path / str(step), settings=settings, model=problem.model
        )
        found.append([(event.kind, event.detail, event.parameter) for event in family.events])
    assert [one[:2] for one in found[0]] == [one[:2] for one in found[1]]
    assert [one[2] for one in found[0]] == pytest.approx([one[2] for one in found[1]], abs=1e-8)
    assert {one[0] for one in found[0]} >= {"resonance", "collision"}
