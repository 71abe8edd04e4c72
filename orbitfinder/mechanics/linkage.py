"""Closed planar chains of bars (four-bar, five-bar, ...) as native DAEs, and their assembly.

A linkage of n bars is the chain of n links whose tip is pinned to the ground at (x, y), x down and
y right, by two more reaction forces and two more constraints. The first joint is at the origin, the
ground is not counted as a bar here: three links make a four-bar. It has n - 2 degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.mechanics.chain import ChainSymbols, Numbers, chain_symbols, chain_system
from orbitfinder.mechanics.constrained import RANK_TOLERANCE, Baumgarte, ConstrainedModel
from orbitfinder.mechanics.maximal import maximal_chain, maximal_states
from orbitfinder.mechanics.model import check_state

DEFAULT_BAUMGARTE = Baumgarte(10.0, 10.0)
"""1/s; phi decays within a few tenths of a second, much faster than a linkage of metres moves"""
REACH_TOLERANCE = 1e-12
"""relative excess over the reach that is taken for round-off"""


def linkage(
    length: Sequence[float] | np.ndarray,
    mass: Numbers = 1.0,
    ground: Sequence[float] = (0.0, 1.0),
    inertia: Numbers | None = None,
    com: Numbers = 0.5,
    *,
    gravity: float = 9.8,
    baumgarte: Baumgarte | Sequence[float] | None = None,
) -> ConstrainedModel:
    """Closed chain from the origin through bars of `length` (n of them, m) to the `ground` pivot (m).

    `mass` (kg), `inertia` (kg m^2 about the centre of mass, default m l^2 / 12), `com` (fraction of
    the length from the upper joint), `gravity` (m/s^2) as for `chain`; `baumgarte` (alpha, beta) in
    1/s. q = (x_G, y_G, theta) per link; lambda are the forces (2 per joint, N) on each link at its
    upper joint, the last pair on the ground at its pivot. Raises `InputError` for a linkage that
    cannot be assembled. Source: the report, section 3.
    """
    lengths = np.atleast_1d(np.asarray(length, float))
    if lengths.ndim != 1 or lengths.size < 2:
        raise InputError(f"length: a linkage has one number per bar and at least 2 bars, got {length!r}")
    pivot = np.asarray(ground, float)
    if pivot.shape != (2,) or not np.all(np.isfinite(pivot)):
        raise InputError(f"ground: need the two coordinates of the far pivot (x down, y right, m), got {ground!r}")
    system = chain_system(lengths.size, lengths, mass, inertia, com, gravity=gravity)
    for absent in ("links", "formulation"):
        del system[absent]
    stabilisation = _baumgarte(baumgarte)
    system |= {
        "kind": "linkage",
        "ground": [float(value) for value in pivot],
        "baumgarte": [stabilisation.alpha, stabilisation.beta],
    }
    check_closable(lengths, pivot)
    symbols = linkage_symbols(system)
    return maximal_chain(symbols, system, stabilisation, ground=symbols.parameters[-2:])


def _baumgarte(given: Baumgarte | Sequence[float] | None) -> Baumgarte:
    if given is None:
        return DEFAULT_BAUMGARTE
    if isinstance(given, Baumgarte):
        return given
    numbers = np.asarray(given, float)
    if numbers.shape != (2,) or not np.all(np.isfinite(numbers)) or np.any(numbers < 0):
        raise InputError(f"baumgarte: need [alpha, beta], both at least 0 in 1/s, got {given!r}")
    return Baumgarte(float(numbers[0]), float(numbers[1]))


def linkage_symbols(system: Mapping[str, Any]) -> ChainSymbols:
    """The chain's symbols with the ground pivot as two more parameters, ground1 (down), ground2 (right)."""
    open_chain = chain_symbols({**system, "links": len(system["length"])})
    return replace(
        open_chain,
        parameters=ca.vertcat(open_chain.parameters, ca.SX.sym("ground", 2)),
        names=(*open_chain.names, "ground1", "ground2"),
        values=np.concatenate([open_chain.values, system["ground"]]),
    )


