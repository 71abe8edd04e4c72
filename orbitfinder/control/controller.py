"""A controller that holds a motion on an orbit: plain numbers and their file, controller.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.records.certificate import Certified, certified
from orbitfinder.records.codec import Codec, Complexes, check_shapes
from orbitfinder.records.reading import Table


@dataclass(frozen=True)
class Returned:
    """What became of `count` disturbed motions of a `size`, in extents of the orbit.

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

    `stabilised` is True where the certificate holds. Numbers over the period are at N + 1 equal times; a spline of
    degree 5 is between, periodic unless an event ends the period.

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
        event: the transition that ends a period of a hybrid system, after which tau begins anew at 0; "" without.
        title: the orbit's.

    Examples:
        >>> bool(np.abs(controller.multipliers).max() < 1)
        True
    """

    __repr__ = brief("name", "actuators", "period", "multipliers", "certificate")
    _entries = (..., "stabilised")
    _sparse = ("title",)

    name: str
    system: Table
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
    open_loop: Complexes
    predicted: Complexes
    multipliers: Complexes
    authority: Mapping[str, float]
    certificate: Certified = None
    basin: Basin | None = None
    provenance: Table = field(default_factory=dict)
    event: str = ""
    title: str = ""

    @property
    def stabilised(self) -> bool:
        """True where the certificate holds: the nonlinear closed loop's multipliers are inside the unit circle."""
        return certified(self)

    def near(self, periods: int) -> float:
        """The share of a disturbance that may be left after so many periods: ten times what the largest multiplier
        leaves, from a hundredth to half."""
        return float(np.clip(10.0 * np.abs(self.multipliers).max() ** periods, 0.01, 0.5))

    def _check(self) -> None:
        rows, d = self.states.shape if self.states.ndim == 2 else (0, 0)
        m = len(self.actuators)
        if rows < 4 or not m or not self.multipliers.size:
            raise ValueError(f"states, actuators, multipliers: expected 4, 1 and 1 at least, got {rows}, {m} and "
                             f"{self.multipliers.size}")  # fmt: skip
        if wrong := [name for name in self.actuators if not name.isidentifier()] or [self.event] * (
            not self.event.isprintable()
        ):
            raise ValueError(f"actuators, event: {wrong[0]!a} is not a name")
        check_shapes(self, states=(rows, d), inputs=(rows, m), gains=(rows, m * d), units=(d,), angles=(d,),
                     control_units=(m,), weight_state=(d, d), weight_control=(m, m))  # fmt: skip
        if not (self.period > 0 and np.all(self.units > 0)):
            raise ValueError("period and units: must be positive")
        if unknown := sorted(set(self.limits) - set(self.actuators)):
            raise ValueError(f"limits: {unknown[0]!r} is none of the actuators")


CODEC = Codec(Controller, "controller", "`orbitfinder stabilise`", "stabilise the orbit again")


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
    return CODEC.save(controller, path)


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
    return CODEC.load(path)
