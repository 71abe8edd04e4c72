"""The page of the studio: from a dragged mechanism over close returns to orbits, their certificates and families."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import ui

from orbitfinder import site
from orbitfinder._runtime.inert import inert
from orbitfinder.errors import InputError, OrbitfinderError, plural
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.scales import lasting, measured
from orbitfinder.orbits.guesses.returns import CloseReturn
from orbitfinder.records.family import Family, FamilyPoint
from orbitfinder.records.orbit import Orbit
from orbitfinder.records.reading import Entries, Table
from orbitfinder.show.facts import told
from orbitfinder.show.html import certificate_html
from orbitfinder.show.scene import solids_of
from orbitfinder.studio import plots
from orbitfinder.studio.beside import RestPanel, SearchPanel, SectionPanel
from orbitfinder.studio.desk import ROOMY, Desk, Staged, button
from orbitfinder.studio.films import draggable, pullable
from orbitfinder.studio.session import Item, Session, leaving, parameters, rests
from orbitfinder.studio.tasks import Film, FilmedOrbit, FilmedStep, Simulated
from orbitfinder.studio.worker import RefusedError, StoppedError

ASSETS = Path(__file__).parent / "assets"
SITE = Path(site.__path__[0]) / "assets"
POINTS = 40
"""Points each way along a family, unless another number is asked for"""
MOST_SLIDERS = 24


@dataclass
class Grip:
    """A point that is held: since which time (s) of the motion, to where it is pulled, how fast it is let go of."""

    point: int
    time: float
    place: list[float] | None = None
    velocity: list[float] | None = None
    state: list[float] | None = None


class Page(Desk):
    """One tab: a quick process for what the stage shows, another one for searches, which can be cancelled."""

    def __init__(self, session: Session, taken: set[str], assets: str) -> None:
        super().__init__(session, taken)
        self.assets = assets
        self.state = [*map(float, session.opened.state)]
        self.returns: tuple[CloseReturn, ...] = ()
        self.picked: int | None = None
        self.orbit: Orbit | None = None
        self.item: Item | None = None
        self.points: list[FamilyPoint] = []
        self.films: dict[bytes, Film | None] = {}
        self.wanted: Entries = {}
        self.inputs: list[Any] = []
        self.grip: Grip | None = None
        self.timer: Any = None
        self.shown, self.simulated = False, asyncio.Event()

    async def built(self) -> None:
        """The page: its title at once, painted while the rest is built; then what it shows is simulated."""
        files = [f"{self.assets}/site/core.js", f"{self.assets}/studio/stage.js"]
        ui.add_head_html(f'<link rel="stylesheet" href="{self.assets}/studio/studio.css">')
        ui.add_head_html("".join(f'<script defer src="{file}"></script>' for file in files))
        ui.add_body_html(f'<p class="opening" aria-hidden="true">{inert(self.session.title)}</p>')  # until it is built
        ui.colors(primary="#005f99", good="#0a6847", bad="#9a3412")
        self.theme = ui.dark_mode()
        client = ui.context.client
        client.on_delete(self.close)
        await client.connected()
        self._head()
        with ui.element("div").classes("studio"):
            with ui.element("div"):
                self._stage()
                self._sliders()
                self.rest = RestPanel(self) if rests(self.session.model) else None
                self.section = SectionPanel(self, self._start_from)
                self.background = SearchPanel(self, self._load_member, self._list)
            with ui.element("div"):
                self._returns()
                self._family()
                self._kept()
        self.timer = ui.timer(0.25, self._redraw)
        ui.on("held", self._held)
        ui.on("released", self._released)
        ui.on("gripped", self.safe(self._gripped))
        self.dark = bool(await ui.run_javascript("matchMedia('(prefers-color-scheme: dark)').matches", timeout=10))
        self._recoloured(self.dark)
        solids = [f"orbitfinder.put({json.dumps(name)}, {json.dumps(entry)});"
                  for name, entry in solids_of(self.session.model.system).items()]  # fmt: skip
        ui.run_javascript(f"{''.join(solids)}stage.mount('stage', {self._holds()})")
        await self._first()

    def close(self) -> None:
        """End the processes of a tab that has gone; results stay in the session's folder."""
        if self.timer is not None:
            self.timer.deactivate()
            self.background.close()
        self.quick.close()
        self.long.close()

    # ------------------------------------------------------------------ what the page is made of

    def _head(self) -> None:
        with ui.row().classes("head w-full items-center no-wrap gap-2"):
            ui.html(f"<h1>{inert(self.session.title)}</h1>", sanitize=False)
            self.status = ui.label("").classes("quiet grow").props('role="status" aria-live="polite" id="status"')
            self.busy = ui.spinner(size="1.4em")
            self.cancel = button("Cancel", self.long.stop, "cancel", "outline")
            ui.button(icon="dark_mode", on_click=lambda: self._recoloured(not self.dark)).props(
                'flat dense round aria-label="Light or dark"'
            )
            self.save = button("Save", self.safe(self._save), "save")
        self.free()

    def _stage(self) -> None:
        model, opened = self.session.model, self.session.opened
        drags = bool(draggable(model) or pullable(model, opened.state))
        with ui.card().classes("panel stage"):
            _title("1. Drag a joint, or flick it, and let go" if drags else "1. Where it starts")
            ui.html(
                '<canvas id="stage" role="img" aria-label="The mechanism in motion"></canvas>', sanitize=False
            ).classes("w-full")
            self.readout = ui.label("").classes("number").props('id="readout"')
            with ui.row().classes("items-center gap-3"):
                button("Run", self._run, "run")
                self.duration = ui.number(
                    f"Simulated time{self.unit('time')}",
                    value=round(self.session.opened.duration, 2),
                    min=1e-3,
                    max=1e4,
                ).props('dense style="width: 9em"')
                ui.switch("Play", value=True, on_change=lambda e: ui.run_javascript(f"stage.play({_js(e.value)})"))
                speeds = {0.25: "quarter speed", 1: "real time", 4: "4 times faster"}
                ui.select(
                    speeds, value=1, label="Speed", on_change=lambda e: ui.run_javascript(f"stage.speed({e.value})")
                ).props("dense options-dense").classes("w-32")

    def _sliders(self) -> None:
        model = self.session.model
        with ui.card().classes("panel"):
            _title("State and parameters")
            if model.constraint is None:
                with ui.expansion("State at t = 0").classes("w-full").props("dense") as self.states:
                    self.inputs = [
                        self._slider(name, value, *_range(value, k < len(model.angular) and bool(model.angular[k])),
                                     partial(self._set, k))
                        for k, (name, value) in enumerate(zip(model.state_names, self.state, strict=True))
                        if k < MOST_SLIDERS
                    ]  # fmt: skip
            with ui.expansion("Parameters: a found orbit follows them").classes("w-full").props("dense id=parameters"):
                known = list(parameters(model).items())[:MOST_SLIDERS]
                self.numbers = {
                    name: self._slider(name, *at, partial(self._parameter, name)) for name, at in known
                }  # fmt: skip
                button("Keep the orbit at these parameters", self.safe(self._keep), "keep", "flat")

    def _slider(self, name: str, value: float, low: float, high: float, then: Callable[[float], Any]) -> Any:
        with ui.row().classes("w-full items-center no-wrap gap-3"):
            ui.label(name).classes("quiet w-24 shrink-0")
            slider = ui.slider(min=low, max=high, value=value, step=(high - low) / 1000)
            slider.props(f'aria-label="{inert(name)}"').classes("grow")
            shown = ui.label().classes("number w-20 shrink-0 text-right").props("aria-hidden=true")
            shown.bind_text_from(slider, "value", lambda x: f"{x:.5g}")
        moved = self.safe(lambda event: then(plots.finite(event.args)))
        slider.on("update:model-value", moved, throttle=0.03)
        return slider

    def _returns(self) -> None:
        with ui.card().classes("panel"):
            _title("2. Close returns: click one to find its orbit")
            self.near = ui.plotly(self._near()).classes("w-full").props('id="returns"')
            self.near.on("plotly_click", self.safe(self._return_clicked))
            with ui.row().classes("items-center gap-3"):
                self.find = button("Find the most promising", self.safe(self._find_first), "find")
                if self.session.opened.guess is not None:
                    button("Find by the file's guess", self.safe(self._find_own), "own", f"outline {ROOMY}")
                self.badge = button("", self._certificate, "badge", "unelevated")
            self.badge.set_visibility(False)
            self.about = ui.label("").classes("number").props('id="about"')

    def _family(self) -> None:
        model = self.session.model
        energies = ["energy", "period"] if model.conservative else []
        with ui.card().classes("panel"):
            _title("3. Its family: slide along it, click an event to branch")
            with ui.row().classes("items-center gap-3"):
                self.follow = button("Follow", self.safe(self._follow), "follow")
                self.along = ui.select([*energies, *model.parameter_names], value=None, label="in").props("dense")
                self.along.classes("w-32").set_value(next(iter([*energies, *model.parameter_names]), None))
                self.count = ui.number("points each way", value=POINTS, min=1, max=100000, precision=0).props("dense")
                self.count.classes("w-28")
            self.plot = ui.plotly(self._figure()).classes("w-full").props('id="family"')
            self.plot.on("plotly_click", self.safe(self._family_clicked))
            self.slide = ui.slider(min=0, max=1, step=1, value=0).props('id="slide" aria-label="Orbit of the family"')
            self.slide.on("update:model-value", js_handler="(value) => stage.turn(value)")
            self.slide.on("update:model-value", self.safe(self._slid), throttle=0.02)
            self.where = ui.label("").classes("number").props('id="where"')
            with ui.row().classes("items-center gap-3 w-full"):
                self.events = ui.select({}, label="event").props("dense options-dense").classes("grow")
                button("Branch", self.safe(self._branch), "branch")
                button("Keep this orbit", self.safe(self._keep_member), "keep-member", "flat")

    def _kept(self) -> None:
        with ui.card().classes("panel last"):
            _title("4. What was found, and how to find it again")
            self.tree = ui.tree([], label_key="label", on_select=self.safe(self._selected))
            self.tree.props('id="tree"').set_visibility(False)
            self.none = ui.label("Nothing yet: find an orbit, and it is listed here.").classes("quiet")
            for sentence in (f"Results are written at once to {self.session.folder}.", *self.session.damaged):
                ui.label(sentence).classes("quiet")
            self.commands = ui.code("", language="bash").classes("commands")
            self.commands.copy_button.props('aria-label="Copy the command lines"')
            self.commands.set_visibility(False)

    # ------------------------------------------------------------------ what happens on it

    def _heard(self, what: Any) -> None:
        if isinstance(what, FilmedStep):
            if what.family != self.growing:  # the next of several branches
                self._begin(what.family, self.parameter)
            for point, film in zip(what.batch.points, what.films, strict=True):
                self.films[point.state.tobytes()] = film
                self.points.insert(len(self.points) if what.batch.direction > 0 else 0, point)
            self.stale = True
            self.say(f"{what.family}: {plural(len(self.points), 'orbit')}")
        else:
            self.say(str(what))

    async def _first(self) -> None:
        given = self.session.opened
        if given.orbit is not None:
            shown: FilmedOrbit = await self.quick.do("opened", given.orbit)
            self.item = self.session.keep_opened(shown.orbit)
            self._show_orbit(shown)
        elif given.family is not None:
            self._show_family(self.session.keep_opened())
        elif given.atlas is not None:
            self.item = self.session.keep_atlas(given.name)
            self.background.show(self.item)
        self._list()
        await self.safe(self._simulate)(given.orbit is not None or given.family is not None)
        if not self.shown:  # the motion was refused
            await self.safe(self._posed)()
        await self.safe(self.long.start)()

    def _held(self, event: Any) -> None:
        """A joint is being dragged: its energy."""
        self._state(event.args["state"])
        self.readout.set_text(self._energy())

    async def _released(self, event: Any) -> None:
        await self._start_from(event.args["state"])

    async def _gripped(self, event: Any) -> None:
        """A point of a mechanism is taken hold of, pulled and let go of."""
        what = event.args
        if "time" in what:
            self.grip = Grip(int(what["point"]), plots.finite(what["time"]))
        if self.grip is not None and "place" in what:
            self.grip.place = [*map(plots.finite, what["place"])]
        if self.grip is not None and "velocity" in what:
            self.grip.velocity = [*map(plots.finite, what["velocity"])]
        await self._latest("grip", self._pull)

    async def _pull(self) -> None:
        """Bring the mechanism to where its point is pulled; let it run once it is let go of."""
        grip, source = self.grip, self.source
        if grip is None:
            return
        system = dict(self.session.model.system)
        if grip.state is None:
            grip.state = await self.quick.do("later", source.system, source.state, grip.time)
        last = grip.velocity is not None
        if grip.place is not None:
            place, grip.place = grip.place, None
            grip.state, film = await self.quick.do("pulled", system, grip.state, grip.point, place)
            self._state(grip.state)
            self.readout.set_text(self._energy())
            if not last:
                self._show(film)
        if last and grip.place is None:
            self.grip = None
            self._state(await self.quick.do("thrown", system, grip.state, grip.point, grip.velocity))
            await self._simulate()

    async def _start_from(self, state: Sequence[float]) -> None:
        """Let the mechanism run from a state (d)."""
        self._state(state)
        await self._run()

    async def _posed(self) -> None:
        self._show(await self.quick.do("posed", dict(self.session.model.system), self.state))

    def _state(self, given: Sequence[Any]) -> None:
        """The numbers of a page, which may be anything, as the state."""
        if len(given) == len(self.state):
            self.state = [*map(plots.finite, given)]
            for slider, value in zip(self.inputs, self.state, strict=False):
                slider.set_value(value)

    def _energy(self) -> str:
        level = self.level(self.state)
        return "" if level is None else f"E = {measured(level, 'energy', self.session.model.system, 6)}"

    async def _set(self, k: int, value: float) -> None:
        self.state[k] = value
        self.readout.set_text(self._energy())
        await self._latest("state", self._simulate)

    async def _run(self) -> None:
        await self.safe(self._latest)("state", self._simulate)

    async def _latest(self, what: str, work: Callable[[], Awaitable[None]]) -> None:
        """Do some work again until nothing new was asked for meanwhile."""
        if what in self.wanted:
            self.wanted[what] = True
            return
        self.wanted[what] = True
        try:
            while self.wanted[what]:
                self.wanted[what] = False
                await work()
        finally:
            del self.wanted[what]

    async def _simulate(self, stay: bool = False, keep: bool = False) -> None:
        duration = plots.finite(self.duration.value or 0.0)
        self.simulated.clear()
        try:
            run: Simulated = await self.quick.do("simulated", dict(self.session.model.system), self.state, duration)
        finally:
            self.simulated.set()
        self.session.energy, self.returns, self.picked = run.energy, run.returns, None
        self.readout.set_text(_readout(run, self.session.model))
        self.near.update_figure(self._near())
        self.find.set_enabled(bool(self.returns))
        if stay and self.shown:
            return
        self.source = Staged(dict(self.session.model.system), list(self.state), run.energy)
        self._show(run.film, run.view, keep)

    def _show(self, film: Film | None, view: Table | None = None, keep: bool = False) -> None:
        if film is not None:
            spans = [2.3 * film["half"]] * film["dims"]
            window = view or (None if self.shown else {"centre": film["centre"], "spans": spans})
            self.shown = True
            ui.run_javascript(f"stage.show({json.dumps(film)}, {json.dumps(window)}, {_js(keep)})")

    def _near(self) -> Entries:
        return plots.returns_figure(self.returns, self.picked, self.session.model.system, self.dark)

    async def _return_clicked(self, event: Any) -> None:
        if (at := plots.clicked(event.args)) is not None and 0 <= at[1] < len(self.returns):
            await self._found_near(at[1])

    async def _find_first(self) -> None:
        """Find the orbit of the most promising close return that has one, of the motion that is being simulated."""
        await self.simulated.wait()
        said = "nothing comes back close enough; start it another way, or simulate for longer"
        for number in range(min(4, len(self.returns))):
            try:
                if await self._found_near(number):
                    return
            except RefusedError as error:
                said = str(error)
        raise InputError(said)

    async def _found_near(self, number: int) -> bool:
        """Whether the orbit that a close return belongs to is certified."""
        near, self.picked = self.returns[number], number
        self.near.update_figure(self._near())
        return await self._found(self.session.problem(near.state, near.period, self.taken))

    async def _find_own(self) -> None:
        await self._found(self.session.own_problem(self.taken))

    async def _found(self, wanted: tuple[str, Path]) -> bool:
        name, file = wanted
        self.say(f"{name}: searching")
        shown: FilmedOrbit = await self.searched("found", file, self.session.folder, said=self._heard)
        if shown.file is not None:
            self.item = self.session.keep_orbit(shown.orbit)
            self._list()
        self._show_orbit(shown)
        self.say(f"{name}: {'certified' if shown.file else 'not an orbit'}")
        return shown.file is not None

    def _show_orbit(self, shown: FilmedOrbit, keep: bool = False) -> None:
        orbit = self.orbit = shown.orbit
        self.source = replace(Staged.of(orbit), orbit=orbit)
        sure = orbit.certificate is not None and orbit.certificate.passed
        self.badge.set_text("Certified" if sure else "Rejected")
        self.badge.props(f"color={'good' if sure else 'bad'} icon={'verified' if sure else 'dangerous'}")
        self.badge.set_visibility(True)
        self.about.set_text(f"{told(orbit, 10)}, closes to {orbit.closure:.0e}")
        self._show(shown.film, keep=keep)

    def _certificate(self) -> None:
        if self.orbit is None or self.orbit.certificate is None:
            return
        with ui.dialog().props('aria-label="Certificate"') as dialog, ui.card().classes("panel certificate max-w-5xl"):
            ui.html(certificate_html(self.orbit.certificate), sanitize=False)
            ui.button("Close", on_click=dialog.close).props("flat no-caps")
        dialog.open()

    # ------------------------------------------------------------------ families

    async def _follow(self) -> None:
        item = self.item
        while item is not None and item.orbit is None:
            item = self.session.items.get(item.parent or "")
        if item is None or not self.along.value:
            return self.say("find an orbit first; then its family can be followed")
        name, parameter, points = f"{item.name}-{self.along.value}", str(self.along.value), self._points()
        while (self.session.folder / name).exists() and name not in self.session.items:  # what is damaged stays
            name += "-again"
        self._begin(name, parameter)
        try:
            family = await self.searched(
                "followed", item.file, parameter, points, name, self.session.folder, said=self._heard
            )
        except StoppedError:
            family = self.session.rescued(name)
            if family is None:
                raise
        self._show_family(self.session.keep_family(family, item.name, points))
        self.say(f"{name}: {family.counts}")

    async def _branch(self) -> None:
        if self.events.value is None or self.item is None or self.item.family is None:
            known = self.item.family if self.item is not None else None
            return self.say(
                "choose an event of a family that was followed; branches leave there"
                if known is None or leaving(known)
                else f"no branch leaves {known.name}: its multipliers meet no root of 1; follow it further"
            )
        item, event, points = self.item, int(self.events.value), self._points()
        self.say(f"{item.name}: looking for what leaves at event {event}")
        self._begin("", self.item.family.parameter)
        try:
            families: list[Family] = await self.searched(
                "branched", item.file, event, points, self.session.folder, said=self._heard
            )
        except OrbitfinderError:
            self._show_family(item)
            raise
        for number, family in enumerate(families, 1):
            self.session.keep_family(family, item.name, points, event, number)
        self._show_family(self.session.items[families[0].name])
        self.say(f"{plural(len(families), 'family')} found at event {event} of {item.name}")

    def _points(self) -> int:
        return max(1, int(plots.finite(self.count.value or 1)))

    def _begin(self, name: str, parameter: str) -> None:
        """Forget the family that is shown, for one that grows."""
        self.growing, self.points, self.parameter, self.stale = name, [], parameter, True
        self.events.set_options({}, value=None)

    growing = ""
    parameter = "energy"
    stale = False

    def _redraw(self) -> None:
        """The plot of a family that grows, a few times a second."""
        if self.stale:
            self.stale = False
            self.plot.update_figure(self._figure())

    def _figure(self, here: FamilyPoint | None = None) -> Entries:
        family = self.item.family if self.item is not None else None
        known = [item.family for item in self.session.items.values() if item.family is not None]
        others = [other for other in known if other.name != self.growing and other.parameter == self.parameter]
        events = family.events if family is not None and family.name == self.growing else ()
        return plots.family_figure(
            self.points, events, here, others, self.parameter, self.session.model.system, self.dark
        )

    def _show_family(self, item: Item) -> None:
        assert item.family is not None
        self.item, family = item, item.family
        self.growing, self.parameter, self.points = family.name, family.parameter, list(family.points)
        self.slide.props(f"max={max(1, len(self.points) - 1)}")
        near = 0.0 if self.orbit is None else self.orbit.period
        self.slide.set_value(min(range(len(self.points)), key=lambda k: abs(self.points[k].period - near)))
        ui.run_javascript(f"stage.put({json.dumps([self.films.get(point.state.tobytes()) for point in self.points])})")
        choice = leaving(family)
        self.events.set_options(choice, value=next(iter(choice), None))
        self.plot.update_figure(self._figure())
        self.where.set_text(f"{family.counts}")
        self._list()

    async def _slid(self, event: Any) -> None:
        await self._slide_to(int(plots.finite(event.args)))

    async def _slide_to(self, number: int) -> None:
        if not 0 <= number < len(self.points):
            return
        point = self.points[number]
        sure = "certified" if point.certified else "closed"
        period = lasting(point.period, point.system, 8)
        self.where.set_text(
            f"orbit {number}: {self.parameter} = {point.value:.8g}, T = {period}, {point.stability}, {sure}"
        )
        self.badge.set_visibility(False)  # what it says is of another orbit
        self.about.set_text("")
        self.source = Staged.of(point)
        self.plot.run_plot_method("restyle", {"x": [[point.value]], "y": [[1 / point.period]]}, [plots.HERE])
        key = point.state.tobytes()
        if self.films.get(key) is None:
            self.films[key] = await self.quick.do("shown", dict(point.system), point)
            ui.run_javascript(f"stage.add({number}, {json.dumps(self.films[key])})")

    async def _family_clicked(self, event: Any) -> None:
        at = plots.clicked(event.args)
        if at is None:
            return
        trace, number = at
        if trace == plots.POINTS and 0 <= number < len(self.points):
            self.slide.set_value(number)
            ui.run_javascript(f"stage.turn({number})")
            await self._slide_to(number)
        elif trace == plots.EVENTS:
            if number in (self.events.options or {}):
                self.events.set_value(number)
                await self._branch()
            else:
                self.say(f"no branch leaves at event {number}")

    async def _keep_member(self) -> None:
        number = int(self.slide.value)
        if self.item is None or self.item.family is None or not 0 <= number < len(self.points):
            raise InputError("slide along a family first; the orbit that is shown is kept")
        orbit: Orbit = await self.quick.do("own", self.points[number])
        await self._found(self.session.problem_of(orbit, self.taken))

    # ------------------------------------------------------------------ parameters, saving, looks

    async def _parameter(self, name: str, value: float) -> None:
        self.wanted_value = name, value
        await self._latest("parameter", self._turn)

    async def _turn(self) -> None:
        """The orbit at another value of a parameter, or the motion where there is no orbit yet."""
        name, value = self.wanted_value
        follows = self.orbit is not None and await self._follows(self.orbit, name, value)
        if not follows:
            self.session.model = with_parameters(self.session.model, {name: value})
        ui.run_javascript(f"stage.links({self._holds()})")
        if self.rest is not None:
            start = self.state if self.orbit is None else [*map(float, self.orbit.state)]
            settled = await self.rest.settle(start, name, plots.finite(self.duration.value or 0.0))
            self._state(self.state if follows else settled)
        if not follows:
            await self._simulate(keep=self.rest is not None)

    async def _follows(self, orbit: Orbit, name: str, value: float) -> bool:
        """Whether an orbit goes along; where a cycle is lost, as at its Hopf point, what settles says what is left."""
        try:
            turned: FilmedOrbit = await self.quick.do("turned", orbit, name, value)
        except RefusedError:
            if self.rest is None:
                raise
            self.orbit = None
            self.badge.set_visibility(False)
            self.about.set_text("")
            return False
        self._show_orbit(turned, keep=True)
        self.session.model = build_model(turned.orbit.system)
        self.say(f"{name} = {value:.6g}: the orbit follows")
        return True

    def _holds(self) -> str:
        """What of the mechanism can be taken hold of, for the stage: links of a chain, or points."""
        model = self.session.model
        return f"{json.dumps(draggable(model))}, {json.dumps(pullable(model, np.asarray(self.state)))}"

    async def _keep(self) -> None:
        if self.orbit is None:
            raise InputError("find an orbit first; then it follows the parameters and can be kept")
        await self._found(self.session.problem_of(replace(self.orbit, expected={}), self.taken))

    def _save(self) -> None:
        written = self.session.save()
        self._list()
        self.say(f"{plural(len(written), 'file')} saved in {self.session.out}" if written else "nothing new to save")

    def _list(self) -> None:
        """The tree of what was found and the command lines."""
        nodes = self.tree.props["nodes"] = self.session.tree()
        self.tree.set_visibility(bool(nodes))
        self.none.set_visibility(not nodes)
        self.tree.update()
        self.tree.expand()
        self.commands.set_content("\n".join(self.session.commands()))
        self.commands.set_visibility(bool(self.session.commands()))

    async def _selected(self, event: Any) -> None:
        item = self.session.items.get(str(event.value))
        if item is None:
            return
        if item.family is not None:
            self._show_family(item)
            ui.run_javascript(f"stage.turn({int(self.slide.value)})")
            return await self._slide_to(int(self.slide.value))
        self.item = item
        if item.atlas is not None:
            return self.background.show(item)
        self._show_orbit(await self.quick.do("opened", item.file))

    async def _load_member(self, name: str, number: int) -> None:
        """Show an orbit of an atlas by its id, to go on from."""
        atlas = self.session.items[name]
        shown: FilmedOrbit = await self.quick.do("opened", Path(f"{atlas.file}#{number}"))
        self.item = self.session.keep_member(atlas, number, shown.orbit)
        self._list()
        self._show_orbit(shown)
        self.say(f"orbit {number} of {name}")

    def _recoloured(self, dark: bool) -> None:
        self.dark = dark
        self.theme.set_value(dark)
        self.near.update_figure(self._near())
        self.plot.update_figure(self._figure())
        self.section.recolour()
        if self.rest is not None:
            self.rest.recolour()
        ui.run_javascript("setTimeout(stage.recolour, 50)")


def _title(text: str) -> None:
    ui.html(f"<h2>{text}</h2>", sanitize=False)


def _js(value: Any) -> str:
    return json.dumps(bool(value))


def _range(value: float, angle: bool) -> tuple[float, float]:
    """How far a slider of a state goes."""
    if angle and abs(value) <= math.pi:
        return -math.pi, math.pi
    reach = max(2.0 * abs(value), 3.0)
    return -reach, reach


def _readout(run: Simulated, model: Model) -> str:
    """What a simulation says."""
    level, system = "", model.system
    if run.energy is not None:
        known, kept = (measured(x, "energy", system, digits) for x, digits in ((run.energy, 6), (run.change, 1)))
        level = f"E = {known}, {'kept to' if model.conservative else 'changes by'} {kept}, "
    events = "".join(f"{plural(often, name)}, " for name, often in run.events)
    events += f"{run.stopped}; " if run.stopped else ""
    return f"{level}{events}{plural(len(run.returns), 'close return')} in {lasting(run.film['period'], system, 6)}"
