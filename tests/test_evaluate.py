"""Functions on NumPy's memory: the same numbers as through DM, broadcasting, sparse outputs, failures."""

import casadi as ca
import numpy as np
import pytest

from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.evaluate import Buffered


def example() -> ca.Function:
    x, p = ca.MX.sym("x", 3, 2), ca.MX.sym("p", 2)
    return ca.Function("example", [x, p], [ca.sin(x) * p[0], x.T @ ca.vertcat(p, 1.0), ca.diag(x[:, 0])])


def test_same_numbers_as_through_dm():
    function = example()
    x, p = np.arange(6.0).reshape(2, 3), np.array([0.3, -1.2])
    found = Buffered(function)(x, p)
    for ours, theirs in zip(found, function(x.T, p), strict=True):
        np.testing.assert_array_equal(ours, theirs.full().T)
    assert found[2].shape == (3, 3)  # sparse there, dense here


def test_results_are_copies_and_inputs_are_broadcast():
    x = ca.MX.sym("x", 3)
    many = Buffered(ca.Function("one", [x, e := ca.MX.sym("e", 0)], [2 * x, e]).map(4))
    first = many(np.array([1.0, 2.0, 3.0]), np.zeros(0))
    np.testing.assert_array_equal(first[0], np.tile([2.0, 4.0, 6.0], (4, 1)))
    many(0.0, 0.0)
    assert first[0].max() == 6.0


def test_sparse_input():
    x = ca.MX.sym("x", ca.Sparsity.lower(2))
    found = Buffered(ca.Function("one", [x], [x @ ca.DM([1.0, 1.0])]))(np.array([[1.0, 2.0], [9.0, 3.0]]))
    np.testing.assert_array_equal(found[0], [[1.0, 5.0]])  # what the pattern has no place for is not read


def test_wrong_shape_and_failure():
    one = Buffered(example())
    with pytest.raises(ValueError, match="could not broadcast"):
        one(np.zeros((3, 2)), np.zeros(2))

    class Failing(ca.Callback):
        def __init__(self) -> None:
            ca.Callback.__init__(self)
            self.construct("failing", {})

        def eval(self, arguments: list[ca.DM]) -> list[ca.DM]:
            raise RuntimeError("no")

    failing = Failing()
    with pytest.raises(IntegrationError, match="cannot be evaluated there"):
        Buffered(failing)(1.0)
