"""The stage in a notebook: an orbit, or a family to slide along, in Jupyter, VS Code and marimo (anywidget).

The player is that of the pages (`site/assets/core.js`), the pictures are those of the static displays; nothing is
loaded from anywhere. Where no widget can run, as on GitHub, the static display is shown.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder import site
from orbitfinder.errors import InputError
from orbitfinder.mechanics.scales import lasting, measured, units
from orbitfinder.records.family import Event, Family, FamilyPoint
from orbitfinder.records.orbit import Orbit
from orbitfinder.records.reading import Entries, finite
from orbitfinder.show import html
from orbitfinder.show.diagram import diagram_of
from orbitfinder.show.facts import numbers
from orbitfinder.show.svg import diagram, plane_of
from orbitfinder.site.motion import Filmed, Simulator, framed, packed
from orbitfinder.site.pages import before, pickable

try:
    import anywidget
    import traitlets
except ImportError as error:
    raise InputError(
        "widget: needs anywidget; pip install 'orbitfinder[notebook]'. Without it the last expression of a cell still "
        "shows the orbit or the family, moving"
    ) from error

ASSETS, SITE = Path(__file__).parent / "assets", Path(site.__path__[0]) / "assets"


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


class Stage(anywidget.AnyWidget):  # type: ignore[misc]
    """An orbit or a family in motion. `index` says which of its orbits is shown (events count too), `playing` and
    `speed` how; all three may be set and observed. `picked` is the Orbit, FamilyPoint or Event shown."""

    _esm = _text(SITE / "core.js") + _text(ASSETS / "widget.js")
    # the palette of the pages, in the widget alone
    _css = _text(SITE / "page.css").partition("\n* {")[0].replace(":root", ".orbitfinder") + _text(
        ASSETS / "widget.css"
    )

    shown = traitlets.Dict().tag(sync=True)
    index = traitlets.Int(0).tag(sync=True)
    playing = traitlets.Bool(True).tag(sync=True)
    speed = traitlets.Float(1.0).tag(sync=True)

    def __init__(self, value: Orbit | Family) -> None:
        self.value = value
        self.members: list[Orbit | Event] = (
            [value] if isinstance(value, Orbit) else [value.members[at] for at in pickable(value)]
        )
        super().__init__(shown=_shown(value, self.members))

    @traitlets.validate("index")  # type: ignore[untyped-decorator]
    def _within(self, proposal: Any) -> int:
        if not 0 <= proposal["value"] < len(self.members):
            raise InputError(f"index: {proposal['value']}; it goes from 0 to {len(self.members) - 1}")
        return int(proposal["value"])

    @traitlets.validate("speed")  # type: ignore[untyped-decorator]
    def _positive(self, proposal: Any) -> float:
        if not 0 < proposal["value"] < np.inf:
            raise InputError(f"speed: {proposal['value']}; give a positive number, 1 for real time")
        return float(proposal["value"])

    @property
    def picked(self) -> Orbit | Event:
        """What is shown now."""
        member: Orbit | Event = self.members[self.index]
        return member

    def __repr__(self) -> str:
        return f"Stage({self.value!r})"

    def _repr_mimebundle_(self, **kwargs: Any) -> Any:
        """The widget, and beside it the static display for where no widget runs."""
        data, metadata = super()._repr_mimebundle_(**kwargs)
        static = html.html(self.value)
        return ({**data, "text/html": static} if static else data), metadata


def stage(value: Orbit | Family) -> Stage:
    """The widget of an orbit or a family."""
    if isinstance(value, Family) and not value.points:
        raise InputError(f"family: {value.name} has no orbits to show; continue it first")
    return Stage(value)


def _shown(value: Orbit | Family, members: list[Orbit | Event]) -> Entries:
    """What the script works with: the items with their motions, pictures and texts, and what they share."""
    simulator, family = Simulator(), value if isinstance(value, Family) else None
    motions = [
        simulator.member(value.system, member) if isinstance(member, FamilyPoint | Event) else simulator.of(member)
        for member in members
    ]
    items = [
        _texts(family, member)
        | {"period": member.period, "motion": packed(motion) if motion else None, "portrait": portrait}
        for member, motion, portrait in zip(members, motions, _portraits(simulator, value.system, motions), strict=True)
    ]
    shown = {
        "items": items,
        "solids": simulator.solids,
        "title": "",
        "below": "",
        "diagram": "",
        "time": units(value.system)["time"],
    }
    if isinstance(value, Orbit):
        shown |= {"title": value.title or value.name, "below": value.source}
    if family is not None:
        drawn = diagram_of(family)
        places = plane_of(drawn).place(drawn.places).round(1).tolist()
        for item, at in zip(items, pickable(family), strict=True):
            item["place"] = places[at]
        shown |= {"title": f"Family {family.name}", "diagram": diagram(drawn)}
    frame = framed(items)
    if frame and family and any(motion.drawn == "mechanism" for motion in motions if motion):
        shown["frame"] = frame | {"unit": units(value.system)["length"]}
    return finite(shown)  # type: ignore[no-any-return]


def _portraits(simulator: Simulator, system: Any, motions: list[Filmed | None]) -> list[str]:
    """Phase portraits, all of the plane in which most moves and on the same axes; empty where there is no motion."""
    known = simulator.model(system)
    if known is None or not any(motions):
        return [""] * len(motions)
    model = known[0]
    seen = [motion and motion.course for motion in motions]
    plane = max((html.Portrait(model, course) for course in seen if course), key=lambda course: course.extent).plane
    drawn = [course and html.Portrait(model, course, plane) for course in seen]
    around = html.range_of([portrait for portrait in drawn if portrait])
    return [portrait.svg(around) if portrait else "" for portrait in drawn]


def _texts(family: Family | None, member: Orbit | Event) -> Entries:
    """The numbers of an orbit in words, its multipliers beside the unit circle, and what it is called on the slider."""
    if isinstance(member, Orbit):
        rows, label = numbers(member), ""
        if family is not None:
            rows = rows[:2] + _parameter(family, member.value) + rows[2:-1]  # type: ignore[attr-defined]
        return {"rows": rows, "circle": html.circle(member), "label": label}
    assert family is not None
    point = before(family, member)
    rows = [("event", member.words), ("period", lasting(member.period, family.system)),
            ("energy", measured(member.energy, "energy", family.system, 12)),
            *_parameter(family, member.parameter), ("stability before", point.stability)]  # fmt: skip
    return {"rows": rows, "circle": html.circle(point), "label": member.words}


def _parameter(family: Family, value: float) -> list[tuple[str, str]]:
    """The row of a parameter that is neither energy nor period."""
    return [] if family.unit else [(family.parameter, f"{value:.12g}")]
