"""Linear algebra stays on one thread while orbits are found and certified, and gets its threads back."""

import os
import subprocess
import sys
from pathlib import Path

import casadi
import numpy as np
import pytest
from conftest import pendulum_period
from threadpoolctl import threadpool_info, threadpool_limits

import orbitfinder as of
from orbitfinder._runtime.processes import NAMES, children_see
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.orbits import certify as certifying
from orbitfinder.orbits import shoot as solve


def threads() -> set[int]:
    """Of every BLAS in this process."""
    import scipy.linalg  # noqa: F401

    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


@pytest.fixture(autouse=True)
def two():
    """Two threads, whatever the machine has."""
    if not threads():
        pytest.skip("the BLAS of this NumPy is none that threadpoolctl knows")
    with threadpool_limits(2, user_api="blas"):
        assert threads() == {2}
        yield


def test_one_thread_inside_and_all_of_them_after():
    with one_thread():
        assert threads() == {1}
        with one_thread():
            assert threads() == {1}
        assert threads() == {1}
    assert threads() == {2}
    with pytest.raises(ZeroDivisionError), one_thread():
        raise ZeroDivisionError
    assert threads() == {2}


def test_searches_certificates_and_families_run_on_one_thread(monkeypatch):
    """Seen from inside the search and from inside the certificate, called by the search and by itself."""
    seen: list[tuple[str, set[int]]] = []
    for module, name in ((solve, "measure"), (certifying, "gather")):
        original = getattr(module, name)

        def watched(*arguments, original=original, name=name, **options):
            seen.append((name, threads()))
            return original(*arguments, **options)

        monkeypatch.setattr(module, name, watched)
    orbit = of.find_orbit(of.Problem(of.chain(1), of.Guess([1.0, 0.0], pendulum_period(1.0)), of.pin(theta1=1.0)))
    assert of.certify(orbit).passed
    assert seen == [("measure", {1}), ("gather", {1}), ("gather", {1})]
    of.follow_family(orbit, points=2, progress=lambda batch: seen.append(("family", threads())))
    assert ("family", {1}) in seen and all(at == {1} for _, at in seen)
    assert threads() == {2}


def test_the_blas_of_ipopt_is_limited_too():
    """CasADi's wheel brings a third OpenBLAS, under a name that threadpoolctl does not know by itself."""
    with one_thread():
        found = {one["internal_api"]: one["num_threads"] for one in threadpool_info()}
    path = Path(casadi.__file__).parent
    if not list(path.glob("libcasadi-tp-openblas.so*")):
        pytest.skip("this CasADi is not a Linux wheel")
    assert found["casadi_openblas"] == 1


def test_environment_of_children_is_put_back(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    code = "import numpy, threadpoolctl; print(*{one['num_threads'] for one in threadpoolctl.threadpool_info()})"
    with children_see(dict.fromkeys(NAMES, "1")):
        assert {os.environ[name] for name in NAMES} == {"1"}
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert os.environ["OMP_NUM_THREADS"] == "7" and "OPENBLAS_NUM_THREADS" not in os.environ
    assert done.stdout.strip() == "1"


def test_numbers_do_not_depend_on_it():
    matrix = np.random.default_rng(0).normal(0, 1, (300, 300))
    free = matrix @ matrix
    with one_thread():
        assert np.abs(matrix @ matrix - free).max() <= 1e-11
