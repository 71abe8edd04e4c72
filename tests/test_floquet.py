"""Reduction, pairing and verdicts of Floquet multipliers, on matrices whose answer is known."""

import numpy as np
import pytest

from orbitfinder.orbits.floquet import analyse, judged, reciprocal_pairs, reduce_monodromy, verdict

E = np.exp


def with_trivial_pair(inner, seed):
    """A monodromy with a Jordan block of ones around `inner`, in random coordinates; gradient, flow."""
    random = np.random.default_rng(seed)
    size = inner.shape[0] + 2
    matrix = np.zeros((size, size))
    matrix[0, 0] = matrix[1, 1] = 1.0
    matrix[0, 1:] = random.normal(size=size - 1)
    matrix[2:, 1] = random.normal(size=size - 2)
    matrix[2:, 2:] = inner
    basis = random.normal(size=(size, size)) + 2 * np.eye(size)
    inverse = np.linalg.inv(basis)
    return basis @ matrix @ inverse, inverse[1][None, :], basis[:, 0][None, :]


def block(*multipliers):
    """A real matrix with the given reciprocal or conjugate multipliers, in random coordinates."""
    size, random = len(multipliers), np.random.default_rng(len(multipliers))
    matrix, k = np.zeros((size, size)), 0
    while k < size:
        mu = complex(multipliers[k])
        if mu.imag:
            matrix[k : k + 2, k : k + 2] = [[mu.real, mu.imag], [-mu.imag, mu.real]]
            k += 2
        else:
            matrix[k, k] = mu.real
            k += 1
    basis = random.normal(size=(size, size)) + 2 * np.eye(size)
    return basis @ matrix @ np.linalg.inv(basis)


UNIT = [E(0.7j), E(-0.7j)]
QUADRUPLE = [1.5 * E(0.9j), 1.5 * E(-0.9j), E(0.9j) / 1.5, E(-0.9j) / 1.5]


def close(found, wanted, tolerance=1e-9):
    """Two multisets of complex numbers agree."""
    left = list(found)
    for mu in wanted:
        k = int(np.argmin([abs(mu - other) for other in left]))
        assert abs(left.pop(k) - mu) <= tolerance
    assert not left


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("wanted", [UNIT, [3.0, 1 / 3], [*UNIT, 200.0, 0.005], QUADRUPLE, [1.001, 1 / 1.001]])
def test_the_reduction_removes_exactly_the_trivial_pair(wanted, seed):
    """The reduced matrix has the multipliers of the inner block and no other, however close to 1 these are."""
    matrix, gradients, directions = with_trivial_pair(block(*wanted), seed)
    naive = np.linalg.eigvals(matrix)
    assert np.sum(np.abs(naive - 1) < 1e-4) == 2  # the pair is there before, smeared
    found = analyse(reduce_monodromy(matrix, gradients, directions)).multipliers
    close(found, wanted, 1e-9 * max(abs(mu) for mu in wanted) ** 2)
    assert found.size == matrix.shape[0] - 2


def test_the_reduction_does_not_depend_on_the_scale_of_gradient_and_flow():
    """Gradients of 1e6 and a flow of 1e-6 are the same directions."""
    matrix, gradients, directions = with_trivial_pair(block(*UNIT), 3)
    close(analyse(reduce_monodromy(matrix, 1e6 * gradients, 1e-6 * directions)).multipliers, UNIT)


def test_a_dissipative_system_loses_only_the_flow():
    """Without invariants only the multiplier 1 of the flow is removed."""
    matrix = np.diag([1.0, 0.5, 0.2])
    reduced = reduce_monodromy(matrix, np.zeros((0, 3)), np.array([[2.0, 0.0, 0.0]]))
    found = analyse(reduced, conservative=False)
    close(found.multipliers, [0.5, 0.2], 1e-14)
    assert found.stability == "asymptotically stable"


def test_a_system_without_other_degrees_of_freedom_has_no_multipliers():
    """One degree of freedom leaves nothing after the reduction, and the verdict is elliptic."""
    matrix, gradients, directions = with_trivial_pair(np.zeros((0, 0)), 1)
    found = analyse(reduce_monodromy(matrix, gradients, directions))
    assert found.multipliers.size == 0 and found.pair_defect == 0.0 and found.stability == "elliptic"


