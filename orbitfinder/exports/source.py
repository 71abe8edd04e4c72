"""What every exporter starts from: an orbit, its equations as one function, and its dense samples."""

from __future__ import annotations

import re
from dataclasses import dataclass

import casadi as ca
import numpy as np

from orbitfinder._runtime.version import __version__
from orbitfinder.integrate.cvodes import build_flow, sample
from orbitfinder.mechanics.catalogue import build_model
from orbitfinder.mechanics.model import Model, vector_field
from orbitfinder.records.orbit import Orbit

SAMPLES = 513
"""Points of one period when orbit.npz is missing."""


@dataclass(frozen=True)
class Source:
    """An orbit ready to be written out.

    `rate(t, x, s, p)` is dx/dt (2n) with unfolding parameters s and all physical parameters p;
    `energy(x, p)` is the total energy (J). `times` (k, s) and `samples` (k x 2n) cover one period.
    """

    orbit: Orbit
    model: Model
    rate: ca.Function
    energy: ca.Function
    times: np.ndarray
    samples: np.ndarray

    @property
    def identifier(self) -> str:
        """The orbit's name as a word that every language accepts."""
        word = re.sub(r"\W", "_", self.orbit.name, flags=re.ASCII)
        return word if word[:1].isalpha() else f"orbit_{word}"

    @property
    def heading(self) -> list[str]:
        """Comment lines for the top of a file: what this is and where it comes from."""
        title = " ".join((self.orbit.title or self.orbit.name).split())
        plain = "".join(letter if letter.isprintable() and letter.isascii() else "?" for letter in title)
        return [
            f"{plain.replace('*/', '* /')}",
            f"period {self.orbit.period!r} s, energy {self.orbit.energy!r} J",
            f"written by orbitfinder {__version__}",
        ]


def source_of(orbit: Orbit, model: Model | None = None) -> Source:
    """The Source of an orbit. `model` is needed only for systems that no file describes."""
    model = model or build_model(orbit.system)
    n = model.degrees_of_freedom
    rate = vector_field(model, model.parameter_names, model.invariants)
    x, p = ca.SX.sym("x", 2 * n), ca.SX.sym("p", len(model.parameter_names))
    total = model.kinetic(x[:n], x[n:], p) + model.potential(x[:n], p)
    times, samples = orbit.times, orbit.samples
    if len(samples) < 2:
        times = np.linspace(0.0, orbit.period, SAMPLES)
        samples = sample(build_flow(model), orbit.state, orbit.period, SAMPLES)
    return Source(orbit, model, rate, ca.Function("energy", [x, p], [total]), times, samples)


def dense_states(source: Source, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Equal times (rows) over the period and the states there (rows x 2n), by cubic Hermite interpolation."""
    from scipy.interpolate import CubicHermiteSpline

    p, samples = source.model.parameter_values, source.samples
    none = np.zeros(len(source.model.invariants))
    slopes = [source.rate(t, x, none, p).full().ravel() for t, x in zip(source.times, samples, strict=True)]
    times = np.linspace(0.0, source.orbit.period, rows)
    return times, CubicHermiteSpline(source.times, samples, np.asarray(slopes))(times)
