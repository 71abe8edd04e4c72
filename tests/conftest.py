"""What the tests share: the report's orbits, the reference data, a few orbits found once."""

import contextlib
import faulthandler
import gc
import json
import os
import shutil
import sqlite3
import tomllib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from _pytest.faulthandler import fault_handler_stderr_fd_key
from lending import Lender
from threadpoolctl import threadpool_limits

from orbitfinder._runtime.rooms import loaded
from orbitfinder.families.equilibrium import Equilibria
from orbitfinder.integrate.compiled import exposed
from orbitfinder.integrate.cvodes import Flow
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.model import Model, energy
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.find import find_orbit
from orbitfinder.records.certificate import Certificate
from orbitfinder.records.orbit import Orbit, save_orbit
from orbitfinder.records.registry import kinds, load_orbit

DATA = Path(__file__).parent / "data"
"""Copies of shared/reference/*.json, computed independently of this project (see their `meta`)."""


@dataclass(frozen=True)
class Printed:
    """An orbit as the report prints it, and its period refined at the energy of the printed state."""

    links: int
    state: tuple[float, ...]
    period: float

    @property
    def guessed_period(self) -> float:
        """The magnitude of the last printed component: all that the report says of the period."""
        return abs(self.state[-1])


# states: the report, figures 11 to 13; periods: shared/design.md, section 5
PRINTED = {
    "triple-1": Printed(
        3,
        (0.207821287890159, 0.230046723844060, -1.448527525250897,
         -0.323636324707770, 0.146094757260416, 1.655339043727058),
        1.65533898831464,
    ),
    "triple-2": Printed(
        3,
        (0.079855812687088, 0.518084913559499, 0.284825068342415,
         -1.489804015361900, 0.110953686219146, -2.925278615817591),
        2.92523733309107,
    ),
    "quadruple-1": Printed(
        4,
        (-0.0291117263322667, -0.016045163432762, 0.022495297315480, 0.110974733413308,
         0.370089523425431, 0.214148128979260, -0.301259983532510, -1.411248973186850),
        1.41124966707868,
    ),
    "quadruple-2": Printed(
        4,
        (-0.0054867762069077, 0.002813551901407, 0.010723510070385, -0.015650651510557,
         0.279933154790084, -0.143699045708179, -0.546710497761539, 0.798011124562596),
        0.79801111165891,
    ),
}  # fmt: skip
TWIN_PERIOD = 2.925520603566
"""The other orbit at the energy of triple-2 (issue 2)."""


def printed_problem(name: str, noise: float = 0.0, seed: int = 0) -> Problem:
    """Find a report orbit from its printed digits, each and the period off by up to `noise`, relative."""
    one, random = PRINTED[name], np.random.default_rng(seed)
    state, model = np.asarray(one.state), chain(one.links)
    factors = 1 + noise * random.uniform(-1, 1, state.size + 1)
    guess = Guess(state * factors[:-1], one.guessed_period * factors[-1])
    return Problem(model, guess, pin=pin(energy=energy(model, state)), name=name)


def reference(file: str) -> dict[str, dict]:
    """Entries of a reference file by name."""
    return {one["name"]: one for one in json.loads((DATA / file).read_text())["orbits"]}


def inside(event, value: float, known: float = 0.0) -> bool:
    """Whether a value that is `known` to so much is within the error bar of an event, which is below 1e-8 of it."""
    return abs(event.parameter - value) <= event.error + known and event.error < 1e-8 * abs(value)


def verified(equilibria: Equilibria, model: Model | None = None) -> Certificate:
    """What `orbitfinder verify` answers of equilibria: what is entered for their kind."""
    return loaded(kinds()["equilibria"].verify)(equilibria, model)


@contextlib.contextmanager
def database(path: Path) -> Iterator[sqlite3.Connection]:
    """A connection whose changes are committed and which is closed: `with sqlite3.connect(path)` leaves it open."""
    with contextlib.closing(sqlite3.connect(path)) as connection, connection:
        yield connection


def pendulum_period(amplitude: float) -> float:
    """Exact period of chain(1) in s: 4 K(sin^2(a/2)) / w0, K the complete elliptic integral."""
    from scipy.special import ellipk

    return 4 * float(ellipk(np.sin(amplitude / 2) ** 2)) / np.sqrt(9.8 * 0.5 / (1 / 3))


