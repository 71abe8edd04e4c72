"""Linear algebra on one processor: our matrices are small, and BLAS threads spin between calls rather than help.

Measured on two processors: a mode of 100 links took 156 s of processor time on one thread and was not finished after
790 s on two; a five-bar linkage 0.48 s of wall and of processor time on one, 0.49 and 0.74 s on two.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import lru_cache

import casadi as ca
import scipy.linalg  # noqa: F401  SciPy brings a BLAS of its own beside NumPy's
import threadpoolctl


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
