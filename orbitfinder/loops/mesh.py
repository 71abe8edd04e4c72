"""The mesh of a family: where the Runge-Kutta steps and the shooting nodes are, moved as the orbit changes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from orbitfinder.errors import UNSOLVED, ConvergenceError, IntegrationError
from orbitfinder.integrate.dop853 import EVALUATIONS_PER_STEP, ReferenceSettings, Trace, integrate_in
from orbitfinder.integrate.equations import accelerations
from orbitfinder.integrate.field import vector_field
from orbitfinder.integrate.march import Gridded, March, Marches, divided
from orbitfinder.loops.continued import Curve, Solution, advanced, correct, plane
from orbitfinder.loops.loop import Equations, Unknowns
from orbitfinder.mechanics.kind import with_parameters

STEP_ERROR = 5e-13
"""Estimated relative error of a Runge-Kutta step on a fresh mesh; the true one is hundreds of times smaller."""

UNEVEN = 1e-4
"""Estimated error of an equal step, relative to the motion, beyond which equal steps lose it: 2e-8 at most of motions
that some hundred follow, 2e-3 and more past close encounters and along bursts"""


@dataclass(frozen=True)
class MeshSettings:
    """How fine a mesh is, and when a family takes a fresh one."""

    coarse: float = 10.0
    """A mesh is kept until some step's estimate is this many times as large."""
    variation_error: float = 2e-10
    """Estimated error of a step's state-transition matrix on a fresh mesh, mostly 30 to 300 times the true one."""
    spare: float = 5.0
    """A mesh is looked at again when the motion alone would do with this many times fewer steps."""
    stale: float = 5.0
    """A mesh is graded anew for the orbits to come when some step's estimate is this many times as large."""
    uneven: float = 1.4
    """... unless a segment needs this many times the steps of an average one."""
    sampled: int = 3
    """One in so many steps is asked for the error of its state-transition matrix, and whether the mesh still fits."""
    widened: int = 3
    """Steps over which the density of a fresh mesh is spread."""
    growth: float = 30.0
    """Segments are added until each one's state-transition matrix is below this."""
    steepest: float = 3000.0
    """... which is done when one has grown to this: with the segments moved at every orbit no predictor would hold."""
    least_nodes: int = 8
    """Nodes of a whole period at least, over which an orbit is measured."""
    moved: float = 1e-4
    """Half of a central difference along a family, in its metric"""
    most_segments: int = 60
    most_steps: int = 6000
    """A motion that asks for more Runge-Kutta steps than this in one horizon is singular."""


MESH = MeshSettings()


def needs_mesh(curve: Curve, solution: Solution, every: int) -> bool:
    """Whether the mesh is too coarse, or a segment too unstable for a point, by one in so many steps."""
    if march := curve.equations.gridded:
        return not march.fits(solution.place.nodes, solution.place.mesh, solution.place.tail)
    motion, variations = _errors(curve, solution, every)
    if max(motion.max(), variations.max()) > MESH.coarse:
        return True
    rough = np.linalg.norm(_blocks(curve, solution), axis=(1, 2)).max()  # no smaller than the 2-norm
    if rough > MESH.steepest and _growths(curve, solution).max() > MESH.steepest:
        return True
    if not (motion**0.125).sum() * MESH.spare < motion.size:
        return False
    return bool(_wanted(*_errors(curve, solution)).sum() < 0.5 * (solution.place.mesh.size - 1))


def _allowed(curve: Curve) -> float:
    """Estimated error of a step on a fresh mesh: less where equations are all but singular, as all along a curve."""
    return STEP_ERROR if curve.test is None else STEP_ERROR / MESH.coarse


