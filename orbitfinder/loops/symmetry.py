"""The symmetries of orbits: what each asks of a part of the period, and how the whole follows from that part.

An `Involution` maps a motion to a motion: each coordinate to itself or to minus itself (or to another one), time run
forwards or backwards. One that runs time backwards, R, makes the orbit its own image about the instants at which it
passes the fixed set of R, x(t0 + t) = R x(t0 - t); one that does not, S, repeats it after half a period,
x(t + T/2) = S x(t). A `Symmetry` is at most one of each: `fraction` of the period says it all. Source:
J. S. W. Lamb, J. A. G. Roberts, Physica D 112 (1998) 1-39.

Only this file and `mechanics/model.py` spell their names.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Any

import casadi as ca
import numpy as np
from scipy.interpolate import PPoly

from orbitfinder._runtime.caches import Kept, Same
from orbitfinder._runtime.sizes import size_of
from orbitfinder.errors import InputError
from orbitfinder.mechanics.constrained import allowed_velocities
from orbitfinder.mechanics.model import Invariant, Model, altered, between, images, wrapped
from orbitfinder.mechanics.scales import masses_of, proportions, shared, snapped, surroundings

RECOGNITION = 1e-6
"""A symmetry holds when its defect is below this, relative to the motion's extent."""


@dataclass(frozen=True)
class Recognition:
    """How exactly motions and equations have a symmetry."""

    mirror: float = 1e-5
    """Largest harmonic of the motion that breaks the mirror about a turning instant, relative to the largest rate."""
    broken: float = 1e-8
    """Relative difference of accelerations there and in the image, above which the equations lack a symmetry."""
    beside: float = 0.02
    """How far beside a motion, in its extents, its equations are tried"""
    mirrored: float = 1e-9
    """Relative difference below which they have one that nobody declares"""
    still: float = 1e-9
    """A component that moves less than this, relative to the one that moves most, is measured in this share of that"""
    most_coordinates: int = 8
    """Mirrors that nobody declares are looked for among this many"""
    largest_shift: float = 1e100
    """What a shift in a record is less than, so that nothing overflows on its account"""
    sizes: tuple[float, ...] = (1.0, 1e-3, 1e-6, 1e-12)
    """Of states, in lengths, at which the forces of a driven system are tried"""


RECOGNISED = Recognition()


Affine = tuple[np.ndarray, np.ndarray]
"""(S, d) of x -> S x + d"""
Rates = Callable[..., np.ndarray]
"""States (k x d) and `times` (k) -> their rates"""


@dataclass(frozen=True)
class Involution:
    """q -> P q, P a sign for each coordinate (or one for all) and perhaps a permutation, v -> sense P v, t -> sense t.

    `order[i]` is the coordinate that takes the place of the i-th; () leaves all where they are. The state of a
    `first_order` system is q alone.
    """

    name: str
    sense: int
    signs: int | tuple[int, ...]
    order: tuple[int, ...] = ()
    first_order: bool = False

    def places(self, n: int) -> np.ndarray:
        """P (n x n)."""
        placed = np.eye(n)[list(self.order)] if self.order else np.eye(n)
        return np.broadcast_to(self.signs, n).astype(float)[:, None] * placed

    def keeps(self, n: int) -> np.ndarray:
        """Which coordinates (n) stay as they are."""
        return np.diag(self.places(n)) > 0

    def matrix(self, n: int) -> np.ndarray:
        """S (2n x 2n) of x -> S x, not to be written to."""
        return _matrix(self, n)

    def after(self, other: Involution) -> Involution:
        """The product of two that commute, the other one done first."""
        if self.order or other.order:
            raise InputError(f"symmetries: {other.name!r} with {self.name!r} is known for plain signs only")
        pair = np.broadcast_arrays(self.signs, other.signs)
        signs = tuple(map(int, np.ravel(pair[0] * pair[1])))
        made: int | tuple[int, ...] = signs[0] if len(set(signs)) == 1 else signs
        sense = self.sense * other.sense
        alike = (each for each in USUAL if (each.sense, each.signs) == (sense, made) and not self.first_order)
        return next(alike, Involution(f"{other.name} with {self.name}", sense, made, first_order=self.first_order))

    def in_words(self, names: tuple[str, ...]) -> str:
        """What it does, for messages."""
        film = "running the film backwards"
        known = {(-1, 1): film, (1, -1): "x -> -x", (-1, -1): f"{film} in a mirror"}
        uniform = self.signs if isinstance(self.signs, int) and not self.order else 0
        if (self.sense, uniform) in known:
            return known[self.sense, uniform]
        return self.moves(names) + (f", {film}" if self.sense < 0 else "")

    def moves(self, names: tuple[str, ...]) -> str:
        """Where the coordinates go that do not stay."""
        rows = self.places(len(names))
        images = [("-" if row.min() < 0 else "") + names[int(np.abs(row).argmax())] for row in rows]
        return ", ".join(f"{name} -> {image}" for name, image in zip(names, images, strict=True) if image != name)


