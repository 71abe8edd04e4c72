"""Chains of many links: what it costs to derive them by each formulation, and 100 links in motion."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps

from orbitfinder.integrate.cvodes import IntegratorSettings, build_flow, sample
from orbitfinder.mechanics.chain import chain
from orbitfinder.mechanics.model import energies, positions
from orbitfinder.show.animate import AnimationSettings, save_animation, simulation_clip
from orbitfinder.show.style import dress, new_figure, plane, save_both
from orbitfinder.show.svg import COLOURS

SIZES = (3, 10, 30, 100, 300, 1000)
FORMULATIONS = ("lagrange", "newton-euler", "dae", "recursive")
PATIENCE = 1.5
"""s: a formulation that took longer for one size is not asked for the next, some 3 times larger"""
LINKS, SPAN = 100, 10.0
LONG_CHAIN = IntegratorSettings(1e-11, 1e-12, max_steps=500_000)


def derivation_part(folder: Path) -> dict[str, Any]:
    """Seconds and operations to derive n links by each formulation, with the exponent of growth.

    These are the only numbers of the report page that differ from run to run.
    """
    found: dict[str, Any] = {}
    for formulation in FORMULATIONS:
        seconds: dict[str, float] = {}
        operations: dict[str, int] = {}
        chain(2, formulation=formulation)  # imports and caches are not part of deriving
        for count in SIZES:
            began = time.perf_counter()
            model = chain(count, formulation=formulation)
            seconds[str(count)] = time.perf_counter() - began
            operations[str(count)] = _operations(model.acceleration)
            if seconds[str(count)] > PATIENCE:
                break
        found[formulation] = {"seconds": seconds, "operations": operations, "exponent": _exponent(seconds)}
    save_both(derivation_figure(found), folder / "derivation")
    return found


def _operations(function: Any) -> int:
    """Scalar operations of a function, those of the SX functions inside an MX one included."""
    if function.is_a("SXFunction"):
        return int(function.n_instructions())
    inner = [function.get_function(name) for name in function.get_function()]
    return sum(_operations(one) for one in inner)


def _exponent(seconds: dict[str, float]) -> float:
    """Slope of log(time) against log(n) over n >= 30, where the fixed costs have faded."""
    counts = np.array([float(n) for n in seconds if int(n) >= 30])
    times = np.array([seconds[n] for n in seconds if int(n) >= 30])
    return float(np.polyfit(np.log(counts), np.log(times), 1)[0]) if counts.size > 1 else float("nan")


def derivation_figure(found: dict[str, Any]) -> Any:
    """Time to derive against the number of links, log-log."""
    figure = new_figure(6.4, 3.8, "Time to derive n links")
    axes = figure.subplots()
    for k, (name, entry) in enumerate(found.items()):
        counts = [int(n) for n in entry["seconds"]]
        label = f"{name}: n^{entry['exponent']:.1f}"
        axes.loglog(
            counts, list(entry["seconds"].values()), "os^D"[k] + "-", color=COLOURS[k], label=label, markersize=4
        )
    axes.axhline(5 * 3600, color="0.4", linestyle=":", linewidth=1.0)
    axes.annotate(
        "the report's 5 h for 100 links", (3, 5 * 3600), xytext=(0, 3), textcoords="offset points", fontsize=8
    )
    dress(axes, "links n", "time to derive (s)")
    axes.legend(frameon=False, fontsize=9)
    return figure


def hundred_part(folder: Path) -> dict[str, Any]:
    """100 links from horizontal rest for 10 s: energy drift against m g l n^2 / 2, and an animation."""
    model = chain(LINKS)
    start = np.concatenate([np.full(LINKS, np.pi / 2), np.zeros(LINKS)])
    states = sample(build_flow(model, settings=LONG_CHAIN), start, SPAN, 501)
    times = np.linspace(0.0, SPAN, len(states))
    kinetic, potential = energies(model, states)
    total = kinetic + potential
    scale = 9.8 * LINKS**2 / 2
    points = positions(model, states)
    settings = AnimationSettings(pixels=320, rate=20, supersampling=2)
    clip = simulation_clip(times, points, f"{LINKS} links from horizontal rest", settings)
    save_animation(clip, folder / "chain-100.gif", settings)
    save_both(chain_figure(times, points, total - total[0], scale), folder / "chain-100")
    drift = float(np.abs(total - total[0]).max())
    return {"links": LINKS, "span": SPAN, "drift": drift, "scale": scale, "relative_drift": drift / scale}


def chain_figure(times: np.ndarray, points: np.ndarray, drift: np.ndarray, scale: float) -> Any:
    """Configurations every half second and the energy drift."""
    figure = new_figure(7.2, 3.6, f"{LINKS} links from horizontal rest")
    left, right = figure.subplots(1, 2, width_ratios=(1.1, 1.0))
    chosen = range(0, len(points), 50)
    for k in chosen:
        down, across = points[k]
        colour = colormaps["cividis"](times[k] / times[-1])
        left.plot(across, -down, color=colour, linewidth=0.9, label=f"{times[k]:.0f} s" if k % 250 == 0 else None)
    plane(left)
    left.legend(frameon=False, fontsize=8)
    right.plot(times, drift / scale, color=COLOURS[2], linewidth=0.9)
    dress(right, "time (s)", r"energy drift / ($m g l n^2 / 2$)")
    return figure
