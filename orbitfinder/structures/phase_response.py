"""Phase response of a cycle: by how much a kick advances all later motion, the gradient Z of its asymptotic phase.

    Z' = -J^T Z,    Z(T) = Z(0),    Z . f = 1        (f = x' along the cycle, J = df/dx)

From phase to phase z_k = A_k^T z_{k+1} of the state-transition matrices A_k: one bordered system, solved at once. No
product is made, so that neither attraction within a moment nor an unstable direction takes digits.

Source: W. Govaerts, B. Sautois, "Computation of the phase response curve: a direct numerical approach", Neural
Computation 18 (2006) 817-847.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse
from scipy.integrate import solve_ivp
from scipy.sparse.linalg import splu

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.errors import InputError, IntegrationError
from orbitfinder.integrate.dop853 import SECOND, ReferenceSettings, Trace, integrate_in
from orbitfinder.integrate.equations import accelerations, with_variations
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.integrate.field import vector_field
from orbitfinder.integrate.march import March
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.model import vector_field as unfolded_field
from orbitfinder.mechanics.scales import extents_of
from orbitfinder.orbits.closure import shift
from orbitfinder.orbits.evidence import units_of, varied_end
from orbitfinder.orbits.floquet import Floquet, judged
from orbitfinder.orbits.product import product
from orbitfinder.records.certificate import Certificate, Certified, Check, at_least, at_most, refused, same
from orbitfinder.records.codec import Codec, Complexes
from orbitfinder.records.orbit import Orbit, refuse_controlled

STEPS = ReferenceSettings(1e-9, 1e-10)
"""What steps are chosen by: a tighter one is lost in round-off where rates are 0 / 0, as Hodgkin and Huxley's"""
HYPERBOLIC, JOINED, LINEAR, KICKED = 1e-6, 1e-9, 1e-8, 1e-6
"""How far multipliers are from the unit circle; what may be left where pieces of the cycle meet (in extents), of the
adjoint and Z . f = 1, and of finite kicks"""
KICKS, SIZES, DECAYED, LONGEST = 6, 1e-3 * 0.25 ** np.arange(4), 1e-8, 40
"""Kicks that are tried, their sizes in extents, what is left of them beside the phase when that is read, and the most
periods until then"""


