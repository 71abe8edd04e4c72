"""What stands beside the stage: a Poincare section to start from, and a search that fills an atlas meanwhile."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import ui

from orbitfinder.atlas.search import SearchStatistics
from orbitfinder.errors import InputError, plural
from orbitfinder.mechanics.scales import lasting, measured
from orbitfinder.studio import plots
from orbitfinder.studio.desk import Desk, button
from orbitfinder.studio.session import SWINGS, Item
from orbitfinder.studio.tasks import Cut, Settled
from orbitfinder.studio.worker import StoppedError, TaskProcess


class SectionPanel:
    """The section of the motion or orbit on the stage; a click on one of its points starts there."""

    def __init__(self, page: Desk, start: Callable[[Sequence[float]], Awaitable[None]]) -> None:
        self._page, self._start = page, start
        self._cut: Cut | None = None
        with ui.expansion("Poincaré section").classes("panel later").props('dense id="beside"') as self._panel:
            with ui.row().classes("items-center gap-3"):
                at = "Section at this energy" if page.session.model.conservative else "Section"
                button(at, page.safe(self._made), "cut")
                self._about = ui.label("Motions of this energy where they cross a plane. Click a point to start there.")
                self._about.classes("quiet").props('id="cut-about"')
            self._plot = ui.plotly(plots.section_figure(None, page.dark)).classes("w-full").props('id="section"')
            self._plot.on("plotly_click", self._clicked)

    def recolour(self) -> None:
        """Draw it for the theme of the page."""
        self._plot.update_figure(plots.section_figure(self._cut, self._page.dark))

    async def _made(self) -> None:
        page = self._page
        page.say("making the section")
        self._cut = await page.searched("cut", page.source.system, page.source.energy, page.source.orbit)
        made = self._cut.section
        level = "" if made.energy != made.energy else f" at E = {measured(made.energy, 'energy', made.system, 6)}"
        regular = f"{int(made.regular.sum())} of {plural(len(made.starts), 'motion')} regular"
        self._about.set_text(f"{made.plane}{level}: {regular}. Click a point to start there.")
        self.recolour()
        page.say(f"section: {plural(made.returns, 'crossing')}")

    async def _clicked(self, event: Any) -> None:
        at = plots.clicked(event.args)
        if at is None or self._cut is None or at[0] != plots.POINTS or not 0 <= at[1] < self._cut.section.returns:
            return
        await self._start(self._cut.section.states[at[1]].tolist())


class RestPanel:
    """The equilibrium at the parameters of the sliders and what the motion comes to there, in a phase portrait."""

    def __init__(self, page: Desk) -> None:
        model, self._page, self._near = page.session.model, page, [*map(float, page.session.opened.state)]
        self._settled: Settled | None = None
        self._names, self._plane, self._box = model.state_names, [*model.planes[0]], np.array([[0.0, 0.0], [1.0, 1.0]])
        self._sizes = np.zeros(len(self._names))
        with ui.expansion("Equilibrium and attractor", value=True).classes("panel later").props('dense id="rest"'):
            self._about = ui.label("Slide a parameter: where the motion comes to rest, or what it goes round on.")
            self._about.classes("number").props('id="rest-about"')
            self._plot = ui.plotly({}).classes("w-full").props('id="portrait"')
        self.recolour()

    def recolour(self) -> None:
        """Draw it for the theme of the page."""
        shown = plots.portrait_figure(self._settled, self._names, self._plane, self._box, self._page.dark)
        self._plot.update_figure(shown)

    async def settle(self, state: list[float], name: str, duration: float) -> list[float]:
        """Where the motion from a state has come to once it has settled; the parameter of a name has changed."""
        model = self._page.session.model
        known = dict(model.system), state, name, duration, self._near, self._sizes
        done: Settled = await self._page.quick.do("settled", *known)
        rest, seen, said = done.rest, [done.path], "no equilibrium near the last one"
        if rest is not None:
            self._near, seen, first = [*map(float, rest.state)], [done.path, rest.state], rest.eigenvalues[0]
            said = f"equilibrium {rest.stability}, eigenvalue {first.real:.3g}"
            said += f" \N{PLUS-MINUS SIGN} {abs(first.imag):.3g}i" if first.imag else ""
        here = np.vstack([*([self._box] if self._settled else []), np.vstack(seen)[:, self._plane]])
        self._box = np.array([here.min(axis=0), here.max(axis=0)])
        self._settled, self._sizes = done, done.sizes
        value = model.value(name)
        motion = "comes to rest" if done.still else "does not come to rest"
        self._about.set_text(f"{name} = {value:.6g}: {said}; the motion {motion}")
        self.recolour()
        return done.state


class SearchPanel:
    """A search in a process of its own, and the list of what it has found; a click loads an orbit."""

    def __init__(
        self, page: Desk, load: Callable[[str, int], Awaitable[None]], listed: Callable[[], None]
    ) -> None:  # fmt: skip
        self._load, self._changed = load, listed
        self._page, self._worker, self._listed = page, TaskProcess(), ""
        self._count = 0
        swing, time = page.session.opened.duration / SWINGS, page.unit("time")
        with ui.expansion("Search in the background").classes("panel later").props('dense id="background"'):
            with ui.row().classes("items-center gap-3"):
                self._low, self._high, self._budget = (
                    ui.number(label, value=round(value, 3), min=1e-6, max=1e6).props("dense").classes("w-28")
                    for label, value in ((f"periods from{time}", 0.3 * swing), (f"to{time}", 3.0 * swing),
                                         ("search for, s", 60.0))
                )  # fmt: skip
                self._go = button("Search", page.safe(self._searched), "search")
                self._stop = button("Cancel", self._worker.stop, "stop", "outline")
            self._about = ui.label("Fills an atlas with the orbits of this energy, while you go on.").classes("quiet")
            self._about.props('id="search-about" role="status"')
            with ui.scroll_area().classes("found").props('id="found" tabindex=0'):
                self._list = ui.column().classes("gap-0 w-full")
        self._running(False)

    def close(self) -> None:
        """End the process; the atlas keeps what it has."""
        self._worker.close()

    def show(self, item: Item) -> None:
        """List what an atlas holds, the last 300 orbits."""
        assert item.atlas is not None
        if item.name != self._listed:
            self._listed, self._count = item.name, 0
            self._list.clear()
        with self._list:
            for row in item.atlas[max(self._count, len(item.atlas) - 300) :]:
                period = lasting(row.period, self._page.session.model.system, 6)
                symmetry = "" if row.symmetry == "none" else f", {row.symmetry.replace('+', ' and ')}"
                label = f"{row.id}: T = {period}, {row.stability}{symmetry}"
                shown = self._page.safe(partial(self._load, item.name, row.id))
                ui.button(label, on_click=shown).props("flat dense no-caps align=left").classes("text-left")
        self._count = len(item.atlas)

    def _running(self, running: bool) -> None:
        self._go.set_visibility(not running)
        self._stop.set_visibility(running)

    async def _searched(self) -> None:
        page, source = self._page, self._page.source
        periods, budget = (_positive(self._low, "from"), _positive(self._high, "to")), _positive(self._budget, "for")
        if not periods[0] < periods[1]:
            raise InputError(f"periods: from {periods[0]:g} to {periods[1]:g} holds none; give a larger second")
        energy = source.energy if page.session.model.conservative else None
        name, atlas = page.session.search(source.state, periods, energy, page.taken)
        self._running(True)
        self._about.set_text(f"{name}: starting")
        said = f"{name}: done"
        try:
            await self._worker.do("searched", source.system, energy, periods, budget, atlas,
                                  said=partial(self._counted, name, atlas))  # fmt: skip
        except StoppedError:
            said = f"{name}: stopped; the same search goes on from there"
        finally:
            self._running(False)
            self._refresh(name, atlas)
        if (item := page.session.items.get(name)) is not None and item.atlas is not None:
            said += f"; {plural(len(item.atlas), 'orbit')} in {atlas}"
        self._about.set_text(said)

    def _counted(self, name: str, atlas: Path, at: SearchStatistics) -> None:
        self._about.set_text(f"{name}: {plural(at.made, 'start')}, {plural(at.orbits, 'orbit')}")
        if at.orbits != self._count or name != self._listed:
            self._refresh(name, atlas)

    def _refresh(self, name: str, atlas: Path) -> None:
        if atlas.is_file():
            self.show(self._page.session.keep_atlas(name))
            self._changed()


def _positive(field: Any, name: str) -> float:
    value = plots.finite(field.value or 0.0)
    if value <= 0:
        raise InputError(f"{name}: must be positive, got {value:g}; give a time")
    return value
