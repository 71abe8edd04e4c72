"""Figures 2, 4, 5 and 6 to 8, the triple pendulum from horizontal rest by every method; figure 10, the four-bar."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps

from orbitfinder.integrate.cvodes import IntegratorSettings, build_flow, sample, transition
from orbitfinder.integrate.idas import DaeSettings, DaeTrajectory, simulate_dae
from orbitfinder.mechanics.constrained import maximal_states, minimal_states
from orbitfinder.mechanics.model import Baumgarte, energies, positions
from orbitfinder.mechanisms.chain import chain, chain_dae
from orbitfinder.mechanisms.linkage import assemble, linkage, linkage_rates, linkage_state
from orbitfinder.records.reading import Entries
from orbitfinder.reproduce.facts import (
    FIGURE_OF_METHOD,
    FORMULATIONS,
    HOURS_FOR_100_LINKS,
    METHODS,
    SEPARATION,
    SIZES,
    TITLES,
    TOLERANCE,
)
from orbitfinder.show.animate import AnimationSettings, save_animation, simulation_clip
from orbitfinder.show.style import dress, new_figure, plane, save_both
from orbitfinder.show.svg import COLOURS

HORIZONTAL_REST = np.array([np.pi / 2] * 3 + [0.0] * 3)
ENERGY_SPAN, COMPARISON_SPAN = 10.0, 25.0
SAMPLES_PER_SECOND = 100
STABILISED = Baumgarte(alpha=20.0, beta=20.0)
IDAS_TOLERANCE = 5e-15
"""about the tightest at which IDAS still works here (2e-15 fails); at 1e-13 the energy drifts 7e-9 J in 10 s"""
LYAPUNOV_SPAN, STRETCH = 400.0, 0.05
"""s over which the exponent is averaged, and between two lengths of a tangent vector that are drawn"""


@dataclass(frozen=True)
class MethodRun:
    """Times (k), states in the angles (k x 2n), energy (k) and, for a DAE, |phi| and |phidot| (k)."""

    times: np.ndarray
    states: np.ndarray
    energy: np.ndarray
    phi: np.ndarray
    phidot: np.ndarray

    @property
    def drift(self) -> float:
        """Largest |E(t) - E(0)|, in J."""
        return float(np.abs(self.energy - self.energy[0]).max())


def simulate(method: str, span: float, baumgarte: Baumgarte | None = None) -> MethodRun:
    """The triple pendulum from horizontal rest by one method at the report's tolerance.

    "dae" is integrated natively by IDAS in maximal coordinates, the others by CVODES in the angles.
    """
    count = round(span * SAMPLES_PER_SECOND) + 1
    times = np.linspace(0.0, span, count)
    if method == "dae":
        model = chain_dae(3, baumgarte=baumgarte)
        start = maximal_states(model, HORIZONTAL_REST)
        result = simulate_dae(model, start, span, count, DaeSettings(IDAS_TOLERANCE, IDAS_TOLERANCE))
        states = minimal_states(model, result.states)
        return MethodRun(times, states, result.energy, result.constraint_drift, result.rate_drift)
    flow = build_flow(chain(3, formulation=method), settings=IntegratorSettings(TOLERANCE, TOLERANCE))
    states = sample(flow, HORIZONTAL_REST, span, count)
    kinetic, potential = energies(flow.model, states)
    return MethodRun(times, states, kinetic + potential, np.zeros(count), np.zeros(count))


def energy_part(folder: Path) -> Entries:
    """Figures 2, 4, 5: energy of the triple pendulum by each method over 10 s, its drift, the DAE's phi."""
    numbers: Entries = {"span": ENERGY_SPAN, "start": "horizontal rest"}
    runs = {method: simulate(method, ENERGY_SPAN) for method in METHODS}
    runs["dae with Baumgarte"] = simulate("dae", ENERGY_SPAN, STABILISED)
    for method, run in runs.items():
        numbers[method] = {"drift": run.drift, "phi": float(run.phi.max()), "phidot": float(run.phidot.max())}
    for method, number in FIGURE_OF_METHOD.items():
        shown = {method: runs[method]}
        if method == "dae":
            shown["dae with Baumgarte"] = runs["dae with Baumgarte"]
        title = f"Figure {number}. Triple pendulum energy, {TITLES[method]}"
        save_both(energy_figure(shown, title), folder / f"figure-{number:02d}")
    save_both(
        energy_figure({"recursive": runs["recursive"]}, "Energy by the O(n) recursion (ours)"),
        folder / "energy-recursive",
    )
    return numbers


