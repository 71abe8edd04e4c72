"""Families of periodic orbits by brute force: short steps, multiple shooting, an eighth-order method, complex steps.

It shares nothing with orbitfinder, which it does not import. The equations are plain NumPy functions of complex numbers
(`benchmarks/brute_systems.py`). An orbit is N pieces of equal length along the motion, integrated all at once by
Dormand and Prince's method of order eight with steps that are not chosen but made twice as fine as a check; its
derivatives are those of the very same arithmetic by complex steps (x + i 1e-40 e_j, exact to round-off). A family is
followed by arclength over all pieces, in extents of the motion, with an integral phase condition, by short steps that
`moved` halves as a check. Bifurcations are sign changes of regular functions of the reduced map M (the flow's direction
and, where there is an energy, its gradient taken out), with p' = dp/ds:

    fold            p'                           turn            T' (where the parameter is the energy)
    branch point    det(M - 1) / p'              doubling        det(M + 1)
    torus           prod (mu_i mu_j - 1), i < j  collision       discriminant of the polynomial in kappa = mu + 1/mu

of an orbit that is half its own mirror image those of the half map, each refined by Brent's method on corrected orbits.
The Hopf point at which a family ends is found from its equilibrium.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.integrate._ivp import dop853_coefficients as dop
from scipy.optimize import brentq

TINY = 1e-40
"""Imaginary step of derivatives: its square is below what doubles hold beside anything that occurs here"""
SINGULAR = 1e-9
"""Singular values below this share of the largest are left out: at a branch point Newton stays on its own branch"""
A, B, C = dop.A[: dop.N_STAGES, : dop.N_STAGES], dop.B, dop.C[: dop.N_STAGES]
Rate = Callable[[Any, np.ndarray, Any, Any], np.ndarray]


@dataclass(frozen=True)
class System:
    """Equations and where to follow their orbits.

    `rate(t, x, p, s)` gives x' (n x ...) of complex states; s multiplies a fictitious damping where there is an energy.
    `twist` maps a state to the one a horizon later, which is the `parts`-th of the period; `winding` is added.
    """

    name: str
    rate: Rate
    state: tuple[float, ...]
    period: float
    start: float
    window: tuple[float, float]
    parameter: str
    directions: tuple[int, ...] = (1, -1)
    forcing: Callable[[Any], Any] | None = None
    energy: Callable[[np.ndarray], Any] | None = None
    twist: float = 1.0
    parts: int = 1
    winding: tuple[float, ...] = ()
    pieces: int = 24
    steps: int = 5
    stride: float = 0.03
    most: int = 1500
    simulate: float = 0.0
    pin: int | None = None
    """The component of the first state that is kept while the first orbit is found, instead of the parameter"""


@dataclass(frozen=True)
class Orbit:
    """A corrected orbit: scaled unknowns u, mesh (widths, sum 1), units of the unknowns and what follows from them."""

    u: np.ndarray
    widths: np.ndarray
    units: np.ndarray
    extents: np.ndarray
    jacobian: np.ndarray
    monodromy: np.ndarray
    tangent: np.ndarray
    rates: np.ndarray
    gap: float


@dataclass(frozen=True)
class Found:
    """A bifurcation: its kind, the parameter, the period, and how far both move when the steps are halved."""

    kind: str
    value: float
    period: float
    error: float
    multiplier: complex = 1.0


@dataclass
class Family:
    """What was found in one direction."""

    events: list[Found] = field(default_factory=list)
    end: str = ""
    value: float = np.nan
    period: float = np.nan
    orbits: int = 0
    gap: float = 0.0
    grown: float = 1.0


class Follower:
    """One system's orbits: residual and Jacobian, Newton, predictor, events."""

    def __init__(self, system: System, fineness: int = 1) -> None:
        self.system, self.n, self.count = system, len(system.state), system.pieces
        self.steps = system.steps * fineness
        self.free_period, self.unfolded = system.forcing is None, system.energy is not None
        self.width = self.n * self.count
        self.size = self.width + self.free_period + 1 + self.unfolded
        self.greatest = np.zeros(self.n)

    # ---- the unknowns -------------------------------------------------------------------------------
    def parts_of(self, u: np.ndarray) -> tuple[np.ndarray, Any, Any, Any]:
        """Nodes (N x n), horizon, parameter and unfolding of raw unknowns."""
        rest = list(u[self.width :])
        horizon = rest.pop(0) if self.free_period else None
        parameter = rest.pop(0)
        horizon = self.system.forcing(parameter) / self.system.parts if horizon is None else horizon
        return u[: self.width].reshape(self.count, self.n), horizon, parameter, rest[0] if rest else 0.0

    def value(self, orbit: Orbit) -> float:
        """The parameter."""
        return float(orbit.u[self.width + self.free_period])

    def period(self, orbit: Orbit) -> float:
        """The period."""
        return float(self.parts_of(orbit.u)[1]) * self.system.parts

    def flow(self, x: np.ndarray, start: np.ndarray, width: np.ndarray, h: Any, p: Any, s: Any) -> np.ndarray:
        """States (n x N x columns) at tau = start + width, x' = h rate(h tau): all pieces, all columns at once."""
        step = (width / self.steps)[:, None]
        for k in range(self.steps):
            tau = start[:, None] + k * step
            stages: list[np.ndarray] = []
            for a, c in zip(A, C, strict=True):
                inner = x + step * h * sum((w * g for w, g in zip(a, stages, strict=False) if w), np.zeros(1))
                stages.append(self.system.rate(h * (tau + c * step), inner, p, s))
            x = x + step * h * sum(w * g for w, g in zip(B, stages, strict=True) if w)
        return x

    def varied(self, u: np.ndarray, widths: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Ends of the pieces (N x n), their derivatives by the node (N x n x n) and by (horizon, p, s) (N x n x 3)."""
        nodes, h, p, s = self.parts_of(u)
        columns = self.n + 3
        x = np.repeat(nodes.T[:, :, None], columns, axis=2).astype(complex)
        for j in range(self.n):
            x[j, :, j] += 1j * TINY
        tail = np.array([h, p, s], dtype=complex)[:, None] * np.ones(columns)
        for j in range(3):
            tail[j, self.n + j] += 1j * TINY
        if not self.free_period:  # the horizon follows the parameter
            tail[0] = self.system.forcing(tail[1]) / self.system.parts
        edges = np.concatenate([[0.0], np.cumsum(widths)[:-1]])
        ends = self.flow(x, edges, widths, *tail)
        slopes = ends.imag / TINY
        by_node, by_tail = (part.transpose(1, 0, 2) for part in (slopes[:, :, : self.n], slopes[:, :, self.n :]))
        return ends[:, :, 0].real.T, by_node, by_tail

    def rates(self, u: np.ndarray, widths: np.ndarray) -> np.ndarray:
        """dx/dtau at the nodes (N x n)."""
        nodes, h, p, s = self.parts_of(u)
        edges = np.concatenate([[0.0], np.cumsum(widths)[:-1]])
        return np.real(h * self.system.rate(h * edges, nodes.T.astype(complex), p, s)).T

    def rows(self, u: np.ndarray, widths: np.ndarray, extents: np.ndarray, reference: Any) -> tuple[Any, ...]:
        """Residual and Jacobian in raw unknowns and scaled rows: continuity, phase, energy; and the transitions."""
        ends, by_node, by_tail = self.varied(u, widths)
        n, count = self.n, self.count
        nodes, _, p, _ = self.parts_of(u)
        winding = np.array(self.system.winding or [0.0] * n)
        tail = [0] * self.free_period + [1] + [2] * self.unfolded
        residual, matrix = np.zeros(self.size - 1), np.zeros((self.size - 1, self.size))
        for k in range(count):
            rows = slice(k * n, k * n + n)
            last = k == count - 1
            after = self.system.twist * nodes[0] + winding if last else nodes[k + 1]
            residual[rows] = (ends[k] - after) / extents
            matrix[rows, k * n : k * n + n] = by_node[k] / extents[:, None]
            there = slice(0, n) if last else slice(k * n + n, k * n + 2 * n)
            matrix[rows, there] -= np.diag((self.system.twist if last else 1.0) / extents)
            matrix[rows, self.width :] = by_tail[k][:, tail] / extents[:, None]
        at = self.width
        if self.free_period:
            old, slope = reference
            row = widths[:, None] * slope / extents**2
            size = np.sqrt(np.sum(widths[:, None] * slope**2 / extents**2))
            residual[at], matrix[at, : self.width] = np.sum(row * (nodes - old)) / size, (row / size).ravel()
            at += 1
        if self.unfolded:
            value, slope = self.gradient(nodes[0])
            residual[at], matrix[at, :n], matrix[at, self.width + 1] = value - p, slope, -1.0
        return residual, matrix, by_node

    def gradient(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """The energy and its gradient."""
        value = self.system.energy(x[:, None] + 1j * TINY * np.eye(self.n))
        return float(value[0].real), value.imag / TINY

    # ---- Newton -------------------------------------------------------------------------------------
    def corrected(
        self, u: np.ndarray, widths: np.ndarray, units: np.ndarray, extents: np.ndarray, reference: Any,
        plane: np.ndarray, level: float, tangent: np.ndarray | None = None,
    ) -> Orbit | None:  # fmt: skip
        """The orbit on the plane `plane . u / units = level`, or None."""
        for turn in range(9):
            with np.errstate(all="ignore"):
                residual, matrix, parts = self.rows(u, widths, extents, reference)
            scaled = np.vstack([matrix * units, plane])
            if not np.isfinite(scaled).all():
                return None
            total = np.append(residual, plane @ (u / units) - level)
            size = float(np.abs(total).max())
            if turn and size < max(2e-13 * max(1.0, np.abs(scaled).max() ** 0.5), 1e-10 * (turn > 5)):
                break
            if size > 1e3:
                return None
            u = u - units * np.linalg.lstsq(scaled, total, rcond=SINGULAR)[0]
        else:
            return None
        monodromy = np.eye(self.n)
        for part in parts:
            monodromy = part @ monodromy
        along = np.linalg.solve(scaled, np.eye(self.size)[-1])
        along /= np.linalg.norm(along)
        if tangent is not None and along @ tangent < 0:
            along = -along
        monodromy = self.system.twist * monodromy
        rates = self.rates(u, widths)
        return Orbit(u, widths, units, extents, scaled, monodromy, along, rates, size)

    def scales(self, u: np.ndarray, widths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Units of the unknowns and extents of the motion, never below a tenth of the greatest that were met."""
        nodes, h, *_ = self.parts_of(u)
        turned = nodes if self.system.twist > 0 else np.vstack([nodes, -nodes])
        now = np.ptp(turned, axis=0) if not self.system.winding else np.maximum(np.ptp(nodes, axis=0), 1e-3)
        self.greatest = np.maximum(self.greatest, now)
        extents = np.maximum(now, 0.1 * self.greatest)
        low, high = self.system.window
        tail = [h] * self.free_period + [high - low] + [1.0] * self.unfolded
        return np.concatenate([(extents / np.sqrt(widths)[:, None]).ravel(), tail]), extents

    def meshed(self, u: np.ndarray, widths: np.ndarray, extents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same motion with nodes at equal lengths of (motion in extents, 1/2 time)."""
        nodes, h, p, s = self.parts_of(u)
        edges = np.concatenate([[0.0], np.cumsum(widths)])
        share = np.linspace(0, 1, 9)[:-1]
        fine = np.repeat(nodes.T[:, :, None], 8, axis=2).astype(complex)
        batch = fine.reshape(self.n, -1)[:, :, None]
        starts, lengths = np.repeat(edges[:-1], 8), (widths[:, None] * share).ravel()
        states = self.flow(batch, starts, lengths, h, p, s)[:, :, 0].real
        times = starts + lengths
        rate = np.real(h * self.system.rate(h * times, states.astype(complex), p, s)) / extents[:, None]
        speed = np.append(np.sqrt(np.sum(rate**2, axis=0)), 0.0)
        speed[-1] = speed[0]
        monitor = speed + 0.5 * np.mean(speed)
        grid = np.append(times, 1.0)
        length = np.concatenate([[0.0], np.cumsum(0.5 * (monitor[1:] + monitor[:-1]) * np.diff(grid))])
        wanted = np.interp(np.linspace(0, length[-1], self.count + 1), length, grid)
        index = np.clip(np.searchsorted(edges, wanted[:-1], side="right") - 1, 0, self.count - 1)
        rest = wanted[:-1] - edges[index]
        moved = self.flow(nodes.T[:, index, None].astype(complex), edges[index], rest, h, p, s)[:, :, 0].real.T
        return np.concatenate([moved.ravel(), u[self.width :]]), np.diff(wanted)

    # ---- the first orbit ----------------------------------------------------------------------------
    def first(self) -> Orbit:
        """The orbit at the start value, from the system's guess, simulated first if it says so."""
        system = self.system
        state, period = np.array(system.state), system.period
        if system.simulate:
            state, period = self.settled(state)
        h = period / system.parts
        widths = np.full(self.count, 1.0 / self.count)
        edges = np.concatenate([[0.0], np.cumsum(widths)[:-1]])
        nodes = self.simulated(state, h, h * edges)
        tail = [h] * self.free_period + [system.start if not self.unfolded else self.gradient(state)[0]]
        u = np.concatenate([nodes.ravel(), tail, [0.0] * self.unfolded])
        units, extents = self.scales(u, widths)
        plane = np.zeros(self.size)
        kept = self.width + self.free_period if system.pin is None else system.pin
        plane[kept] = 1.0
        orbit = None
        for _ in range(4):
            u, widths = self.meshed(u, widths, extents)
            units, extents = self.scales(u, widths)
            reference = (u[: self.width].reshape(self.count, self.n), self.rates(u, widths))
            level = u[kept] / units[kept]
            orbit = self.corrected(u, widths, units, extents, reference, plane, level)
            if orbit is None:
                raise RuntimeError(f"{system.name}: no first orbit")
            u, widths = orbit.u, orbit.widths
        return orbit

    def simulated(self, state: np.ndarray, duration: float, times: np.ndarray) -> np.ndarray:
        """States at times, by SciPy."""
        rate = self.system.rate
        told = solve_ivp(lambda t, x: np.real(rate(t, x.astype(complex), self.system.start, 0.0)), (0, duration), state,
                         method="DOP853", rtol=1e-11, atol=1e-12, t_eval=times)  # fmt: skip
        return told.y.T

    def settled(self, state: np.ndarray) -> tuple[np.ndarray, float]:
        """A state on the cycle that attracts, and its period: the next return through the plane across the motion."""
        end = self.simulated(state, self.system.simulate, np.array([self.system.simulate]))[-1]
        rate = self.system.rate
        normal = np.real(rate(0.0, end.astype(complex), self.system.start, 0.0))
        span = 3 * self.system.period
        path = self.simulated(end, span, np.linspace(0, span, 20001))
        units = np.ptp(path, axis=0)
        side = (path - end) / units @ (normal / units)
        near = np.linalg.norm((path - end) / units, axis=1)
        crossed = np.flatnonzero((side[:-1] < 0) & (side[1:] >= 0) & (near[1:] < 0.05))
        return end, float(np.linspace(0, span, 20001)[crossed[0]])

    # ---- what is looked for -------------------------------------------------------------------------
    def reduced(self, orbit: Orbit) -> np.ndarray:
        """The map without the flow's direction and, with an energy, on its surface; scaled by extents."""
        units = orbit.extents
        matrix = orbit.monodromy * units / units[:, None]
        if not self.free_period:
            return matrix
        out = [orbit.rates[0] / units]
        if self.unfolded:
            out.append(self.gradient(orbit.u[: self.n])[1] * units)
        basis = np.linalg.qr(np.array(out).T, mode="complete")[0][:, len(out) :]
        return basis.T @ matrix @ basis

    def kappas(self, orbit: Orbit) -> np.ndarray:
        """mu + 1/mu of a map with an energy, one of each pair."""
        m = self.reduced(orbit)
        half = len(m) // 2
        values = np.linalg.eigvals(m)
        sums = values + 1 / values
        order = np.argsort(np.round(sums.real, 6) + 1e-3 * np.round(sums.imag, 6))
        return sums[order][::2][:half]

    def tests(self) -> dict[str, Callable[[Orbit], float]]:
        """The regular functions by the kind of what their sign changes are."""
        at, size = self.width + self.free_period, len(self.system.state) - 2

        def slope(orbit: Orbit) -> float:
            return float(orbit.tangent[at])

        def shifted(orbit: Orbit, mu: complex) -> complex:
            m = self.reduced(orbit)
            return complex(np.linalg.det(m - mu * np.eye(len(m))))

        def torus(orbit: Orbit) -> float:
            mu = np.linalg.eigvals(self.reduced(orbit))
            return float(np.prod([1.0, *(a * b - 1 for a, b in combinations(mu, 2))]).real)

        found = {"fold": slope, "branch_point": lambda one: shifted(one, 1.0).real / slope(one)}
        other = "branch_point -" if self.system.parts == 2 else "period_doubling"
        found[other] = lambda one: shifted(one, -1.0).real
        if self.unfolded:
            found["turn"] = lambda one: float(one.tangent[self.width])
            found["collision"] = self.discriminant
            if self.system.parts == 2:
                found["period_doubling"] = lambda one: (shifted(one, 1j) / 1j ** (size // 2)).real
        elif len(self.reduced_size()) > 1:
            found["torus"] = torus
        return found

    def discriminant(self, orbit: Orbit) -> float:
        """Of the polynomial whose roots are the kappas: 0 where two of them meet, from the traces of two powers."""
        m = self.reduced(orbit)
        count = len(m) // 2
        if count == 1:
            return 1.0
        assert count == 2, "written for two pairs"
        total, square = np.trace(m), np.trace(m @ m)  # k1 + k2 and k1^2 + k2^2 - 4
        return float(2 * (square + 4) - total**2)

    def reduced_size(self) -> range:
        """As many as the reduced map has dimensions."""
        return range(self.n - self.free_period - self.unfolded)

    def unstable(self, orbit: Orbit) -> bool:
        """Whether a multiplier is outside the unit circle."""
        sizes = np.abs(np.linalg.eigvals(self.reduced(orbit)))
        return bool(sizes.max(initial=0.0) > 1 + (2e-5 if self.unfolded else 0))

    # ---- along --------------------------------------------------------------------------------------
    def between(self, a: Orbit, b: Orbit, share: float) -> Orbit:
        """The corrected orbit on the plane across the chord from a to b, which have one mesh."""
        chord = (b.u - a.u) / a.units
        length = np.linalg.norm(chord)
        plane, u = chord / length, a.u + share * (b.u - a.u)
        reference = (u[: self.width].reshape(self.count, self.n), self.rates(u, a.widths))
        found = self.corrected(u, a.widths, a.units, a.extents, reference, plane, plane @ (u / a.units), a.tangent)
        if found is None:
            raise RuntimeError(f"{self.system.name}: no orbit between two orbits at {self.value(a)}")
        return found

    def met(self, a: Orbit, b: Orbit, test: Callable[[Orbit], float]) -> tuple[float, Orbit]:
        """Where between two neighbours a function vanishes, as a share of the way, and the orbit there."""
        at = {0.0: test(a), 1.0: test(b)}
        share = brentq(lambda t: at[t] if t in at else test(self.between(a, b, t)), 0, 1, xtol=1e-12, rtol=1e-12)
        return share, self.between(a, b, share)

    def events(self, a: Orbit, b: Orbit) -> list[tuple[float, Found]]:
        """What happens between two neighbours, as shares of the way and in order."""
        found = []
        for kind, test in self.tests().items():
            ends = (test(a), test(b))
            if ends[0] * ends[1] >= 0:
                continue
            share, there = self.met(a, b, test)
            mu = np.linalg.eigvals(self.reduced(there))
            nearest = -1.0 if kind == "period_doubling" else 1.0
            if kind == "torus":
                nearest = mu[np.argmin(np.abs(np.abs(mu) - 1))]
            if kind == "torus" and (abs(nearest.imag) < 1e-6 or abs(abs(nearest) - 1) > 1e-5):
                continue  # a neutral saddle
            if kind == "branch_point" and abs(test(there)) > 0.5 * max(map(abs, ends)):
                continue  # the pole of a fold beside which the determinant does not vanish
            made = Found(kind.split(" ")[0], self.value(there), self.period(there), there.gap, complex(nearest))
            found.append((share, made))
        return sorted(found, key=lambda pair: pair[0])

    def changes(self, a: Orbit, b: Orbit, found: list[tuple[float, Found]]) -> Iterator[Found]:
        """The events at which the verdict changes: looked at half-way between events."""
        if not found:
            return
        shares = [0.0, *(0.5 * (x[0] + y[0]) for x, y in pairwise(found)), 1.0]
        verdicts = [self.unstable(a), *(self.unstable(self.between(a, b, t)) for t in shares[1:-1]), self.unstable(b)]
        for (_, one), before, after in zip(found, verdicts, verdicts[1:], strict=False):
            if before != after:
                yield Found("stability_change", one.value, one.period, one.error)

    def follow(self, direction: int, first: Orbit | None = None) -> Family:
        """From the first orbit to an end of the window, a Hopf point, or after `most` orbits."""
        system, told = self.system, Family()
        here = first or self.first()
        at = self.width + self.free_period
        sign = np.sign(here.tangent[at]) * direction or 1.0
        along, stride = here.tangent * sign, system.stride / 4
        low, high = system.window
        for turn in range(system.most):
            u, widths = (here.u, here.widths) if turn == 0 else self.meshed(here.u, here.widths, here.extents)
            units, extents = self.scales(u, widths)
            reference = (u[: self.width].reshape(self.count, self.n), self.rates(u, widths))
            # the same orbit on the new mesh, with its tangent
            plane = np.zeros(self.size)
            moved = self.retold(here, along, widths, units) if turn else along
            plane[:] = moved
            start = self.corrected(u, widths, units, extents, reference, plane, plane @ (u / units), moved)
            if start is None:
                told.end = "no convergence"
                return told
            if turn and (start.tangent @ moved) < 0.3:
                raise RuntimeError(f"{system.name}: lost its direction")
            there = None
            while there is None or there.tangent @ start.tangent < 0.9:
                if there is not None:
                    stride /= 2
                if stride < 1e-7:
                    told.end, told.value, told.period = "stuck", self.value(start), self.period(start)
                    return told
                guess = start.u + stride * units * start.tangent
                there = self.corrected(guess, widths, units, extents, reference, start.tangent,
                                       start.tangent @ (guess / units), start.tangent)  # fmt: skip
                if there is None:
                    stride /= 2
            stride = min(stride * 1.4, system.stride)
            past = [edge for edge in (low, high) if (self.value(start) - edge) * (self.value(there) - edge) < 0]
            if past and not (turn == 0 and self.value(start) == past[0]):
                there = self.met(start, there, lambda one, edge=past[0]: self.value(one) - edge)[1]
            amplitude = np.max(np.ptp(there.u[: self.width].reshape(self.count, self.n), axis=0) / self.greatest)
            if self.free_period and not system.winding and (amplitude < 5e-3 or self.passed(start, there)):
                told.end, (told.value, told.period) = "hopf", self.hopf(start)
                return told
            found = self.events(start, there)
            told.events += [one for _, one in found]
            told.events += self.changes(start, there, found)
            told.orbits, told.gap = turn + 2, max(told.gap, there.gap)
            told.grown = max(told.grown, float(np.abs(np.linalg.eigvals(self.reduced(there))).max()) ** system.parts)
            if past:
                told.end, told.value, told.period = "target", past[0], self.period(there)
                return told
            here, along = there, there.tangent
        told.end, told.value = "orbits", self.value(here)
        return told

    def retold(self, orbit: Orbit, along: np.ndarray, widths: np.ndarray, units: np.ndarray) -> np.ndarray:
        """A tangent on another mesh."""
        raw = along * orbit.units
        edges = [np.concatenate([[0.0], np.cumsum(one)[:-1]]) for one in (orbit.widths, widths)]
        old = raw[: self.width].reshape(self.count, self.n)
        nodes = np.array([np.interp(edges[1], [*edges[0], 1.0], [*column, column[0] * self.system.twist])
                          for column in old.T]).T  # fmt: skip
        there = np.concatenate([nodes.ravel(), raw[self.width :]]) / units
        return there / np.linalg.norm(there)

    def passed(self, a: Orbit, b: Orbit) -> bool:
        """Whether the motion has gone through rest: it is then half a period later, the other way round."""
        moved = [one.u[: self.width].reshape(self.count, self.n) for one in (a, b)]
        off = [(nodes - a.widths @ nodes) / a.extents for nodes in moved]
        return bool(np.sum(a.widths[:, None] * off[0] * off[1]) < 0)

    def hopf(self, last: Orbit) -> tuple[float, float]:
        """The Hopf point that a shrinking family runs into: an equilibrium with the eigenvalues +-2 pi i / T."""
        rate, n = self.system.rate, self.n
        centre = last.u[: self.width].reshape(self.count, n).T @ last.widths
        omega = 2 * np.pi / self.period(last)

        def growth(p: float) -> tuple[float, float]:
            x = centre.copy()
            for _ in range(50):
                values = rate(0.0, x[:, None] + 1j * TINY * np.eye(n), p, 0.0)
                step = np.linalg.solve(values.imag / TINY, values[:, 0].real)
                x = x - step
                if np.abs(step / last.extents).max() < 1e-15:
                    break
            value = min(np.linalg.eigvals(values.imag / TINY), key=lambda one: abs(one - 1j * omega))
            return float(value.real), float(value.imag)

        p, near = self.value(last), 1e-5 * (self.system.window[1] - self.system.window[0])
        while growth(p - near)[0] * growth(p + near)[0] > 0:
            near *= 2
        p = brentq(lambda one: growth(one)[0], p - near, p + near, xtol=1e-15, rtol=1e-14)
        return p, 2 * np.pi / growth(p)[1]


def recorded(system: System) -> dict[str, Any]:
    """Everything that is found of a system, in plain numbers: the first orbit, and each direction."""
    made: dict[str, Any] = {"parameter": system.parameter, "directions": {}}
    for direction in system.directions:
        follower = Follower(system)
        first = follower.first()
        made |= {
            "start": float(system.start if system.pin is None and not system.energy else follower.value(first)),
            "state": first.u[: follower.n].tolist(),
            "period": follower.period(first),
        }
        family = follower.follow(direction, first)
        events = [
            {
                "kind": one.kind, "value": one.value, "period": one.period,
                "multiplier": [one.multiplier.real, one.multiplier.imag],
            }
            for one in family.events
        ]  # fmt: skip
        made["directions"][str(direction)] = {
            "end": family.end, "value": family.value, "period": family.period, "orbits": family.orbits,
            "gap": family.gap, "largest multiplier": family.grown, "events": events,
        }  # fmt: skip
    return made


def moved(system: System) -> float:
    """How far, relative, events move with twice the steps, more pieces and twice the orbits: the same must be met."""
    finer = replace(system, steps=2 * system.steps, pieces=system.pieces * 4 // 3, stride=system.stride / 2)
    coarse, fine = recorded(system), recorded(finer)
    pairs = [
        (a, b)
        for direction in coarse["directions"]
        for a, b in zip(*(one["directions"][direction]["events"] for one in (coarse, fine)), strict=True)
    ]
    assert all(a["kind"] == b["kind"] for a, b in pairs), system.name
    return max((abs(a["value"] - b["value"]) / max(1.0, abs(a["value"])) for a, b in pairs), default=0.0)
