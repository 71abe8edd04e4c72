"""The kinds of [system] that are mechanisms, and the systems that come with this library, for the registry of kinds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from orbitfinder.mechanics.kind import CLOSING, FUNCTIONS, KINDS, SystemKind
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanisms import library, structure  # noqa: F401 - enters itself
from orbitfinder.mechanisms.chain import chain, chain_dae
from orbitfinder.mechanisms.chain_motion import field_of, motion_of, works_of
from orbitfinder.mechanisms.closing import JOINED, minimal_mechanism
from orbitfinder.mechanisms.driven import DRIVEN
from orbitfinder.mechanisms.linkage import LOOPS, linkage, minimal_linkage
from orbitfinder.mechanisms.machines import MACHINES
from orbitfinder.mechanisms.mechanism import mechanism
from orbitfinder.records.reading import Table


def _built(builder: Callable[..., Model], system: Table, *without: str) -> Model:
    return builder(**{key: value for key, value in system.items() if key not in ("kind", *without)})


def _linkage(system: Table, _: Path | None) -> Model:
    model = _built(linkage, system, "independent", "branch")
    chosen = system.get("independent")
    return model if chosen is None else minimal_linkage(model, chosen, system.get("branch", 1))


def _mechanism(system: Table, _: Path | None) -> Model:
    model = _built(mechanism, system, "independent")
    return minimal_mechanism(model, system["independent"]) if "independent" in system else model


def _pendulum(system: Table) -> str:
    links = str(system.get("links"))
    words = {"1": "single", "2": "double", "3": "triple", "4": "quadruple", "5": "quintuple", "6": "sextuple"}
    return f"{words.get(links, f'{links}-link')} pendulum"


def _bars(system: Table) -> str:
    lengths = system.get("length")
    bars = len(lengths) + 1 if isinstance(lengths, list) else 0
    words = {3: "three-bar", 4: "four-bar", 5: "five-bar", 6: "six-bar", 7: "seven-bar", 8: "eight-bar"}
    return f"{words.get(bars, f'{bars}-bar')} linkage"


KINDS.update(
    chain=SystemKind(
        lambda system, _: _built(chain_dae, system, "formulation") if "baumgarte" in system else _built(chain, system),
        _pendulum, takes=chain, reread=True, pendulum=True, joints=lambda system: int(system["links"]),
        motion=motion_of, field=field_of, works=works_of,
    ),
    linkage=SystemKind(
        _linkage, _bars, takes=linkage, reread=True, joints=lambda system: len(system["length"]) + 1, loops=LOOPS
    ),
    mechanism=SystemKind(
        _mechanism, lambda system: f"{'spatial' if system.get('dimension') == 3 else 'planar'} mechanism",
        takes=mechanism, drawn=True, loops=JOINED,
    ),
)  # fmt: skip
CLOSING[""] = replace(JOINED, minimal=None)  # other constraints have no minimal form
FUNCTIONS.update(library.FUNCTIONS | MACHINES | DRIVEN)
