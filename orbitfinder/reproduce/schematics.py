"""Figures 1, 3 and 9: the mechanisms and their free bodies, drawn from the models' own positions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder.mechanics.model import positions
from orbitfinder.mechanisms.chain import chain
from orbitfinder.show.style import new_figure, place_labels, save_both
from orbitfinder.show.svg import COLOURS

POSE = np.array([0.45, 0.95, 0.25, 0.0, 0.0, 0.0])
FOUR_BAR_POSE = np.array([-0.35, 1.35, 2.55, 0.0, 0.0, 0.0])
GREY = "0.35"


def schematic_part(folder: Path) -> dict[str, Any]:
    """Draw the triple pendulum, its free bodies and those of the four-bar."""
    save_both(pendulum_figure(), folder / "figure-01")
    save_both(free_bodies(POSE, False, "Figure 3. Triple pendulum free body diagrams"), folder / "figure-03")
    save_both(free_bodies(FOUR_BAR_POSE, True, "Figure 9. Four-bar linkage free body diagrams"), folder / "figure-09")
    return {"drawn": [1, 3, 9]}


def _pose(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Joints (2 x n+1) and centres (2 x n) on the page: to the right, up."""
    model = chain(state.size // 2)
    joints, centres = positions(model, state[None])[0], positions(model, state[None], "centres")[0]
    page = np.array([[0.0, 1.0], [-1.0, 0.0]])
    return page @ joints, page @ centres


def pendulum_figure() -> Any:
    """The triple pendulum with angles from the downward vertical, centres of mass and axes."""
    figure = new_figure(4.6, 5.2, "Figure 1. Triple pendulum schematic")
    axes = figure.subplots()
    joints, centres = _pose(POSE)
    across, up = joints[:, 0]
    axes.plot(across + np.array([-0.25, 0.25]), [up] * 2, color="black", linewidth=2)  # the ground
    for shift in np.linspace(-0.22, 0.22, 6):
        axes.plot([across + shift, across + shift + 0.06], [up, up + 0.09], color="black", linewidth=1)
    axes.plot(*joints, color=COLOURS[0], linewidth=4, solid_capstyle="round")
    axes.plot(*joints[:, :-1], "o", color="white", markeredgecolor="black", markersize=9)
    axes.plot(*centres, "x", color=COLOURS[1], markersize=8, markeredgewidth=2)
    for i in range(3):
        (across, up), angle = joints[:, i], POSE[i]
        axes.plot([across, across], [up, up - 0.55], color=GREY, linestyle=":", linewidth=1.0)
        sweep = np.linspace(0.0, angle, 30)
        axes.plot(across + 0.4 * np.sin(sweep), up - 0.4 * np.cos(sweep), color=GREY, linewidth=1.0)
        middle = joints[:, i] + 0.54 * np.array([np.sin(angle / 2), -np.cos(angle / 2)])
        axes.annotate(rf"$\theta_{i + 1}$", middle, ha="center", va="center", fontsize=10)
        axes.annotate(rf"$G_{i + 1}$", centres[:, i], xytext=(8, 5), textcoords="offset points")
        axes.annotate(rf"$O_{i + 1}$", joints[:, i], xytext=(-24, -14), textcoords="offset points")
    corner = np.array([-0.9, -0.4])
    _arrow(axes, corner, np.array([0.0, -0.45]), "x", GREY)
    _arrow(axes, corner, np.array([0.45, 0.0]), "y", GREY)
    _arrow(axes, np.array([-0.9, -1.4]), np.array([0.0, -0.5]), "g", COLOURS[2])
    axes.set_xlim(-1.2, joints[0].max() + 0.3)
    axes.set_ylim(joints[1].min() - 0.2, 0.3)
    return _clean(figure, axes)


def free_bodies(state: np.ndarray, closed: bool, title: str) -> Any:
    """Each link apart, with weight at its centre and the joint forces R on both ends."""
    figure = new_figure(8.4, 4.2, title)
    axes = figure.subplots()
    joints, centres = (1.6 * shape for shape in _pose(state))
    count = centres.shape[1]
    place = 0.0
    weights, forces = list[Label](), list[Label]()
    for i in range(count):
        ends = joints[:, i : i + 2]
        offset = np.array([place - ends[0].min(), -ends[1].mean()])
        upper, lower, centre = ends[:, 0] + offset, ends[:, 1] + offset, centres[:, i] + offset
        axes.plot(*np.column_stack([upper, lower]), color=COLOURS[0], linewidth=4, solid_capstyle="round")
        axes.plot(*centre, "x", color=COLOURS[1], markersize=8, markeredgewidth=2)
        weights.append(_force(axes, centre, np.array([0.0, -0.36]), f"m_{i + 1} g", COLOURS[2]))
        forces += _joint_forces(axes, upper, f"R_{{{i + 1}", 1.0)
        if closed or i + 1 < count:
            forces += _joint_forces(axes, lower, f"R_{{{i + 2}", -1.0)
        axes.annotate(f"link {i + 1}", (place + np.ptp(ends[0]) / 2, -1.5), ha="center", fontsize=10)
        place += float(np.ptp(ends[0])) + 1.6
    axes.set_xlim(-0.75, place - 0.85)
    axes.set_ylim(-1.6, 1.3)
    _clean(figure, axes)
    place_labels(figure, axes, weights, 10.0, color=COLOURS[2], parse_math=True)
    place_labels(figure, axes, forces, 10.0, color=COLOURS[3], parse_math=True)
    return figure


Label = tuple[str, float, float]


def _joint_forces(axes: Any, at: np.ndarray, name: str, sign: float) -> list[Label]:
    """R_x (down) and R_y (to the right) with their sign on this body."""
    minus = "" if sign > 0 else "-"
    return [
        _force(axes, at, np.array([0.0, -0.3 * sign]), f"{minus}{name}x}}", COLOURS[3]),
        _force(axes, at, np.array([0.3 * sign, 0.0]), f"{minus}{name}y}}", COLOURS[3]),
    ]


def _force(axes: Any, start: np.ndarray, step: np.ndarray, name: str, colour: str) -> Label:
    """An arrow, as an unseen line too so that names keep off it; its name and its tip."""
    _arrow(axes, start, step, "", colour)
    tip = start + step
    axes.plot(*np.column_stack([start, tip]), alpha=0.0)
    return f"${name}$", float(tip[0]), float(tip[1])


def _arrow(axes: Any, start: np.ndarray, step: np.ndarray, text: str, colour: str) -> None:
    axes.annotate(
        "", start + step, start, arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 1.5, "shrinkA": 0}
    )
    length = float(np.linalg.norm(step))
    axes.annotate(text, start + step * (1 + 0.15 / length), color=colour, ha="center", va="center", fontsize=9)


def _clean(figure: Any, axes: Any) -> Any:
    axes.set_aspect("equal")
    axes.set_axis_off()
    return figure