@lru_cache(maxsize=64)
def _matrix(involution: Involution, n: int) -> np.ndarray:
    matrix = (
        involution.places(n)
        if involution.first_order
        else np.kron(np.diag([1.0, involution.sense]), involution.places(n))
    )
    matrix.flags.writeable = False
    return matrix


@dataclass(frozen=True)
class _Fixed:
    """The fixed set of an involution that runs time backwards: `rows` x = constant; `lift` makes the d of S x + d."""

    rows: np.ndarray
    lift: np.ndarray
    share: np.ndarray
    """constants of angles are multiples of 2 pi times this (n)"""

    def turning(self, angles: Sequence[bool] | np.ndarray) -> np.ndarray:
        """Which rows (n) hold angles."""
        return np.asarray(np.any(self.rows[:, : len(angles)][:, np.asarray(angles, bool)] != 0, axis=1))


@lru_cache(maxsize=64)
def _fixed(involution: Involution, n: int) -> _Fixed:
    matrix = involution.matrix(n)
    apart = np.eye(len(matrix)) - matrix
    partner = np.abs(matrix).argmax(axis=1)
    kept = [i for i in range(len(matrix)) if i <= partner[i] and np.any(apart[i])]
    share = np.array([0.5 if partner[i] == i else 1.0 for i in kept])
    rows = apart[kept] * share[:, None]
    return _Fixed(rows, apart @ rows.T @ np.linalg.inv(rows @ rows.T), share)