def check_closable(lengths: np.ndarray, ground: np.ndarray) -> None:
    """`InputError` unless the polygon of bars and ground closes: no side longer than all others together."""
    sides = np.append(lengths, np.linalg.norm(ground))
    longest = int(np.argmax(sides))
    others = float(sides.sum() - sides[longest])
    if sides[longest] > others * (1 + REACH_TOLERANCE):
        name = f"length{longest + 1}" if longest < lengths.size else "the distance between the ground pivots"
        raise InputError(
            f"linkage: cannot be assembled, {name} = {sides[longest]:.6g} m exceeds the sum of all other sides, "
            f"{others:.6g} m (polygon inequality); shorten it by more than {sides[longest] - others:.6g} m "
            "or lengthen the others"
        )


def dimensions(model: ConstrainedModel) -> tuple[np.ndarray, np.ndarray]:
    """Bar lengths (n) and ground pivot (2) of a linkage from its parameter values, in m."""
    if model.system.get("kind") != "linkage":
        raise InputError(f"expected a linkage, got kind {model.system.get('kind')!r}; build it with linkage(...)")
    values = dict(zip(model.parameter_names, model.parameter_values, strict=True))
    lengths = [values[f"length{i + 1}"] for i in range(model.coordinates // 3)]
    return np.array(lengths), np.array([values["ground1"], values["ground2"]])


def closure_jacobian(lengths: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Derivative (2 x n) of the tip's position sum l_i e_i with respect to the angles: columns l_i n_i."""
    return np.asarray(lengths * np.array([-np.sin(theta), np.cos(theta)]))


def check_regular(lengths: np.ndarray, theta: np.ndarray) -> None:
    """`InputError` at a change-point configuration: all bars on one line, the closure loses rank."""
    values = np.linalg.svd(closure_jacobian(lengths, theta), compute_uv=False)
    if values[-1] < RANK_TOLERANCE * values[0]:
        raise InputError(
            "linkage: change-point configuration, all bars lie on one line at theta = "
            f"{np.array2string(theta, precision=6)} (singular values of the closure {values[0]:.3g} "
            f"and {values[-1]:.3g}), so the motion is not determined; "
            "start from another configuration or change a length slightly"
        )


def joint_forces(model: ConstrainedModel, state: np.ndarray) -> np.ndarray:
    """Reaction forces (2 x joints, N) at one state (2n): on each link at its upper joint, x down, y right.

    For a linkage the last column is the force on the ground at its pivot.
    """
    x, n = check_state(model, state), model.coordinates
    z = model.algebraic(0.0, x[:n], x[n:], model.parameter_values).full().ravel()
    return np.asarray(z[n:].reshape(-1, 2).T)


def linkage_state(model: ConstrainedModel, theta: np.ndarray, rates: np.ndarray | None = None) -> np.ndarray:
    """State (6n) of a linkage at angles (n, rad) and rates (n, rad/s; at rest without them)."""
    speeds = np.zeros(len(theta)) if rates is None else rates
    return maximal_states(model, np.concatenate([theta, speeds]))


def grashof(length: Sequence[float], ground: Sequence[float]) -> str:
    """Class of a four-bar of three bars and the ground, by Grashof's inequality s + l <= p + q.

    Source: J. E. Shigley, J. J. Uicker, Theory of Machines and Mechanisms, chapter 1. One of
    "change-point", "drag-link", "crank-rocker", "double-rocker", "triple-rocker".
    """
    if len(length) != 3:
        raise InputError(f"length: Grashof's rule is for three bars and the ground, got {len(length)} bars")
    sides = np.append(np.asarray(length, float), np.linalg.norm(ground))
    excess = 2 * (sides.min() + sides.max()) - sides.sum()
    if abs(excess) <= REACH_TOLERANCE * sides.sum():
        return "change-point"
    if excess > 0:
        return "triple-rocker"
    return ("crank-rocker", "double-rocker", "crank-rocker", "drag-link")[int(np.argmin(sides))]
