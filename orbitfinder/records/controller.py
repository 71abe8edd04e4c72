"""A controller that holds a motion on an orbit: plain numbers and their file, controller.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.errors import InputError
from orbitfinder.records.orbit import Certificate, Check, certificate_to_document
from orbitfinder.records.reading import json_bytes, json_file, plain_numbers, read_as, walked, write_atomically

FORMAT, VERSION = "orbitfinder/controller", 1
AGAIN = "stabilise the orbit again"


@dataclass(frozen=True)
class Returned:
    """What became of `count` disturbed motions of one `size`, in extents of the orbit.

    `peak` and `rms` are the greatest magnitude and the root mean square, over all motions that returned, of each
    control's difference from what the orbit itself takes, in its own unit.
    """

    size: float
    count: int
    returned: int
    peak: np.ndarray
    rms: np.ndarray


@dataclass(frozen=True)
class Basin(Shown):
    """Seeded disturbances of the nonlinear system under a sampled controller, and how many of them returned.

    `rate` samples and control values a period, held between; `noise` is the standard deviation of what is measured, in
    extents of the orbit. Returned: all along the last of so many `periods` within `near`, a share of the disturbance,
    and three times what noise alone does. It is a hundredth, more where the largest multiplier leaves more by then.
    """

    __repr__ = brief("rows", "periods", "noise")

    rows: tuple[Returned, ...]
    periods: int
    rate: int
    noise: float
    seed: int
    near: float


@dataclass(frozen=True)
class Controller(Shown):
    """u = u*(tau) - K(tau) (x - x*(tau)), tau the place (s) of the orbit nearest to x, or with `clock` the time.

    `stabilised` is True where the certificate holds. Numbers over the period are at N + 1 equal times; a periodic
    cubic spline is between.

    Args:
        name: a word for files.
        system: plain description that rebuilds the model.
        actuators: the parameters that it sets (m).
        period: of the orbit, s.
        clock: whether tau is the time.
        units: in which nearest is measured (d), the extents of the orbit.
        angles: 1 where a difference is taken within half a turn (d).
        states: x* (N + 1 x d).
        inputs: u* (N + 1 x m).
        gains: K (N + 1 x m d, row after row).
        limits: lowest and highest of controls, by name.
        weight_state: Q.
        weight_control: R.
        control_units: in which controls are weighed (m).
        open_loop: multipliers of deviations from the orbit without control.
        predicted: those of the linear design.
        multipliers: those found by integrating the nonlinear closed loop.
        authority: of each actuator alone, at rms 1 in `control_units`, how far it moves in a period, in extents, the
            deviation that it moves least of those that do not decay, or of all where all do; 0: it cannot.
        certificate: its checks.
        basin: what `of.basin` measured.
        provenance: how it was designed.

    Examples:
        >>> bool(np.abs(controller.multipliers).max() < 1)
        True
    """

    __repr__ = brief("name", "actuators", "period", "multipliers", "certificate")

    name: str
    system: Mapping[str, Any]
    actuators: tuple[str, ...]
    period: float
    clock: bool
    units: np.ndarray
    angles: np.ndarray
    states: np.ndarray
    inputs: np.ndarray
    gains: np.ndarray
    limits: Mapping[str, tuple[float, float]]
    weight_state: np.ndarray
    weight_control: np.ndarray
    control_units: np.ndarray
    open_loop: np.ndarray
    predicted: np.ndarray
    multipliers: np.ndarray
    authority: Mapping[str, float]
    certificate: Certificate | None = None
    basin: Basin | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def stabilised(self) -> bool:
        """True where the certificate holds: the nonlinear closed loop's multipliers are inside the unit circle."""
        return self.certificate is not None and self.certificate.passed


def controller_to_document(controller: Controller) -> dict[str, Any]:
    """The JSON document of a controller; floats round-trip exactly."""
    entries = {one.name: getattr(controller, one.name) for one in fields(Controller)}
    basin = controller.basin
    if basin is not None:
        entries["basin"] = vars(basin) | {"rows": [dict(vars(row)) for row in basin.rows]}
    entries["certificate"] = certificate_to_document(controller.certificate)
    entries["stabilised"] = controller.stabilised
    return {"format": FORMAT, "version": VERSION} | {name: walked(one, plain_numbers) for name, one in entries.items()}


def save_controller(controller: Controller, path: str | Path) -> Path:
    """Write a controller.json.

    Args:
        controller: what to write.
        path: where.

    Returns:
        The path.

    Raises:
        InputError: where it cannot be written.

    Examples:
        >>> of.save_controller(controller, "controller.json").name
        'controller.json'
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(target, json_bytes(controller_to_document(controller)))
    return target


@dataclass(frozen=True)
class _Certified:
    """The `certificate` entry of the file."""

    checks: tuple[Check, ...] = ()
    scale: float = 1.0


def load_controller(path: str | Path) -> Controller:
    """Read a controller.json.

    Args:
        path: of the file.

    Returns:
        A Controller.

    Raises:
        InputError: on anything that is none.

    Examples:
        >>> _ = of.save_controller(controller, "controller.json")
        >>> of.load_controller("controller.json").actuators
        ('torque1',)
    """
    source = Path(path)
    document = json_file(source, "controller.json", AGAIN)
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InputError(f"{source}: format: expected {FORMAT!r}; give a controller.json, which `stabilise` writes")
    if document.get("version") != VERSION:
        raise InputError(
            f"{source}: version: this orbitfinder reads {VERSION}, got {document.get('version')!r}; "
            "use the orbitfinder that wrote it, or stabilise the orbit again"
        )
    complexes = ("open_loop", "predicted", "multipliers")
    plain = {name: entry for name, entry in document.items() if name not in (*complexes, "certificate")}
    spectra = {name: read_as(tuple[complex, ...], document.get(name), f"{source}: {name}", AGAIN) for name in complexes}
    given = read_as(_Certified, document.get("certificate") or {}, f"{source}: certificate", AGAIN)
    found: Controller = read_as(Controller, plain | {name: [0.0] for name in complexes}, str(source), AGAIN)
    entries = {one.name: getattr(found, one.name) for one in fields(Controller)}
    entries |= {name: np.array(one, complex) for name, one in spectra.items()}
    entries["certificate"] = Certificate(given.checks, given.scale) if given.checks else None
    made = Controller(**entries)
    _check_shapes(made, source)
    return made


def _check_shapes(found: Controller, source: Path) -> None:
    """`InputError` unless the tables of a controller belong together."""
    rows, d = found.states.shape if found.states.ndim == 2 else (0, 0)
    m = len(found.actuators)
    wanted = {"states": (rows, d), "inputs": (rows, m), "gains": (rows, m * d), "units": (d,), "angles": (d,),
              "control_units": (m,), "weight_state": (d, d), "weight_control": (m, m)}  # fmt: skip
    for name, shape in wanted.items():
        if rows < 4 or not m or getattr(found, name).shape != shape:
            raise InputError(
                f"{source}: {name}: shape {getattr(found, name).shape} where {shape} belongs to {m} controls and {d} "
                f"states; {AGAIN}"
            )
    if not (found.period > 0 and np.all(found.units > 0)):
        raise InputError(f"{source}: period and units: must be positive; {AGAIN}")
    if unknown := sorted(set(found.limits) - set(found.actuators)):
        raise InputError(f"{source}: limits: {unknown[0]!r} is none of the actuators; {AGAIN}")
