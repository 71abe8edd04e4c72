"""What a search returns: plain numbers that outlive CasADi, and their file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np

from orbitfinder._runtime import notebook as display
from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.errors import InputError
from orbitfinder.records.certificate import Certified
from orbitfinder.records.codec import Complexes, Dense, Filed, Unknown, check_format, entries_of
from orbitfinder.records.control import check_control
from orbitfinder.records.reading import (
    Entries,
    Table,
    arrays,
    content_digest,
    json_bytes,
    json_file,
    plain_numbers,
    typed,
    write_atomically,
    write_npz,
)

FORMAT, VERSION = "orbitfinder/orbit", 1
AGAIN = "run the problem again"
SHARE = "share_"
"""What the name of the parameter begins with that says how much of the period an arc of a hybrid orbit takes"""
SHIFT = "shift_"
"""In front of a coordinate's name: how far a relative orbit shifts in it, among expected numbers."""


@dataclass(frozen=True)
class _Expectation:
    value: float
    tolerance: float


Expected = Annotated[
    Mapping[str, tuple[float, float]],
    Filed(
        lambda told: {name: _Expectation(*pair) for name, pair in told.items()},
        lambda entry, where: {
            name: (told.value, told.tolerance) for name, told in typed(dict[str, _Expectation], entry, where).items()
        },
    ),
]
"""Numbers that are expected of an orbit, each with a tolerance"""


@dataclass(frozen=True)
class Orbit(Shown):
    """A periodic orbit: a state and its minimal period, and what follows from them.

    Args:
        name: a word for files.
        system: plain description that rebuilds the model.
        state: at t = 0 (2n).
        period: the minimal one, s.
        energy: J; of first-order systems the first invariant that no symmetry belongs to, nan (null in the file)
            where there is none.
        action: integral of momentum.dq over the loop, J s; of first-order systems the integral of |x'|^2.
        closure: the largest gap round the loop by the independent integrator.
        symmetry: what the orbit has, as in `Problem`.
        winding: whole turns of each coordinate in a period (n).
        floquet_multipliers: the non-trivial ones (complex).
        pair_defect: max |mu_i mu_j - 1| over reciprocal pairs, their error bar.
        stability: elliptic | marginal | unstable, or of dissipative systems asymptotically stable.
        unfolding: what the unfolding parameters came back as: 0 but for round-off.
        nodes: states at equal times over the period (N x 2n).
        times: of the dense picture of the orbit (k, s).
        samples: states at these times (k x 2n).
        tolerance: the closure that the certificate asks for.
        expected: what the problem expected of it.
        certificate: its checks; None before.
        provenance: how it came about.
        title: a line for people.
        source: where the numbers come from.
        proof: the record of its proof, if there is any.
        record: the file that it was read from.
        shift: of a relative orbit, how far its cyclic coordinates go in a period.
        control: of a controlled motion, how its controls vary and what they cost.

    Examples:
        >>> orbit
        Orbit(name='fast-swing', period=1.1193409, energy=-18, ... certificate=Certificate(passed=True, ...))
        >>> np.abs(orbit.floquet_multipliers).round(9)
        array([1., 1.])

    See Also:
        `of.load_orbit`, `of.save_orbit`, `of.save_figures`, `of.follow_family`.
    """

    __repr__ = brief("name", "period", "energy", "closure", "symmetry", "stability", "certificate")
    _entries: ClassVar[tuple[str, ...]] = (
        "name", "title", "source", "system", "state", "period", "energy", "action", "closure", "symmetry", "winding",
        "floquet_multipliers", "pair_defect", "stability", "unfolding", "tolerance", "nodes", "expected", "certificate",
        "provenance", "shift", "control",
    )  # fmt: skip
    _sparse: ClassVar[tuple[str, ...]] = ("shift", "control")

    name: str
    system: Table
    state: np.ndarray
    period: float
    energy: Unknown
    action: float
    closure: float
    symmetry: str
    winding: tuple[int, ...]
    floquet_multipliers: Complexes
    pair_defect: float
    stability: str
    unfolding: tuple[float, ...]
    nodes: np.ndarray
    times: Dense
    samples: Dense
    tolerance: float
    expected: Expected = field(default_factory=dict)
    certificate: Certified = None
    provenance: Table = field(default_factory=dict)
    title: str = ""
    source: str = ""
    proof: Table | None = None
    record: str | None = field(default=None, compare=False)
    shift: Mapping[str, float] = field(default_factory=dict)

    control: Table | None = None

    def _check(self) -> None:
        described = {"period", "energy", "action", *self.system, *self.system.get("arguments", {})}
        described |= {f"{SHIFT}{name}" for name in self.shift}
        if np.isnan(self.energy) and not unconserved(self):
            raise ValueError("energy: missing, that of a mechanical system")
        if not 0 < self.tolerance < 1:
            raise ValueError(f"tolerance: expected between 0 and 1, got {self.tolerance}")
        if unknown := [name for name in self.expected if not {name, name.rstrip("0123456789")} & described]:
            raise ValueError(f"expected: {unknown[0][:60]!a} is nothing that an orbit of this system has")
        if self.control is not None:
            check_control(self.control, self.state.size)

    def widget(self) -> Any:
        """The orbit on a stage with play, speed and a slider in time, for Jupyter, VS Code and marimo; of a point of a
        family that point alone. Raises `InputError` without the extra [notebook]."""
        return display.stage(self)