def dop853(flow: Flow, state, times, s=(), free=()) -> np.ndarray:
    """States at increasing times by the independent integrator, on the flow's own field."""
    from orbitfinder.integrate.dop853 import integrate
    from orbitfinder.integrate.field import vector_field

    t, x = ca.MX.sym("t"), ca.MX.sym("x", len(state))
    field = ca.Function("field", [t, x], [flow.field(t, x, ca.DM(list(s)), ca.DM(list(free)))])
    times = np.asarray(times, float)
    return integrate(vector_field(field), np.asarray(state, float), times, longest_step=float(np.ptp(times)) / 200 or 1)


EXTRAS = {
    "browser": ("selenium",),
    "cluster": ("distributed",),
    "compiler": ("ziglang",),
    "docs": ("mkdocs", "material", "mkdocstrings", "griffe", "yaml", "nbformat", "sympy", "urdf_parser_py"),
    "notebook": ("anywidget", "ipykernel", "nbclient", "nbformat"),
    "parquet": ("pyarrow",),
    "proof": ("flint",),
    "robot": ("urdf_parser_py", "mujoco", "sympy"),
    "sbml": ("libsbml",),
    "studio": ("nicegui",),
}
"""Modules that an extra brings; `@pytest.mark.needs("proof")` skips a test where one of them is missing."""


@cache
def missing(extra: str) -> bool:
    """Whether a module of an extra is not installed."""
    return not all(map(find_spec, EXTRAS[extra]))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what needs an extra that is not there: `.ci/run` runs exactly that once the extras are installed.

    Slow tests have four times as long before their traceback is written.
    """
    if item.get_closest_marker("slow") and item.config.pluginmanager.hasplugin("faulthandler"):
        seconds, stream = (
            float(item.config.getini("faulthandler_timeout")),
            item.config.stash[fault_handler_stderr_fd_key],
        )
        faulthandler.dump_traceback_later(4 * seconds, file=stream)
    for extra in [extra for mark in item.iter_markers("needs") for extra in mark.args]:
        if missing(extra):
            pytest.skip(f"needs the extra {extra}: pip install -e '.[{extra}]'")


@cache
def quick_compiler() -> str:
    """A $CC that does not optimise, "" where none is needed or known: most of a compilation, and no bit of a result.

    test_compiled.py compares the bits, and compiles as users do.
    """
    known = os.name == "posix" and "CC" not in os.environ and next(filter(shutil.which, ("cc", "gcc", "clang")), None)
    return f"sh -c 'exec {known} \"$@\" -O0' {known}" if known else ""


@pytest.fixture(scope="session", autouse=True)
def own_cache(pytestconfig, tmp_path_factory):
    """Compiled functions go to a folder of the tests, which its processes share, not to the user's cache.

    It is pytest's own where nobody else may write: what one run compiled, .ci/run's second finds.

    Commands keep the bytecode of the package, as they do unless told otherwise: each of them would compile it anew.
    Linear algebra has one thread: where as many processes as processors test, threads wait for each other, and the
    eigenvalues of a matrix of 300 rows took 0.9 s of processor time in place of 0.01.
    """
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "cache"
    kept = getattr(pytestconfig, "cache", None)
    if kept and not exposed(kept.mkdir("orbitfinder").resolve()):
        folder = kept.mkdir("orbitfinder")
    folder.mkdir(mode=0o700, exist_ok=True)
    with threadpool_limits(1, user_api="blas"), pytest.MonkeyPatch.context() as patch:
        patch.setenv("ORBITFINDER_CACHE", str(folder))
        if quick_compiler():
            patch.setenv("CC", quick_compiler())
        patch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
        patch.setattr(os, "fsync", lambda handle: None)  # for when the power fails; here it waits for the disk
        yield


BUDGET = Path(__file__).parent / "budget.toml"
"""Which tests take more than a second: those of the quick set with seconds and reason, and those that are slow."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--times FILE`: processor seconds of each test and of each shared fixture, for benchmarks/slow_tests.py."""
    parser.addoption("--times", metavar="FILE", help="write processor seconds per test and per shared fixture (JSON)")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that `budget.toml` lists as slow."""
    listed = set(tomllib.loads(BUDGET.read_text(encoding="utf-8"))["slow"])
    for item in items:
        if not listed.isdisjoint((item.nodeid, item.nodeid.partition("[")[0])):
            item.add_marker("slow")


def processor_seconds() -> float:
    """Processor time of this process and of its children that have ended."""
    return sum(os.times()[:4])


def shared_name(fixturedef) -> str:
    """What a fixture that tests share is called in the times and the budget."""
    return f"fixture: {fixturedef.baseid}::{fixturedef.argname}"


class Times:
    """Processor seconds of each test with its own fixtures, and of each fixture that tests share (`fixture: NAME`)."""

    def __init__(self) -> None:
        self.last = 0.0
        self.shared: list[tuple[str, float]] = []
        self.spent: Counter[str] = Counter()
        self.uses: dict[str, list[str]] = {}

    def pytest_collection_finish(self) -> None:
        """What was spent before any test is no test's."""
        self.last = processor_seconds()

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef, request):
        """A fixture's own time: what it needs was set up before."""
        began = processor_seconds()
        try:
            return (yield)
        finally:
            if fixturedef.scope != "function":
                self.shared.append((shared_name(fixturedef), processor_seconds() - began))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item, call):
        """Hand the time since the last phase to the process that reports."""
        report = yield
        now = processor_seconds()
        spent = [(item.nodeid, now - self.last - sum(seconds for _, seconds in self.shared)), *self.shared]
        uses = [
            shared_name(known[-1])
            for known in item._fixtureinfo.name2fixturedefs.values()
            if known[-1].scope != "function"
        ]
        report.user_properties = [*report.user_properties, ("processor seconds", spent), ("uses", uses)]
        self.last, self.shared = now, []
        return report

    def pytest_runtest_logreport(self, report) -> None:
        """Add up the phases of each test; of a fixture that several processes made, the longest."""
        properties = dict(report.user_properties)
        self.uses[report.nodeid] = properties.get("uses", [])
        for name, seconds in properties.get("processor seconds", ()):
            self.spent[name] = (
                max(self.spent[name], seconds) if name.startswith("fixture") else self.spent[name] + seconds
            )

    def pytest_sessionfinish(self, session) -> None:
        """Write them, most expensive first."""
        if not hasattr(session.config, "workerinput"):
            rows = {name: round(seconds, 3) for name, seconds in self.spent.most_common()}
            text = json.dumps({"seconds": rows, "uses": self.uses}, indent=0)
            Path(session.config.getoption("times")).write_text(text, encoding="utf-8")


