"""The flow on a mesh by collocation: every step of it is a step of an implicit Runge-Kutta method, all solved at once.

    Z_i = h sum_j a_ij f(x + Z_j),    x(h) = x + sum_j d_j Z_j,    d = b A^-1

The points are Radau's (IIA, m of them, order 2 m - 1 at the ends of steps) or Gauss' (order 2 m). Radau's, the last at
the end of the step, damp to 0 what decays fast within a step, which Gauss' leave as large as it was; so multipliers of
stiff cycles come out as small as they are.
Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II (1996), sections IV.3, IV.5 and IV.8.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.compiled import compiled
from orbitfinder.integrate.lanes.stages import Staging, staging
from orbitfinder.integrate.march import Gridded, Varied
from orbitfinder.mechanics.model import symbol_of

POINTS, REMEMBERED = 5, 8
"""Collocation points in a step; motions whose stages are kept, to begin with those of the nearest on a mesh"""
SOLVED, MOST_ITERATIONS = 1e-10, 12
"""A change of the stages, in extents of the motion, after which one more would be round-off; and the most changes"""
ERROR, FEWEST, MOST = 1e-8, 20, 6000
"""Error of the polynomials in extents of the motion, where intervals end it is 1e-6 times that; and the intervals of
a mesh"""
LOPSIDED, SLACK, SPARSEST = 2.5, 1.5, 0.1
"""Times the mean work of an interval that one may have before a mesh is made anew, by how much their number may be off,
and the share of the mean density that a mesh has everywhere"""
GROWTH, STEEPEST = 30.0, 80.0
"""Times that errors may grow over an interval of a fresh mesh, and of one that is kept: near 500 times Radau's five
points have a pole, beyond which errors change their sign"""
BESIDE, FASTEST = 1e-9, -300.0
"""A motion as near as this, in extents, has the stages that first order tells, to round-off. The logarithm of what is
left of an error in a step from which on it is nothing"""


@dataclass(frozen=True)
class Tableau:
    """Points (m) in a step, the weights a (m x m), d (m) of the end and b (m) of an integral, and those (m + 1) of the
    m-th divided difference of x, x + Z."""

    points: np.ndarray
    inner: np.ndarray
    end: np.ndarray
    weights: np.ndarray
    difference: np.ndarray

    @cached_property
    def packed(self) -> np.ndarray:
        """Points, inner and weights."""
        return np.concatenate([self.points, self.inner.ravel(), self.weights])

    def basis(self, places: np.ndarray) -> np.ndarray:
        """Lagrange's polynomials (k x m) of the stages, 0 where the step begins, at places (k) in it from 0 to 1."""
        nodes = np.append(0.0, self.points)
        others = [np.delete(nodes, r) for r in range(1, nodes.size)]
        rows = np.array([np.prod((places[:, None] - own) / (node - own), axis=1)
                         for node, own in zip(self.points, others, strict=True)])  # fmt: skip
        return np.asarray(rows.T)

    def amplified(self, grown: np.ndarray) -> np.ndarray:
        """What a step makes (...) of errors that grow exp(z) times in it, z being given (...)."""
        count, z = self.points.size, grown[..., None, None]
        inside = np.linalg.solve(np.eye(count) - z * self.inner, z * self.inner.sum(axis=1)[:, None])
        return np.asarray(1.0 + inside[..., 0] @ self.end)


@lru_cache(maxsize=8)
def tableau(points: int = POINTS, rule: str = "radau") -> Tableau:
    """The `Tableau` of so many points, "radau" or "legendre" (Gauss)."""
    places = np.array(ca.collocation_points(points, rule))
    powers = places[:, None] ** np.arange(points)
    by_power = np.arange(1, points + 1)
    inner = (places[:, None] * powers / by_power) @ np.linalg.inv(powers)
    weights = np.linalg.solve(powers.T, 1.0 / by_power)
    end = np.linalg.solve(inner.T, weights)
    if rule == "radau":  # to the last bit
        end = np.eye(points)[-1]
    nodes = np.append(0.0, places)
    difference = np.array([1.0 / np.prod(node - np.delete(nodes, k)) for k, node in enumerate(nodes)])
    return Tableau(places, inner, end, weights, difference)


