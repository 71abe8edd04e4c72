"""The pictures that `plot` draws of sections, manifolds, connections and controllers."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from orbitfinder.control.controller import Controller
from orbitfinder.mechanics.model import Model
from orbitfinder.show.diagram import entitled
from orbitfinder.show.sections import draw_manifolds, draw_section
from orbitfinder.show.style import dress, legend, line_style, new_figure, save_png, told_in
from orbitfinder.show.svg import axis
from orbitfinder.structures.manifold import Connection, Manifold
from orbitfinder.structures.section import Section


def section_figures(record: Section | Manifold | Connection, folder: Path, model: Model) -> list[Path]:
    """`returns.png` of a section, `manifold-WHICH.png` of curves on one or a tube, `connection.png` of crossings."""
    if isinstance(record, Section):
        return [draw_section(record, folder / "returns.png", model=model)]
    if isinstance(record, Connection):
        return [draw_section(None, folder / "connection.png", connections=[record], model=model)]
    target = folder / f"manifold-{record.which}.png"
    draws = {"curves": partial(draw_section, None, manifolds=[record])}
    return [draws.get(record.kind, partial(draw_manifolds, [record]))(path=target, model=model)]


def controller_figures(controller: Controller, folder: Path, model: Model) -> list[Path]:
    """`controller.png`: gains over a period, a panel an actuator, and the multipliers without and with control."""
    verdict = "stabilised" if controller.stabilised else "NOT stabilised"
    count = len(controller.actuators)
    figure = new_figure(4.6 * (count + 1), 4.8, entitled(controller), f"{verdict} by {', '.join(controller.actuators)}")
    *gains, plane = figure.subplots(1, count + 1)
    times = np.linspace(0.0, controller.period, len(controller.gains))
    for axes, name, rows in zip(gains, controller.actuators, np.split(controller.gains, count, axis=1), strict=True):
        for k, row in enumerate(rows.T):
            axes.plot(times, row, label=axis(model, k), **line_style(k, len(rows.T)))
        dress(axes, "time (s)" if controller.clock else "place on the orbit (s)", f"gains of {name}")
    legend(figure, gains[0], "lower left", ncols=min(4, controller.units.size))
    turn = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 200))
    plane.plot(turn.real, turn.imag, color="0.7", linewidth=0.8)
    for mark, words, multipliers in (("x", "without", controller.open_loop), ("o", "with", controller.multipliers)):
        plane.plot(
            multipliers.real,
            multipliers.imag,
            mark,
            markersize=5,
            label=f"multipliers {words} control",
            fillstyle="none",
        )
    plane.set_aspect("equal", adjustable="datalim")
    dress(plane, "real part", "imaginary part")
    legend(figure, plane, "lower right")
    return [save_png(told_in(figure, controller.system), folder / "controller.png")]
