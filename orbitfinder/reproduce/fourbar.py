"""Figure 10: four-bar linkages as native DAEs, their energy, constraints and joint forces."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder.integrate.idas import DaeSettings, DaeTrajectory, simulate_dae
from orbitfinder.mechanics.linkage import assemble, linkage, linkage_rates, linkage_state
from orbitfinder.mechanics.model import positions
from orbitfinder.reproduce.runs import IDAS_TOLERANCE
from orbitfinder.show.animate import save_animation, simulation_clip
from orbitfinder.show.style import dress, new_figure, plane, save_both
from orbitfinder.show.svg import COLOURS

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


def four_bar_part(folder: Path) -> dict[str, Any]:
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
    constraint.legend(frameon=False, fontsize=8, ncols=2, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.1)
    ground = result.forces.reshape(len(result.times), -1, 2)
    for k, (joint, label) in enumerate(((0, "left pivot"), (-1, "right pivot"))):
        size = np.linalg.norm(ground[:, joint], axis=1)
        force.plot(result.times, size, color=COLOURS[k], linestyle="-" if k == 0 else "--", linewidth=0.9, label=label)
    dress(force, "time (s)", "joint force (N)")
    force.legend(frameon=False, fontsize=8, ncols=2, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.1)
    for down, across in points[: SAMPLES // 2 : 12]:
        sweep.plot(across, -down, color=COLOURS[0], alpha=0.25, linewidth=0.8)
    sweep.plot(points[0, 1], -points[0, 0], "o-", color="black", linewidth=1.6, markersize=4)
    plane(sweep)
    return figure
