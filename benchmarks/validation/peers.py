"""Other programs' own examples: what their demos, documentation and tests print, found again by orbitfinder.

The numbers are in tests/data/peers.json, each with repository, path and commit; AUTO's are what AUTO prints on this
machine (auto_demos.py). Models are those of problems/published and of the built-in systems.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, least_squares

from benchmarks.validation.comparison import Comparison, Section, attempted, number
from benchmarks.validation.literature import certified
from benchmarks.validation.reference_orbits import read_json
from orbitfinder.errors import OrbitfinderError
from orbitfinder.families.branches import switch_branch
from orbitfinder.families.folder import follow_family
from orbitfinder.families.point import FamilySettings
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.guesses.modes import normal_mode
from orbitfinder.problemfile.read import load_problem
from orbitfinder.records.family import Event, Family
from orbitfinder.records.orbit import Orbit
from orbitfinder.systems import lorenz, restricted_three_body

PROBLEMS = Path(__file__).parents[2] / "problems"
FILE = "peers.json"
KINDS = {
    "PD": "period_doubling",
    "BP": "branch_point",
    "LP": "fold",
    "TR": "torus",
    "ns": "torus",
    "pd": "period_doubling",
}
"""Event of ours for each label of AUTO's and BifurcationKit's"""
EXACT = 1e-12
"""Allowed against closed forms"""
SINGLE = 1e-9
"""Allowed against orbits that UPOsHam integrates with relative tolerances of 3e-10"""
PLAIN = FamilySettings(certify=False)
Rates = Callable[[float, np.ndarray], Sequence[float]]


def sections(data: Path) -> list[Section]:
    """AUTO, BifurcationKit, COCO, heyoka, CAPD, UPOsHam. Raises `InputError` when the numbers are not there."""
    found = read_json(data / FILE)
    return [auto(found["auto"]), bifurcationkit(found["bifurcationkit"]), coco(found["coco"]),
            heyoka(found["heyoka"]), capd(found["capd"]), uposham(found["uposham"])]  # fmt: skip


def published(name: str) -> dict[str, Any]:
    """What a Python file of problems/published defines."""
    return run_path(str(PROBLEMS / "published" / name))


# ---- AUTO ---------------------------------------------------------------------------------------------------


def auto(data: Mapping[str, Any]) -> Section:
    """Every label of the four demos."""
    rows: list[Comparison] = []
    for name, events in (("pen", pen), ("lor", lor), ("tor", tor), ("r3b", r3b)):
        labels, precision = data["labels"][name], data["precision"][name]
        rows += attempted(f"{name}, labels", "", partial(_labels, name, labels, precision, events))
    source = (
        f"{data['program']} ({data['repository']}): labels of the demos pen, lor, tor, r3b, with their parameter and "
        "period. Ours are the events of the same families, by shooting. Allowed: AUTO's EPSS times 1 + the value."
    )
    return Section("AUTO-07p's demos", source, tuple(rows))


def _labels(
    name: str, labels: Sequence[Mapping[str, Any]], precision: float, events: Callable[[], Iterator[Event]]
) -> list[Comparison]:
    rows, found = [], events()
    for count, label in enumerate(labels, 1):
        named = f"{name}, label {count} ({label['kind']})"
        told = {parameter: value for parameter, value in label.items() if parameter != "kind"}
        rows += attempted(named, repr(next(iter(told.values()))), partial(_label, named, told, precision, found))
    return rows


def _label(named: str, told: Mapping[str, float], precision: float, events: Iterator[Event]) -> list[Comparison]:
    event = next(events)
    return [
        number(f"{named}, {name}", repr(value), _value(event, name), precision * (1 + abs(value)))
        for name, value in told.items()
    ]


def _value(event: Event, parameter: str) -> float:
    if parameter == "energy":  # AUTO subtracts mu (1 - mu) / 2
        return float(event.parameter) - 0.063 * (1 - 0.063) / 2
    return float(event.period if parameter == "period" else event.parameter)


def event_of(family: Family, kind: str, count: int = 0) -> Event:
    """The count-th event of a kind, by AUTO's name, along the family; one that is not there is a failure of ours."""
    events = sorted(family.events, key=lambda event: abs(event.arclength))
    found = [one for one in events if one.kind == KINDS[kind] and one.detail != "period"]
    if len(found) <= count:
        raise OrbitfinderError(f"family {family.name}: {len(found)} events of kind {KINDS[kind]}, {count + 1} wanted")
    return found[count]