OFTEN_EMPTY = ("winding", "nodes", "expected", "certificate", "provenance", "shift")
"""Entries that say nothing where they are empty or null"""


def orbit_to_document(orbit: Orbit) -> Entries:
    """The JSON document of an orbit (the contract of orbit.json); floats round-trip exactly."""
    document = {"format": FORMAT, "version": VERSION, **entries_of(orbit, Orbit)}
    if not unconserved(orbit):
        document["energy"] = plain_numbers(orbit.energy)  # nan is no energy of a mechanical system
    document["record"] = digest(document)
    return document if orbit.proof is None else document | {"proof": dict(orbit.proof)}


def refuse_controlled(orbit: Any, what: str) -> None:
    """`InputError` where something is asked of a controlled orbit that only motions without control have."""
    if getattr(orbit, "control", None) is not None:
        raise InputError(f"{what}: {orbit.name} is a controlled orbit; give one without control, or state the problem "
                         "again with other pins and limits (of.Control)")  # fmt: skip


def level(energy: float | None) -> float:
    """An energy (J), as recorded or in memory, to sort and to measure by: 0 where none is conserved."""
    return 0.0 if energy is None else float(np.nan_to_num(energy))


def unconserved(orbit: Orbit) -> bool:
    """True for the orbit of a first-order system, which has as many turns as components, without an energy."""
    return bool(np.isnan(orbit.energy)) and len(orbit.winding) == orbit.state.size


DIGESTED = (
    "system", "state", "period", "energy", "action", "closure", "symmetry", "winding",
    "floquet_multipliers", "pair_defect", "stability", "unfolding", "tolerance", "nodes", "expected",
)  # fmt: skip


def incomputable(state: np.ndarray, period: float, farthest: float = 1e100) -> str:
    """What squares or inverses overflow of, of a state (d) and a period (s), in words; "" where they do not."""
    sizes = ("state", float(np.abs(state).max(initial=0.0)), 0.0), ("period", period, 1 / farthest)
    wrong = [
        f"{name}: {size:g} is nothing to compute with" for name, size, least in sizes if not least <= size < farthest
    ]
    return wrong[0] if wrong else ""


def system_at(system: Table, values: Mapping[str, float]) -> Table:
    """The description of a system with some physical parameters changed: `length3` is the third entry of `length`.

    Shares of arcs, which solvers free too, are no part of it.
    """
    physical = {name: float(value) for name, value in values.items() if not name.startswith(SHARE)}
    if not physical:
        return system
    if "function" in system:
        return {**system, "arguments": {**system.get("arguments", {}), **physical}}
    if "bodies" in system:
        return {**system, "values": {**system.get("values", {}), **physical}}
    if "parameters" in system:
        return {**system, "parameters": {**system["parameters"], **physical}}
    changed = dict(system)
    for name, value in physical.items():
        entry = name.rstrip("0123456789")
        if entry == name and name in changed:
            changed[name] = value
        elif entry in changed:
            column = list(changed[entry])
            column[int(name[len(entry) :]) - 1] = value
            changed[entry] = column
    return changed


def digest(document: Table) -> str:
    """SHA-256 of the numbers of an orbit document, independent of its layout on disk."""
    relative = {name: document[name] for name in ("shift", "control") if document.get(name)}
    return content_digest({name: document.get(name) for name in DIGESTED} | relative)


