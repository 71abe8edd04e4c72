"""Figures 11 to 13: the printed orbits as printed, refined, certified, drawn and animated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from orbitfinder.integrate.cvodes import build_flow
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.model import Model, energy, positions
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.closure import gap
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.measure import dense
from orbitfinder.records.orbit import Orbit, save_orbit
from orbitfinder.reproduce.facts import ORBITS, PrintedOrbit
from orbitfinder.show.animate import orbit_clip, save_animation
from orbitfinder.show.style import arrows, dress, line_style, new_figure, plane, save_both, sweep, trail, widen
from orbitfinder.show.svg import COLOURS


def refine(printed: PrintedOrbit) -> Orbit:
    """The certified orbit at the energy of the printed state, named as in the report."""
    model = chain(printed.links)
    level = energy(model, np.asarray(printed.state))
    problem = Problem(
        model,
        Guess(np.asarray(printed.state), printed.period_guess),
        pin=pin(energy=level),
        name=printed.name,
        title=printed.title,
        source=f"report, figure {printed.figure}",
    )
    orbit = find_orbit(problem)
    lasting = {key: value for key, value in orbit.provenance.items() if key != "wall_time"}
    return replace(orbit, provenance=lasting)  # a run's duration would differ at every regeneration


def printed_closure(printed: PrintedOrbit) -> tuple[float, float]:
    """Least |x(T) - x(0)| (2-norm) of the printed digits over T near the guess, and that T."""
    state, guess = np.asarray(printed.state), printed.period_guess
    flow = build_flow(chain(printed.links))

    def miss(period: float) -> float:
        ends = dense(flow, state[None], period)[1]
        return float(np.linalg.norm(ends[-1] - ends[0]))

    best = minimize_scalar(miss, bracket=(guess - 1e-3, guess + 1e-3), tol=1e-10)
    return float(best.fun), float(best.x)


def orbit_part(folder: Path) -> dict[str, Any]:
    """Refine and certify the four orbits; write orbit.json, figures 11 to 13 and a GIF each."""
    numbers = {}
    orbits = []
    for printed in ORBITS:
        orbit = refine(printed)
        assert orbit.certificate is not None
        closest, moment = printed_closure(printed)
        save_orbit(orbit, folder / "orbits" / printed.name / "orbit.json")
        save_animation(orbit_clip(orbit), folder / f"{printed.name}.gif")
        numbers[printed.name] = {
            "figure": printed.figure,
            "last_component": printed.period_guess,
            "printed_closure": closest,
            "printed_period": moment,
            "period": orbit.period,
            "energy": orbit.energy,
            "closure": orbit.closure,
            "stability": orbit.stability,
            "symmetry": orbit.symmetry,
            "largest_multiplier": float(np.abs(orbit.floquet_multipliers).max(initial=1.0)),
            "pair_defect": orbit.pair_defect,
            "certified": orbit.certificate.passed,
            "shift": float(np.abs(orbit.state - np.asarray(printed.state)).max()),
        }
        orbits.append(orbit)
    save_both(orbit_figure(orbits[:1], "Figure 11. Triple pendulum periodic solution"), folder / "figure-11")
    save_both(orbit_figure(orbits[1:2], "Figure 12. Triple pendulum like a single pendulum"), folder / "figure-12")
    save_both(orbit_figure(orbits[2:], "Figure 13. Quadruple pendulum modes"), folder / "figure-13")
    return numbers


def orbit_figure(orbits: list[Orbit], title: str) -> Any:
    """One row per orbit: angles over a period, and the configurations swept."""
    figure = new_figure(7.2, 3.3 * len(orbits) + 0.3, title)
    panels = figure.subplots(len(orbits), 2, squeeze=False, width_ratios=(1.25, 1.0))
    for orbit, (left, right) in zip(orbits, panels, strict=True):
        model = chain(int(orbit.system["links"]))
        n = model.degrees_of_freedom
        for i in range(n):
            left.plot(orbit.times, orbit.samples[:, i], label=rf"$\theta_{i + 1}$", **line_style(i, n))
        gap_found = gap(orbit.samples[0], orbit.samples[-1], np.zeros(n))
        dress(left, "time (s)", "angle from the downward vertical (rad)")
        level = f"{orbit.energy:.6f}".replace("-", "\N{MINUS SIGN}")
        left.set_title(f"T = {orbit.period:.9f} s, E = {level} J", fontsize=9)
        left.set_xlim(0, orbit.period)
        if gap_found < 1e-6:
            left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=n, frameon=False, fontsize=9)
        _sweep(right, orbit, model)
    return figure


def _sweep(axes: Any, orbit: Orbit, model: Model) -> None:
    points = positions(model, orbit.samples)
    down, right = points[:, :, -1].T
    sweep(axes, points[::16], 0.12, 0.4, 0.9)
    trail(axes, points[:, :, -1], 1.3)
    speed = np.abs(orbit.samples[:, model.degrees_of_freedom :]).max(axis=1)
    if speed.min() > 0.01 * speed.max():  # what comes to rest goes both ways along its path
        arrows(axes, right, -down, COLOURS[1])
    axes.plot(0, 0, "s", color="black", markersize=6)
    plane(axes)
    widen(axes, float(np.ptp(points[:, 1])), float(np.ptp(points[:, 0])))
    axes.set_title("configurations and path of the tip", fontsize=9)