def pen() -> Iterator[Event]:
    """The doubling of two pendula that go round together, and where the doubled family branches."""
    problem = load_problem(PROBLEMS / "families" / "coupled-pendula.toml")
    family = follow_family(problem, "torque", until=0.17, settings=PLAIN)
    doubling = event_of(family, "PD")
    away = FamilySettings(certify=False, directions="away", longest_step=0.5, longest_stretch=0.1, resonances=1)
    branch = follow_family(switch_branch(family, doubling), settings=away, points=80)
    yield doubling
    yield from (event_of(branch, "BP", k) for k in range(2))


def lor() -> Iterator[Event]:
    """Three doublings, each from the branch of the one before."""
    problem = load_problem(PROBLEMS / "families" / "lorenz-doubling.toml")
    family = follow_family(problem, "rho", until=205.0, settings=PLAIN)
    yield (found := event_of(family, "PD"))
    for _ in range(2):
        family = follow_family(switch_branch(family, found), until=205.0, settings=PLAIN, points=30)
        yield (found := event_of(family, "PD"))


def freire() -> tuple[Family, Family]:
    """The symmetric cycles of the circuit past their fold, and the lopsided ones."""
    made = published("freire.py")
    model, problem = made["freire"](), made["problem"]()
    forward, away = (FamilySettings(certify=False, directions=one) for one in ("forward", "away"))  # type: ignore[arg-type]
    family = follow_family(problem, "nu", settings=forward, points=25, model=model)
    branch = switch_branch(family, event_of(family, "BP"), model=model)
    return family, follow_family(branch, settings=away, points=10, model=model)


def tor() -> Iterator[Event]:
    """Fold and branch point of the symmetric cycles, torus and doubling of the lopsided ones."""
    family, branch = freire()
    yield from (event_of(family, "LP"), event_of(family, "BP"))
    yield from (event_of(branch, "TR"), event_of(branch, "PD"))


def r3b() -> Iterator[Event]:
    """Where halos and axial orbits leave the planar Lyapunov family about L1 of ratio 0.063."""
    model = restricted_three_body(0.063, spatial=True)
    guess = normal_mode(model, 2, 0.02, equilibrium=[*model.landmarks["L1"]])
    problem = Problem(model, guess, symmetry="mirror", name="r3b")
    forward = FamilySettings(certify=False, directions="forward")
    family = follow_family(problem, until=-1.48, settings=forward, points=60)
    yield from (event_of(family, "BP", k) for k in range(2))


# ---- BifurcationKit -----------------------------------------------------------------------------------------


def bifurcationkit(data: Mapping[str, Any]) -> Section:
    """Lur'e's doublings, the order of bifurcations of the circuit, the torus of Steinmetz and Larter."""
    rows = [
        *attempted("Lur'e, doubling", data["lure"]["tested"][0], partial(_lure, data["lure"])),
        *attempted("circuit, branch", ", ".join(data["freire"]["branch"]), partial(_order, data["freire"])),
        *attempted("Steinmetz-Larter, k8 of the torus", data["steinmetz"]["chenciner"]["k8"], _steinmetz),
    ]
    paths = "; ".join(f"{one['path']} at {one['commit'][:7]}" for one in data.values() if isinstance(one, Mapping))
    source = (
        f"{data['repository']}: {paths}. Allowed: what its tests allow (1e-4, relative) for Lur'e's doublings and "
        "their period. Steinmetz and Larter's reaction is stiff, and found by collocation."
    )
    return Section("BifurcationKit's tests and tutorials", source, tuple(rows))


def _lure(data: Mapping[str, Any]) -> Iterator[Comparison]:
    made = published("lure.py")
    family = follow_family(made["problem"](), "alpha", until=-0.9, settings=PLAIN, model=made["lure"]())
    found = sorted((event_of(family, "PD", k) for k in range(2)), key=lambda event: -event.parameter)
    for told, event in zip(data["tested"], found, strict=True):
        yield number(
            f"Lur'e, doubling near {float(told):+.2f}", told, event.parameter, data["relative"] * abs(float(told))
        )
    for name, value in (("alpha", found[0].parameter), ("period", found[0].period)):
        told = data["shooting"][name]
        yield number(f"Lur'e, first doubling by shooting, {name}", told, value, data["relative"] * float(told))


