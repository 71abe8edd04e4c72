"""Linear algebra on one processor: our matrices are small, and BLAS threads spin between calls rather than help.

Measured on two processors: a mode of 100 links took 156 s of processor time on one thread and was not finished after
790 s on two; a five-bar linkage 0.48 s of wall and of processor time on one, 0.49 and 0.74 s on two.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

NAMES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that BLAS libraries read when they are loaded"""
PROCESSORS = "ORBITFINDER_PROCESSORS"
"""Environment variable: how many processors one process may keep busy; processes of ours get one"""


@lru_cache(maxsize=1)
def _libraries() -> ThreadpoolController:
    """The BLAS libraries of this process, looked for once: that takes 10 ms, a limit 10 us."""
    import casadi
    import scipy.linalg  # noqa: F401  SciPy brings a BLAS of its own beside NumPy's
    import threadpoolctl

    class Casadi(threadpoolctl.OpenBLASController):
        """The OpenBLAS in CasADi's wheel, which MUMPS factorises IPOPT's systems with."""

        internal_api = "casadi_openblas"
        filename_prefixes = ("libcasadi-tp-openblas",)

    casadi.has_nlpsol("ipopt")  # loads it
    threadpoolctl.register(Casadi)
    return threadpoolctl.ThreadpoolController()


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """The BLAS of this process on one thread inside the block, or in the function that this decorates."""
    with _libraries().limit(limits=1, user_api="blas"):
        yield


@contextlib.contextmanager
def children_see(variables: Mapping[str, str]) -> Iterator[None]:
    """Processes started in the block have these environment variables, for as long as they live."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def children_on_one_thread() -> contextlib.AbstractContextManager[None]:
    """Processes started in the block have their BLAS on one thread each."""
    return children_see(dict.fromkeys(NAMES, "1"))