@dataclass(frozen=True)
class Symmetry:
    """What an orbit has: no involution, one, or one that runs time backwards and then one that does not."""

    maps: tuple[Involution, ...] = ()
    first_order: bool = False
    """the state is the coordinates alone, without their rates"""
    relative: tuple[tuple[float, ...], ...] = ()
    """directions (n each) along which the motion need not come back: it returns up to a shift"""

    def coordinates(self, size: int) -> int:
        """n, how many components of a state (d) are coordinates: half of them, or of a first-order system all."""
        return size if self.first_order else size // 2

    @property
    def name(self) -> str:
        """Its name in files and messages."""
        return "+".join(involution.name for involution in self.maps) or "none"

    @property
    def parts(self) -> int:
        """How many times the integrated part fits into the period."""
        return int(2 ** len(self.maps))

    @property
    def fraction(self) -> float:
        """The part of the period that is integrated."""
        return 1.0 / self.parts

    @property
    def forward(self) -> Involution | None:
        """The involution after which the orbit repeats itself half a period later, if there is one."""
        return next((involution for involution in self.maps if involution.sense > 0), None)

    @property
    def reverses(self) -> bool:
        """True when time may be run backwards: t = 0 is then fixed, and the boundary rows hold no invariant twice."""
        return bool(self.maps) and self.maps[0].sense < 0

    @property
    def mirrors(self) -> tuple[Involution, Involution]:
        """Of a symmetry that reverses: the involutions about the start and about the end of the part."""
        first, forward = self.maps[0], self.forward
        return first, first if forward is None else forward.after(first)

    # ---- the boundary rows -------------------------------------------------------------------------

    def rows(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        """B0 and B1 (2n x 2n) of the boundary rows B0 x(0) + B1 x(end) = constant."""
        return _rows(self, n)

    def held(self, n: int) -> np.ndarray:
        """Which components of a state (2n) the rows hold at the start by themselves."""
        first = self.rows(n)[0]
        return np.any(first != 0, axis=0) if self.reverses else np.zeros(len(first), bool)

    def constants(
        self,
        angles: np.ndarray,
        start: np.ndarray,
        end: np.ndarray | None = None,
        turns: np.ndarray | tuple[int, ...] | None = None,
    ) -> np.ndarray:
        """The constants (2n) of the rows that start and end of a motion (2n each) come nearest to.

        `turns` are the whole turns of a period (n), where they are known. An angle counts in half turns about a centre,
        and in whole turns over the part, or half of its `turns`; without `end` it stays with the start's.
        """
        n = self.coordinates(start.size)
        rest = np.zeros(start.size - n)
        whole = np.zeros(n) if turns is None else np.asarray(turns)
        if not self.reverses:
            forward = self.forward
            if forward is None or end is None:
                return np.concatenate([2 * np.pi * whole, rest])
            gap = (end - forward.matrix(n) @ start)[:n]
            gap = np.where(angles, 2 * np.pi * np.round(gap / (2 * np.pi)), 0.0)
            return np.concatenate([np.where(forward.keeps(n) & (turns is not None), np.pi * whole, gap), rest])

        def nearest(involution: Involution, x: np.ndarray) -> np.ndarray:
            fixed = _fixed(involution, n)
            counted = 2 * np.pi * fixed.share
            return np.where(fixed.turning(angles), counted * np.round(fixed.rows @ x / counted), 0.0)

        first, last = self.mirrors
        begin = nearest(first, start)
        if end is None or (turns is not None and first == last):
            travelled = np.concatenate([np.pi * whole, rest])
            return np.concatenate([begin, begin + _fixed(first, n).rows @ travelled if first == last else 0 * begin])
        return np.concatenate([begin, nearest(last, end)])

    def boundary(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        """The `rows` (r x 2n) that are `asked`."""
        (first, last), asked = self.rows(n), self.asked(n)
        return (first, last) if asked is None else (asked @ first, asked @ last)

    def asked(self, n: int) -> np.ndarray | None:
        """The combinations (r x 2n) of the rows that no shift along `relative` changes; None where all are asked."""
        return _asked(self, n) if self.relative else None

    def settled(self, constant: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """The constants with the shift that a motion from `start` to `end` of the part (2n each) has."""
        if not self.relative:
            return constant
        n = self.coordinates(start.size)
        first, last = self.rows(n)
        along = last[:, :n] @ np.transpose(self.relative)
        missed = first @ start + last @ end - constant
        return np.asarray(constant + along @ np.linalg.lstsq(along, missed, rcond=None)[0])

    def shifts(self, constant: np.ndarray) -> np.ndarray:
        """How far a period takes the motion along each of `relative`, from constants that are `settled`."""
        n = self.coordinates(constant.size)
        moved = self.displaced(constant)[1][:n] - 2 * np.pi * self.turns(constant)
        return np.asarray(np.linalg.lstsq(np.reshape(self.relative, (-1, n)).T, moved, rcond=None)[0])

    def displaced(self, constant: np.ndarray) -> Affine:
        """(S, d) of the map that takes x(0) to the state half a period on, or a whole one without symmetry."""
        n = self.coordinates(constant.size)
        if not self.reverses:
            return (np.eye(constant.size) if self.forward is None else self.forward.matrix(n)), constant
        (first, begin), (last, end) = self.about(constant)
        return last @ first, last @ begin + end

    def about(self, constant: np.ndarray) -> tuple[Affine, Affine]:
        """(S, d) of the maps about the start and about the end of the part, of a symmetry that reverses."""
        n, half = self.coordinates(constant.size), constant.size // 2
        first, last = self.mirrors
        return (first.matrix(n), _fixed(first, n).lift @ constant[:half]), (
            last.matrix(n), _fixed(last, n).lift @ constant[half:],
        )  # fmt: skip

    def turns(self, constant: np.ndarray) -> np.ndarray:
        """Whole turns of each coordinate in one period (n); zero for orbits that swing back."""
        n, (matrix, moved) = self.coordinates(constant.size), self.displaced(constant)
        turned = (moved if self.forward is None else moved + matrix @ moved)[:n] / (2 * np.pi)
        return np.round(beside(turned, self.relative)).astype(int)

    def may_turn(self, n: int) -> np.ndarray:
        """Which coordinates (n) may make whole turns in a period."""
        if self.reverses and self.forward is None:
            return self.held(n)[:n]
        return np.full(n, not self.maps)

    def centre(self, constant: np.ndarray) -> np.ndarray:
        """Where the coordinates (n) must be centred, nan for those that may be anywhere."""
        n = self.coordinates(constant.size)
        matrix, moved = self.displaced(constant)
        flipped = (np.diag(matrix)[:n] < 0) & (self.forward is not None)
        return np.where(flipped, 0.5 * moved[:n], np.nan)

    # ---- the whole from a part ---------------------------------------------------------------------

    def whole(
        self, times: np.ndarray, states: np.ndarray, constant: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Times and states (k x 2n) over a whole period from those over the part, both of its ends among them.

        Without the rows' constants the states' own are taken.
        """
        if constant is None:  # those of rates are 0
            n = self.coordinates(states.shape[1])
            first, last = self.rows(n)
            rates = np.any((np.abs(first) + np.abs(last))[:, n:] > 0, axis=1)
            constant = np.where(rates, 0.0, first @ states[0] + last @ states[-1])
        constant = self.settled(constant, states[0], states[-1])
        if self.reverses:
            _, (last, moved) = self.about(constant)
            times = np.concatenate([times, 2 * times[-1] - times[-2::-1]])
            states = np.vstack([states, states[-2::-1] @ last.T + moved])
        if self.forward is not None:
            matrix, moved = self.displaced(constant)
            times = np.concatenate([times, times[-1] + times[1:]])
            states = np.vstack([states, states[1:] @ matrix.T + moved])
        return times, states

    def closes(self, states: np.ndarray, angles: np.ndarray) -> float:
        """How far the end of a part (k x 2n) is from where the next one begins, relative to the motion's extent.

        Coordinates count where the symmetry says where they must be, modulo half turns of angles.
        """
        n = self.coordinates(states.shape[1])
        first, last = self.rows(n)
        gap = last @ states[-1] + (0.0 if self.reverses else first @ states[0])
        kept = np.any(last != 0, axis=1)
        where = np.any(last[:, :n] != 0, axis=1)
        kept &= ~where | self.reverses | self.first_order
        constant = self.constants(angles, states[0], states[-1]) * where
        if self.first_order and not self.reverses:
            constant = np.where(angles, 2 * np.pi * np.round(gap / (2 * np.pi)), 0.0)
        units = (np.abs(last) * _moved(states, angles)).max(axis=1)
        return float((np.abs(gap - constant) / np.where(kept, units, 1.0))[kept].max())

    def root(
        self,
        part: Any,
        inverse_of: Callable[[Any], Any],
        size: int,
        *,
        made: Callable[[np.ndarray], Any] = np.asarray,
        times: Callable[[Any, Any], Any] = operator.matmul,
    ) -> tuple[Any, int]:
        """(root, power) of the monodromy matrix root^power from the part's state-transition matrix A (2n square).

        S A after S, R0 A^-1 R1 A after R0 about the start and R1 about the end; of the symmetry's two, each at most.
        `inverse_of(B)` is A^-1 B; `made` and `times` are those of the algebra that A belongs to.
        """
        n = self.coordinates(size)
        if not self.reverses:
            return (part, 1) if self.forward is None else (times(made(self.forward.matrix(n)), part), 2)
        first, last = (made(mirror.matrix(n)) for mirror in self.mirrors)
        return times(first, inverse_of(times(last, part))), len(self.maps)

    # ---- what it removes, who has it ---------------------------------------------------------------

    def unfolded(self, model: Model) -> tuple[Invariant, ...]:
        """The invariants that the boundary rows hold twice: I(S x) = I(x), or -I(x) where time runs backwards.

        Each needs an unfolding parameter, and, where a shift along its symmetry keeps the rows, a phase condition: by
        Noether's theorem these are the same ones.
        """
        return tuple(
            invariant
            for invariant in model.invariants
            if all(_parity(model, invariant, each) == each.sense for each in self.both)
        )

    def generators(self, model: Model) -> tuple[Any, ...]:
        """The model's continuous symmetries besides time that keep the boundary rows."""
        return tuple(invariant.generator for invariant in self.unfolded(model) if invariant.generator is not None)

    @property
    def both(self) -> tuple[Involution, ...]:
        """Every involution that the boundary rows are made of."""
        return tuple(dict.fromkeys(self.mirrors)) if self.reverses else self.maps

    def narrower(self) -> Iterator[tuple[Symmetry, float]]:
        """Symmetries that a branch of such orbits may keep, the largest first, with where in the period it starts."""
        if self.maps:
            yield self, 0.0
        if self.reverses and self.forward is not None:
            first, last = self.mirrors
            yield from (
                (replace(self, maps=(each,)), share)
                for each, share in ((first, 0.0), (last, 0.25), (self.forward, 0.0))
            )
        elif self.reverses:
            yield self, 0.5

    def check(self, model: Model, state: np.ndarray, cycles: int = 0) -> None:
        """`InputError` when the equations lack it, tried at states around one (2n).

        a(sense t, P q, sense P v) = P a(t, q, v) is needed, of one that runs forwards at t + T/2, where T is `cycles`
        periods of the forcing.
        """
        if model.constraint is not None and any(involution.signs != 1 or involution.order for involution in self.maps):
            raise InputError(
                f"symmetry: {self.name!r} cannot be imposed in redundant coordinates, where x -> -x moves the joints; "
                f"use symmetry = {BRAKE.name!r} or 'none' (symmetric orbits are recognised)"
            )
        half = 0.0
        if model.forcing_period is not None:
            half = cycles * model.driving_period / 2
        for involution in self.maps:
            if _broken(model, state, involution, half if involution.sense > 0 else 0.0):
                meaning = involution.in_words(model.coordinates)
                raise InputError(
                    f"symmetry: this system's equations change under {meaning}, so {self.name!r} cannot be imposed; "
                    "use symmetry = 'none' (symmetric orbits are recognised)"
                )

    def lost_beside(self, rates: Rates, states: np.ndarray, sizes: np.ndarray, half: float) -> Involution | None:
        """An involution R of it that x' = f(t, x) lacks, f(sense t, R x) = sense R f(t, x), beside states (k x d) of a
        motion of these `sizes` (d) that has it: the motion may go on to where the equations lose it.

        `rates` are f of rows at times, which an R that runs forwards shifts by `half` a period.
        """
        random, n = np.random.default_rng(0), self.coordinates(sizes.size)
        near = states + RECOGNISED.beside * sizes * random.normal(size=states.shape)
        for each in self.maps:
            matrix, shift = each.matrix(n), half if each.sense > 0 else 0.0
            times = random.uniform(0, float(snapped(shift)) + 2 * shift, len(near))
            with np.errstate(all="ignore"):
                here = each.sense * rates(near, times=times) @ matrix.T / sizes
                apart = rates(near @ matrix.T, times=each.sense * times + shift) / sizes - here
            known = np.isfinite(apart).all(axis=1)
            if np.abs(apart[known]).max(initial=0.0) > RECOGNISED.broken * size_of(here[known]):
                return each
        return None

    def held_by(self, model: Model, state: np.ndarray, cycles: int = 0) -> bool:
        """Whether a model's equations have it (see `check`)."""
        try:
            self.check(model, state, cycles)
        except InputError:
            return False
        return True


def beside(moved: np.ndarray, directions: Sequence[Sequence[float]]) -> np.ndarray:
    """What is left of how far coordinates moved (n) when each direction's first coordinate is brought back along it."""
    for direction in np.asarray(directions, float):
        first = int(np.flatnonzero(direction)[0])
        moved = moved - moved[first] / direction[first] * direction
    return moved


@lru_cache(maxsize=64)
def _asked(symmetry: Symmetry, n: int) -> np.ndarray:
    along = symmetry.rows(n)[1][:, :n] @ np.transpose(symmetry.relative)
    if np.all(np.count_nonzero(along, axis=0) == 1):
        return np.delete(np.eye(len(along)), np.flatnonzero(along.any(axis=1)), axis=0)
    return np.linalg.svd(along)[0][:, along.shape[1] :].T


@lru_cache(maxsize=64)
def _rows(symmetry: Symmetry, n: int) -> tuple[np.ndarray, np.ndarray]:
    if not symmetry.reverses:
        forward = symmetry.forward
        unit = np.eye(n if symmetry.first_order else 2 * n)
        return -(unit if forward is None else forward.matrix(n)), unit
    first, last = (_fixed(mirror, n).rows for mirror in symmetry.mirrors)
    return np.vstack([first, 0 * last]), np.vstack([0 * first, last])


BRAKE_MAP = Involution("brake", -1, 1)
REFLECTION_MAP = Involution("reflection", 1, -1)
REVERSAL_MAP = Involution("reversal", -1, -1)
USUAL = (BRAKE_MAP, REFLECTION_MAP, REVERSAL_MAP)
NONE = Symmetry()
ALONE = Symmetry(first_order=True)
"""Nothing is asked of the orbit of a first-order system."""
REFLECTION = Symmetry((REFLECTION_MAP,))
"""x(t + T/2) = -x(t)"""
BRAKE = Symmetry((BRAKE_MAP,))
"""All rates vanish at some instant, and the motion runs back from there."""
REVERSAL = Symmetry((REVERSAL_MAP,))
"""All coordinates are at 0 (angles at 0 or pi) at some instant, q(-t) = -q(t): running orbits, mostly."""
QUARTER = Symmetry((BRAKE_MAP, REFLECTION_MAP))
"""From rest through q = 0: both the first ones."""
SYMMETRIES: Mapping[str, Symmetry] = {one.name: one for one in (NONE, REFLECTION, BRAKE, REVERSAL, QUARTER)}
"""The symmetries that need no declaration, by name."""


def declared(model: Model) -> tuple[Involution, ...]:
    """The involutions that a model declares."""
    alone = model.rates is not None
    return tuple(Involution(name, sense, signs, first_order=alone) for name, sense, signs in model.symmetries)


def involutions(model: Model) -> tuple[Involution, ...]:
    """The usual involutions of a model, of a first-order system x -> -x and rest where x = (q, p), and its own."""
    if model.rates is None:
        return *USUAL, *declared(model)
    half = model.degrees_of_freedom // 2
    rest = replace(BRAKE_MAP, signs=(1,) * half + (-1,) * half, first_order=True)
    return *[rest] * model.hamiltonian, replace(REFLECTION_MAP, first_order=True), *declared(model)


def symmetries_of(model: Model) -> Mapping[str, Symmetry]:
    """The symmetries that a Problem of this model may ask for, by name: the usual ones and those it declares."""
    alone, known = model.rates is not None, involutions(model)
    pairs = [(first, last) for first in known for last in known if first.sense < last.sense and first != REVERSAL_MAP]
    made = (Symmetry(maps, alone) for maps in ((), *((each,) for each in known), *pairs))
    return {each.name: each for each in made}


def named(name: str, model: Model) -> Symmetry:
    """The symmetry with a name, of a mirror that nobody declares too; `InputError` names the known ones."""
    known = symmetries_of(knowing(model, name))
    if name not in known:
        raise InputError(f"symmetry: unknown {name!r}; use one of {', '.join(known)}")
    return known[name]


@dataclass(frozen=True)
class Shift:
    """A constant direction (n) along which the equations do not change, and the name of the momentum kept with it."""

    direction: tuple[float, ...]
    momentum: str


def shifts_of(model: Model) -> Mapping[str, Shift]:
    """The shifts of a model by name: its cyclic coordinates, and the momenta kept with other constant directions."""
    n, shifts, random = model.degrees_of_freedom, {}, np.random.default_rng(0)
    states = random.normal(0, 1.0, (2, len(model.state_names)))
    for invariant in model.invariants:
        if invariant.generator is None:
            continue
        here, there = (invariant.generator(x[:n], x[n:], model.parameter_values).full().ravel() for x in states)
        if np.array_equal(here, there) and not np.any(here[n:]) and np.any(here[:n]):
            moving = np.flatnonzero(here[:n])
            name = model.state_names[moving[0]] if moving.size == 1 else invariant.name
            shifts[name] = Shift(tuple(map(float, here[:n])), invariant.name)
    return shifts


def related(symmetry: Symmetry, model: Model, names: Sequence[str]) -> Symmetry:
    """A symmetry of orbits that come back up to shifts by name, those of `shifts_of`."""
    if not names:
        return symmetry
    known = shifts_of(model)
    return replace(symmetry, relative=tuple(known[name].direction for name in names))


def shifting(symmetry: Symmetry, model: Model) -> Mapping[str, Shift]:
    """What `relative` of a symmetry is called in a model."""
    known = shifts_of(model) if symmetry.relative else {}
    return {name: shift for name, shift in known.items() if shift.direction in symmetry.relative}


def turned(model: Model, turns: np.ndarray, shift: Mapping[str, float]) -> np.ndarray:
    """How far coordinates (n) go in a period, in 2 pi: whole turns, and what an orbit shifts by name.

    Raises `InputError` where the system has no such shift.
    """
    known, gone = shifts_of(model) if shift else {}, turns
    for name, amount in shift.items():
        if name not in known or not abs(amount) < RECOGNISED.largest_shift:
            raise InputError(
                f"shift: {name} = {amount} is none of this system, which has {', '.join(known) or 'no'} shifts; the "
                "record contradicts its system, run the problem again"
            )
        gone = gone + amount / (2 * np.pi) * np.asarray(known[name].direction)
    return gone


def momenta_of(symmetry: Symmetry, model: Model) -> tuple[str, ...]:
    """The momenta that are kept with what orbits of a symmetry are relative in."""
    return tuple(shift.momentum for shift in shifting(symmetry, model).values())


def called(symmetry: Symmetry, model: Model) -> Symmetry:
    """The same symmetry by the name that its model knows it by."""
    n = model.degrees_of_freedom

    def acts(symmetry: Symmetry) -> list[tuple[int, bytes]]:
        return [(each.sense, each.matrix(n).tobytes()) for each in symmetry.maps]

    wanted = acts(symmetry)
    return next((one for one in symmetries_of(model).values() if acts(one) == wanted), symmetry)


def _parity(model: Model, invariant: Invariant, involution: Involution) -> int:
    """1 or -1 as an invariant keeps or changes its sign under an involution, 0 for neither; an energy keeps it."""
    if invariant.generator is None:
        return 1
    n, random = model.degrees_of_freedom, np.random.default_rng(0)
    matrix = involution.matrix(n)
    for _ in range(4):
        x = random.normal(0, 1.0, len(matrix))
        here, there = (float(invariant.value(s[:n], s[n:], model.parameter_values)) for s in (x, matrix @ x))
        if np.isfinite(here - there) and here:
            return int(np.round(there / here)) if abs(abs(there / here) - 1.0) < RECOGNISED.broken else 0
    return 0


def _broken(model: Model, state: np.ndarray, involution: Involution, shift: float) -> bool:
    random, n, state = np.random.default_rng(0), model.degrees_of_freedom, np.asarray(state, float)
    q, v = state[:n], state[n:]
    lengths, clock = surroundings(model, q)
    paces = lengths[: v.size]
    quick, pairs = 0.3 / clock + np.abs(v / paces).max(initial=0.0), []
    for _ in range(4):
        place, rate = q + lengths * random.normal(0, 0.3, q.size), v + paces * random.normal(0, quick, v.size)
        if model.constraint is not None:  # off the constraints the stabilisation is damped
            basis = allowed_velocities(model, q)
            place, rate = q, basis @ (basis.T @ rate)
        t = float(random.uniform(0, float(snapped(shift)) + 2 * shift))
        pairs.append(_apart(model, involution, (t, place, rate), shift, lengths))
    aparts, sizes = np.array([pair for pair in pairs if np.isfinite(pair[0])]).reshape(-1, 2).T
    return bool(np.any(aparts > RECOGNISED.broken * np.maximum(sizes, sizes.max(initial=0.0) * RECOGNISED.broken)))


def _apart(
    model: Model,
    involution: Involution,
    at: tuple[float, np.ndarray, np.ndarray],
    shift: float,
    lengths: np.ndarray,
) -> tuple[float, float]:
    """Largest difference of the accelerations at the image of (t, q, v) from the image of theirs, and their size.

    Coordinates are measured in `lengths` (n). Of a first-order system f(sense t, P q) = sense P f(t, q) is asked of
    its rates.
    """
    places = ca.DM(involution.places(lengths.size))
    pair = images(
        model, involution.sense, places, [*(each for each in at if np.size(each)), model.parameter_values], shift
    )
    there, here = pair.full().T / lengths
    return float(np.abs(there + here).max()), float(np.abs(here).max())


def undeclared_mirrors(model: Model) -> tuple[Involution, ...]:
    """What runs time backwards with signs that differ, of usual and declared ones none, tried at a few states.

    It is called mirror, or mirror-x after the coordinates that it turns where there are several.
    """
    n, random = model.degrees_of_freedom, np.random.default_rng(0)
    if n > RECOGNISED.most_coordinates or model.constraint is not None or model.rates is not None:
        return ()
    lengths, clock = surroundings(model, np.zeros(n))
    states = random.normal(0, 1.0, (4, 2, n)) + np.array([np.ones(n), np.zeros(n)])
    known = {signs for _, sense, signs in model.symmetries if sense < 0}
    states *= np.array([lengths, lengths / clock])

    mirrors = []
    for signs in product((1, -1), repeat=n):
        turned = [name for name, sign in zip(model.coordinates, signs, strict=True) if sign < 0]
        candidate = Involution("-".join(["mirror", *turned]), -1, signs)
        if len(set(signs)) < 2 or signs in known:
            continue
        pairs = (_apart(model, candidate, (0.0, *x), 0.0, lengths) for x in states)
        if all(apart <= RECOGNISED.mirrored * size for apart, size in pairs):
            mirrors.append(candidate)
    alone = len(mirrors) + len(model.symmetries) < 2
    return tuple(replace(each, name="mirror") for each in mirrors) if alone else tuple(mirrors)


def with_mirrors(model: Model) -> Model:
    """The Model with the mirrors that nobody declares declared."""
    mirrors = tuple((mirror.name, mirror.sense, mirror.signs) for mirror in undeclared_mirrors(model))
    return altered(model, symmetries=(*model.symmetries, *mirrors)) if mirrors else model  # type: ignore[arg-type]


def knowing(model: Model, name: str) -> Model:
    """The Model, with its mirrors declared where the name of a symmetry is one of theirs."""
    return model if name in symmetries_of(model) else with_mirrors(model)


# ---- recognition -------------------------------------------------------------------------------------------


def recognise(times: np.ndarray, states: np.ndarray, model: Model, *, own: bool = True) -> str:
    """The name of the symmetry that states (k+1 x 2n) at equal times over T have.

    Looked for are rest and x -> -x, else a centre, and then, with `own`, what the model declares. Of hybrid orbits none
    is asked.
    """
    if not model.smooth:
        return NONE.name
    if model.rates is None:
        states = states / np.tile(proportions(model, states[0]), 2)
    kept = dict[int, Involution]()
    for each in involutions(model if own else altered(model, symmetries=())):
        able = each.sense not in kept and not (kept and each == REVERSAL_MAP)
        if able and has(each, times, states, model.angular):
            kept[each.sense] = each
    return Symmetry(tuple(kept[sense] for sense in sorted(kept))).name


def has(involution: Involution, times: np.ndarray, states: np.ndarray, angles: np.ndarray) -> bool:
    """Whether samples over a period have a symmetry, wherever in it they begin."""
    if involution.sense < 0:
        if involution.first_order:
            return _reversed(involution, states, angles)
        return _mirrored(involution, times, states, angles)
    half = (len(states) - 1) // 2
    gaps = wrapped(states[half : 2 * half] - states[:half] @ involution.matrix(angles.size).T, angles)
    return bool(np.all(np.abs(gaps) <= RECOGNITION * _moved(states, angles)))


def off_centre(involution: Involution, states: np.ndarray, angles: Sequence[bool] | np.ndarray) -> np.ndarray:
    """rows x - constant (k x n) at states (k x 2n): how far they are from the fixed set, the nearest for angles."""
    fixed = _fixed(involution, len(angles))
    gaps = states @ fixed.rows.T
    return np.asarray(wrapped(gaps / fixed.share, fixed.turning(angles)) * fixed.share)


def _moved(states: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """What components (d) move (k x d) beside each other, of a first-order system at least a share of the largest."""
    extent = np.ptp(states, axis=0)
    least = RECOGNISED.still * extent.max() if angles.size == extent.size else 0.0
    return shared(np.maximum(extent, least), angles)


def _reversed(involution: Involution, states: np.ndarray, angles: np.ndarray) -> bool:
    """Whether x(t0 + t) = S x(t0 - t) for some t0: about it harmonics are c = S conj(c).

    The phase of the largest harmonic leaves twice as many candidates for t0 as its number.
    """
    drift = np.linspace(0, 1, len(states))[:, None] * (states[-1] - states[0])
    harmonics = np.fft.rfft((states - drift)[:-1] / _moved(states, angles), axis=0) / (len(states) - 1)
    order, matrix = np.arange(len(harmonics))[:, None], involution.matrix(states.shape[1])
    partner = harmonics @ matrix.T
    k, i = np.unravel_index(int(np.abs(harmonics[1:] * partner[1:]).argmax()), harmonics[1:].shape)
    phase = np.angle(harmonics[k + 1, i] * partner[k + 1, i])  # c e^(iks) = conj(S c e^(iks)) at s = -phase / 2k
    for turn in range(2 * (int(k) + 1)):
        shifted = harmonics * np.exp(1j * order * (2 * np.pi * turn - phase) / (2 * (k + 1)))
        if np.abs(shifted - shifted.conj() @ matrix.T).max() <= RECOGNISED.mirror:
            return True
    return False


def _mirrored(involution: Involution, times: np.ndarray, states: np.ndarray, angles: np.ndarray) -> bool:
    """True when the motion passes the fixed set, and its rates about that instant are even or odd as they must be."""
    n = angles.size
    rows = _fixed(involution, n).rows
    sizes = shared(np.append(np.ptp(states[:, :n], axis=0), np.abs(states[:, n:]).max(axis=0)), angles)
    units = (np.abs(rows) * sizes).max(axis=1)  # of coordinates and of rates
    coordinate = np.any(rows[:, :n] != 0, axis=1)
    moved = states @ rows.T
    leading = int((np.where(coordinate, np.ptp(moved, axis=0), np.abs(moved).max(axis=0)) / units).argmax())
    # between two samples nothing changes by more than twice what it changes from each to the next
    if (
        np.abs(off_centre(involution, states, angles) / units).max(axis=1).min()
        > 2 * np.abs(np.diff(moved, axis=0) / units).max() + 10 * RECOGNITION
    ):
        return False
    levels = [0.0]
    if coordinate[leading]:
        pieces = _cubics(times, states[:, :n] @ rows[leading, :n], states[:, n:] @ rows[leading, :n])
        if angles[np.flatnonzero(rows[leading])].all():
            turn, leads = 2 * np.pi * _fixed(involution, n).share[leading], moved[:, leading]
            levels = list(np.arange(np.floor(leads.min() / turn), leads.max() / turn + 1) * turn)
    else:
        pieces = _cubics(times, states[:, :n] @ rows[leading, n:], moved[:, leading])
        pieces = pieces[:3] * np.array([[3.0], [2.0], [1.0]])  # their rates
    crossings = np.concatenate([_crossings(times, pieces, level) for level in levels])
    moments, there = np.append(crossings, times), np.vstack([between(times, states, n, crossings), states])
    defects = np.abs(off_centre(involution, there, angles) / units).max(axis=1)
    # the spline's rates are good to about the fourth power of the sampling interval
    if not defects.size or not defects.min() <= 10 * RECOGNITION:
        return False
    centre = moments[int(defects.argmin())]
    # v odd (even) about the centre: Fourier coefficients there are imaginary (real); exact for periodic samples
    harmonics = np.fft.rfft(states[:-1, n:], axis=0) * (2.0 / (len(states) - 1))
    turned = harmonics * np.exp(2j * np.pi * np.arange(len(harmonics)) * centre / times[-1])[:, None]
    image = turned.conj() @ involution.places(n).T * involution.sense
    return bool(np.abs(turned - image).max() / 2 <= RECOGNISED.mirror * np.abs(states[:, n:]).max())


def _cubics(times: np.ndarray, values: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """The cubics (4 x k, the highest power first) of the time since each of k + 1 times that have values and slopes."""
    step = np.diff(times)
    mean, first, last = np.diff(values) / step, slopes[:-1], slopes[1:]
    return np.array([(first + last - 2 * mean) / step**2, (3 * mean - 2 * first - last) / step, first, values[:-1]])


def _crossings(times: np.ndarray, pieces: np.ndarray, level: float) -> np.ndarray:
    """Moments at which polynomials (order x k) of the time since each of k + 1 times have a level, before the next."""
    lasts = np.diff(times)
    reach = np.abs(pieces[:-1] * lasts ** np.arange(len(pieces) - 1, 0, -1)[:, None]).sum(axis=0)
    near = np.flatnonzero(np.abs(pieces[-1] - level) <= (1 + 1e-9) * reach)
    if not near.size:
        return times[:0]
    begins = np.append(0.0, np.cumsum(lasts[near]))  # of these alone, back to back
    roots = PPoly(pieces[:, near], begins).solve(level, discontinuity=False, extrapolate=False)
    roots = roots[np.isfinite(roots)]
    own = np.minimum(np.searchsorted(begins, roots, side="right") - 1, near.size - 1)
    return np.asarray(times[near[own]] + roots - begins[own])


def moved(model: Model, free: Sequence[str]) -> Model:
    """The Model with freed parameters at other values: what holds there too holds along a family."""
    numbers = model.parameter_values.copy()
    places = [model.parameter_index(name) for name in free]
    numbers[places] = np.where(numbers[places], 1.1 * numbers[places], 0.1)
    return altered(model, parameter_values=numbers) if free else model


_slopes = Kept[Any](16)
"""The derivatives of forces that were asked for last"""


def symplectic(model: Model) -> bool:
    """Whether the flow is Hamilton's, driven or not, so that multipliers come in reciprocal pairs.

    The forces of a driven system are then the gradient of a potential, tried at a few states of several sizes; what
    damping does is measured in the time of the drive.
    """
    if model.rates is not None:
        return model.hamiltonian
    if model.conservative or model.forces is None or not model.forced:
        return model.conservative
    forces, random, n = model.forces, np.random.default_rng(0), model.degrees_of_freedom
    slopes = _slopes(Same(forces), lambda: forces.jacobian())
    lengths, _ = surroundings(model, np.zeros(n))
    clock = model.driving_period / (2 * np.pi)
    for size in np.tile(RECOGNISED.sizes, 2):
        t, (q, v) = float(random.uniform()) * clock, size * random.normal(0, 1.0, (2, n)) * lengths / [[1.0], [clock]]
        by_q, by_v = (slope.full() for slope in slopes(t, q, v, model.parameter_values, 0)[1:3])
        roots = np.sqrt(np.abs(masses_of(model.kinetic, np.append(q, v), model)))
        work = np.outer(roots, roots) / clock**2
        turned, damped = np.abs(by_q - by_q.T), np.abs(by_v) / clock
        if max(turned.max(), damped.max()) > RECOGNISED.mirrored * max(work.max(), np.abs(by_q).max()):
            return False
    return True