def _errors(curve: Curve, solution: Solution, every: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Estimated errors of all steps, or of one in so many, and of their state-transition matrices, each in what it may
    be on a fresh mesh."""
    place, march = solution.place, curve.equations.march
    asked = np.arange(0, place.mesh.size - 1, every)
    motion = march.step_errors(solution.march.states, place.mesh, place.tail, curve.units, asked)
    return motion / _allowed(curve), variation_errors(curve, solution)


def variation_errors(curve: Curve, solution: Solution) -> np.ndarray:
    """The same of the state-transition matrices of all steps, of which those of a large system are asked of every
    third: a motion that goes on as smoothly may come to where its variations are fast."""
    place, march = solution.place, curve.equations.march
    every, count = MESH.sampled if march.wide else 1, place.mesh.size - 1
    asked, units = np.arange(0, count, every), curve.scales.states
    errors = march.variation_errors(solution.march.states, place.mesh, place.tail, units, asked)
    return np.repeat(errors / MESH.variation_error, every)[:count]


def _growths(curve: Curve, solution: Solution) -> np.ndarray:
    return np.array([np.linalg.norm(block, 2) for block in _blocks(curve, solution)])


def _blocks(curve: Curve, solution: Solution) -> np.ndarray:
    units = curve.scales.states
    blocks = solution.march.transitions * units / units[:, None]
    if not np.all(np.isfinite(blocks)):
        raise IntegrationError("the variations of the motion overflow; give a state and a period that fit each other")
    return np.asarray(blocks)


def _wanted(motion: np.ndarray, variations: np.ndarray) -> np.ndarray:
    """(error / allowed)^(1/8), the number of steps that each present one (M) should become, for both of `_errors`."""
    return np.asarray(np.maximum(motion, variations) ** 0.125)


def _spread(density: np.ndarray) -> np.ndarray:
    """The density widened to its neighbours, so that the mesh still fits when the motion has moved a little."""
    return np.asarray(
        uniform_filter1d(maximum_filter1d(density, MESH.widened, mode="nearest"), MESH.widened, mode="nearest")
    )


def _graded(density: np.ndarray, mesh: np.ndarray, steps: int) -> np.ndarray:
    """So many steps over a mesh as its density (M) asks for."""
    work = np.concatenate([[0.0], np.cumsum(density)])
    return np.asarray(np.interp(np.linspace(0.0, work[-1], steps + 1), work, mesh))


def remeshed(curve: Curve, solution: Solution) -> Unknowns:
    """The place on a mesh that spreads the error estimate evenly, with as many segments as the growth asks for.

    Nodes are interpolated and must be corrected again.
    """
    place = solution.place
    if curve.equations.links:
        return _remeshed_arcs(curve, solution)
    if march := curve.equations.gridded:
        if place.steps > 1:  # of a first guess: each is an interval
            place = replace(place, nodes=solution.march.states[:-1])
        return regridded(march, place)
    (density,), count = _asked(curve, solution, _fewest(curve), 1)
    each = _rounded(density.sum() / count)
    mesh = _graded(density, place.mesh, count * each)
    nodes = between(curve, solution, mesh[each:-1:each])
    return replace(place, nodes=np.vstack([place.nodes[:1], nodes]), mesh=mesh)


def _asked(curve: Curve, solution: Solution, fewest: int, arcs: int) -> tuple[np.ndarray, int]:
    """The density (arcs x M) of a fresh mesh, and the segments of each arc, `fewest` at least."""
    density = np.maximum(_wanted(*_errors(curve, solution)), 0.15).reshape(arcs, -1)
    density = np.array([_spread(part) for part in density])
    growth = np.log(np.maximum(_growths(curve, solution), 1.5)).reshape(arcs, -1).sum(axis=1).max()
    if not density.sum() < MESH.most_steps:
        raise ConvergenceError("the motion is nearly singular, its mesh would become too fine; take a smaller step")
    return density, int(np.clip(np.ceil(growth / np.log(MESH.growth)), fewest, MESH.most_segments))


def fitted(curve: Curve, place: Unknowns, several: bool = True) -> Unknowns:
    """A motion's unknowns on a mesh that fits it; a large system's first mesh is made finer where numbers overflow, and
    where equal steps lose the motion those that DOP853 takes come first, and no more segments than there are unless
    `several` are wanted: between encounters errors grow and shrink again, and nodes make equations less linear."""
    p, first = curve.equations, place
    tries = [1, 4, 16] if p.march.wide else [1] if p.links or p.gridded else [1, 0]
    for times in tries:
        try:
            place = first.on(divided(first.mesh, times)) if times else stepped(p, first, curve.units)
            if not (times or several):
                return place.on(divided(place.mesh, 2))
            for _ in range(2):
                solution = Solution(place, p.varied(place, states=True), np.zeros((0, 0)), 0.0)
                if times and not tries[-1] and _errors(curve, solution)[0].max() * _allowed(curve) > UNEVEN:
                    raise ConvergenceError("equal steps lose the motion")
                place = remeshed(curve, solution)
            break
        except UNSOLVED:
            if times == tries[-1]:
                raise
    return place


def stepped(equations: Equations, place: Unknowns, units: np.ndarray) -> Unknowns:
    """The unknowns on a mesh of the steps that DOP853 takes from each node in `units` (d), as many in each segment."""
    pieces = []
    finest = STEP_ERROR / MESH.coarse
    settings = ReferenceSettings(finest, finest, 4 * EVALUATIONS_PER_STEP * MESH.most_steps)
    values = dict(zip(equations.free, place.free.tolist(), strict=True))
    field = vector_field(accelerations(with_parameters(equations.model, values)))
    for node, span in zip(place.nodes, pairwise(place.edges * place.period), strict=True):
        traces = list[Trace]()
        integrate_in(units, field, node, np.linspace(*span, 3), settings, traces=traces)
        pieces.append(traces[0].moments / place.period)
    each = _rounded(max(piece.size - 1 for piece in pieces))
    shares = np.linspace(0.0, 1.0, each + 1)[:-1]
    inside = [np.interp(shares, np.linspace(0.0, 1.0, piece.size), piece) for piece in pieces]
    return place.on(np.append(np.concatenate(inside), place.mesh[-1]))


def between(curve: Curve, solution: Solution, moments: np.ndarray) -> np.ndarray:
    """States (k x d) at moments (k, in periods), exactly where they fix the phase."""
    place, march = solution.place, curve.equations.march
    if isinstance(march, Gridded):
        return march.sampled(place.nodes, place.mesh, place.tail, moments)
    return sampled(march, place, solution.march.states, moments)


def sampled(march: March | Marches, w: Unknowns, states: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """States (k x d) at moments (k, in periods) of a motion whose `states` at the mesh of w are known: a step on from
    the last, forced motions by Hermite's cubics."""
    if march.forced:
        slopes = march.rates(states, w.tail, w.mesh * w.period) * w.period
        return np.asarray(CubicHermiteSpline(w.mesh, states, slopes)(moments))
    before = np.searchsorted(w.mesh, moments, side="right") - 1
    return march.ends(states[before], np.append(0.0, np.cumsum(moments - w.mesh[before])), w.tail)


def _remeshed_arcs(curve: Curve, solution: Solution) -> Unknowns:
    """The same arc by arc of a hybrid orbit, of which each has as many segments and steps as the others."""
    place, arcs = solution.place, curve.equations.links.count
    density, count = _asked(curve, solution, int(np.ceil(MESH.least_nodes / arcs)), arcs)
    each, steps = _rounded(density.sum(axis=1).max() / count), density.shape[1]
    meshes, nodes = [], []
    for k, own in enumerate(density):
        edges, states = place.mesh[k * steps : (k + 1) * steps + 1], arc_states(solution, arcs, k)
        mesh = _graded(own, edges, count * each)
        slopes = curve.equations.march.arcs[k].rates(states, place.tail) * place.period
        nodes.append(CubicHermiteSpline(edges, states, slopes)(mesh[:-1:each]))
        nodes[-1][0] = states[0]
        meshes.append(mesh[:-1])
    return replace(place, nodes=np.vstack(nodes), mesh=np.append(np.concatenate(meshes), place.mesh[-1]))


def arc_states(solution: Solution, arcs: int, k: int) -> np.ndarray:
    """States at the mesh in arc k, the last of them before its event."""
    steps = (solution.place.mesh.size - 1) // arcs
    end = solution.march.ends[(k + 1) * (len(solution.march.ends) // arcs) - 1]
    return np.vstack([solution.march.states[k * steps : (k + 1) * steps], end])


def arc_mesh(w: Unknowns, arcs: int, k: int) -> np.ndarray:
    """The mesh in arc k, over its own duration (0 to 1)."""
    steps = (w.mesh.size - 1) // arcs
    return w.mesh[k * steps : (k + 1) * steps + 1] * arcs - k


def _rounded(steps: float) -> int:
    """A tenth more than so many steps, and an even number, of which the approach can leave out every other."""
    each = int(np.ceil(1.1 * steps + 0.25))
    return each + each % 2


def regraded(curve: Curve, solution: Solution) -> np.ndarray:
    """The mesh of an orbit, its steps moved inside their segments to where they are needed.

    Nodes, and with them the equations, stay as they are: Newton's method can do so on its way.
    """
    if curve.equations.gridded:
        return solution.place.mesh
    place, errors = solution.place, _errors(curve, solution)
    if np.max(errors) < MESH.stale:
        return place.mesh
    density = _spread(np.maximum(_wanted(*errors), 0.15)).reshape(len(place.nodes), -1)
    needed = density.sum(axis=1)
    if not needed.max() < min(MESH.uneven * needed.mean(), MESH.most_steps / len(needed)):
        return place.mesh  # the segments themselves are in the wrong place, which `settled` sees in time
    each, old = _rounded(needed.max()), density.shape[1]
    pieces = []
    for k, part in enumerate(density):
        edges = place.mesh[k * old : (k + 1) * old + 1]
        pieces.append(_graded(part, edges, each)[:-1])
        pieces[-1][0] = edges[0]
    return np.append(np.concatenate(pieces), place.mesh[-1])


def refined(curve: Curve, solution: Solution, along: np.ndarray) -> Solution:
    """The same orbit with half as many steps again in every segment, for one whose shear amplifies their errors."""
    place = solution.place
    count = len(place.nodes)
    if march := curve.equations.gridded:
        finer = regridded(march, place, int(1.5 * count))
        along = carried(curve, place, along, finer)
        return correct(curve, finer, plane(curve, finer, along), finer)
    steps = (place.mesh.size - 1) // count
    more = 4 * int(np.ceil(1.5 * steps / 4))
    old, new = np.arange(place.mesh.size), np.linspace(0.0, place.mesh.size - 1, count * more + 1)
    finer = replace(place, mesh=np.interp(new, old, place.mesh))
    return correct(curve, finer, plane(curve, place, along), place)


def carried(curve: Curve, place: Unknowns, whole: np.ndarray, other: Unknowns) -> np.ndarray:
    """A direction over w as one over others of the same orbit: what moves along it, marched to where segments begin."""
    if np.array_equal(place.edges, other.edges) or whole.size != place.vector.size:
        return whole if whole.size == other.vector.size else other.spread(whole)
    sides = (advanced(place, whole, length) for length in (-MESH.moved, MESH.moved))
    before, after = (curve.equations.march.states(side.nodes, side.mesh, side.tail) for side in sides)
    moved = ((after - before) / (2 * MESH.moved)).T
    nodes = np.array([np.interp(other.edges[:-1], place.mesh, component) for component in moved]).T
    return np.concatenate([nodes.ravel(), whole[place.nodes.size :]])


def settled(curve: Curve, solution: Solution, along: np.ndarray, every: int = MESH.sampled) -> Solution:
    """The same orbit on a fitting mesh, held in the hyperplane through it normal to a direction over w.

    Segments stay where they are if they can, for the predictor of the next orbit looks back over them.
    """
    for _ in range(4):
        if not needs_mesh(curve, solution, every):
            break
        mesh, gridded = solution.place.mesh, curve.equations.gridded is not None
        tame = gridded or _growths(curve, solution).max() <= MESH.steepest
        if tame and len(solution.place.nodes) >= _fewest(curve):
            mesh = regraded(curve, solution)
        place = remeshed(curve, solution) if mesh is solution.place.mesh else replace(solution.place, mesh=mesh)
        along = carried(curve, solution.place, along, place)
        solution = correct(curve, place, plane(curve, place, along), solution.place)
        if gridded:
            break
    return solution


def regridded(march: Gridded, w: Unknowns, count: int = 0) -> Unknowns:
    """An orbit over so many segments of a march that chooses its mesh, 0 for as many as it asks for."""
    nodes, mesh = march.regridded(w.nodes, w.mesh, w.tail, count)
    return replace(w, nodes=nodes, mesh=mesh)


def _fewest(curve: Curve) -> int:
    """Nodes of a horizon at least."""
    return int(np.ceil(MESH.least_nodes * curve.equations.symmetry.fraction))
