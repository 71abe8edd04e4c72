"""A loop's single segment in more digits than doubles have: past close encounters round-off grows to too much."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from orbitfinder.integrate.extended import Extended, extended
from orbitfinder.integrate.field import CasadiField
from orbitfinder.integrate.march import Varied
from orbitfinder.integrate.rk8 import variational_field
from orbitfinder.loops.loop import Equations, Unknowns
from orbitfinder.mechanics.kind import system_kind
from orbitfinder.mechanics.model import inputs_of, vector_field


@dataclass(frozen=True)
class Wide:
    """What integrates it, with its states measured in `units` (d), and an integrand that there may be in `work`."""

    equations: Equations
    states: Extended
    variations: Extended
    units: np.ndarray
    work: float
    numbers: np.ndarray

    def ends(self, w: Unknowns) -> np.ndarray:
        """The end (1 x d) of the segment. Raises `IntegrationError`, as `varied` does."""
        return self.along(w, np.array([0.0, w.edges[-1]]), 1 / 64)[1:]

    def along(self, w: Unknowns, moments: np.ndarray, first: float = 1.0) -> np.ndarray:
        """The states (k x d) at moments (k, in periods)."""
        given = self.units, w.nodes[0], moments * w.period, self._free(w), first
        return self.states.along(*given)[:, 0].astype(float)

    def varied(self, w: Unknowns) -> Varied:
        """The segment with its derivatives."""
        size, more, last, work = self.units.size, w.tail.size - 1, w.edges[-1:], [self.work] if self.work else []
        slopes = np.outer(self.units, np.append(1 / self.units, np.ones(more))).ravel("F")
        begin = np.concatenate([w.nodes[0], np.eye(size, size + more).ravel("F"), np.zeros(len(work))])
        measures, span = np.concatenate([self.units, slopes, work]), (0.0, last[0] * w.period)
        end = self.variations.end(measures, begin, span, self._free(w)).astype(float)
        columns = end[size : size * (1 + size + more)].reshape(1, size, size + more, order="F")
        rate = last * self.equations.march.rates(end[None, :size], w.tail, last * w.period)
        by = np.concatenate([rate[:, :, None], columns[:, :, size:]], axis=2)
        return Varied(end[None, :size], columns[:, :, :size], by, w.nodes, float(end[-1]) if work else 0.0)

    def _free(self, w: Unknowns) -> np.ndarray:
        """(s, free) and the other parameters."""
        return np.append(w.tail[1:], self.numbers)


def wide(equations: Equations, units: np.ndarray, quadruple: bool, work: float = 0.0) -> Wide | None:
    """Long double or quadruple precision for the segment of a loop, where that can be had.

    Newton's method has enough of derivatives in long double; in `work` they are asked for themselves, without those by
    the unfolding. The numbers of parameters are given to the equations: folded into them they are rounded, in the
    slopes not as in the rates.
    """
    model, names = equations.model, equations.free
    given = tuple(name for name in model.parameter_names if name not in names and not system_kind(model.system).reread)
    flow = vector_field(model, (*names, *given), () if work else equations.symmetry.unfolded(model))
    t, x, s, chosen = inputs = inputs_of(flow)
    rates = [flow(*inputs), model.action_rate(t, x, model.parameters((*names, *given), chosen))]
    apart = [t, x, s, *(type(x).sym(name, size) for name, size in (("free", len(names)), ("given", len(given))))]
    field, action = (
        ca.Function("known", apart, ca.Function("whole", inputs, [rate]).call([t, x, s, ca.vertcat(*apart[3:])]))
        for rate in rates
    )
    states = extended(_gathered(field), quadruple)
    varied = extended(_gathered(variational_field(field, action if work else None)), quadruple and work > 0)
    numbers = model.values_of(given)
    return Wide(equations, states, varied, units, work, numbers) if states and varied else None


def _gathered(field: ca.Function) -> CasadiField:
    """A field of (t, y, s, free) as that of (t, y, tail)."""
    t, y, *given = field.mx_in()
    ends = np.cumsum([0, *(each.numel() for each in given)]).tolist()
    tail = ca.MX.sym("tail", ends[-1])
    return CasadiField(ca.Function("closing", [t, y, tail], [field(t, y, *ca.vertsplit(tail, ends))]))