def energy_figure(runs: dict[str, MethodRun], title: str) -> Any:
    """Kinetic, potential and total energy above, the drift of the total below."""
    figure = new_figure(6.4, 4.6, title)
    upper, lower = figure.subplots(2, 1, sharex=True)
    first = next(iter(runs.values()))
    upper.plot(first.times, first.energy, color="black", linewidth=1.5, label="total")
    upper.axhline(0.0, color="0.7", linewidth=0.6)
    kinetic, potential = energies(chain(first.states.shape[1] // 2), first.states)
    upper.plot(first.times, kinetic, color=COLOURS[0], linewidth=1.0, label="kinetic")
    upper.plot(first.times, potential, color=COLOURS[1], linewidth=1.0, linestyle="--", label="potential")
    for k, (name, run) in enumerate(runs.items()):
        lower.plot(run.times, run.energy - run.energy[0], color=COLOURS[2 + k], linewidth=0.9, label=name)
    dress(upper, "", "energy (J)")
    dress(lower, "time (s)", "E(t) \N{MINUS SIGN} E(0) (J)")
    lower.set_xlim(0, first.times[-1])
    _legend_above(upper, 3, 9)
    if len(runs) > 1:
        lower.legend(frameon=False, fontsize=9, loc="best")
    return figure


def _legend_above(axes: Any, columns: int, size: int = 8) -> None:
    """A legend over the upper left corner of a panel."""
    axes.legend(frameon=False, fontsize=size, ncols=columns, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.1)


PAIRS = (("lagrange", "newton-euler", 6), ("lagrange", "dae", 7), ("dae", "newton-euler", 8))


def difference_part(folder: Path) -> Entries:
    """Figures 6 to 8: how the methods separate over 25 s, and the Lyapunov exponent that explains it."""
    runs = {method: simulate(method, COMPARISON_SPAN) for method in ("lagrange", "newton-euler", "dae")}
    exponent = float(stretching(LYAPUNOV_SPAN, 1.0)[-1]) / LYAPUNOV_SPAN
    expected = stretching(COMPARISON_SPAN, STRETCH)
    at_first = float(expected[round(SEPARATION / STRETCH) - 1]) / SEPARATION
    numbers: Entries = {
        "span": COMPARISON_SPAN, "lyapunov": exponent, "lyapunov_span": LYAPUNOV_SPAN, "at_first": at_first,
    }  # fmt: skip
    for first, second, number in PAIRS:
        distance = np.abs(runs[first].states[:, :3] - runs[second].states[:, :3])
        times = runs[first].times
        largest = distance.max(axis=1)
        rate, _ = growth(times, largest)
        above = times[largest > 1.0]
        numbers[f"{first} - {second}"] = {
            "figure": number,
            "rate": rate,
            "largest_to_12_s": float(largest[times <= 12.0].max()),
            "first_above_1_rad": float(above[0]) if above.size else None,
        }
        title = f"Figure {number}. {TITLES[first][0].upper()}{TITLES[first][1:]} against {TITLES[second]}"
        figure = difference_figure(times, distance, expected, (at_first, exponent), title)
        save_both(figure, folder / f"figure-{number:02d}")
    return numbers


def growth(times: np.ndarray, distance: np.ndarray) -> tuple[float, float]:
    """Least-squares fit log(distance) = level + rate t while the distance is in (1e-13, 1e-1)."""
    running = np.maximum.accumulate(distance)
    fitted = (running > 1e-13) & (running < 1e-1) & (times > 0.5)
    rate, level = np.polyfit(times[fitted], np.log(running[fitted]), 1)
    return float(rate), float(level)


def stretching(span: float, interval: float) -> np.ndarray:
    """Logarithm of the length of a tangent vector after every `interval` (s) from horizontal rest.

    Over a long span it grows at the maximal Lyapunov exponent; renormalised every `interval`: G. Benettin,
    L. Galgani, A. Giorgilli, J.-M. Strelcyn, Meccanica 15 (1980) 9-20.
    """
    flow = build_flow(chain(3), settings=IntegratorSettings(1e-10, 1e-10))
    state, tangent, total, logarithms = HORIZONTAL_REST, np.ones(6) / np.sqrt(6.0), 0.0, []
    for _ in range(round(span / interval)):
        state, matrix = transition(flow, state, interval)
        tangent = matrix @ tangent
        length = float(np.linalg.norm(tangent))
        total += np.log(length)
        tangent /= length
        logarithms.append(total)
    return np.array(logarithms)


def difference_figure(
    times: np.ndarray, distance: np.ndarray, expected: np.ndarray, rates: tuple[float, float], title: str
) -> Any:
    """Absolute differences of the three angles on a log scale, and what the linearised motion makes of the first.

    `expected` is the logarithm of the growth of a small difference at equal steps up to the last of the times, `rates`
    its mean rates (1/s) up to SEPARATION and over LYAPUNOV_SPAN.
    """
    moments = np.linspace(0.0, times[-1], len(expected) + 1)[1:]
    running = np.log(np.maximum.accumulate(distance.max(axis=1))[np.searchsorted(times, moments - 1e-9)])
    small = (running < np.log(0.1)) & (moments > 0.5)
    level = float(np.median((running - expected)[small]))
    said = f"small differences grow at {rates[0]:.2f} 1/s up to {SEPARATION:g} s;\nthe mean over {LYAPUNOV_SPAN:g} s, "
    figure = new_figure(6.4, 4.2, title, f"{said}the Lyapunov exponent, is {rates[1]:.2f} 1/s")
    axes = figure.subplots()
    for i in range(distance.shape[1]):
        name = rf"$|\Delta\theta_{i + 1}|$"
        axes.semilogy(times, np.maximum(distance[:, i], 1e-17), color=COLOURS[i], linewidth=0.8, label=name)
    shown = expected + level < np.log(10.0)
    line = np.exp(level + expected[shown])
    axes.semilogy(moments[shown], line, color="black", linestyle="--", linewidth=1.2,
                  label=f"{np.exp(level):.0e} rad, linearised motion")  # fmt: skip
    axes.axvline(SEPARATION, color="0.5", linestyle=":", linewidth=1.0)
    axes.annotate(f"{SEPARATION:g} s", (SEPARATION, 2e-16), xytext=(3, 0), textcoords="offset points", fontsize=8,
                  color="0.35")  # fmt: skip
    dress(axes, "time (s)", "absolute difference (rad)")
    axes.set_ylim(1e-16, 1e2)
    axes.set_xlim(0, times[-1])
    _legend_above(axes, 4)
    return figure


SPAN, SAMPLES = 10.0, 1001


@dataclass(frozen=True)
class FourBar:
    """A linkage and the motion that shows it: bars (m), far pivot (m), start angle and rate."""

    file: str
    title: str
    length: tuple[float, float, float]
    ground: tuple[float, float]
    theta1: float
    theta1dot: float
    branch: int


FOUR_BARS = (
    FourBar("four-bar", "Three bars of 1 m", (1.0, 1.0, 1.0), (0.0, 2.0), 1.3, 0.0, 1),
    FourBar("parallelogram", "Parallelogram, rocking", (1.0, 2.0, 1.0), (0.0, 2.0), 1.0, 0.0, 1),
    FourBar("drag-link", "Drag link, full rotation", (1.0, 0.9, 1.1), (0.0, 0.5), 0.0, 9.0, 1),
)


def run(which: FourBar) -> DaeTrajectory:
    """Ten seconds of one linkage by IDAS."""
    model = linkage(which.length, ground=which.ground)
    theta = assemble(model, {"theta1": which.theta1}, branch=which.branch)
    rates = linkage_rates(model, theta, {"theta1dot": which.theta1dot})
    start = linkage_state(model, theta, rates)
    return simulate_dae(model, start, SPAN, SAMPLES, DaeSettings(IDAS_TOLERANCE, IDAS_TOLERANCE))


def four_bar_part(folder: Path) -> Entries:
    """Simulate the linkages, draw figure 10 and animate them."""
    entries = []
    for which in FOUR_BARS:
        result = run(which)
        points = positions(result.model, result.states)
        save_animation(simulation_clip(result.times, points, which.title, closed=True), folder / f"{which.file}.gif")
        turned = result.states[:, 2 : result.model.degrees_of_freedom : 3]
        extent = (turned.max(axis=0) - turned.min(axis=0)) / (2 * np.pi)
        entries.append({
            "file": which.file,
            "title": which.title,
            "span": SPAN,
            "drift": float(np.abs(result.energy - result.energy[0]).max()),
            "phi": float(result.constraint_drift.max()),
            "phidot": float(result.rate_drift.max()),
            "motion": "turns of the bars " + ", ".join(f"{value:.2f}" for value in extent),
            "largest_force": float(np.abs(result.forces).max()),
        })  # fmt: skip
        if which is FOUR_BARS[0]:
            save_both(figure_10(result, points), folder / "figure-10")
    return {"linkages": entries}


def figure_10(result: DaeTrajectory, points: np.ndarray) -> Any:
    """Energy drift, constraint errors, ground reactions and the sweep of the linkage."""
    figure = new_figure(7.2, 5.4, "Figure 10. Four-bar linkage as a native DAE")
    (drift, constraint), (force, sweep) = figure.subplots(2, 2)
    drift.plot(result.times, result.energy - result.energy[0], color=COLOURS[2], linewidth=0.9)
    dress(drift, "time (s)", "E(t) \N{MINUS SIGN} E(0) (J)")
    constraint.semilogy(
        result.times, result.constraint_drift + 1e-17, color=COLOURS[0], linewidth=0.7, label=r"$|\phi|$ (m)"
    )
    constraint.semilogy(
        result.times, result.rate_drift + 1e-17, color=COLOURS[1], linewidth=0.7, label=r"$|\dot\phi|$ (m/s)"
    )
    dress(constraint, "time (s)", "constraint error")
    _legend_above(constraint, 2)
    ground = result.forces.reshape(len(result.times), -1, 2)
    for k, (joint, label) in enumerate(((0, "left pivot"), (-1, "right pivot"))):
        size = np.linalg.norm(ground[:, joint], axis=1)
        force.plot(result.times, size, color=COLOURS[k], linestyle="-" if k == 0 else "--", linewidth=0.9, label=label)
    dress(force, "time (s)", "joint force (N)")
    _legend_above(force, 2)
    for down, across in points[: SAMPLES // 2 : 12]:
        sweep.plot(across, -down, color=COLOURS[0], alpha=0.25, linewidth=0.8)
    sweep.plot(points[0, 1], -points[0, 0], "o-", color="black", linewidth=1.6, markersize=4)
    plane(sweep)
    return figure


# --------------------------------------------------------------------------------------------------
# Chains of many links: what it costs to derive them by each formulation, and 100 links in motion.


LINKS = 100


def derivation_part(folder: Path) -> Entries:
    """Seconds and operations to derive n links by each formulation, with the exponent of growth.

    These are the only numbers of the report page that differ from run to run.
    """
    costs: Entries = {}
    for formulation in FORMULATIONS:
        seconds = {}
        operations = {}
        for count in SIZES:
            model, seconds[str(count)] = _derived(count, formulation)
            operations[str(count)] = _operations(model.acceleration)
            if seconds[str(count)] > 1.5:
                break  # one size more is some 3 times larger
        # the slope of log(time) against log(n) over n >= 30, where the fixed costs have faded
        counts, times = np.array([(float(n), seconds[n]) for n in seconds if int(n) >= 30]).reshape(-1, 2).T
        exponent = float(np.polyfit(np.log(counts), np.log(times), 1)[0]) if counts.size > 1 else np.nan
        costs[formulation] = {"seconds": seconds, "operations": operations, "exponent": exponent}
    save_both(derivation_figure(costs), folder / "derivation")
    return costs


def _derived(count: int, formulation: str) -> tuple[Any, float]:
    """A chain and the processor seconds that it takes to derive, the least of several where it is quick.

    The first time also pays for imports, caches and memory.
    """
    took = np.inf
    for _ in range(5 if count <= 30 else 1):
        began = time.process_time()
        model = chain(count, formulation=formulation)
        took = min(took, time.process_time() - began)
    return model, took


def _operations(function: Any) -> int:
    """Scalar operations of a function, those of the SX functions inside an MX one included."""
    if function.is_a("SXFunction"):
        return int(function.n_instructions())
    inner = [function.get_function(name) for name in function.get_function()]
    return sum(_operations(part) for part in inner)


def derivation_figure(costs: Entries) -> Any:
    """Time to derive against the number of links, log-log."""
    figure = new_figure(6.4, 3.8, "Time to derive n links")
    axes = figure.subplots()
    for k, (name, entry) in enumerate(costs.items()):
        counts = [*map(int, entry["seconds"])]
        label = rf"{TITLES[name]}: $n^{{{entry['exponent']:.1f}}}$"
        axes.loglog(
            counts, list(entry["seconds"].values()), "os^D"[k] + "-", color=COLOURS[k], label=label, markersize=4
        )
    told = f"the report: more than {HOURS_FOR_100_LINKS:g} h for {LINKS} links"
    axes.loglog(LINKS, HOURS_FOR_100_LINKS * 3600, "*", color="black", markersize=9)
    axes.annotate(told, (LINKS, HOURS_FOR_100_LINKS * 3600), xytext=(-8, 0), textcoords="offset points", fontsize=8,
                  ha="right", va="center")  # fmt: skip
    dress(axes, "links n", "processor time to derive (s)")
    axes.set_ylim(top=HOURS_FOR_100_LINKS * 3600 * 5)
    axes.legend(frameon=False, fontsize=9, title="growth from n = 30", title_fontsize=9)
    return figure


def hundred_part(folder: Path) -> Entries:
    """100 links from horizontal rest for 10 s: energy drift against m g l n^2 / 2, and an animation."""
    model = chain(LINKS)
    start = np.concatenate([np.full(LINKS, np.pi / 2), np.zeros(LINKS)])
    settings = IntegratorSettings(1e-11, 1e-12, max_steps=500_000)
    states = sample(build_flow(model, settings=settings), start, SPAN, 501)
    times = np.linspace(0.0, SPAN, len(states))
    kinetic, potential = energies(model, states)
    total = kinetic + potential
    scale = 9.8 * LINKS**2 / 2
    points = positions(model, states)
    drawn = AnimationSettings(pixels=320, rate=20, supersampling=2)
    clip = simulation_clip(times, points, f"{LINKS} links from horizontal rest", drawn)
    save_animation(clip, folder / "chain-100.gif", drawn)
    figure = new_figure(7.2, 3.6, f"{LINKS} links from horizontal rest")
    left, right = figure.subplots(1, 2, width_ratios=(1.1, 1.0))
    chosen = range(0, len(points), 50)
    for k in chosen:
        down, across = points[k]
        colour = colormaps["cividis"](times[k] / times[-1])
        left.plot(across, -down, color=colour, linewidth=0.9, label=f"{times[k]:.0f} s" if k % 250 == 0 else None)
    plane(left)
    left.legend(frameon=False, fontsize=8)
    right.plot(times, (total - total[0]) / scale, color=COLOURS[2], linewidth=0.9)
    dress(right, "time (s)", r"energy drift / ($m g l n^2 / 2$)")
    save_both(figure, folder / "chain-100")
    drift = float(np.abs(total - total[0]).max())
    return {"links": LINKS, "span": SPAN, "drift": drift, "scale": scale, "relative_drift": drift / scale}