def recorded_proof(document: Table) -> Table | None:
    """The proof that an orbit document says it has; None without any, and where it is of another orbit's numbers.

    It is a claim until `orbitfinder verify --proof` does it again.
    """
    proof = document.get("proof")
    verdicts = ("linearly stable", "asymptotically stable", "unstable", "open")
    if not isinstance(proof, Mapping) or proof.get("proved") is not True or proof.get("stability") not in verdicts:
        return None
    try:
        level, period = proof["energy"], float(document["period"])
        apart = abs(float(proof["period"]["value"]) - period)
        near = apart <= float(proof["period_distance"]) + np.spacing(period)
        return proof if near and (level is None or float(level["value"]) == document["energy"]) else None
    except (KeyError, TypeError, ValueError):
        return None


def save_orbit(orbit: Orbit, path: str | Path) -> Path:
    """Write an orbit.json and, beside it, the dense samples in orbit.npz.

    Args:
        orbit: what to write.
        path: of the JSON.

    Returns:
        The path of the JSON.

    Raises:
        InputError: where it cannot be written, and for what is no number.

    Examples:
        >>> of.save_orbit(orbit, "kept/orbit.json").name
        'orbit.json'
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    text = json_bytes(orbit_to_document(orbit))  # refuses what is no number before anything is written
    write_npz(target.with_suffix(".npz"), {"times": orbit.times, "samples": orbit.samples})
    write_atomically(target, text)
    return target


def read_orbit(source: Path) -> Orbit:
    """The Orbit of an orbit.json (and orbit.npz if it is there). Raises `InputError` on anything unreadable."""
    orbit = orbit_from_document(json_file(source, "orbit.json", AGAIN), str(source))
    beside, size = source.with_suffix(".npz"), orbit.state.size
    times, samples = np.zeros(0), np.zeros((0, size))
    if beside.exists():
        dense = arrays(beside, ("times", "samples"), AGAIN)
        times, samples = dense["times"].astype(float), dense["samples"].astype(float)
        fits = times.ndim == 1 and samples.shape == (times.size, size) and times.size != 1
        # times increase; those of a hybrid orbit's events come twice, with the state before and the state after
        if not fits or np.any(np.diff(times) < 0) or np.any(times[2:] <= times[:-2]):
            raise InputError(f"{beside}: damaged (its times and states do not fit together or the orbit); {AGAIN}")
    return replace(orbit, times=times, samples=samples)


def read_document(source: Path) -> Entries:
    """The checked JSON document at a path."""
    return check_document(json_file(source, "orbit.json", AGAIN), str(source))


def check_document(document: Any, where: str) -> Entries:
    """The same document, if it is that of an orbit, or `InputError`; what is in it `orbit_from_document` reads."""
    several = isinstance(document, (list, dict)) and document and (isinstance(document, list) or "points" in document)
    give = f"give an orbit.json{f', or one orbit of the file: {where}#0' if several else ''}"
    return check_format(document, FORMAT, VERSION, where, give, AGAIN)


def orbit_from_document(document: Any, where: str = "orbit document") -> Orbit:
    """The Orbit of an orbit document, without samples; `InputError` names where the document is from."""
    document = check_document(document, where)
    told = {name: entry for name, entry in document.items() if entry or name not in OFTEN_EMPTY}
    try:
        size = np.size(told.get("state", ()))
        usual = {"winding": [0] * (size // 2), "nodes": [told.get("state")], "pair_defect": 0.0, "unfolding": [],
                 "tolerance": 1e-12}  # fmt: skip
        if "certificate" in told:  # 0.1 wrote the closure only beside it
            told["certificate"] = {"closure": document.get("closure")} | dict(told["certificate"])
        dense = {"times": np.zeros(0), "samples": np.zeros((0, size))}
        orbit: Orbit = typed(Orbit, usual | told | dense, "")
    except (TypeError, ValueError, KeyError, AttributeError, OverflowError) as error:
        raise InputError(f"{where}: malformed entry ({error}); {AGAIN}") from error
    return orbit


def _orbits(entries: Any, where: str) -> tuple[Orbit, ...]:
    several = typed(tuple[Any, ...], entries, where)
    return tuple(orbit_from_document(document, f"{where}[{k}]") for k, document in enumerate(several))


Orbits = Annotated[tuple[Orbit, ...], Filed(lambda orbits: list(map(orbit_to_document, orbits)), _orbits)]
"""Orbits, each with its own format and digest"""
