"""Closed loops of mechanisms: their equations, assembly near a pose, and minimal coordinates.

`minimal_mechanism` has the motion of the native DAE in as many coordinates as degrees of freedom: the others follow by
Newton's method on the closures, from a pose along a straight line.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy.linalg import qr

from orbitfinder._runtime.sizes import size_of
from orbitfinder.errors import InputError, closest, plural
from orbitfinder.mechanics.constrained import RANK_TOLERANCE, Loops, by_place
from orbitfinder.mechanics.factorise import solve_positive_definite
from orbitfinder.mechanics.lagrange import Symbols, Terms, mechanical_model
from orbitfinder.mechanics.model import Invariant, Model, constraint_of
from orbitfinder.mechanics.newton import closed
from orbitfinder.records.reading import Table

HOMOTOPY, FINAL = 20, 3
"""Newton steps along the way from the pose to a place, and at the place, of the minimal form"""
LEAST_SHARE = 5e-3
"""Least over largest singular value of the closures' slopes below which a mechanism is at a dead point."""


def independent_rows_at(closure: LoopClosure, place: np.ndarray, names: Sequence[str], drop: bool) -> list[int]:
    """Rows that do not repeat earlier ones; `InputError` where some do, or only in this pose."""
    slopes, rows = closure.slopes(place), len(closure.names)
    kept = independent_rows(slopes)
    if len(kept) >= len(place):
        held = ", ".join(dict.fromkeys(map(closure.joint, range(rows))))
        raise InputError(f"joints: over-constrained, {held} leave no freedom; take a joint away")
    if len(kept) == rows:
        return kept
    lost = next(k for k in range(rows) if k not in kept)
    if len(_beside(closure, place)) > len(kept):
        shown = ", ".join(f"{name} = {value:.4g}" for name, value in zip(names, place, strict=True))
        raise InputError(
            f"pose: singular at {shown}: the equations of {closure.joint(lost)} depend on the others here and "
            "nowhere near (a dead point of the loop: bars in line); give another pose"
        )
    if drop:
        best = qr(slopes.T, mode="r", pivoting=True)[1]  # what is farthest from repeating others
        return sorted(int(k) for k in best[: len(kept)])
    raise InputError(
        f"joints: over-constrained, row {closure.names[lost]!r} of {closure.joint(lost)} repeats what others hold "
        f"(rank {len(kept)} of {rows} equations), so its force is not determined; loosen that joint, or leave "
        "such rows out by redundant = 'drop'"
    )


def _beside(closure: LoopClosure, place: np.ndarray) -> list[int]:
    """Independent rows at the best of a few configurations nearby."""
    random, best = np.random.default_rng(0), list[int]()
    for _ in range(4):
        start = place + 0.1 * closure.units * random.uniform(-1, 1, place.size)
        with suppress(InputError):
            best = max(best, independent_rows(closure.slopes(closure.near(start))), key=len)
    return best


def independent_rows(matrix: np.ndarray) -> list[int]:
    """Rows of a matrix that are no combination of earlier ones."""
    basis, kept = np.zeros((0, matrix.shape[1])), list[int]()
    size = size_of(matrix)
    for k, row in enumerate(matrix):
        rest = row - basis.T @ (basis @ row)
        rest -= basis.T @ (basis @ rest)
        if np.linalg.norm(rest) > RANK_TOLERANCE * size:
            basis, kept = np.vstack([basis, rest / np.linalg.norm(rest)]), [*kept, k]
    return kept