def _order(data: Mapping[str, Any]) -> list[Comparison]:
    _, branch = freire()
    wanted = [KINDS[one] for one in data["branch"]]
    events = sorted(branch.events, key=lambda event: abs(event.arclength))
    met = [one.kind for one in events if one.kind in wanted][: len(wanted)]
    wrong = sum(one != other for one, other in zip(met, wanted, strict=False)) + len(wanted) - len(met)
    return [Comparison("circuit, first bifurcations of the branch", ", ".join(wanted), ", ".join(met), wrong, 0.0)]


def _steinmetz() -> list[Comparison]:
    orbit = find_orbit(published("steinmetz_larter.py")["problem"]())
    return [replace(certified(orbit), quantity="Steinmetz-Larter, failed checks of the certificate")]


# ---- COCO ---------------------------------------------------------------------------------------------------


def coco(data: Mapping[str, Any]) -> Section:
    """Its examples with exact answers: a forced line, an impact oscillator and where it grazes, two fields."""
    rows = [
        *(row for p in data["linode"]["p"] for row in attempted(f"linode, p = {p:g}", "", partial(_linode, p))),
        *attempted("impact, speed", "", partial(_impact, data["impact"])),
        *attempted("piecewise, radius", "", partial(_piecewise, data["piecewise"])),
    ]
    source = (
        f"{data['repository']} at {data['commit'][:7]}: linode, impact and piecewise. COCO prints no digits of them; "
        "the left column is their closed form: of linode the one in its file, of the impact oscillator the linear "
        "motion between impacts and its linear resonance (grazing, COCO's event GR), of piecewise the two separable "
        f"equations for the radius. Allowed: {EXACT:g}, and {1e-9:g} for grazing, which a root finder locates."
    )
    return Section("COCO's examples", source, tuple(rows))


def _linode(p: float) -> list[Comparison]:
    orbit = find_orbit(published("forced_linear.py")["problem"](p))
    exact = math.sqrt(2 * math.pi) / math.sqrt(p**2 - 2 * p + 2)
    return [number(f"linode, p = {p:g}, L2 norm", repr(exact), math.sqrt(orbit.action), EXACT), certified(orbit)]


def _impact(data: Mapping[str, Any]) -> list[Comparison]:
    problem = load_problem(PROBLEMS / "published" / "impact-oscillator.toml")
    orbit, (speed, phase) = find_orbit(problem), bounce(data["force"])
    family = follow_family(problem, "force", until=0.05, settings=PLAIN)
    grazing = next(one.parameter for one in family.events if one.kind == "grazing")
    return [
        number("impact, velocity after it", repr(speed), float(orbit.state[1]), EXACT),
        number("impact, phase of it", repr(phase), float(orbit.state[2]), EXACT),
        number("impact, force of grazing", data["grazing"], grazing, 1e-9),
        certified(orbit),
    ]


