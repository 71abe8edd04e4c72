"""Four hundred rough starts: `of.find_orbit` beside twenty lines of SciPy, from the same guesses.

Twenty shipped problems that have a vector field; of each its certified orbit, from twenty starts: every component of
the state is off by up to 3 % of its range along the orbit, the period by up to 3 %, uniformly, by `default_rng([SEED,
k])` for the k-th problem. `find_orbit` gets the problem with that guess and default settings. SciPy gets
`least_squares` on the gap of a period and the problem's pins, by DOP853 at 1e-12 with the variational equations; it
has got there where the rows are below 1e-9 of the ranges and the motion is no equilibrium. Each has a minute of
processor time.

    python benchmarks/rough_starts.py [NAME ...] [--starts N]   writes results/validation/rough_starts.md of all
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
from machine import processor, versions
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import orbitfinder as of
from orbitfinder.errors import OrbitfinderError
from orbitfinder.integrate.equations import accelerations, invariant_gradients
from orbitfinder.orbits.closure import shift

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "results" / "validation" / "rough_starts.md"
PROBLEMS = (
    "brusselator", "coupled-oscillators", "double-pendulum-fast-mode", "double-pendulum-large-swing",
    "double-well-across", "double-well-inside", "duffing", "fermi-pasta-ulam", "fitzhugh-nagumo",
    "forced-duffing-upper", "forced-pendulum-swinging", "henon-heiles-loop", "hodgkin-huxley", "lorenz", "rossler",
    "spring-pendulum-bounce", "three-body-lyapunov", "triple-pendulum-middle-mode", "unequal-double-pendulum",
    "van-der-pol",
)  # fmt: skip
SEED, STARTS, OFF, LIMIT, CLOSED, STILL = 2026, 20, 0.03, 60.0, 1e-9, 1e-3


def rough(problem: of.Problem, orbit: of.Orbit, random: np.random.Generator) -> of.Problem:
    """The problem with a guess beside its orbit."""
    ranges = np.ptp(orbit.samples, axis=0)
    state = orbit.state + OFF * ranges * random.uniform(-1, 1, ranges.size)
    period = orbit.period * (1 if problem.model.forced else 1 + OFF * random.uniform(-1, 1))
    return replace(problem, guess=of.Guess(state, period), expected={})


def by_hand(problem: of.Problem, orbit: of.Orbit) -> Callable[[], bool]:
    """SciPy's search from the problem's guess, as a function that says whether it got there."""
    model, n = problem.model, orbit.state.size
    x, t = ca.SX.sym("x", n), ca.SX.sym("t")
    rates = accelerations(model)
    columns = ca.SX.sym("columns", n, n)
    rate = rates(t, x)
    both = ca.Function("both", [t, x, columns], [rate, ca.jacobian(rate, x) @ columns])
    ranges = np.ptp(orbit.samples, axis=0)
    turned = shift(np.asarray(orbit.winding), n)
    kept, degrees = {one.name: j for j, one in enumerate(model.invariants)}, model.degrees_of_freedom
    slope = invariant_gradients(model)

    def field(at: float, y: np.ndarray) -> np.ndarray:
        one, more = both(at, y[:n], y[n:].reshape(n, n, order="F"))
        return np.concatenate([one.full().ravel(), more.full().ravel("F")])

    def rows(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        state, period = w[:n] * ranges, float(w[n]) * orbit.period
        if time.process_time() > deadline[0]:
            raise TimeoutError
        start = np.concatenate([state, np.eye(n).ravel("F")])
        solved = solve_ivp(field, (0.0, period), start, method="DOP853", rtol=1e-12, atol=1e-13)
        end, phi = solved.y[:n, -1], solved.y[n:, -1].reshape(n, n, order="F")
        flow = rates(period, end).full().ravel() * orbit.period
        found = [(end - state - turned) / ranges]
        slopes = [np.column_stack([(phi - np.eye(n)) * ranges, flow]) / ranges[:, None]]
        for one in problem.pin:
            row = np.zeros(n + 1)
            if one.name in kept:
                value = model.invariants[kept[one.name]].value(state[:degrees], state[degrees:], model.parameter_values)
                row[:n] = slope(state).full()[kept[one.name]] * ranges
                size = np.abs(row).sum()
                found.append([(float(value) - one.value) / size])
                row /= size
            elif one.name == "period":
                found.append([period / orbit.period - one.value / orbit.period])
                row[n] = 1.0
            else:
                k = model.state_names.index(one.name)
                found.append([(state[k] - one.value) / ranges[k]])
                row[k] = 1.0
            slopes.append(row[None])
        if model.forced:
            slopes[0][:, n] = 0.0  # the period is the forcing's
        else:  # across the flow of the guess
            along = across / np.linalg.norm(across)
            found.append([along @ (state - problem.guess.state) / ranges.min()])
            slopes.append(np.append(along * ranges / ranges.min(), 0.0)[None])
        return np.concatenate(found), np.vstack(slopes)

    deadline, known = [np.inf], dict[bytes, tuple[np.ndarray, np.ndarray]]()
    across = rates(0.0, problem.guess.state).full().ravel() / ranges**2

    def at(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        key = w.tobytes()
        if key not in known:
            known.clear()
            known[key] = rows(w)
        return known[key]

    def solved() -> bool:
        deadline[0] = time.process_time() + LIMIT
        first = np.append(problem.guess.state / ranges, problem.guess.period / orbit.period)
        try:
            found = least_squares(lambda w: at(w)[0], first, jac=lambda w: at(w)[1], xtol=1e-12, ftol=None, gtol=None,
                                  max_nfev=30)  # fmt: skip
        except (TimeoutError, ValueError, IndexError):
            return False
        moving = np.abs(rates(0.0, found.x[:n] * ranges).full().ravel() / ranges).max() * orbit.period
        return bool(np.abs(found.fun).max() < CLOSED and moving > STILL and found.x[n] > 0)

    return solved


def searched(problem: of.Problem) -> str:
    """What `find_orbit` says: certified, refused by what, or the first words of its error."""
    try:
        orbit = of.find_orbit(problem, of.SolveSettings(limit=LIMIT))
    except OrbitfinderError as error:
        return f"{type(error).__name__}: {error}"
    assert orbit.certificate is not None
    return "certified" if orbit.certificate.passed else "refused by " + ", ".join(orbit.certificate.failures)


def main() -> None:
    """Search, count, write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--starts", type=int, default=STARTS, help="of each problem; the page is of all")
    chosen = parser.parse_args()
    names, starts, table, missed = chosen.names, chosen.starts, list[str](), list[str]()
    sums = np.zeros(5)
    for k, name in enumerate(PROBLEMS):
        if names and name not in names:
            continue
        problem = of.load_problem(ROOT / "problems" / "gallery" / f"{name}.toml")
        orbit, random = of.find_orbit(problem), np.random.default_rng([SEED, k])
        counts = np.zeros(5)
        for start in range(starts):
            tried = rough(problem, orbit, random)
            began = time.process_time()
            said = searched(tried)
            between = time.process_time()
            there = by_hand(tried, orbit)()
            both = time.process_time() - between
            certified = said == "certified"
            counts += [certified, there, certified and there, between - began, both]
            if there and not certified:
                missed.append(f"| {name} | {start} | {said[:160]} |")
        table.append(f"| {name} | " + " | ".join(f"{one:.0f}" for one in counts[:3])
                     + f" | {counts[3] / starts:.2f} | {counts[4] / starts:.2f} |")  # fmt: skip
        print(table[-1], flush=True)
        sums += counts
    count = starts * len(table)
    table.append(f"| **all of {count}** | " + " | ".join(f"{one:.0f}" for one in sums[:3])
                 + f" | {sums[3] / count:.2f} | {sums[4] / count:.2f} |")  # fmt: skip
    print(table[-1], *missed, sep="\n")
    if not names and starts == STARTS:
        head = [
            "| problem | certified | SciPy gets there | both | find_orbit (s) | SciPy (s) |",
            "|---|---|---|---|---|---|",
        ]
        lost = ["| problem | start | what find_orbit says |", "|---|---|---|", *missed]
        said = (
            f"Written by `python benchmarks/rough_starts.py` on {processor()}; {versions()}. Seconds of the processor."
        )
        PAGE.write_text("\n".join(["# Rough starts", "", said, "", *head, *table, "",
                                   "Where SciPy gets there and `find_orbit` does not:", "", *lost, ""]))  # fmt: skip


if __name__ == "__main__":
    main()
