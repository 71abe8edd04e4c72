"""How CasADi's functions are evaluated: on NumPy's memory, and with linear algebra on one processor.

A march of 350 steps has 17,000 results: as a DM they take 1 ms to convert, 30 times what they take to copy. Our
matrices are small, and BLAS threads spin between calls rather than help: on two processors a mode of 100 links took
156 s of processor time on one thread and was not finished after 790 s on two; a five-bar linkage 0.48 s of wall and of
processor time on one, 0.49 and 0.74 s on two.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import lru_cache

import casadi as ca
import numpy as np
import scipy.linalg  # noqa: F401  SciPy brings a BLAS of its own beside NumPy's
import threadpoolctl

from orbitfinder._runtime import limit
from orbitfinder.errors import IntegrationError


class Buffered:
    """A function of dense matrices; every input and output is the transpose of CasADi's (k x rows for k columns)."""

    def __init__(self, function: ca.Function) -> None:
        self.function = _dense(function)  # kept, or it is freed under the evaluation
        self._buffer, self._evaluate = self.function.buffer()
        self._fails = not self.function.is_a("SXFunction")
        self.inputs = [np.zeros((function.size2_in(k), function.size1_in(k))) for k in range(function.n_in())]
        self.outputs = [np.zeros((function.size2_out(k), function.size1_out(k))) for k in range(function.n_out())]
        for k, place in enumerate(self.inputs):
            self._buffer.set_arg(k, place.data)
        for k, output in enumerate(self.outputs):
            self._buffer.set_res(k, output.data)

    def __call__(self, *arguments: np.ndarray | float) -> list[np.ndarray]:
        """Outputs as new arrays; what is smaller than an input is broadcast. Raises `IntegrationError`."""
        limit.check()
        for place, given in zip(self.inputs, arguments, strict=True):
            if place.size:
                place[...] = given
        try:
            self._evaluate()
            failed = self._fails and self._buffer.ret() != 0
        except RuntimeError:
            failed = True
        if failed:
            raise IntegrationError("the equations of motion cannot be evaluated there")
        return [output.copy() for output in self.outputs]


def _dense(function: ca.Function) -> ca.Function:
    """The same function, or one around it, with dense inputs and outputs only."""
    inside = [function.sparsity_in(k) for k in range(function.n_in())]
    outside = [function.sparsity_out(k) for k in range(function.n_out())]
    if all(pattern.is_dense() for pattern in (*inside, *outside)):
        return function
    symbols = [ca.MX.sym(f"i{k}", *pattern.shape) for k, pattern in enumerate(inside)]
    arguments = [ca.project(symbol, pattern) for symbol, pattern in zip(symbols, inside, strict=True)]
    return ca.Function("dense", symbols, [ca.densify(value) for value in function.call(arguments)])


class Casadi(threadpoolctl.OpenBLASController):  # type: ignore[misc]
    """The OpenBLAS in CasADi's wheel, which MUMPS factorises IPOPT's systems with."""

    internal_api = "casadi_openblas"
    filename_prefixes = ("libcasadi-tp-openblas",)


@lru_cache(maxsize=1)
def _libraries() -> threadpoolctl.ThreadpoolController:
    """The BLAS libraries of this process, looked for once: that takes 10 ms, a limit 10 us."""
    ca.has_nlpsol("ipopt")  # loads it
    threadpoolctl.register(Casadi)
    return threadpoolctl.ThreadpoolController()


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """The BLAS of this process on one thread inside the block, or in the function that this decorates."""
    with _libraries().limit(limits=1, user_api="blas"):
        yield