def bounce(force: float, damping: float = 0.1, restitution: float = 0.8) -> tuple[float, float]:
    """Velocity after the impact and phase of x'' + damping x' + x = force cos(t + phase), stop at 1, one turn later.

    Between impacts x = e^(-damping t / 2) (a cos wt + b sin wt) + (force / damping) sin(t + phase), with
    w^2 = 1 - damping^2 / 4.
    """
    size, turn, decay = force / damping, math.sqrt(1 - damping**2 / 4), math.exp(-damping * math.pi)
    c, s = math.cos(2 * math.pi * turn), math.sin(2 * math.pi * turn)

    def missed(unknown: np.ndarray) -> list[float]:
        v, phase = unknown
        a = 1 - size * math.sin(phase)
        b = (v - size * math.cos(phase) + damping / 2 * a) / turn
        place = decay * (a * c + b * s) + size * math.sin(phase)
        rate = decay * ((b * turn - damping / 2 * a) * c - (a * turn + damping / 2 * b) * s) + size * math.cos(phase)
        return [place - 1, v + restitution * rate]

    speed, phase = least_squares(missed, [-1.36, 0.076], xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    return float(speed), float(phase)


def _piecewise(data: Mapping[str, Any]) -> list[Comparison]:
    orbit, (radius, period) = (
        find_orbit(published("piecewise.py")["problem"]()),
        halves(data["al"], data["be"], data["ga"]),
    )
    return [
        number("piecewise, radius below", repr(radius), float(abs(orbit.state[1])), EXACT),
        number("piecewise, period", repr(period), orbit.period, EXACT),
        certified(orbit),
    ]


def halves(al: float, be: float, ga: float) -> tuple[float, float]:
    """Where the cycle of problems/published/piecewise.py crosses x = 0 below, and its period.

    On the right d(angle) = dr (1 + ga / (be - r)) / (al r) is half a turn, on the left r' = r (1 - r) for the time pi.
    """

    def angle(r: float) -> float:
        return ((1 + ga / be) * math.log(r) - ga / be * math.log(be - r)) / al

    def above(r: float) -> float:
        return float(brentq(lambda end: angle(end) - angle(r) - math.pi, r, be * (1 - 1e-15), xtol=1e-15))

    def back(r: float) -> float:
        return 1 / (1 + (1 / above(r) - 1) * math.exp(-math.pi)) - r

    start = float(brentq(back, 0.5, be - 0.1, xtol=1e-15))
    right = [math.log(r / (be - r)) / (al * be) for r in (start, above(start))]
    return start, math.pi + right[1] - right[0]


# ---- heyoka, CAPD, UPOsHam ----------------------------------------------------------------------------------


def heyoka(data: Mapping[str, Any]) -> Section:
    """The Lyapunov orbit that its notebook closes; heyoka's x and y are the negatives of ours, its p momenta."""
    source = (
        f"{data['repository']}, {data['path']} at {data['commit'][:7]}: state, period and multipliers as printed, of "
        "an orbit 4e-4 across. Ours at the energy of that state. Allowed: 1e-9, and half a unit of the multipliers' "
        "last digit; for the smallest also the round-off of the largest, which an eigenvalue beside it has."
    )
    return Section("heyoka's notebook", source, tuple(attempted("period", data["period"], partial(_tiny, data))))


def _tiny(data: Mapping[str, Any]) -> list[Comparison]:
    x, y, px, py = map(float, data["state"])
    model = restricted_three_body(float(data["ratio"]), spatial=True)
    state = np.array([-x, -y, 0.0, -(px + y), -(py - x), 0.0])
    problem = load_problem(PROBLEMS / "published" / "lyapunov-tiny.toml")
    orbit = find_orbit(Problem(model, Guess(state, float(data["period"])), problem.pin))
    largest, smallest = (float(size(np.abs(orbit.floquet_multipliers))) for size in (np.max, np.min))
    turning = next(mu for mu in orbit.floquet_multipliers if mu.imag > 0)
    return [
        number("period", data["period"], orbit.period, 1e-9),
        Comparison(
            "state", "17 digits", "refined", float(np.abs(orbit.state - state).max()), 1e-9, "largest component"
        ),
        number("largest multiplier", data["multipliers"][0], largest, 5e-6),
        number("smallest multiplier", data["multipliers"][1], smallest, 5e-13 + 2.0**-52 * largest),
        number("multiplier across the plane, real part", data["spatial"][0], turning.real, 5e-10),
        number("multiplier across the plane, imaginary part", data["spatial"][1], turning.imag, 5e-9),
        certified(orbit),
    ]


def capd(data: Mapping[str, Any]) -> Section:
    """Cycles that CAPD proves: three of Rossler's equations, the shortest of Lorenz's."""
    flow, section = data["rossler"], data["lorenz"]
    rows = [row for k in range(3) for row in attempted(f"Rossler, cycle {k + 1}", "", partial(_rossler, flow, k))]
    for k, cycle in enumerate(section["cycles"], 1):
        rows += attempted(f"Lorenz, cycle {k}", "", partial(_lorenz, k, cycle, section["section"]))
    source = (
        f"{data['repository']}: {flow['path']}, what the program prints; {section['path']}, the boxes in which it "
        "proves a cycle of the Lorenz equations (its count is of returns to z = 27 on one side). Shown is the middle "
        "of each enclosure. Allowed: half its width, and 4 units of round-off of ours."
    )
    return Section("CAPD's proved cycles", source, tuple(rows))


def enclosed(quantity: str, ends: Sequence[float | str], ours: float) -> Comparison:
    """A row of a number against an interval that is proved to contain it."""
    low, high = map(float, ends)
    middle = (low + high) / 2
    return number(quantity, repr(middle), ours, (high - low) / 2 + 4 * math.ulp(middle))


def _rossler(data: Mapping[str, Any], k: int) -> list[Comparison]:
    orbit = find_orbit(load_problem(PROBLEMS / "published" / f"rossler-{k + 1}.toml"))
    place = on_section(rossler_rates, orbit.state, 0, 0.0)
    return [
        enclosed(f"Rossler, cycle {k + 1}, return time", data["period"][k], orbit.period),
        enclosed(f"Rossler, cycle {k + 1}, y on x = 0", data["y"][k], place[1]),
        enclosed(f"Rossler, cycle {k + 1}, z on x = 0", data["z"][k], place[2]),
        certified(orbit),
    ]


def on_section(rates: Rates, state: np.ndarray, component: int, value: float) -> np.ndarray:
    """The point of an orbit where a component has a value near to that of `state`, by Newton's method in time."""
    for _ in range(3):
        duration = (value - state[component]) / rates(0.0, state)[component]
        state = solve_ivp(rates, (0.0, duration), state, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
    return np.asarray(state)


def rossler_rates(_: float, x: np.ndarray) -> Sequence[float]:
    """Rossler's equations at CAPD's parameters."""
    return -x[1] - x[2], x[0] + 0.2 * x[1], 0.2 + x[2] * (x[0] - 5.7)


def lorenz_rates(_: float, x: np.ndarray) -> Sequence[float]:
    """The Lorenz equations at the classical parameters."""
    return 10 * (x[1] - x[0]), x[0] * (28 - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]


def _lorenz(k: int, cycle: Sequence[float], section: float) -> list[Comparison]:
    returns, x, y = int(cycle[0]), cycle[1:3], cycle[3:5]
    start = np.array([sum(x) / 2, sum(y) / 2, section])

    def height(_: float, state: np.ndarray) -> float:
        return float(state[2] - section)

    path = solve_ivp(lorenz_rates, (0.0, 1.2 * returns), start, method="DOP853", rtol=1e-12, atol=1e-12, events=height)
    times = [time for time in path.t_events[0] if time > 0.05]
    orbit = find_orbit(Problem(lorenz(), Guess(start, float(times[2 * returns - 1])), name=f"lorenz-{k}"))
    place = on_section(lorenz_rates, orbit.state, 2, section)
    named = f"Lorenz, cycle {k} ({returns} returns)"
    return [enclosed(f"{named}, x on z = 27", x, place[0]), enclosed(f"{named}, y on z = 27", y, place[1])]


def uposham(data: Mapping[str, Any]) -> Section:
    """Unstable orbits over saddles at given energies."""
    rows: list[Comparison] = []
    over: tuple[tuple[str, str, float, dict[str, Any]], ...] = (
        ("coupled", "quartic_saddle.py", 0.0, {}),
        ("uncoupled", "quartic_saddle.py", 0.0, {"coupling": 0.0}),
        ("deleonberne", "deleon_berne.py", 1.0, {}),
    )
    for name, file, saddle, more in over:
        for one in data[name]:
            rows += attempted(name, one["row"][3], partial(_over, name, file, one["row"], saddle, more))
    source = (
        f"{data['repository']}: the last row of each file of the method of turning points, coupled and uncoupled "
        f"quartic Hamiltonian, De Leon and Berne. Allowed: {SINGLE:g}; UPOsHam integrates with tolerances of 3e-10."
    )
    return Section("UPOsHam's data", source, tuple(rows))


def _over(name: str, file: str, row: Sequence[str], saddle: float, more: Mapping[str, Any]) -> list[Comparison]:
    above, x, y, period = row
    problem = published(file)["problem"](float(above) + saddle, (float(x), float(y)), float(period), **more)
    orbit: Orbit = find_orbit(problem)
    kept = {"x": (x, 0), "y": (y, 1)}
    place = [number(f"{name} at {above}, {axis}", told, float(orbit.state[k]), SINGLE)
             for axis, (told, k) in kept.items() if float(told)]  # fmt: skip
    return [number(f"{name} at {above}, period", period, orbit.period, SINGLE), *place]