@pytest.mark.parametrize("multipliers", [[*UNIT, 5.0, 0.2], QUADRUPLE, [-2.0, -0.5, *UNIT], [400.0, 1 / 400, 2, 0.5]])
def test_each_multiplier_is_paired_with_its_reciprocal(multipliers):
    """Whatever the order, the pairs multiply to 1 and every multiplier is in one pair."""
    random = np.random.default_rng(0)
    for _ in range(5):
        shuffled = random.permutation(np.asarray(multipliers, complex))
        first, second = reciprocal_pairs(shuffled)
        np.testing.assert_allclose(shuffled[first] * shuffled[second], 1.0, atol=1e-12)
        assert sorted([*first, *second]) == list(range(len(multipliers)))


def test_the_pair_defect_measures_a_broken_pair():
    """A multiplier wrong by one per cent shows as a defect of one per cent."""
    found = analyse(np.diag([2.0, 0.5 * 1.01]))
    assert found.pair_defect == pytest.approx(0.01, rel=1e-9)


@pytest.mark.parametrize(
    ("multipliers", "verdict"),
    [
        (UNIT, "elliptic"),
        ([*UNIT, E(2j), E(-2j)], "elliptic"),
        ([2.0, 0.5], "unstable"),
        ([-2.0, -0.5, *UNIT], "unstable"),
        (QUADRUPLE, "unstable"),
        ([1.0, 1.0, *UNIT], "marginal"),
        ([-1.0, -1.0], "marginal"),
        ([1.001, 1 / 1.001], "unstable"),
        ([E(0.001j), E(-0.001j)], "elliptic"),
    ],
)
def test_conservative_verdicts(multipliers, verdict):
    """On the unit circle: elliptic; off it: unstable; at +1 or -1: marginal."""
    blocks = np.zeros((len(multipliers),) * 2)
    k = 0
    while k < len(multipliers):
        mu = complex(multipliers[k])
        width = 2 if mu.imag else 1
        blocks[k : k + width, k : k + width] = [[mu.real, mu.imag], [-mu.imag, mu.real]] if mu.imag else mu.real
        k += width
    assert analyse(blocks).stability == verdict


def test_an_index_within_its_error_bar_is_marginal():
    """A pair defect of 1e-3 forbids a verdict on an index 2.0005."""
    mu = 1.0226
    assert analyse(np.diag([mu, 1 / mu])).stability == "unstable"
    assert analyse(np.diag([mu, 1.001 / mu])).stability == "marginal"
    assert analyse(np.diag([mu, 1 / mu]), error=1e-4).stability == "marginal"
    told = [judged(np.array([e, 1 / e]), error=np.inf).stability for e in (E(1j), mu)]
    assert told == ["undecided", "unstable"]  # where nothing resolves the fastest


@pytest.mark.parametrize(("largest", "said"), [(0.9, "asymptotically stable"), (1.1, "unstable"), (-1.0, "marginal")])
def test_dissipative_verdicts(largest, said):
    """Without invariants the largest modulus decides."""
    assert analyse(np.diag([0.3, largest]), conservative=False).stability == said


@pytest.mark.parametrize(("largest", "error", "said"), [
    (1.5, 0.001, "unstable"), (1.5, 0.1, "marginal"), (0.7, 0.1, "marginal"), (0.2, 0.1, "asymptotically stable"),
    (1e5, 0.1, "unstable"), (1e5, 1.0, "marginal"), (0.0, 1.0, "asymptotically stable"),
])  # fmt: skip
def test_an_error_bar_decides_of_what_dissipates(largest, error, said):
    """A relative error of 0.1 leaves a factor of 20 undecided on one side of 1, and one of 4 on the other."""
    assert verdict(np.array([largest, 1e-9]), np.array([error, 1.0])) == said


def test_multipliers_come_largest_first():
    """The order is by modulus, so that the first one is the instability."""
    found = analyse(np.diag([0.5, 3.0, 2.0, 1 / 3])).multipliers
    np.testing.assert_allclose(found, [3.0, 2.0, 0.5, 1 / 3])