@dataclass(frozen=True)
class LoopClosure:
    """The equations phi(q) = 0 of loops with the joints that they are of."""

    function: ca.Function
    """(q, p) -> (phi, J)"""
    values: np.ndarray
    units: np.ndarray
    """of the coordinates (n)"""
    names: Sequence[str]
    joints: Mapping[str, Table]

    @classmethod
    def of(cls, model: Model, units: np.ndarray | None = None) -> LoopClosure:
        """That of a Model under constraints."""
        constraint = constraint_of(model)
        q, p = constraint.phi.sx_in()
        function = ca.Function("phi", [q, p], [constraint.phi(q, p), constraint.jacobian(q, p)])
        units = coordinate_units(model) if units is None else units
        return cls(function, model.parameter_values, units, constraint.force_names, model.system.get("joints", {}))

    def slopes(self, place: np.ndarray) -> np.ndarray:
        """J at a place, columns in units of their own."""
        return np.asarray(self.function(place, self.values)[1].full() * self.units)

    def near(self, start: np.ndarray, fixed: Sequence[int] = ()) -> np.ndarray:
        """A configuration (n) with phi = 0 near a start, some coordinates held, by Gauss-Newton; `InputError` naming
        the joint that stays open."""

        def phi(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            gaps, slopes = (part.full() for part in self.function(place, self.values))
            return gaps.ravel(), slopes

        loose, units = [k for k in range(start.size) if k not in fixed], self.units
        solution = closed(phi, start, loose, units, float(np.abs(units[units != 1.0]).max(initial=0.0)))
        if solution.converged:
            return solution.w
        gaps = phi(solution.w)[0]
        worst = int(np.abs(gaps).argmax())
        raise InputError(
            f"joints: the loop stays open at {self.joint(worst)}: {abs(gaps[worst]):.3g} m are left between their "
            "points in the nearest configuration that was found; check the lengths, or give a pose nearer to one that "
            "closes"
        )

    def joint(self, row: int) -> str:
        """The joint that a row belongs to, with its bodies, for messages."""
        name = self.names[row].rpartition("_")[0]
        if name not in self.joints:
            return self.names[row]
        return f"joint {name!r} between {' and '.join(map(repr, self.joints[name]['between']))}"


def mechanism_state(
    model: Model,
    known: Mapping[str, float] | None = None,
    rates: Mapping[str, float] | None = None,
    near: np.ndarray | None = None,
) -> np.ndarray:
    """The state (2n) of a mechanism at some coordinates and rates (others at rest), its loops closed near the pose.

    Coordinates that are not `known` start from `near` (n) or the pose. Raises `InputError` where a loop stays open, or
    at a dead point of the given coordinates, which then do not say how the others move.
    """
    names = model.coordinates
    given = by_place(known or {}, names, "coordinate", "mechanism")
    speeds = by_place(rates or {}, [f"{name}dot" for name in names], "rate", "mechanism")
    pose = model.system.get("pose", {})
    place = np.array([pose.get(name, 0.0) for name in names]) if near is None else np.array(near, float)
    if place.shape != (len(names),):
        raise InputError(f"near: {plural(place.size, 'number')}; give one for each of {', '.join(names)}")
    rate = np.zeros(len(names))
    rate[list(speeds)] = list(speeds.values())
    if model.constraint is None:
        place[list(given)] = list(given.values())
        return np.concatenate([place, rate])
    freedom = len(names) - len(model.constraint.force_names)
    for what, table in (("coordinates", given), ("rates", speeds)):
        if len(table) > freedom:
            raise InputError(f"{what}: {len(table)} given, this mechanism has {plural(freedom, 'degree')} of freedom")
    closure = LoopClosure.of(model)
    place, units = closure.near(place), closure.units
    begin, wanted = place[list(given)], np.array(list(given.values()))
    away = float(np.abs((wanted - begin) / units[list(given)]).max(initial=0.0))
    strides = int(
        np.ceil(away / 0.2)
    )  # so short, in rad or shares of the size, that it is the same assembly all the way
    for share in np.linspace(0.0, 1.0, 1 + strides)[1:]:
        place[list(given)] = begin + share * (wanted - begin)
        place = closure.near(place, list(given))
    slopes = closure.slopes(place)
    others = [k for k in range(len(names)) if k not in speeds]
    if speeds and len(independent_rows(slopes[:, others].T)) < len(slopes):
        raise InputError(
            f"rates: dead point, here {', '.join(names[k] for k in speeds)} cannot say how "
            f"{', '.join(names[k] for k in others)} move; give the rate of another coordinate"
        )
    rate[others] = units[others] * np.linalg.lstsq(slopes[:, others], -slopes @ (rate / units), rcond=1e-12)[0]
    return np.concatenate([place, rate])


def point_sizes(names: Sequence[str], values: Sequence[float]) -> list[float]:
    """Sizes of the points and lengths among numbers by name."""
    pattern = re.compile(r"_[12]_[xyz]$|_com_[xyz]$|_length$")
    return [abs(value) for name, value in zip(names, values, strict=True) if pattern.search(name)]


def coordinate_units(model: Model) -> np.ndarray:
    """1 rad of angles, of slides (n) the largest number of a point."""
    sizes = point_sizes(model.parameter_names, model.parameter_values.tolist())
    return np.where(model.angular, 1.0, max(sizes, default=1.0) or 1.0)


def minimal_mechanism(model: Model, independent: Sequence[str], near: np.ndarray | None = None) -> Model:
    """The Model of a mechanism with loops in its `independent` coordinates u, as many as degrees of freedom.

    The others follow from phi(u, d, p) = 0 by Newton's method along the straight line from the pose `near` (n) to u,
    angles by the shorter way round; with q' = B u', q'' = B u'' + g the equations are B^T (M q'' + h) = 0. Source: R.
    A. Wehage, E. J. Haug, Journal of Mechanical Design 104 (1982) 247-255. Valid while the closures determine the
    others (no dead point of u). Raises `InputError`.
    """
    names, n = model.coordinates, model.degrees_of_freedom
    freedom = n - len(constraint_of(model).force_names)
    for name in independent:
        if name not in names:
            raise InputError(f"independent: unknown coordinate {name!r}{closest(name, names)}; use {', '.join(names)}")
    if len(set(independent)) != freedom:
        raise InputError(
            f"independent: need {freedom} different coordinates of {', '.join(names)}, got {list(independent)}"
        )
    chosen = [names.index(name) for name in independent]
    pose = mechanism_state(model, near=near)[:n]
    rest = [k for k in range(n) if k not in chosen]
    if _margins(model, pose[None])(chosen)[0] < RANK_TOLERANCE / LEAST_SHARE:
        raise InputError(
            f"independent: dead point of {', '.join(independent)} at the pose: {_weakest(model, pose, rest)} does not "
            f"say where {', '.join(names[k] for k in rest)} go; choose other coordinates"
        )
    return _embedded(model, chosen, pose)


def _embedded(model: Model, chosen: list[int], pose: np.ndarray) -> Model:
    constraint, n, size = constraint_of(model), model.degrees_of_freedom, len(chosen)
    rest = [k for k in range(n) if k not in chosen]
    t, u, rate = ca.SX.sym("t"), ca.SX.sym("u", size), ca.SX.sym("udot", size)
    p = ca.SX.sym("p", model.parameter_values.size)
    q = _followed(model, chosen, pose, u, p)
    jacobian = constraint.jacobian(q, p)
    basis = ca.SX(n, size)
    basis[chosen, :] = ca.SX.eye(size)
    basis[rest, :] = -ca.solve(jacobian[:, rest], jacobian[:, chosen])
    v = ca.mtimes(basis, rate)
    turning = ca.SX(n, 1)
    turning[rest] = -ca.solve(jacobian[:, rest], constraint.acceleration(q, v, ca.SX.zeros(n), p))
    a = ca.SX.sym("a", n)
    force = ca.SX.zeros(len(constraint.force_names))
    equations = constraint.balances(t, q, v, a, force, p)
    mass = ca.jacobian(equations, a)
    bias = ca.substitute(equations, a, ca.densify(turning))
    inner = ca.mtimes([basis.T, mass, basis])
    symbols = Symbols(u, rate, p, model.parameter_names, tuple(map(float, model.parameter_values)),
                      time=t if model.forced else None)  # fmt: skip
    if model.forcing_period is not None:
        symbols = replace(symbols, forcing_period=model.forcing_period(p))
    forces = None if model.forces is None else ca.mtimes(basis.T, model.forces(t, q, v, p))
    drive = None if model.actuation is None else ca.mtimes(basis.T, model.actuation(t, q, v, p))
    terms = Terms(model.kinetic(q, v, p), model.potential(q, p), forces=forces, actuation=drive)
    names = [model.state_names[k] for k in chosen]
    acceleration = solve_positive_definite(inner, -ca.mtimes(basis.T, bias))
    shown = {name: float(value) for name, value in zip(model.state_names, pose, strict=False)}
    both, invariants = [*chosen, *(n + k for k in chosen)], list[Invariant]()
    for each in model.invariants:
        parts = each.value(q, v, p), each.unfolding(q, v, p)[chosen], each.generator and each.generator(q, v, p)[both]
        value, added, along = (None if x is None else ca.Function(each.name, [u, rate, p], [x]) for x in parts)
        invariants.append(Invariant(each.name, value, added, along))
    return mechanical_model(
        ca.Function("acceleration", [t, u, rate, p], [acceleration]), terms, symbols, names,
        invariants=invariants,
        angles=tuple(bool(model.angular[k]) for k in chosen),
        points=None if model.points is None else ca.Function("points", [u, p], [model.points(q, p)]),
        space=None if model.space is None else ca.Function("space", [u, p], [model.space(q, p)]),
        strokes=model.strokes, controls=model.controls, limits=model.limits,
        system={**model.system, "pose": shown, "independent": names},
    )  # fmt: skip


def _followed(model: Model, chosen: list[int], pose: np.ndarray, u: ca.SX, p: ca.SX) -> ca.SX:
    """All coordinates (n) from the independent: a Newton step at each place along the way, a few at its end."""
    constraint, angular = constraint_of(model), model.angular[chosen]
    rest = [k for k in range(pose.size) if k not in chosen]
    from_pose = ca.vertcat(*(
        ca.atan2(ca.sin(u[k] - pose[j]), ca.cos(u[k] - pose[j])) if angular[k] else u[k] - pose[j]
        for k, j in enumerate(chosen)
    ))  # fmt: skip
    q = ca.SX(ca.DM(pose))
    for step in range(1, HOMOTOPY + FINAL + 1):
        share = min(step / HOMOTOPY, 1.0)
        q[chosen] = pose[chosen] + share * from_pose
        phi, slopes = constraint.phi(q, p), constraint.jacobian(q, p)
        q[rest] = q[rest] - ca.solve(slopes[:, rest], phi)
    q[chosen] = u
    return q


def _in_all(model: Model, system: Table, u: ca.SX) -> ca.SX:
    """All coordinates (n) of the minimal form with this system."""
    names = model.coordinates
    chosen = [names.index(name) for name in system["independent"]]
    pose = np.array([system["pose"][name] for name in names])
    return _followed(model, chosen, pose, u, ca.SX(ca.DM(model.parameter_values)))


def _margins(model: Model, places: np.ndarray) -> Callable[[Sequence[int]], np.ndarray]:
    """The least singular value, over the largest, of the slopes with which the loops' equations hold the others, of a
    single equation over all its slopes; negative beyond a dead point."""
    rows = model.along(constraint_of(model).jacobian, places.T)
    slopes = rows.reshape(rows.shape[0], len(places), -1).transpose(1, 0, 2) * coordinate_units(model)

    def margins(chosen: Sequence[int]) -> np.ndarray:
        held = np.delete(slopes, chosen, axis=2)
        values, side = np.linalg.svd(held, compute_uv=False), np.linalg.slogdet(held)[0]
        largest = values[:, 0] if len(rows) > 1 else np.linalg.norm(slopes[:, 0], axis=1)
        return np.asarray(side * side[0] * values[:, -1] / largest / LEAST_SHARE)

    return margins


def _at_dead_point(model: Model, place: np.ndarray, chosen: Sequence[int]) -> str:
    names, rest = model.state_names, [k for k in range(place.size) if k not in chosen]
    return (
        f"{_weakest(model, place, rest)} no longer says how {', '.join(names[k] for k in rest)} "
        f"follow from {', '.join(names[k] for k in chosen)} (a dead point)"
    )


def _weakest(model: Model, place: np.ndarray, rest: Sequence[int]) -> str:
    """The joint whose equation says least about where some coordinates go."""
    closure = LoopClosure.of(model)
    return closure.joint(int(np.abs(np.linalg.svd(closure.slopes(place)[:, rest])[0][:, -1]).argmax()))


JOINED = Loops(
    lambda model, *given, branch=None, **more: mechanism_state(model, *given, **more),  # a pose says the branch
    lambda model, near: [mechanism_state(model, near=near)[: model.degrees_of_freedom]],
    lambda model: range(model.degrees_of_freedom), _margins, _at_dead_point, _in_all,
    lambda model, chosen, near: minimal_mechanism(model, [model.state_names[k] for k in chosen], near),
)  # fmt: skip