@dataclass(frozen=True)
class PhaseResponse(Shown):
    """By how much a small kick dx at a phase of a cycle advances all later motion: Z . dx, a time.

    Divided by `period` it is in periods. Of an unstable cycle: of motions in its stable or its unstable manifold.

    Args:
        name: a word for files.
        system: plain description that rebuilds the model.
        period: of the cycle.
        winding: whole turns of each coordinate in it.
        times: since phase 0 (k), closer where the motion is quick.
        states: x there (k x d).
        response: Z there (k x d), units of time a unit of each component; Z . x' = 1.
        normalisation: the largest |Z . x' - 1|.
        multipliers: Floquet's, without the 1.
        stability: asymptotically stable | unstable.
        certificate: its checks, finite kicks among them.
        title: the cycle's.

    Examples:
        >>> curve.response.shape == curve.states.shape, curve.certificate.passed
        (True, True)
    """

    __repr__ = brief("name", "period", "stability", "normalisation", "certificate")
    _sparse = ("title",)
    name: str
    system: Mapping[str, Any]
    period: float
    winding: tuple[int, ...]
    times: np.ndarray
    states: np.ndarray
    response: np.ndarray
    normalisation: float
    multipliers: Complexes
    stability: str
    certificate: Certified = None
    title: str = ""

    def save(self, path: str | Path) -> Path:
        """Write a phase.json, which `orbitfinder.records.registry.load` reads."""
        return CODEC.save(self, path)

    def _check(self) -> None:
        count = self.times.size
        fit = self.states.shape == self.response.shape == (count, self.states.size // max(1, count))
        if fit and len(self.winding) > self.states.shape[1]:
            raise ValueError(f"winding: {len(self.winding)} numbers of states with {self.states.shape[1]}")
        if not fit or self.times[0] != 0 or not np.all(np.diff(self.times, append=self.period) > 0):
            raise ValueError("times: expected as many as states and rows of the response, from 0 to before the period")


CODEC = Codec(PhaseResponse, "phase-response", "`orbitfinder phase`", "compute it again")


@one_thread()
def phase_response(orbit: Orbit, model: Model | None = None, *, name: str | None = None) -> PhaseResponse:
    """The phase response curve of a cycle x' = f(x), with its certificate.

    Args:
        orbit: a hyperbolic cycle of an autonomous, smooth, dissipative system.
        model: needed only for systems that no file describes, at the orbit's parameters.
        name: a word for files; the orbit's without one.

    Returns:
        A PhaseResponse.

    Raises:
        InputError: for other systems, and cycles that are not hyperbolic.

    Examples:
        >>> of.phase_response(cycle).stability
        'asymptotically stable'
    """
    model = model or build_model(orbit.system)
    refuse_controlled(orbit, "orbit")
    what = "keeps an integral, so that a kick leads to another orbit" if model.invariants or orbit.shift else ""
    what = "is under constraints; take its minimal form" if model.constraint is not None else what
    if what := "is forced, so that its phase is the forcing's" if model.forced else what if model.smooth else "jumps":
        raise InputError(f"model: {what}; phase responses are of cycles of autonomous, smooth, dissipative systems")
    march, tail, mesh = March(unfolded_field(model)), np.array([orbit.period]), _mesh(model, orbit)
    states = march.states(orbit.nodes, mesh, tail)
    states[: -1 : (mesh.size - 1) // len(orbit.nodes)] = orbit.nodes
    starts, units = states[:-1:2], extents_of(model, states, orbit.period)
    factors = march.varied(starts, mesh, tail).transitions * units / units[:, None]
    floquet, apart = _others(factors)
    if apart < HYPERBOLIC:
        raise InputError(f"orbit: not hyperbolic, another multiplier is {apart:.1g} from the unit circle: there is no "
                         "asymptotic phase beside it; take the orbit of another parameter")  # fmt: skip
    rates = march.rates(starts, tail)
    # z (k x d) with z_k = A_k^T z_{k+1} round the cycle and z . rate = 1
    count, size, _ = factors.shape
    onwards = sparse.bsr_matrix((factors.swapaxes(1, 2), (np.arange(count) + 1) % count, np.arange(count + 1)))
    border = sparse.csr_matrix((rates * orbit.period / units).reshape(1, -1) / count)
    whole = sparse.bmat([[sparse.identity(count * size) - onwards, border.T], [border, None]], format="csc")
    solved = splu(whole).solve(np.eye(1, count * size + 1, count * size)[0])[:-1]
    response = solved.reshape(count, size) * orbit.period / units
    off = float(np.abs((response * rates).sum(axis=1) - 1).max())
    whose, times = (name or orbit.name, dict(orbit.system), orbit.period, orbit.winding), orbit.period * mesh[:-1:2]
    curve = PhaseResponse(*whose, times, starts, response, off, floquet.multipliers, floquet.stability)
    return replace(curve, certificate=certify_phase_response(curve, model), title=orbit.title)


def _mesh(model: Model, orbit: Orbit) -> np.ndarray:
    """A mesh in periods of steps a quarter as long as DOP853's rough ones, as many from node to node."""
    field, count = vector_field(accelerations(model)), len(orbit.nodes)
    units, traces = units_of(field, orbit.state, np.zeros(0), orbit.period), list[Trace]()
    for node in orbit.nodes:
        span = np.array([0.0, 0.5, 1.0]) * orbit.period / count
        integrate_in(units, field, node, span, STEPS, orbit.period / 100, traces)
    shares = np.linspace(0.0, 1.0, 4 * max(len(trace.moments) for trace in traces), endpoint=False)
    parts = [np.interp(shares, np.linspace(0.0, 1.0, len(own)), own) for own in (trace.moments for trace in traces)]
    return np.append(np.concatenate([part / orbit.period + k / count for k, part in enumerate(parts)]), 1.0)


def _others(factors: np.ndarray) -> tuple[Floquet, float]:
    """The multipliers without the 1, of any size, and how near to the unit circle they come."""
    values = product(factors).values
    others = judged(np.delete(values, np.argmin(np.abs(values - 1))), conservative=False)
    return others, float(np.abs(np.abs(others.multipliers) - 1).min(initial=1.0))


def certify_phase_response(curve: PhaseResponse, model: Model | None = None) -> Certificate:
    """From its states, times and curve alone: DOP853's variations from phase to phase, and finite kicks."""
    try:
        return Certificate(tuple(_checks(curve, model or build_model(curve.system))))
    except IntegrationError as error:
        return Certificate((refused("integration", error),))


def _checks(curve: PhaseResponse, model: Model) -> Iterator[Check]:
    x, z, units = curve.states, curve.response, extents_of(model, curve.states, curve.period)
    varied, field = vector_field(with_variations(model)), vector_field(accelerations(model))
    spans, work = pairwise(np.append(curve.times, curve.period)), float(units @ units) / curve.period
    pieces = [varied_end(varied, *each, units, work, STEPS) for each in zip(x, map(np.array, spans), strict=True)]
    ends, matrices, _ = (np.array(part) for part in zip(*pieces, strict=True))
    gaps = np.abs((ends - np.vstack([x[1:], x[:1] + shift(curve.winding, units.size)])) / units)
    yield at_most("closure", gaps.max(), JOINED, "from phase to phase, in extents of the cycle")
    early = integrate_in(units, field, x[0], curve.period / np.array([np.inf, 7, 5, 3, 2]), SECOND)[1:]
    least = np.abs((early - x[0]) / units).max(axis=1).min()
    yield at_least("period", least, HYPERBOLIC, "how near it comes back after a 2nd, 3rd, 5th, 7th of it")
    factors, scaled = matrices * units / units[:, None], z * units
    floquet, apart = _others(factors)
    yield at_least("hyperbolic", apart, HYPERBOLIC, "of other multipliers from the unit circle")
    known = floquet.multipliers.shape == curve.multipliers.shape
    off = np.abs(floquet.multipliers - curve.multipliers).max(initial=0.0) if known else np.inf
    yield at_most("multipliers", off / np.abs(floquet.multipliers).max(initial=1.0), LINEAR, "recorded - recomputed")
    yield same("stability", curve.stability, floquet.stability)
    off = np.abs((z * field.many(np.zeros(len(x)), x)).sum(axis=1) - 1).max()
    yield at_most("normalisation", max(off, curve.normalisation), LINEAR, "Z . x' - 1")
    missed = np.linalg.norm(scaled - np.einsum("kji,kj->ki", factors, np.roll(scaled, -1, axis=0)), axis=1)
    yield at_most("adjoint", (missed / np.linalg.norm(scaled, axis=1)).max(), LINEAR, "from phase to phase, and closed")
    yield _kicked(curve, field, units, np.abs(floquet.multipliers))


def _kicked(curve: PhaseResponse, field: Any, units: np.ndarray, sizes: np.ndarray) -> Check:
    """Kicks both ways of four sizes, extrapolated to none; backwards in time where all leave; read along the flow, or
    where they neither all decay nor all leave, by Z itself."""
    largest, back = float(sizes.max(initial=0.0)), bool(sizes.size and sizes.min() > 1)
    rate = max(1 / sizes.min() if back else largest, DECAYED)
    settled = rate**LONGEST < DECAYED
    periods = int(np.ceil(np.log(DECAYED) / np.log(rate))) * (-1 if back else 1) if settled else 1
    random, lengths = np.random.default_rng(0), (SIZES if settled else SIZES / max(1.0, largest))[:, None, None]
    chosen, ways = random.choice(len(curve.states), KICKS), random.normal(size=(KICKS, units.size))
    x, z = curve.states[chosen] / units, curve.response[chosen] * units
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    starts = np.array([x + lengths * ways, x - lengths * ways])

    def together(_: float, y: np.ndarray) -> np.ndarray:
        states = y.reshape(-1, units.size) * units
        return np.asarray((field.many(np.zeros(len(states)), states) / units).ravel())

    span, tight = (0.0, periods * curve.period), {"rtol": SECOND.relative_tolerance, "atol": SECOND.absolute_tolerance}
    moved = solve_ivp(together, span, starts.ravel(), "DOP853", span[1:], **tight)
    if not moved.success:
        return refused("kicks", moved.message)
    flow = together(0.0, x).reshape(x.shape)
    reader = flow / (flow**2).sum(axis=1)[:, None] if settled else z
    ahead, behind = moved.y.reshape(starts.shape)
    advanced = ((ahead - behind) / (2 * lengths) * reader).sum(axis=2)
    sharper = (16 * advanced[1:] - advanced[:-1]) / 15
    best = np.abs(np.diff(sharper, axis=0)).argmin(axis=0) + 1
    off = np.abs(sharper[best, range(KICKS)] - (z * ways).sum(axis=1)) / np.linalg.norm(z, axis=1)
    how = "along the flow" if settled else "by Z itself"
    return at_most("kicks", off.max(), KICKED, f"{KICKS} at random, after {periods} periods, read {how}; of |Z|")