def pytest_configure(config: pytest.Config) -> None:
    """Measure where it was asked for."""
    if config.getoption("times"):
        config.pluginmanager.register(Times())


def pytest_collection_finish() -> None:
    """What was collected stays: no garbage collection looks at a million objects of modules and tests again."""
    gc.freeze()


@pytest.fixture(scope="module")
def optimised():
    """The compiler that users have: for files whose marches are so long that optimising them pays."""
    with pytest.MonkeyPatch.context() as patch:
        if quick_compiler():
            patch.delenv("CC")
        yield


@pytest.fixture(scope="session")
def lend(own_cache) -> Iterator[Lender]:
    """Folders that tests read, filled once: `lend(name, make, __file__)`."""
    lender = Lender(Path(os.environ["ORBITFINDER_CACHE"]) / "lent")
    yield lender
    lender.check()


@pytest.fixture(scope="session")
def report_orbits(lend) -> dict[str, Orbit]:
    """The four report orbits, found once from the printed digits with default settings."""

    def make(folder: Path) -> None:
        for name in PRINTED:
            save_orbit(find_orbit(printed_problem(name)), folder / f"{name}.json")

    folder = lend("report", make, __file__)
    return {name: replace(load_orbit(folder / f"{name}.json"), record=None) for name in PRINTED}


@pytest.fixture(scope="session")
def pendulum_orbit(lend) -> Orbit:
    """A single pendulum swinging to 1 rad, from rest."""
    problem = Problem(chain(1), Guess([1.0, 0.0], 1.8), pin=pin(theta1=1.0), name="pendulum")
    folder = lend("pendulum", lambda folder: save_orbit(find_orbit(problem), folder / "orbit.json"), __file__)
    return replace(load_orbit(folder / "orbit.json"), record=None)