def gauss(points: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes (s), inner (s x s) and outer weights (s) of Gauss' rule on (0, 1), of any number of points: by Legendre's
    polynomials P_k, the integral of which is (P_k+1 - P_k-1) / (2 k + 1)."""
    nodes, weights = np.polynomial.legendre.leggauss(points)
    values = np.polynomial.legendre.legvander(nodes, points)
    before = np.hstack([-np.ones((points, 1)), values[:, : points - 1]])
    inner = (values[:, 1:] - before) @ (values[:, :points] * weights[:, None]).T / 4
    return (nodes + 1) / 2, inner, weights / 2


@dataclass(frozen=True)
class Stages:
    """Steps that were solved: their beginnings (P x d), parameters (P x (T, s, free)), stages Z (P x m x d), how these
    change with the beginnings and the parameters (P x m d x (d + 1 + ...)), the integrals (P), and the last change of
    stages in extents of the motion.
    """

    nodes: np.ndarray
    tails: np.ndarray
    stages: np.ndarray
    slopes: np.ndarray
    integrals: np.ndarray
    change: float = np.inf

    @cached_property
    def beside(self) -> np.ndarray:
        """Beginnings and parameters beside each other (P x d + ...)."""
        return np.concatenate([self.nodes, self.tails], axis=1)

    def moved(self, nodes: np.ndarray, tails: np.ndarray) -> np.ndarray:
        """The stages (P x m x d) of beginnings and parameters nearby, to first order."""
        change = np.concatenate([nodes - self.nodes, tails - self.tails], axis=1)
        return np.asarray(self.stages + (self.slopes @ change[:, :, None])[:, :, 0].reshape(self.stages.shape))


class Collocation(Gridded):
    """The segments of a loop by collocation, side by side: a `March` each of whose steps is implicit.

    A step begins with the stages that it had last on the same mesh, moved along with the nodes, else with cubics.
    """

    name: ClassVar[str] = "collocation"
    stiff: ClassVar[bool] = True

    def __init__(
        self, field: ca.Function, forced: bool = False, integrand: ca.Function | None = None, alone: bool = False,
        points: int = POINTS, rule: str = "radau",
    ) -> None:  # fmt: skip
        super().__init__(field, forced, integrand, alone)
        self.tableau = tableau(points, rule)
        self._known: list[tuple[Any, Stages]] = []
        self._staged: tuple[Any, ...] = (None,) * 4

    @property
    def together(self) -> bool:
        """No multiple of a width is needed."""
        return False

    def build(self) -> None:
        """Derive and compile now what is evaluated."""
        assert self._staging or self._linear

    @cached_property
    def _symbolic(self) -> ca.Function:
        """f, its derivatives by x, (t, s, free), and the integrand, in a column, as a function of (t, x, s, free)."""
        f, symbol = self.field, symbol_of(self.field)
        inputs = [symbol(name, f.size1_in(k)) for k, name in enumerate(("t", "x", "s", "free"))]
        rate = f(*inputs)
        others = ca.vertcat(*[inputs[k] for k in ((0, 2, 3) if self.forced else (2, 3))])
        parts = [rate, ca.vec(ca.jacobian(rate, inputs[1])), ca.vec(ca.jacobian(rate, others))]
        added = [] if self.integrand is None else [self.integrand(*inputs)]
        return ca.Function("collocated", inputs, [ca.densify(ca.vertcat(*parts, *added))])

    @cached_property
    def _staging(self) -> Staging | None:
        added = self.integrand is not None
        return staging(self._symbolic, self.tableau.points.size, self.forced, added, self._effort)

    @cached_property
    def _linear(self) -> ca.Function:
        return compiled(self._symbolic, effort=self._effort)

    def _evaluated(self, times: np.ndarray, states: np.ndarray, tails: np.ndarray) -> tuple[np.ndarray, ...]:
        """Rates (K x d), slopes by x (K x d x d) and by the rest (K x d x r), the integrand (K) at K points."""
        size, cut = self.size, 1 + self.unfolding
        if self._staging is not None:
            rows = self._staging.valued(times, states, tails)
        else:
            rows = self._lanes.evaluated(self._linear, 1, times[:, None], states, tails[:, 1:cut], tails[:, cut:])
        rates, slopes = rows[:, :size], rows[:, size : size + size**2].reshape(len(rows), size, size).swapaxes(1, 2)
        count = self.columns - size + self.forced
        others = rows[:, size + size**2 : size * (1 + size + count)].reshape(len(rows), count, size).swapaxes(1, 2)
        return rates, slopes, others, rows[:, size * (1 + size + count) :].sum(axis=1)

    def decays(self, states: np.ndarray, tail: np.ndarray, times: np.ndarray) -> np.ndarray:
        """The fastest rate at which anything decays (k) at states (k x d) and times (k), 0 where nothing does."""
        exponents = np.linalg.eigvals(self._slopes(states, tail, times)).real
        return np.asarray(np.maximum(-exponents.min(axis=1), 0.0))

    def growths(self, states: np.ndarray, tail: np.ndarray, times: np.ndarray, least: np.ndarray) -> np.ndarray:
        """The fastest rate at which anything grows (k), in the same way; 0 where that is below `least` (k)."""
        slopes, units = self._slopes(states, tail, times), nonzero(np.ptp(states, axis=0))
        fast = ~(np.abs(slopes * units / units[:, None]).sum(axis=2).max(axis=1) <= least)  # no eigenvalue is larger
        fastest = np.zeros(len(states))
        if fast.any():
            fastest[fast] = np.linalg.eigvals(slopes[fast]).real.max(axis=1)
        return np.maximum(fastest, 0.0)

    def _slopes(self, states: np.ndarray, tail: np.ndarray, times: np.ndarray) -> np.ndarray:
        return self._evaluated(times * self.forced, states, np.repeat(tail[None], len(states), axis=0))[1]

    def _nearest(self, key: Any, nodes: np.ndarray, tails: np.ndarray) -> tuple[Stages | None, float]:
        """What is known on the same mesh of the nearest motion, and how far that is."""
        width = nodes.shape[1] + tails.shape[1]
        near = [known for other, known in reversed(self._known) if other == key and known.beside.shape[1] == width]
        if not near:
            return None, np.inf
        flat = np.concatenate([nodes, tails], axis=1)
        away = np.abs(np.stack([known.beside for known in near]) - flat).max(axis=1)
        apart = (away / nonzero(np.abs(flat).max(axis=0))).max(axis=1)
        first = int(np.argmin(apart))
        return near[first], float(apart[first])

    def _keep(self, key: Any, stages: Stages) -> None:
        self._known = [*self._known[1 - REMEMBERED :], (key, stages)]

    def _solved(
        self, key: Any, nodes: np.ndarray, steps: np.ndarray, begins: np.ndarray, tails: np.ndarray, once: bool = False
    ) -> Stages:
        """P steps of lengths `steps` that begin at shares `begins` of the period, solved by Newton's method, or changed
        by it `once`."""
        (known, away), solved = self._nearest(key, nodes, tails), None
        if known is not None and away == 0.0 and known.change < SOLVED:
            return known
        if known is not None and np.isfinite(away):
            solved = self._from(known.moved(nodes, tails), nodes, steps, begins, tails, once)
        if solved is None:  # also where another orbit had the mesh
            # from the cubics through nodes and rates, the last of which ends where the first begins; straight lines
            # where steps do not follow each other
            moments = begins * tails[:, 0] * self.forced
            rates, ahead = tails[:, :1] * self._evaluated(moments, nodes, tails)[0], np.roll(nodes, -1, axis=0) - nodes
            slopes, later = steps[:, None] * rates, steps[:, None] * np.roll(rates, -1, axis=0)
            jumps = np.append(begins[1:] - begins[:-1] > 1.5 * steps[:-1], False)
            jumps[-1] = len(nodes) == 1 or np.any(np.abs(ahead[-1]) > 0.5 * np.ptp(nodes, axis=0))
            ahead[jumps] = later[jumps] = slopes[jumps]
            s = self.tableau.points[:, None]
            bent = (1 - s) * slopes[:, None] - s * later[:, None]
            cubic = s**2 * (3 - 2 * s) * ahead[:, None] + s * (1 - s) * bent
            solved = self._from(cubic, nodes, steps, begins, tails, once)
        if solved is None:
            raise IntegrationError("the equations of collocation do not converge; start nearer, or with a finer mesh")
        self._keep(key, solved)
        return solved

    def _from(
        self, z: np.ndarray, nodes: np.ndarray, steps: np.ndarray, begins: np.ndarray, tails: np.ndarray, once: bool
    ) -> Stages | None:
        """The same from first stages, None where they lead nowhere."""
        units = nonzero(np.abs(nodes).max(axis=0))
        for _ in range(MOST_ITERATIONS):
            if self._staging is not None:
                changes, integrals = self._staging.changed(nodes, begins, steps, tails, self.tableau.packed, z)
            else:
                changes, integrals = self._newton(z, nodes, steps, begins, tails)
            moved = changes[:, :, 0].reshape(z.shape)
            z, change = z + moved, float(np.abs(moved / units).max())
            if not change < 1e6:
                break
            if once or change < SOLVED:
                return Stages(nodes, tails, z, changes[:, :, 1:], integrals, change)
        return None

    def _newton(
        self, z: np.ndarray, nodes: np.ndarray, steps: np.ndarray, begins: np.ndarray, tails: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Newton's change of the stages and their derivatives by nodes and by (T, s, free) (P x m d x 1 + d + ...), and
        the integrals (P)."""
        count, m, size = z.shape
        a, duration = self.tableau.inner, steps * tails[:, 0]
        moments = (begins[:, None] + steps[:, None] * self.tableau.points).ravel()
        places, states = np.repeat(tails, m, axis=0), (nodes[:, None] + z).reshape(-1, size)
        values = self._evaluated(moments * places[:, 0] * self.forced, states, places)
        integrals = duration * (values[3].reshape(count, m) @ self.tableau.weights)
        rates, slopes, others = (each.reshape(count, m, *each.shape[1:]) for each in values[:3])
        across = duration[:, None, None, None, None] * a[:, None, :, None] * slopes.swapaxes(1, 2)[:, None]
        matrix = np.eye(m * size) - across.reshape(count, m * size, m * size)
        right = np.empty((count, m, size, 1 + size + tails.shape[1]))
        carried = np.einsum("ij,pjbc->pibc", a, np.concatenate([rates[..., None], others], axis=3))
        carried *= duration[:, None, None, None]
        right[..., 0] = carried[..., 0] - z
        right[..., 1 : 1 + size] = across.sum(axis=3)
        right[..., 1 + size] = carried[..., 0] / tails[:, :1, None]
        if self.forced:  # a longer period moves every moment
            late = others[..., 0] * moments.reshape(count, m, 1)
            right[..., 1 + size] += duration[:, None, None] * np.einsum("ij,pja->pia", a, late)
        right[..., 2 + size :] = carried[..., 1 + self.forced :]
        try:
            return np.asarray(np.linalg.solve(matrix, right.reshape(count, m * size, -1))), integrals
        except np.linalg.LinAlgError:
            return np.full((count, m * size, right.shape[3]), np.nan), integrals

    def once(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> Varied:
        """`varied` with states of segments of one step each, whose stages are changed once: Newton's method for nodes
        and stages together."""
        return self.varied_each(nodes[None], mesh, tail[None], True, True)[0]

    def varied_each(
        self, nodes: np.ndarray, mesh: np.ndarray, tails: np.ndarray, states: bool = False, once: bool = False
    ) -> list[Varied]:
        """The integration of several loops on one mesh, of nodes (B x N x d) and tails (B x m), beside each other."""
        (loops, count, size), each = nodes.shape, (mesh.size - 1) // nodes.shape[1]
        now, tail, widths = nodes.reshape(-1, size), np.repeat(tails, count, axis=0), np.diff(mesh)
        grown, integrals, change = np.zeros((0, 0, 0)), np.zeros(len(now)), 0.0
        path = []
        for k in range(each):
            steps, begins = (np.tile(part[k::each], loops) for part in (widths, mesh[:-1]))
            key = (loops, k, mesh.tobytes())
            done = self._solved(key, now, steps, begins, tail, once)
            changed = self._ended(done.slopes.reshape(len(now), -1, size, size + tails.shape[1]))
            changed[:, :, :size] += np.eye(size)
            added = changed
            if k:
                added = changed[:, :, :size] @ grown
                added[:, :, size:] += changed[:, :, size:]
            path.append(now)
            now, grown = now + self._ended(done.stages), added
            integrals, change = integrals + done.integrals, max(change, done.change)
        ends = now.reshape(loops, count, size)
        by_node, by_tail = np.split(grown.reshape(loops, count, size, -1), [size], axis=3)
        whole = nodes
        if states:
            inner = np.stack(path, axis=1).reshape(loops, -1, size)
            whole = np.concatenate([inner, ends[:, -1:]], axis=1)
        totals = np.reshape(integrals, (loops, -1)).sum(axis=1).tolist()
        return list(map(Varied, ends, by_node, by_tail, whole, totals, [change] * loops))

    def _ended(self, stages: np.ndarray) -> np.ndarray:
        """What stages (P x m x ...) make of the end of a step (P x ...)."""
        *others, last = self.tableau.end
        if last == 1.0 and not any(others):
            return np.array(stages[:, -1])
        return np.asarray(np.einsum("i,pi...->p...", self.tableau.end, stages))

    def ends(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
        """States (N x d) at the ends of the segments from their nodes (N x d). Raises `IntegrationError`."""
        return self.varied(nodes, mesh, tail).ends

    def states(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
        """States (M + 1 x d) at the mesh."""
        if len(nodes) < mesh.size - 1:
            return self.varied(nodes, mesh, tail, states=True).states
        return np.vstack([nodes, self.ends(nodes[-1:], mesh[-2:], tail)])

    def stages(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
        """Stages Z (N x m x d) of segments of one step each; kept until they are of another motion."""
        asked, *before = self._staged
        if before[0] is not nodes or before[1] is not mesh or before[2] is not tail:
            asked = self._stages(nodes, mesh, tail)
            self._staged = asked, nodes, mesh, tail
        return np.asarray(asked)

    def _stages(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
        tails, key = np.repeat(tail[None], len(nodes), axis=0), (1, 0, mesh.tobytes())
        known, away = self._nearest(key, nodes, tails)
        if known is not None and away < BESIDE and known.change < SOLVED:
            return known.moved(nodes, tails)
        return self._solved(key, nodes, np.diff(mesh), mesh[:-1], tails).stages

    def integral(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> float:
        """The integral over segments of one step each."""
        rule, steps, count = self.tableau, np.diff(mesh), len(nodes)
        states = (nodes[:, None] + self.stages(nodes, mesh, tail)).reshape(-1, self.size)
        moments = (mesh[:-1, None] + steps[:, None] * rule.points).ravel() * tail[0] * self.forced
        values = self._evaluated(moments, states, np.repeat(tail[None], len(states), axis=0))[3]
        return float(tail[0] * steps @ (values.reshape(count, -1) @ rule.weights))

    def sampled(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray, places: np.ndarray) -> np.ndarray:
        """States (k x d) at places (k, in periods) of the polynomials of segments of one step each."""
        step = np.clip(np.searchsorted(mesh, places, side="right") - 1, 0, len(nodes) - 1)
        basis = self.tableau.basis((places - mesh[step]) / (mesh[step + 1] - mesh[step]))
        stages = self.stages(nodes, mesh, tail)
        return np.asarray(nodes[step] + np.einsum("km,kmd->kd", basis, stages[step]))

    def begin(self, nodes: np.ndarray, stages: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> None:
        """Begin with these stages (N x m x d) where segments of one step each are next integrated on a mesh."""
        tails = np.repeat(tail[None], len(nodes), axis=0)
        none = np.zeros((len(nodes), stages[0].size, self.size + tail.size))
        self._keep((1, 0, mesh.tobytes()), Stages(nodes, tails, stages, none, np.zeros(len(nodes))))

    def _worked(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
        """The (m + 1)-th root of the error of the polynomial of m points over each interval of an orbit (N).

        In its extents; more where errors grow by more than `GROWTH` over it. A mesh is right where it is the same
        everywhere (U. Ascher, R. Mattheij, R. Russell, Numerical Solution of Boundary Value Problems for Ordinary
        Differential Equations (1995), section 9.3).
        """
        rule, units, root = self.tableau, nonzero(np.ptp(nodes, axis=0)), 1.0 / (self.tableau.points.size + 1)
        steps, share = np.diff(mesh), ERROR**root / np.log(GROWTH)
        work = curvatures(rule, self.stages(nodes, mesh, tail), mesh, units) ** root * steps
        return np.asarray(np.maximum(work, share * self._grown(nodes, mesh, tail, work / share)))

    def _grown(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray, least: np.ndarray) -> np.ndarray:
        """The logarithm of how often errors grow over each interval (N), by the faster of its ends; 0 where that is
        below `least` (N)."""
        steps = tail[0] * np.diff(mesh)
        rates = least / steps
        fastest = self.growths(nodes, tail, mesh[:-1] * tail[0], np.minimum(rates, np.roll(rates, 1)))
        return np.asarray(np.maximum(fastest, np.roll(fastest, -1)) * steps)

    def growth_errors(self, grown: np.ndarray) -> np.ndarray:
        """The relative error with which a step lets errors grow exp(z) times, z being given (...)."""
        grown = np.maximum(grown, FASTEST)
        return np.asarray(np.abs(self.tableau.amplified(grown) * np.exp(-grown) - 1.0))

    def wanted(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> int:
        """As many intervals as leave the error that is allowed, in tens, no more than twice as many as there are."""
        return self._enough(self._worked(nodes, mesh, tail))

    def _enough(self, work: np.ndarray) -> int:
        enough = work.sum() / ERROR ** (1 / (self.tableau.points.size + 1))
        return int(np.clip(10 * np.ceil(0.1 * enough), FEWEST, min(2 * work.size, MOST)))

    def fits(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> bool:
        """Whether its intervals share the work, are as many as the error asks for, and errors do not outgrow one."""
        work = self._worked(nodes, mesh, tail)
        steepest = np.full(work.size, np.log(STEEPEST))
        even = work.max() <= LOPSIDED * work.mean() and np.all(self._grown(nodes, mesh, tail, steepest) <= steepest)
        return bool(even and work.size <= SLACK * self._enough(work) <= SLACK**2 * work.size)

    def regridded(
        self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray, count: int = 0
    ) -> tuple[np.ndarray, np.ndarray]:
        """The orbit interpolated on a mesh of intervals of equal work."""
        steps, rule, work = np.diff(mesh), self.tableau, self._worked(nodes, mesh, tail)
        density = work / steps
        density = np.maximum(density, SPARSEST * float(density @ steps))
        total = np.append(0.0, np.cumsum(density * steps))
        new = np.interp(np.linspace(0.0, total[-1], (count or self._enough(work)) + 1), total, mesh)
        inside = (new[:-1, None] + np.diff(new)[:, None] * rule.points).ravel()
        ends, between = (self.sampled(nodes, mesh, tail, places) for places in (new[:-1], inside))
        self.begin(ends, between.reshape(len(ends), rule.points.size, -1) - ends[:, None], new, tail)
        return ends, new


def curvatures(rule: Tableau, stages: np.ndarray, mesh: np.ndarray, units: np.ndarray) -> np.ndarray:
    """The (m + 1)-th derivative, divided by (m + 1)!, over each step (N), the largest of its components in `units` (d).

    From how the m-th divided differences change between the middles of neighbouring steps, of a closed motion.
    """
    steps = np.diff(mesh)
    lower = np.einsum("m,kmd->kd", rule.difference[1:], stages) / steps[:, None] ** rule.points.size
    apart = 0.5 * (steps + np.roll(steps, -1))
    change = np.abs(np.roll(lower, -1, axis=0) - lower) / apart[:, None] / (rule.points.size + 1)
    return np.asarray((0.5 * (change + np.roll(change, 1, axis=0)) / units).max(axis=1))
