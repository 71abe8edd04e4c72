"""Mechanisms as drawn: bodies, joints, springs, dampers and motors, in the plane and in space.

Joints that reach a new body span a tree, whose joint coordinates are those of the system; each node of the tree is a
coordinate, a turn or a slide, so that a universal joint is two nodes and a ball joint three. Velocities and forces go
through the tree by recursion in the bodies' own axes (R. Featherstone, Rigid Body Dynamics Algorithms, 2008, chapter 7:
articulated bodies, O(n)). Every other joint closes a loop: its equations are constraints phi(q) = 0, all in m, and the
system is a native DAE (see `constrained`), closed and put into minimal coordinates by `closing`.

Axes: x down, y right, z towards the eye. A ball joint turns by three angles about axes of which the second leaves the
first (Cardan's x, y, z unless said otherwise): as many coordinates as freedoms, so that q' = v, a mode is a mode and a
multiplier a multiplier; where the second angle is +-90 degrees (0 of z, x, z) two axes are one. With axes =
"quaternion" it turns by c / |c|, which no pose stops, and |c| = 1 is a constraint beside those of the loops.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError, closest, plural
from orbitfinder.mechanics.constrained import RANK_TOLERANCE, constrained_model
from orbitfinder.mechanics.controls import divided
from orbitfinder.mechanics.factorise import LinearBalances, acceleration_function, solve_positive_definite
from orbitfinder.mechanics.lagrange import (
    Symbols,
    Terms,
    coordinate_names,
    detected_invariants,
    energy_invariant,
    mass_matrix_and_bias,
    mechanical_model,
    pictured,
    take_apart,
)
from orbitfinder.mechanics.model import Baumgarte, Model, finite_number
from orbitfinder.mechanics.scales import with_units
from orbitfinder.mechanisms.closing import LoopClosure, independent_rows_at, point_sizes
from orbitfinder.mechanisms.shapes import undescribed
from orbitfinder.records.reading import Entries, Table

GROUND = "ground"
KEYS = {
    "bodies": {"mass", "inertia", "com", "shape", "disc"},
    "joints": {"kind", "between", "at", "axis", "axes", "turned", "length", "rotor", "range", "mimics"},
    "springs": {"between", "at", "stiffness", "length", "joint", "rest"},
    "dampers": {"between", "at", "damping", "joint"},
    "motors": {"joint", "torque", "amplitude", "phase", "limit"},
    "motions": {"joint", "offset", "amplitude", "phase", "turns"},
}
EXPRESSION = re.compile(
    r"\s*([+-]?)\s*(?:(\d+\.?\d*(?:[eE][+-]?\d+)?)\s*\*\s*)?([A-Za-z_]\w*)\s*(?:/\s*(\d+\.?\d*))?\s*"
)


class _Numbers:
    """The physical parameters met while a drawing is read: each number that is not 0 gets a symbol and a name."""

    def __init__(self, shared: Table, values: Table) -> None:
        self.names: list[str] = []
        self.values: list[float] = []
        self.symbols: list[ca.SX] = []
        self._given = dict(values)
        for name, value in shared.items():
            if not name.isidentifier():
                raise InputError(f"parameters: {name!r} is no name; use letters, digits and _")
            self.new(name, finite_number(f"parameters.{name}", value))

    def new(self, name: str, value: float) -> ca.SX:
        """A number with a symbol of its own, 0 or not."""
        if name in self.names:
            raise InputError(f"{name}: two physical parameters have this name; rename a body, a joint or a parameter")
        self.names.append(name)
        self.values.append(float(self._given.pop(name, value)))
        self.symbols.append(ca.SX.sym(name))
        return self.symbols[-1]

    def __call__(self, where: str, name: str, entry: Any) -> ca.SX | float:
        """A number as a symbol of its own (0 stays 0), or an expression such as "-length / 2" of shared ones."""
        if not isinstance(entry, str):
            value = finite_number(where, entry)
            return self.new(name, value) if value or name in self._given else 0.0
        match = EXPRESSION.fullmatch(entry)
        if not match or match[3] not in self.names:
            known = ", ".join(self.names) or "none yet: add [system.parameters]"
            raise InputError(f"{where}: {entry!r} is not [number *] parameter [/ number]; parameters are {known}")
        factor = float(f"{match[1]}1") * float(match[2] or 1) / float(match[4] or 1)
        symbol = self.symbols[self.names.index(match[3])]
        return symbol if factor == 1 else factor * symbol

    def value(self, entry: ca.SX | float) -> float:
        """What a number or expression is, at the given values."""
        return float(ca.substitute(ca.SX(entry), self.vector, ca.DM(self.values)))

    @property
    def vector(self) -> ca.SX:
        """All symbols (k)."""
        return ca.vertcat(*self.symbols) if self.symbols else ca.SX(0, 1)

    def finish(self) -> None:
        """`InputError` for values of parameters that are not there."""
        for name in self._given:
            raise InputError(f"values: unknown physical parameter {name!r}{closest(name, self.names)}")


@dataclass
class _Node:
    """One coordinate of the tree, a turn or a slide about or along `axis` (3), by `q` with rates `v`, `a`.

    Its frame before the motion lies at `place` in the parent node's frame, turned by `frame` (axes in columns).
    """

    parent: int
    frame: ca.SX
    place: ca.SX
    turns: bool
    axis: ca.SX
    name: str
    q: ca.SX = field(default_factory=lambda: ca.SX(0))
    v: ca.SX = field(default_factory=lambda: ca.SX(0))
    a: ca.SX | None = None
    inertia: ca.SX = field(default_factory=lambda: ca.SX(6, 6))
    rotor: ca.SX | float = 0.0
    """inertia of what turns with it in its drive, geared (kg m^2, kg)"""
    index: int = -1
    unit: bool = False
    """of a unit quaternion (see `_orient`)"""

    def turn(self) -> ca.SX:
        """Its axes in the parent's (3 x 3)."""
        return ca.mtimes(self.frame, _rotation(self.axis, self.q)) if self.turns else self.frame

    def origin(self) -> ca.SX:
        """Its origin in the parent's axes (3)."""
        return self.place if self.turns else self.place + ca.mtimes(self.frame, self.axis * self.q)

    def way(self) -> ca.SX:
        """The spatial velocity (6: turning, sliding) that a unit rate makes, in its own axes."""
        none = ca.SX(3, 1)
        return ca.vertcat(self.axis, none) if self.turns else ca.vertcat(none, self.axis)


@dataclass
class _Body:
    """A body's frame (axes in columns, origin) in that of its node; -1 is the ground."""

    node: int
    frame: ca.SX
    place: ca.SX
    turned: ca.SX = field(default_factory=lambda: ca.SX(0))
    """in the plane: the sum of what joints are turned by on the way to it"""


@dataclass
class _Mass:
    """What moves with a node: mass, centre of mass (3) and inertia about it (3 x 3) in the node's axes."""

    body: str
    node: int
    mass: ca.SX
    com: ca.SX
    inertia: ca.SX


@dataclass
class _Closing:
    """A joint that closes a loop, with its table."""

    name: str
    table: Table
    rows: str
    points: tuple[ca.SX, ca.SX]
    ways: list[tuple[bool, ca.SX]]
    turned: ca.SX
    length: ca.SX | float = 0.0


@dataclass
class _Drawing:
    """A mechanism as read: its tree of nodes, where bodies are, what is left to close."""

    system: Table
    numbers: _Numbers
    kinds: Mapping[str, JointKind]
    nodes: list[_Node] = field(default_factory=list)
    bodies: dict[str, _Body] = field(default_factory=dict)
    closing: list[_Closing] = field(default_factory=list)
    owner: dict[str, str] = field(default_factory=dict)
    """the joint of each coordinate"""
    levels: dict[str, _Node] = field(default_factory=dict)
    """of each quaternion's joint the node with its length (see `_orient`)"""
    masses: list[_Mass] = field(default_factory=list)
    coms: dict[str, ca.SX] = field(default_factory=dict)
    places: dict[str, tuple[ca.SX, ca.SX]] = field(default_factory=dict)
    """the points (3) of each joint and spring in its two bodies"""
    size: float = 1.0
    """m, the largest distance of a point in its body"""

    def angle(self, body: str) -> ca.SX:
        """In the plane: how far a body has turned."""
        start = self.bodies[body]
        angle, k = start.turned, start.node
        while k >= 0:
            node = self.nodes[k]
            angle = angle + node.axis[2] * node.q if node.turns else angle
            k = node.parent
        return angle

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""
        return int(self.system["dimension"])

    def tables(self, what: str) -> Table:
        """What is drawn by name: bodies, joints, springs, ..."""
        return dict(self.system.get(what, {}))

    @cached_property
    def frames(self) -> list[tuple[ca.SX, ca.SX]]:
        """Axes (3 x 3) and origin (3) of every node in the world, once all nodes have coordinates."""
        frames: list[tuple[ca.SX, ca.SX]] = []
        for node in self.nodes:
            turn, origin = frames[node.parent] if node.parent >= 0 else (_eye(), ca.SX(3, 1))
            frames.append((ca.mtimes(turn, node.turn()), origin + ca.mtimes(turn, node.origin())))
        return frames

    def point(self, body: str, at: ca.SX) -> ca.SX:
        """Where a point (3) of a body is in the world."""
        turn, origin = self.axes(body)
        return origin + ca.mtimes(turn, at)

    def axes(self, body: str) -> tuple[ca.SX, ca.SX]:
        """Axes (3 x 3) and origin (3) of a body in the world."""
        there = self.bodies[body]
        turn, origin = self.frames[there.node] if there.node >= 0 else (_eye(), ca.SX(3, 1))
        return ca.mtimes(turn, there.frame), origin + ca.mtimes(turn, there.place)


def mechanism(
    bodies: Mapping[str, Table],
    joints: Mapping[str, Table],
    springs: Mapping[str, Table] | None = None,
    dampers: Mapping[str, Table] | None = None,
    motors: Mapping[str, Table] | None = None,
    motions: Mapping[str, Table] | None = None,
    *,
    gravity: Sequence[float] | None = None,
    dimension: int = 2,
    parameters: Table | None = None,
    frequency: float | None = None,
    pose: Mapping[str, float] | None = None,
    redundant: str = "refuse",
    baumgarte: Sequence[float] | None = None,
    values: Table | None = None,
    scales: Mapping[str, float] | None = None,
    drawn: Table | None = None,
    units: Mapping[str, str] | None = None,
) -> Model:
    """The Model of a mechanism in the plane or in space, described as drawn: bodies, joints, springs, dampers, motors.

    Joints that reach a new body from the ground outwards have coordinates of their name, in their order (`ball1`,
    `ball2`, `ball3` of a joint `ball` with three); all others close loops, as a native DAE. Each number that is not 0
    is a physical parameter: `crank_mass`, `crank_inertia`, `crank_com_x`, `pin_1_x` (first point of joint `pin`),
    `k_stiffness`, `k_length`, `gravity_x`, and those in `parameters` by their own names. SI units, angles in rad.

    Args:
        bodies: bodies by name: mass, inertia (about the centre of mass), com.
        joints: joints by name: kind, between two bodies or the "ground", at = their points, axis.
        springs: springs by name, between points or in a joint.
        dampers: dampers by name, likewise.
        motors: motors by name, torques or forces in a joint.
        motions: prescribed motions of joints by name.
        gravity: acceleration in m/s^2, 9.8 down when left out; x down, y right, z out.
        dimension: 2 in the plane (x down, y right), 3 in space (z towards the eye).
        parameters: shared numbers by name, for text such as '-length / 2'.
        frequency: of what varies in time, in rad/s.
        pose: coordinates near which loops are assembled, 0 otherwise.
        redundant: what to do with equations that repeat others: refuse, or drop them.
        baumgarte: stabilisation [alpha, beta] of the loops in 1/s; its own pace.
        values: numbers that replace parameters.
        scales: sizes to measure in, by name.
        drawn: what pictures show beside the bodies.
        units: words for time, length, mass, angle, or a state or parameter by name ("ms", "mV"); nothing is converted.

    Returns:
        A Model; with a constraint where there are loops.

    Raises:
        InputError: naming body and joint for what cannot be a mechanism.

    Examples:
        >>> rod = {"mass": 1.0, "inertia": 1 / 12, "com": [0.5, 0.0]}
        >>> hinge = {"kind": "revolute", "between": ["ground", "rod"]}
        >>> hung = of.mechanism({"rod": rod}, {"pin": hinge}, gravity=[9.8, 0.0])
        >>> hung.state_names
        ('pin', 'pindot')

    See Also:
        `of.robot` reads URDF and MJCF files; `of.linkages` has poses, rates and minimal forms.
    """
    numbers = _Numbers(parameters or {}, values or {})
    acting = {"springs": springs, "dampers": dampers, "motors": motors, "motions": motions}
    system = _description({"bodies": bodies, "joints": joints, **acting}, gravity, dimension, redundant)
    for name, extra in (("parameters", parameters), ("pose", pose), ("values", values)):
        if extra:
            system[name] = {key: finite_number(f"{name}.{key}", number) for key, number in extra.items()}
    if frequency is not None:
        system["frequency"] = finite_number("frequency", frequency)
    system |= {"redundant": redundant} if redundant != "refuse" else {}
    if drawn:
        system["drawn"] = dict(drawn)
    drawing = _drawn(system, numbers)
    if drawing.levels:
        system["pose"] = {node.name: 1.0 for node in drawing.levels.values()} | system.get("pose", {})
    motion = _Energies.of(drawing)
    numbers.finish()
    made = _closed(drawing, motion, baumgarte) if drawing.closing else _tree(drawing, motion)
    return with_units(replace(made, scales={k: float(v) for k, v in (scales or {}).items()}), units)


def _description(tables: Table, gravity: Any, dimension: Any, redundant: Any) -> Entries:
    """The tables as plain data, checked for shape; what was not given is left out."""
    if dimension not in (2, 3):
        raise InputError(f"dimension: must be 2 (the plane) or 3 (space), got {dimension!r}")
    fall = [9.8, 0.0, 0.0][:dimension] if gravity is None else [finite_number("gravity", number) for number in gravity]
    if len(fall) != dimension:
        raise InputError(f"gravity: {plural(len(fall), 'number')}; give {dimension} (m/s^2, x down, y right)")
    if redundant not in ("refuse", "drop"):
        raise InputError(f"redundant: must be 'refuse' or 'drop' (equations that repeat others), got {redundant!r}")
    system = {"kind": "mechanism", "dimension": dimension, "gravity": fall}
    for name, table in tables.items():
        for key, entry in (table or {}).items():
            if not str(key).isidentifier() or key == GROUND:
                raise InputError(f"{name}: {key!r} is no name; use letters, digits and _, and not {GROUND!r}")
            known = KEYS[name]
            if not isinstance(entry, Mapping):
                raise InputError(f"{name}.{key}: must be a table of {', '.join(sorted(known))}, got {entry!r}")
            for word in entry:
                if word not in known:
                    use = f"{closest(word, known)}; use {', '.join(sorted(known))}"
                    raise InputError(f"{name}.{key}.{word}: unknown key{use}")
        if table:
            system[name] = {key: {k: _plain(v) for k, v in entries.items()} for key, entries in table.items()}
        elif name in ("bodies", "joints"):
            raise InputError(f"{name}: none given; a mechanism has at least one body and joint")
    return system


def _plain(value: Any) -> Any:
    """Numbers, text and lists of them, as a file keeps them."""
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(entry) for entry in value]
    return value if isinstance(value, str) else float(value)


def _eye() -> ca.SX:
    return ca.SX.eye(3)


def _skew(axis: ca.SX) -> ca.SX:
    """The matrix of the product axis x, with the zeros left out."""
    matrix = ca.SX(3, 3)
    for i, j, k, sign in ((0, 1, 2, -1), (0, 2, 1, 1), (1, 2, 0, -1)):
        if axis.sparsity().has_nz(k, 0):
            matrix[i, j], matrix[j, i] = sign * axis[k], -sign * axis[k]
    return matrix


def _rotation(axis: ca.SX, angle: ca.SX) -> ca.SX:
    """The turn about a unit axis (3): aa^T + cos (1 - aa^T) + sin [a], zeros left out."""
    along = ca.mtimes(axis, axis.T)
    across = ca.SX(ca.sparsify(ca.DM(_eye() - along))) if not ca.symvar(axis) else _eye() - along
    return along + ca.cos(angle) * across + ca.sin(angle) * _skew(axis)


def _vector(numbers: _Numbers, where: str, name: str, entry: Any, dimension: int) -> ca.SX:
    """A point (3, zeros left out) as parameters NAME_x, NAME_y, NAME_z."""
    if not isinstance(entry, (list, tuple, np.ndarray)) or len(entry) != dimension:
        raise InputError(f"{where}: need {dimension} numbers (m), got {entry!r}")
    point = ca.SX(3, 1)
    for k, (letter, number) in enumerate(zip("xyz", entry, strict=False)):
        value = numbers(where, f"{name}_{letter}", number)
        if isinstance(value, ca.SX):
            point[k] = value
    return point


def _unit(where: str, entry: Any, dimension: int, numbers: _Numbers) -> ca.SX:
    """A direction (3): numbers of any length but 0, or in the plane an angle from the x axis, which may be named."""
    if dimension == 2 and not isinstance(entry, (list, tuple, np.ndarray)):
        angle = numbers(where, where.removeprefix("joints.").replace(".", "_"), entry)
        return ca.vertcat(ca.cos(angle), ca.sin(angle), 0)
    size = None if entry is None else np.asarray(entry, float)
    if size is None or size.shape != (dimension,) or not np.all(np.isfinite(size)) or not np.any(size):
        raise InputError(f"{where}: need a direction of {dimension} numbers, not all 0, got {entry!r}")
    direction = np.zeros(3)
    direction[:dimension] = size / np.linalg.norm(size)
    return ca.SX(ca.sparsify(ca.DM(direction)))


def _drawn(system: Table, numbers: _Numbers) -> _Drawing:
    """The tree of a mechanism and what is left to close."""
    dimension, joints = int(system["dimension"]), system["joints"]
    pairs = {name: _between("joints", name, table, system["bodies"]) for name, table in joints.items()}
    made = _Drawing(system, numbers, {name: _kind(dimension, name, table) for name, table in joints.items()})
    made.bodies[GROUND] = _Body(-1, _eye(), ca.SX(3, 1))
    left = dict(joints)
    reached = [GROUND]
    for body in reached:  # from the ground outwards, which cuts loops in their middle
        for name in [n for n in left if body in pairs[n] and made.kinds[n].reaches]:
            other = next(end for end in pairs[name] if end != body)
            if other not in made.bodies:
                _grow(made, name, left.pop(name), pairs[name])
                reached.append(other)
    for name in system["bodies"]:
        if name not in made.bodies:
            held = [joint for joint, pair in pairs.items() if name in pair]
            raise InputError(
                f"bodies.{name}: hangs in the air, no joint leads from the ground to it (its joints: "
                f"{', '.join(held) or 'none'}); join it (kind = 'free' joins it by nothing)"
            )
    for name, table in left.items():
        if not made.kinds[name].rows:
            closing = [kind for kind, joint in JOINTS[dimension].items() if joint.rows]
            raise InputError(
                f"joints.{name}: {table['kind']!r} closes no loop; a loop is closed by {', '.join(closing)}"
            )
        length, kind = ca.SX(0), made.kinds[name]
        ways, points = _motions(made, name, table), _points(made, "joints", name, table)
        if "l" in kind.rows:
            length = _positive(numbers, f"joints.{name}.length", f"{name}_length", table.get("length", 0.0), "m")
        turned = _turned(made, name, table) if "l" not in kind.rows else _eye()
        made.closing.append(_Closing(name, table, kind.rows, points, ways, turned, length))
    _check_bars(made, pairs)
    return made


def _between(where: str, name: str, table: Table, bodies: Table) -> tuple[str, str]:
    pair = table.get("between")
    if not isinstance(pair, list) or len(pair) != 2 or pair[0] == pair[1]:
        raise InputError(f"{where}.{name}.between: need two different bodies, such as ['{GROUND}', ...], got {pair!r}")
    for end in pair:
        if end != GROUND and end not in bodies:
            raise InputError(
                f"{where}.{name}.between: unknown body {end!r}{closest(str(end), bodies)}; bodies are {GROUND}, "
                f"{', '.join(bodies)}"
            )
    return pair[0], pair[1]


def _kind(dimension: int, name: str, table: Table) -> JointKind:
    kind, known = table.get("kind"), JOINTS[dimension]
    if not isinstance(kind, str) or kind not in known:
        hint = closest(str(kind), known)
        raise InputError(
            f"joints.{name}.kind: unknown {kind!r}{hint}; in {dimension} dimensions use {', '.join(known)}"
        )
    return known[kind]


def _points(made: _Drawing, where: str, name: str, table: Table) -> tuple[ca.SX, ca.SX]:
    """The points of a joint, spring or damper in its two bodies; at their origins where nothing is said."""
    at = table.get("at", [[0.0] * made.dimension] * 2)
    if not isinstance(at, (list, tuple)) or len(at) != 2:
        raise InputError(f"{where}.{name}.at: need two points, one in each body, got {at!r}")
    first, second = (
        _vector(made.numbers, f"{where}.{name}.at", f"{name}_{k + 1}", point, made.dimension)
        for k, point in enumerate(at)
    )
    made.places[name] = (first, second)
    return first, second


def _motions(made: _Drawing, name: str, table: Table) -> list[tuple[bool, ca.SX]]:
    """What a joint leaves free: turns (True) and slides with their axes (3), in the first body's frame."""
    kind, free = made.kinds[name], made.kinds[name].free
    axes = (_world if kind.unit(table) else kind.axes)(made, name, table, free)
    ways = [(way == "R", axis) for way, axis in zip(free, axes, strict=True)]
    return [*ways[:-3], (False, ca.SX(3, 1)), *ways[-3:]] if kind.unit(table) else ways


def _own_axis(made: _Drawing, name: str, table: Table, free: str) -> list[ca.SX]:
    """The axis given, of all; in the plane of slides, where turns are about z."""
    plane = made.dimension == 2
    if not free or (plane and "P" not in free):
        return [_basis(2)] * len(free)
    axis = _unit(f"joints.{name}.axis", table.get("axis"), made.dimension, made.numbers)
    return [_basis(2) if plane and way == "R" else axis for way in free]


def _own_axes(made: _Drawing, name: str, table: Table, free: str) -> list[ca.SX]:
    """The axes given, of turns in their order; x, y, z unless said otherwise."""
    axes = table.get("axes", np.eye(3)[: len(free)].tolist())
    if isinstance(axes, str) and set(axes) <= set("xyz"):
        axes = [np.eye(3)["xyz".index(letter)].tolist() for letter in axes]
    if not isinstance(axes, list) or len(axes) != len(free):
        raise InputError(f"joints.{name}.axes: need {len(free)} directions, or letters such as 'xyz', got {axes!r}")
    directions = [_unit(f"joints.{name}.axes", axis, 3, made.numbers) for axis in axes]
    for axis, other in pairwise(directions):
        if float(ca.norm_2(ca.cross(ca.densify(axis), ca.densify(other)))) < RANK_TOLERANCE:
            raise InputError(f"joints.{name}.axes: two axes in a row are one; give others")
    return directions


def _world(made: _Drawing, name: str, table: Table, free: str) -> list[ca.SX]:
    """The first body's own axes."""
    del made, name, table
    return [_basis(k % 3) for k in range(len(free))]


def _basis(k: int) -> ca.SX:
    """One of the axes x, y, z (3), zeros left out."""
    return ca.SX(ca.sparsify(ca.DM(np.eye(3)[k])))


@dataclass(frozen=True)
class JointKind:
    """What a kind of joint leaves free and holds: every question about kinds of joints is answered by `JOINTS`."""

    free: str
    """in its order: slides P and turns R"""
    rows: str = ""
    """the equations by which it closes a loop, one letter each (see `_rows`); none closes none"""
    axes: Callable[[_Drawing, str, Table, str], list[ca.SX]] = _own_axis
    """(drawing, name, table, free) -> their axes (3) in the first body's frame"""
    drawn: str = ""
    """the stroke through its point on the second body, or through both of a rod"""
    pin: bool = False
    """whether a body of two such joints at one point is a bar of no length"""
    reaches: bool = True
    """whether it may join a body to the tree; else it closes a loop wherever it is"""

    def unit(self, table: Table) -> bool:
        """Whether its turns are the last four coordinates, a unit quaternion."""
        return self.free.endswith("RRR") and table.get("axes") == "quaternion"


JOINTS = {
    2: {
        "revolute": JointKind("R", "xy", pin=True),
        "prismatic": JointKind("P", "na", drawn="slider"),
        "slot": JointKind("PR", "n", drawn="slider"),
        "fixed": JointKind("", "xya"),
        "free": JointKind("PPR", axes=_world),
        "rod": JointKind("", "l", drawn="rod", reaches=False),
    },
    3: {
        "revolute": JointKind("R", "xyzuv", pin=True),
        "prismatic": JointKind("P", "pqabc", drawn="slider"),
        "cylindrical": JointKind("PR", "pquv", drawn="slider"),
        "universal": JointKind("RR", "xyzo", _own_axes),
        "spherical": JointKind("RRR", "xyz", _own_axes, pin=True),
        "fixed": JointKind("", "xyzabc"),
        "free": JointKind("PPPRRR", axes=_world),
        "connect": JointKind("", "ijk", reaches=False),
        "weld": JointKind("", "ijkabc", reaches=False),
        "rod": JointKind("", "l", drawn="rod", reaches=False),
    },
}
"""Kinds of joints by dimension and name"""


def _turned(made: _Drawing, name: str, table: Table) -> ca.SX:
    """The second body's axes in the first's where the joint is at 0 (3 x 3): an angle, or roll, pitch and yaw."""
    given = table.get("turned", 0.0 if made.dimension == 2 else [0.0] * 3)
    if made.dimension == 2:
        angle = made.numbers(f"joints.{name}.turned", f"{name}_turned", given)
        return _rotation(_basis(2), angle) if isinstance(angle, ca.SX) else _eye()
    if not isinstance(given, list) or len(given) != 3:
        raise InputError(f"joints.{name}.turned: need roll, pitch and yaw (rad), got {given!r}")
    turned = _eye()
    for k in (2, 1, 0):
        angle = made.numbers(f"joints.{name}.turned", f"{name}_turned_{'xyz'[k]}", given[k])
        turned = ca.mtimes(turned, _rotation(_basis(k), angle)) if isinstance(angle, ca.SX) else turned
    return turned


def _angle(turned: ca.SX) -> ca.SX:
    """The angle of a turn about z (3 x 3)."""
    return ca.atan2(turned[1, 0], turned[0, 0]) if ca.symvar(turned) else ca.SX(0)


def _grow(made: _Drawing, name: str, table: Table, pair: tuple[str, str]) -> None:
    """Nodes for a joint that reaches a new body, forwards or backwards."""
    ways, turned = _motions(made, name, table), _turned(made, name, table)
    points = _points(made, "joints", name, table)
    forwards = pair[0] in made.bodies
    known, new = pair if forwards else pair[::-1]
    here, there = points if forwards else points[::-1]
    base = made.bodies[known]
    labels = [name] if len(ways) == 1 else [f"{name}{k + 1}" for k in range(len(ways))]
    steps = list(zip(ways, labels, strict=True))
    made.owner |= dict.fromkeys(labels, name)
    if not forwards:  # the same motions undone in the other order
        steps = [((turns, -axis), label) for (turns, axis), label in reversed(steps)]
    parent, frame = base.node, base.frame
    place = base.place + ca.mtimes(frame, here)
    if not forwards:
        frame = ca.mtimes(frame, turned.T)
    for (turns, axis), label in steps:
        rotor = (
            made.numbers(f"joints.{name}.rotor", f"{name}_rotor", table.get("rotor", 0.0)) if len(steps) == 1 else 0.0
        )
        unit = made.kinds[name].unit(table) and label in labels[-4:]
        made.nodes.append(_Node(parent, frame, place, turns, axis, label, rotor=rotor, unit=unit))
        if unit and not turns:
            made.levels[name] = made.nodes[-1]
        parent, frame, place = len(made.nodes) - 1, _eye(), ca.SX(3, 1)
    if forwards:
        frame = ca.mtimes(frame, turned)
    angle = _angle(turned) if made.dimension == 2 else ca.SX(0)
    whole = base.turned + (angle if forwards else -angle)
    made.bodies[new] = _Body(parent, frame, place - ca.mtimes(frame, there), whole)
    if name in made.levels:
        made.closing.append(_Closing(name, table, "s", points, ways, turned))


def _orient(level: _Node, *turns: _Node) -> None:
    """Put coordinates c into the nodes of a quaternion: R(c / |c|), the rates of turning about the second body's axes,
    and the level (|c|^2 - 1) / 2, which moves no body: its inertia makes the mass matrix regular, and takes no part
    in the motion, along which the level stays 0."""
    c, rates = (ca.vertcat(*(getattr(node, name) for node in (level, *turns))) for name in "qv")
    across, back = _skew(c[1:]), turns[0].axis[0]  # -1 where the joint is told from its second body
    turn = _eye() + 2 * ca.mtimes(back * c[0] * _eye() + across, across) / ca.sumsqr(c)
    level.frame = ca.mtimes(level.frame, turn)
    spin = 2 * (c[0] * rates[1:] - rates[0] * c[1:] - ca.mtimes(across, rates[1:])) / ca.sumsqr(c)
    for k, node in enumerate(turns):
        node.q, node.v = ca.SX(0), spin[k]
    level.q, level.v, level.rotor = (ca.sumsqr(c) - 1) / 2, ca.dot(c, rates), 1.0


def _check_bars(made: _Drawing, pairs: Mapping[str, tuple[str, str]]) -> None:
    """`InputError` for a bar of no length, and for two pins of the same two bodies in the same place."""
    for body in (*made.tables("bodies"), GROUND):
        places = {}
        for name, table in made.tables("joints").items():
            if body in pairs[name] and made.kinds[name].pin:
                at = table.get("at", [[0.0] * made.dimension] * 2)[pairs[name].index(body)]
                places[name] = (str(at), frozenset(pairs[name]))
        ends = list(places.items())
        for k, (name, (at, pair)) in enumerate(ends):
            for other, (there, second) in ends[:k]:
                alone = len(ends) == 2 and body != GROUND and len(made.closing) > len(made.levels)
                if at == there and (alone or pair == second) and not _cross(made, name, other):
                    raise InputError(
                        f"joints.{name}: at the same point of body {body!r} as joint {other!r} ({at}), which leaves a "
                        "bar of no length; move one of them"
                    )


def _cross(made: _Drawing, *names: str) -> bool:
    """Whether two joints are hinges in space about different axes, as in a spherical linkage, whose axes meet."""
    if made.dimension == 2 or any(made.kinds[name].free != "R" for name in names):
        return False
    tables = [made.tables("joints")[name] for name in names]
    first, second = (np.asarray(table["axis"], float) / np.linalg.norm(table["axis"]) for table in tables)
    return any("turned" in table for table in tables) or bool(np.linalg.norm(np.cross(first, second)) > RANK_TOLERANCE)


@dataclass
class _Energies:
    """Energies and forces of a drawing in its coordinates: what `Symbols` and `Terms` are made of.

    `kinetic` and `potential` depend on t where motions are prescribed; `pushed` (n) are forces of springs, dampers and
    motors (gravity left out), `acting` (n) those that no potential has: `passive`, and what the `controls` (motors
    without a torque of their own) `drive`.
    """

    symbols: Symbols
    kinetic: ca.SX
    potential: ca.SX
    elastic: ca.SX
    passive: ca.SX | None
    drive: ca.SX | None
    controls: tuple[str, ...]
    acting: ca.SX | None
    gravity: ca.SX
    names: list[str]
    angles: list[bool]
    points: ca.SX
    strokes: tuple[tuple[str, tuple[int, ...]], ...]
    prescribed: bool

    @classmethod
    def of(cls, made: _Drawing) -> _Energies:
        numbers, clock = made.numbers, _clock(made)
        moved = _prescribed(made, clock)
        places = list(made.owner)  # a joint told from its second body has its nodes the other way round
        behind = {name: table["mimics"] for name, table in made.tables("joints").items() if "mimics" in table}
        free = (node for node in made.nodes if node.name not in {*moved, *behind})
        own = sorted(free, key=lambda node: places.index(node.name))
        q, v = ca.SX.sym("q", len(own)), ca.SX.sym("v", len(own))
        if not own:
            raise InputError("motions: every coordinate is prescribed, which leaves no motion to compute; free one")
        for k, node in enumerate(own):
            node.q, node.v, node.index = q[k], v[k], k
        for name in made.levels:
            _orient(*(node for node in own if node.unit and made.owner[node.name] == name))
        for name, rule in behind.items():
            _follow(made, name, rule)
        _weigh(made)
        gravity = _vector(numbers, "gravity", "gravity", made.system["gravity"], made.dimension)
        kinetic, t = _kinetic(made), clock[0]
        fall = ca.SX(0)
        for mass in made.masses:
            place = made.frames[mass.node][1] + ca.mtimes(made.frames[mass.node][0], mass.com)
            fall -= mass.mass * ca.dot(gravity, place)
        elastic, spent, work = ca.SX(0), ca.SX(0), ca.SX(0)
        for name, table in made.tables("springs").items():
            elastic += _spring(made, name, table)
        for name, table in made.tables("dampers").items():
            spent += _damper(made, name, table, (q, v, t))
        for name, table in made.tables("motors").items():
            where = f"motors.{name}"
            joint = _coordinate(made, where, table)
            torque = numbers.new(
                name, finite_number(f"{where}.torque", table.get("torque", 0.0))
            )  # a parameter of its name
            swing, late = (
                numbers(f"{where}.{key}", f"{name}_{key}", table.get(key, 0.0)) for key in ("amplitude", "phase")
            )
            if isinstance(swing, ca.SX):
                torque = torque + swing * ca.cos(clock[1] * clock[0] + late)
            work += torque * _rate(joint, q, v, t)
        acting = ca.gradient(work - spent, v) if made.tables("motors") or made.tables("dampers") else None
        controls = tuple(
            name for name, motor in made.tables("motors").items() if not (motor.get("torque") or motor.get("amplitude"))
        )
        passive, drive = divided(acting, numbers.vector, controls, numbers.names, numbers.values)
        forced = ca.depends_on(ca.vertcat(kinetic, fall + elastic, work), t)
        points, strokes = _picture(made)
        points = ca.substitute(points, t, ca.SX(0))  # pictures show what is prescribed as it is at t = 0
        symbols = Symbols(
            q, v, numbers.vector, tuple(numbers.names), tuple(numbers.values), time=t if forced else None,
            forcing_period=2 * np.pi / clock[1] if forced else None,
        )  # fmt: skip
        angles = [node.turns and not node.unit for node in own]
        names = [node.name for node in own]
        return cls(
            symbols, kinetic, fall + elastic, elastic, passive, drive, controls, acting, gravity, names, angles,
            points, strokes, bool(moved),
        )  # fmt: skip


def _clock(made: _Drawing) -> tuple[ca.SX, ca.SX]:
    """Time and the forcing's frequency (rad/s)."""
    t, given = ca.SX.sym("t"), made.system.get("frequency")
    if given is None:
        varying = [f"motors.{n}" for n, motor in made.tables("motors").items() if motor.get("amplitude")]
        varying += [f"motions.{name}" for name in made.tables("motions")]
        if varying:
            raise InputError(f"frequency: missing, and {varying[0]} varies in time; give it in rad/s")
        return t, ca.SX(1)
    if given <= 0:
        raise InputError(f"frequency: must be positive, got {given:g}; give it in rad/s")
    return t, ca.SX(made.numbers("frequency", "frequency", given))


def _prescribed(made: _Drawing, clock: tuple[ca.SX, ca.SX]) -> set[str]:
    """Coordinates moved by what a file says: q = offset + turns w t + amplitude cos(w t + phase); their names."""
    t, w = clock
    moved = set()
    nodes = {node.name: node for node in made.nodes}
    for name, table in made.tables("motions").items():
        where = f"motions.{name}"
        node = nodes.get(str(table.get("joint")))
        if node is None:
            raise InputError(
                f"{where}.joint: {table.get('joint')!r} is no coordinate of the tree; use {', '.join(nodes)}"
            )
        if made.closing:
            raise InputError(
                f"{where}: joint {node.name!r} moves a mechanism with loops (closed by {made.closing[0].name!r}), "
                "which is not prescribed; drive it by a motor, or open the loop"
            )
        offset, amplitude, phase = (
            made.numbers(f"{where}.{key}", f"{name}_{key}", table.get(key, 0.0))
            for key in ("offset", "amplitude", "phase")
        )
        turns = finite_number(f"{where}.turns", table.get("turns", 0.0))
        if turns != round(turns) or (turns and not node.turns):
            raise InputError(f"{where}.turns: must be a whole number, of a joint that turns, got {turns:g}")
        node.q = ca.SX(offset + turns * w * t + amplitude * ca.cos(w * t + phase))
        node.v = ca.jacobian(node.q, t)
        node.a = ca.jacobian(node.v, t)
        moved.add(node.name)
    return moved


def _follow(made: _Drawing, name: str, rule: Any) -> None:
    """Put q = ratio q_other + offset into a joint that mimics another: (other, ratio, offset)."""
    nodes = {node.name: node for node in made.nodes}
    own = {node.name: node for node in made.nodes if node.index >= 0}
    if not isinstance(rule, list) or len(rule) != 3 or name not in nodes or rule[0] not in own or made.closing:
        raise InputError(
            f"joints.{name}.mimics: need [joint, ratio, offset] of a joint of one coordinate, in a mechanism without "
            f"loops, got {rule!r}; joints are {', '.join(own)}"
        )
    node, other = nodes[name], own[rule[0]]
    ratio, offset = (made.numbers(f"joints.{name}.mimics", f"{name}_{w}", x)
                     for w, x in zip(("ratio", "offset"), rule[1:], strict=True))  # fmt: skip
    node.q, node.v = ca.SX(ratio * other.q + offset), ca.SX(ratio * other.v)


def _weigh(made: _Drawing) -> None:
    """The bodies' masses and inertias, put into the nodes' axes."""
    numbers = made.numbers
    for name, table in made.tables("bodies").items():
        where, body = f"bodies.{name}", made.bodies[name]
        # what decides is the mass matrix: others hang on it, or it has no coordinate of its own
        light = any(
            name in joint.get("between", ())[: 2 if "mimics" in joint else 1]
            for joint in made.tables("joints").values()
        )
        bare = light and table.get("mass", 0.0) == 0.0
        mass = ca.SX(0) if bare else numbers(f"{where}.mass", f"{name}_mass", table.get("mass", 0.0))
        if numbers.value(mass) <= 0 and not bare:
            raise InputError(
                f"{where}.mass: must be positive, got {numbers.value(mass)!r}; give the body {name!r} a mass, or "
                "draw a bar without one as a joint of kind 'rod'"
            )
        com = _vector(numbers, f"{where}.com", f"{name}_com", table.get("com", [0.0] * made.dimension), made.dimension)
        inertia, made.coms[name] = _inertia(numbers, name, table, made.dimension), com
        if body.node < 0:
            continue
        com, inertia = body.place + ca.mtimes(body.frame, com), ca.mtimes([body.frame, inertia, body.frame.T])
        made.masses.append(_Mass(name, body.node, ca.SX(mass), com, inertia))
        lever = mass * _skew(com)
        made.nodes[body.node].inertia += ca.blockcat(
            [[inertia + ca.mtimes(lever, _skew(com).T), lever], [lever.T, mass * _eye()]]
        )
    sizes = [*point_sizes(numbers.names, numbers.values)]
    for number in (number for table in made.tables("joints").values() for at in table.get("at", []) for number in at):
        if (match := EXPRESSION.fullmatch(str(number))) and match[3] in numbers.names:  # by a shared parameter
            sizes.append(abs(numbers.values[numbers.names.index(match[3])]))
    made.size = max(sizes, default=1.0) or 1.0


def _inertia(numbers: _Numbers, name: str, table: Table, dimension: int) -> ca.SX:
    """Inertia about the centre of mass in the body's axes (3 x 3): a number, xx yy zz, or xx yy zz xy xz yz."""
    where, given, matrix = f"bodies.{name}.inertia", table.get("inertia", 0.0), ca.SX(3, 3)
    if dimension == 2:
        value = numbers(where, f"{name}_inertia", given)
        if isinstance(value, ca.SX):
            if numbers.value(value) < 0:
                raise InputError(f"{where}: must not be negative, got {given!r} (kg m^2 about the centre of mass)")
            matrix[2, 2] = value
        return matrix
    entries = [given] * 3 if not isinstance(given, list) else given
    if len(entries) not in (3, 6):
        raise InputError(f"{where}: need xx yy zz or xx yy zz xy xz yz (kg m^2), got {given!r}")
    places = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    met: dict[Any, ca.SX | float] = {}
    for k, ((i, j), entry) in enumerate(zip(places, entries, strict=False)):
        alike = (entry, k < 3)  # equal moments of a body of revolution are one parameter
        value = met[alike] if alike in met else numbers(where, f"{name}_inertia_{'xyz'[i]}{'xyz'[j]}", entry)
        met[alike] = value
        if isinstance(value, ca.SX):
            matrix[i, j] = matrix[j, i] = value
    at = ca.Function("inertia", [numbers.vector], [ca.densify(matrix)])(numbers.values).full()
    moments = np.linalg.eigvalsh(at)
    if moments[0] < -1e-12 * moments[2] or moments[0] + moments[1] < moments[2] * (1 - 1e-9):
        raise InputError(
            f"{where}: no body has these principal moments, {np.array2string(moments, precision=4)} kg m^2: none is "
            "negative and the largest is at most the sum of the others; check the units and the axes"
        )
    return matrix


def _kinetic(made: _Drawing) -> ca.SX:
    """T, by velocities in the nodes' own axes."""
    speeds, energy = _speeds(made), ca.SX(0)
    for body in made.masses:
        turning, sliding = speeds[body.node][:3], speeds[body.node][3:]
        centre = sliding + ca.mtimes(_skew(body.com).T, turning)
        energy += 0.5 * body.mass * ca.sumsqr(centre) + 0.5 * ca.dot(turning, ca.mtimes(body.inertia, turning))
    return energy + sum(0.5 * node.rotor * node.v**2 for node in made.nodes)


def _speeds(made: _Drawing) -> list[ca.SX]:
    """Spatial velocities (6: turning, sliding) of the nodes in their own axes."""
    speeds: list[ca.SX] = []
    for node in made.nodes:
        before = speeds[node.parent] if node.parent >= 0 else ca.SX(6, 1)
        speeds.append(ca.mtimes(_transform(node), before) + node.way() * node.v)
    return speeds


def _transform(node: _Node) -> ca.SX:
    """Spatial velocities of the parent node seen in a node (6 x 6): [[E, 0], [-E rx, E]]."""
    back = node.turn().T
    return ca.blockcat([[back, ca.SX(3, 3)], [ca.mtimes(back, _skew(node.origin()).T), back]])


def _rate(value: ca.SX, q: ca.SX, v: ca.SX, t: ca.SX) -> ca.SX:
    """d/dt of an expression in (t, q)."""
    return ca.jtimes(value, q, v) + ca.jacobian(value, t)


def _coordinate(made: _Drawing, where: str, table: Table) -> ca.SX:
    """The angle (rad) or slide (m) of a joint, of what closes a loop too; `InputError` for others."""
    name = str(table.get("joint"))
    for node in made.nodes:
        if node.name == name and not node.unit:
            return node.q
    for closing in made.closing:
        if closing.name == name and made.dimension == 2 and closing.ways:
            turns, axis = closing.ways[0]
            if turns:
                first, second = closing.table["between"]
                return made.angle(second) - made.angle(first) - _angle(closing.turned)
            gap, turn = _gap(made, closing)
            return ca.dot(gap, ca.mtimes(turn, axis))
    known = [node.name for node in made.nodes if not node.unit]
    raise InputError(f"{where}.joint: {name!r} is no coordinate{closest(name, known)}; use {', '.join(known)}")


def _stretch(made: _Drawing, what: str, name: str, table: Table) -> ca.SX:
    """The vector (3) from the first to the second point of a spring or damper."""
    first, second = _between(what, name, table, made.tables("bodies"))
    here, there = _points(made, what, name, table)
    return made.point(second, there) - made.point(first, here)


def _positive(numbers: _Numbers, where: str, name: str, entry: Any, unit: str) -> ca.SX | float:
    number = numbers(where, name, entry)
    if numbers.value(number) <= 0:
        raise InputError(f"{where}: must be positive, got {entry!r} ({unit})")
    return number


def _spring(made: _Drawing, name: str, table: Table) -> ca.SX:
    """Energy of a spring between two points or in a joint: k (length - rest)^2 / 2."""
    where, numbers = f"springs.{name}", made.numbers
    stiffness = _positive(numbers, f"{where}.stiffness", f"{name}_stiffness", table.get("stiffness", 0.0), "N/m")
    if "joint" in table:
        rest = numbers(f"{where}.rest", f"{name}_rest", table.get("rest", 0.0))
        return 0.5 * stiffness * (_coordinate(made, where, table) - rest) ** 2
    gap = _stretch(made, "springs", name, table)
    rest = numbers(f"{where}.length", f"{name}_length", table.get("length", 0.0))
    return 0.5 * stiffness * ((ca.norm_2(gap) - rest) ** 2 if isinstance(rest, ca.SX) else ca.sumsqr(gap))


def _damper(made: _Drawing, name: str, table: Table, now: Sequence[ca.SX]) -> ca.SX:
    """Half the power that a damper takes: c (d length / dt)^2 / 2, Rayleigh's function."""
    where = f"dampers.{name}"
    damping = _positive(made.numbers, f"{where}.damping", f"{name}_damping", table.get("damping", 0.0), "N s/m")
    if "joint" in table:
        length = _coordinate(made, where, table)
    else:
        length = ca.norm_2(_stretch(made, "dampers", name, table))
    return 0.5 * damping * _rate(length, *now) ** 2


def _gap(made: _Drawing, closing: _Closing) -> tuple[ca.SX, ca.SX]:
    """From a joint's point on its first body to that on its second (3), and the first body's axes (3 x 3)."""
    first, second = closing.table["between"]
    here, there = closing.points
    return made.point(second, there) - made.point(first, here), made.axes(first)[0]


def _rows(made: _Drawing, closing: _Closing) -> ca.SX:
    """The equations of a joint that closes a loop, in m, a letter each: x y z the gap, i j k in the first body's axes,
    in which equations that repeat others do so wherever it turns, n p q across the axis,
    u v d e the axis against two directions of the other body, a b c axes against each other, o of a universal joint,
    l the length of a rod, s that of a quaternion.
    """
    gap, turn = _gap(made, closing)
    other = made.axes(closing.table["between"][1])[0]
    wanted = ca.mtimes(turn, closing.turned)
    rows = dict(zip("xyzijk", ca.vertsplit(ca.vertcat(gap, ca.mtimes(turn.T, gap))), strict=True))
    if "l" in closing.rows:
        rows["l"] = (ca.sumsqr(gap) - closing.length**2) / (2 * closing.length)
    else:
        rows |= {
            c: made.size * ca.dot(wanted[:, i], other[:, j]) for c, i, j in (("a", 0, 1), ("b", 1, 2), ("c", 2, 0))
        }
    if closing.ways and set("npquv") & set(closing.rows):
        axis = ca.densify(closing.ways[0][1])
        across = [ca.cross(axis, ca.SX([0, 0, 1]))] if made.dimension == 2 else _across(axis)
        rows |= {
            c: ca.dot(gap, ca.mtimes(turn, d))
            for c, d in zip("n" if made.dimension == 2 else "pq", across, strict=True)
        }
        if made.dimension == 3:
            ahead = ca.mtimes(turn, axis)
            rows |= {
                c: made.size * ca.dot(ahead, ca.mtimes([other, closing.turned.T, d]))
                for c, d in zip("uv", across, strict=True)
            }
    if "s" in closing.rows:
        rows["s"] = made.size * made.levels[closing.name].q
    if "o" in closing.rows:
        (_, first), (_, second) = closing.ways
        rows["o"] = made.size * ca.dot(ca.mtimes(turn, first), ca.mtimes([other, closing.turned.T, second]))
    return ca.densify(ca.vertcat(*(rows[letter] for letter in closing.rows)))


def _across(axis: ca.SX) -> list[ca.SX]:
    """Two directions across a direction of numbers (3)."""
    along = np.array(ca.DM(axis)).ravel()
    first = np.cross(along, np.eye(3)[int(np.abs(along).argmin())])
    first /= np.linalg.norm(first)
    return [ca.SX(first), ca.SX(np.cross(along, first))]


def _picture(made: _Drawing) -> tuple[ca.SX, tuple[tuple[str, tuple[int, ...]], ...]]:
    """Points (2 x k, in space 3 x k) and what is drawn through which: ground, spring, rod (a body), slider, disc, solid
    (centre and three sides of the box about it) with a bone for a rod."""
    columns = []
    strokes = []

    def place(body: str, at: ca.SX) -> int:
        columns.append(made.point(body, at))
        return len(columns) - 1

    solids = _solids(made)
    held, pulled = ({name: list[ca.SX]() for name in made.bodies} for _ in range(2))
    for name, (centre, half) in solids.items():
        sides = (ca.SX(centre + half * way) for way in np.vstack([np.zeros(3), np.eye(3)]))
        strokes.append(("solid", tuple(place(name, at) for at in sides)))
    for name, table in made.tables("joints").items():
        kind, ends = made.kinds[name], list(zip(table["between"], made.places[name], strict=True))
        for body, at in ends:
            if not (body == GROUND and "P" in kind.free) and not _among(at, held[body]):
                held[body].append(at)
            if kind.drawn == "slider" and body == table["between"][1]:
                strokes.append((kind.drawn, (place(body, at),)))
        if kind.drawn == "rod":
            strokes.append((kind.drawn, tuple(place(*end) for end in ends)))
    for name, table in made.tables("springs").items():
        if name in made.places:
            ends = list(zip(table["between"], made.places[name], strict=True))
            for body, at in ends:
                (held if body == GROUND else pulled)[body].append(at)
            strokes.append(("spring", tuple(place(*end) for end in ends)))
    strokes += [("ground", (place(GROUND, at),)) for at in held.pop(GROUND)]
    for name, table in made.tables("bodies").items():
        com = made.coms[name]
        if "disc" in table:
            axle = int(np.argmax(table.get("inertia", 0.0))) if made.dimension == 3 else 2  # heaviest about its axle
            rims = [ca.densify(com) + float(table["disc"]) * _eye()[:, k] for k in range(3) if k != axle]
            seen = (com, *rims) if made.dimension == 3 else (com, rims[0])
            strokes.append(("disc", tuple(place(name, at) for at in seen)))
        flat, points = [0.0] * (3 - made.dimension), held[name]
        if "shape" in table:
            points = [ca.SX([*map(float, point), *flat]) for point in table["shape"]]
        if len(points) < 2 and (made.dimension == 3 or "disc" not in table):
            far = [_solid_end(*solids[name], at) if name in solids else _rod_end(table, at, com) for at in points]
            points = [*points, *far, *([] if points else [com])]
        if not {"shape", "disc"} & set(table):  # a spring does not end in the air
            points = [*points, *(at for at in pulled[name] if not _among(at, points))]
        chain = [place(name, at) for at in points]
        line = tuple(chain + chain[:1] * (len(chain) > 2 and "shape" not in table))
        strokes.append(("bone" if name in solids else "rod", line))
    return ca.horzcat(*(ca.densify(point)[: made.dimension] for point in columns)), tuple(strokes)


def _solids(made: _Drawing) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Of every body whose shape is known the centre of the box about it and half its sides (3 each, m)."""
    boxes, solids = dict[str, tuple[np.ndarray, np.ndarray]](), made.tables("drawn").get("solids")
    for name, entry in solids.items() if isinstance(solids, Mapping) else ():
        try:
            corners, faces = undescribed(entry)
            sound = name in made.bodies and made.dimension == 3 and faces.max(initial=0) < len(corners)
        except (TypeError, ValueError):
            sound = False
        if not sound:
            raise InputError(f"drawn.solids.{name}: is no solid of a body in space; take it out")
        six = [finite_number(f"drawn.solids.{name}", number) for number in entry[:6]]
        boxes[name] = np.array(six[:3]), np.array(six[3:])
    return boxes


def _solid_end(centre: np.ndarray, half: np.ndarray, at: ca.SX) -> ca.SX:
    """Where what is held at a point ends, seen from there through the middle of the box about it."""
    away = centre - ca.densify(at)
    return centre + away * ca.mmin(half / ca.fmax(ca.fabs(away), 1e-6 * float(half.max())))


def _rod_end(table: Table, at: ca.SX, com: ca.SX) -> ca.SX:
    """Where a body ends that is held at a single point: beyond its centre of mass as far as a uniform rod of its mass
    and moment of inertia, I = m h^2 / 3, but no farther than on this side; the disc's centre with a disc."""
    inertia, arm = np.ravel(table.get("inertia", 0.0)), com - at
    if (
        "disc" in table
        or not table.get("mass")
        or ca.SX(arm).is_zero()
        or not all(isinstance(x, float) for x in inertia.tolist())
    ):
        return com
    beyond = np.sqrt(3.0 * float(np.max(inertia[:3])) / float(table["mass"]))
    return com + arm * ca.fmin(1.0, beyond / ca.norm_2(arm))


def _among(at: ca.SX, points: Sequence[ca.SX]) -> bool:
    """Whether a point is among some, as an expression."""
    return any(ca.is_equal(ca.densify(at), ca.densify(point), 9) for point in points)


def _articulated(made: _Drawing, pushed: ca.SX, gravity: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Accelerations (n) and what each coordinate has to move (n, kg m^2 or kg), by Featherstone's recursion.

    `pushed` (n) are the generalized forces but for gravity, which is the ground's acceleration the other way.
    """
    nodes, speeds = made.nodes, _speeds(made)
    inertia = [node.inertia for node in nodes]
    bias = [
        ca.mtimes(_crossed(speed).T, ca.mtimes(-node.inertia, speed)) for node, speed in zip(nodes, speeds, strict=True)
    ]
    moved = [ca.mtimes(_crossed(speed), node.way() * node.v) for node, speed in zip(nodes, speeds, strict=True)]
    kept = [(ca.SX(6, 1), ca.SX(0), ca.SX(0))] * len(nodes)
    for k in reversed(range(len(nodes))):
        node, way = nodes[k], nodes[k].way()
        if node.a is not None:
            passed, rest = inertia[k], bias[k] + ca.mtimes(inertia[k], moved[k] + way * node.a)
        else:
            column = ca.mtimes(inertia[k], way)
            weight, push = ca.dot(way, column) + node.rotor, pushed[node.index] - ca.dot(way, bias[k])
            kept[k] = (column, weight, push)
            passed = inertia[k] - ca.mtimes(column, column.T) / weight
            rest = bias[k] + ca.mtimes(passed, moved[k]) + column * (push / weight)
        if node.parent >= 0:
            across = _transform(node)
            inertia[node.parent] = inertia[node.parent] + ca.mtimes([across.T, passed, across])
            bias[node.parent] = bias[node.parent] + ca.mtimes(across.T, rest)
    start, speeding = ca.vertcat(ca.SX(3, 1), -gravity), list[ca.SX]()
    accelerations, weights = [ca.SX(0)] * pushed.numel(), [ca.SX(0)] * pushed.numel()
    for k, node in enumerate(nodes):
        before = ca.mtimes(_transform(node), speeding[node.parent] if node.parent >= 0 else start) + moved[k]
        column, weight, push = kept[k]
        own = node.a if node.a is not None else (push - ca.dot(column, before)) / weight
        speeding.append(before + node.way() * own)
        if node.a is None:
            accelerations[node.index], weights[node.index] = own, weight
    return ca.densify(ca.vertcat(*accelerations)), ca.vertcat(*weights)


def _crossed(speed: ca.SX) -> ca.SX:
    """The matrix of v x in motion space (6 x 6); that of forces is minus its transpose."""
    turning, sliding = _skew(speed[:3]), _skew(speed[3:])
    return ca.blockcat([[turning, ca.SX(3, 3)], [sliding, turning]])


def _tree(made: _Drawing, motion: _Energies) -> Model:
    """The Model of a mechanism without loops: accelerations by recursion."""
    symbols, arguments = motion.symbols, motion.symbols.arguments
    t, q, v, p = arguments
    pushed = -ca.gradient(motion.elastic, q)
    if all(node.index >= 0 or node.a is not None for node in made.nodes):
        accelerations, weights = _articulated(
            made, pushed if motion.acting is None else pushed + motion.acting, motion.gravity
        )
        acceleration = ca.Function("acceleration", arguments, [accelerations])
    else:  # what mimics a joint moves with it, wherever in the tree it is
        matrix, bias = mass_matrix_and_bias(motion.kinetic, motion.potential, q, v, motion.acting, t)
        acceleration, weights = acceleration_function(matrix, bias, arguments), ca.diag(matrix)
    pose = made.tables("pose")
    place = np.array([pose.get(name, 0.0) for name in motion.names])
    _check_weights(made, motion, place, ca.Function("weights", [t, q, p], [weights]))
    terms = _terms(motion, arguments)
    labels = coordinate_names(motion.names, symbols)
    return mechanical_model(
        acceleration, terms, symbols, labels,
        invariants=[] if symbols.time is not None else
        detected_invariants(terms, labels, arguments, cyclic(terms, arguments)),
        system=made.system, **_parts(made, motion),
    )  # fmt: skip


def _parts(made: _Drawing, motion: _Energies) -> Entries:
    """What a Model has of a drawing beside its equations, with or without loops."""
    _, q, _, p = motion.symbols.arguments
    limits = {name: motor["limit"] for name, motor in made.tables("motors").items() if "limit" in motor}
    return {
        "angles": tuple(motion.angles), **pictured(motion.points, [q, p]), "strokes": motion.strokes,
        "controls": motion.controls, "limits": limits,
    }  # fmt: skip


def cyclic(terms: Terms, arguments: list[ca.SX]) -> list[bool]:
    """Which coordinates the Lagrangian does not depend on, at seeded states and parameters.

    Not by what stands in it: of a body of revolution cos^2 + sin^2 of the spin remains.
    """
    t, q, v, p = arguments
    lagrangian = terms.kinetic - terms.potential + (0 if terms.gyroscopic is None else terms.gyroscopic)
    slopes = ca.Function("slopes", [t, q, v, p], [ca.gradient(lagrangian, q), lagrangian])
    random, steepest, size = np.random.default_rng(0), np.zeros(q.numel()), 0.0
    for _ in range(4):
        slope, value = slopes(0, *(random.uniform(0.5, 1.5, symbols.numel()) for symbols in (q, v, p)))
        steepest, size = np.maximum(steepest, np.abs(slope.full().ravel())), max(size, abs(float(value)))
    return [bool(steep <= 1e-13 * size) for steep in steepest]  # round-off


def _terms(motion: _Energies, arguments: list[ca.SX]) -> Terms:
    """The Lagrangian's terms; a mass matrix that moves with time stays at t = 0, forces make up for the rest."""
    t, q, v, _ = arguments
    if not motion.prescribed or not ca.depends_on(ca.hessian(motion.kinetic, v)[0], t):
        terms = take_apart(motion.kinetic, motion.potential, motion.passive, arguments)
        return replace(terms, actuation=motion.drive)
    if motion.drive is not None:
        raise InputError(
            f"motors.{motion.controls[0]}: a control beside a prescribed motion that changes the inertia is not "
            "supported; give the motor a torque or an amplitude, or move the joint by another motor"
        )
    mass, bias = mass_matrix_and_bias(motion.kinetic, motion.potential, q, v, motion.passive, t)
    there = ca.substitute(mass, t, ca.SX(0))
    steady = Terms(0.5 * ca.dot(v, there @ v), ca.substitute(motion.potential, t, ca.SX(0)))
    rest = mass_matrix_and_bias(steady.kinetic, steady.potential, q, v)[1]
    return replace(steady, forces=rest - there @ solve_positive_definite(mass, bias))


def _check_weights(made: _Drawing, motion: _Energies, place: np.ndarray, weights: ca.Function) -> None:
    """`InputError` naming joint and body where a coordinate moves no mass at the pose."""
    moved = weights(0.0, place, np.array(motion.symbols.parameter_values)).full().ravel()
    masses = [float(made.numbers.value(part.mass)) for part in made.masses]
    total = sum(masses)
    for name, angle, weight in zip(motion.names, motion.angles, moved, strict=True):
        if weight > 1e-12 * total * (made.size**2 if angle else 1.0):  # else it moves nothing
            continue
        joint = made.owner[name]
        body = made.tables("joints")[joint]["between"][1]
        why = (
            "two of its axes are one in this pose; give another pose, or other axes"
            if made.kinds[joint].free.count("R") > 1 and joint not in made.levels
            else f"body {body!r} turns about its own centre of mass without inertia; give it an inertia, or move com"
        )
        raise InputError(f"joints.{joint}: coordinate {name} moves no mass: {why}")


def _closed(made: _Drawing, motion: _Energies, baumgarte: Sequence[float] | None) -> Model:
    """The Model of a mechanism with loops, a native DAE."""
    symbols = motion.symbols
    t, q, v, p = symbols.arguments
    names = [f"{closing.name}_{letter}" for closing in made.closing for letter in closing.rows]
    phi = ca.vertcat(*(_rows(made, closing) for closing in made.closing))
    place, kept = _checked(made, motion, phi, names)
    weights = _articulated(made, ca.SX.zeros(q.numel()), motion.gravity)[1]
    _check_weights(made, motion, place, ca.Function("weights", [t, q, p], [weights]))
    phi, names = phi[kept], [names[k] for k in kept]
    matrix, bias = mass_matrix_and_bias(motion.kinetic, motion.potential, q, v, motion.acting)
    if baumgarte is None:
        free, values = ca.Function("free", symbols.arguments, [matrix, bias]), np.array(symbols.parameter_values)
        sizes, fastest = np.where(motion.angles, 1.0, made.size), 0.0  # how fast it goes, in 1/s
        for away in (0.0, 0.3, -0.3):
            mass, rest = (part.full() for part in free(0.0, place + away * sizes, 0 * place, values))
            pushed = np.linalg.lstsq(mass, -rest.ravel(), rcond=None)[0]
            fastest = max(fastest, float(np.abs(pushed / sizes).max()))
        baumgarte = [float(2.0 ** np.round(np.log2(np.sqrt(fastest)))) if fastest > 0 else 1.0] * 2
    stabilisation = Baumgarte(*(finite_number("baumgarte", number) for number in baumgarte))
    terms = Terms(motion.kinetic, motion.potential, forces=motion.passive, actuation=motion.drive)
    labels = coordinate_names(motion.names, symbols)
    invariants = [] if motion.passive is not None else [energy_invariant(terms.kinetic, terms.potential, q, v, p)]
    if made.levels:  # turning all that hangs on a ball joint changes nothing, or its spin
        held = ca.gradient(ca.dot(np.sqrt(2.0 + np.arange(len(names))), phi), q)  # forces of the loops, in any shares
        acting = replace(terms, forces=held if motion.passive is None else held + motion.passive)
        turned, values = {node.name for node in made.nodes if node.unit}, np.array(symbols.parameter_values)
        about = place + [k * (name in turned) for k, name in enumerate(motion.names)]
        invariants += [  # but for that of slides alone about where they are 0, which a body there does not have
            each for each in detected_invariants(acting, labels, symbols.arguments, None, motion.angles)
            if each.generator and np.any(each.generator(about, 0 * place, values).full())
        ]  # fmt: skip
    return constrained_model(
        LinearBalances.held(matrix, bias, phi, q, v), phi, terms, symbols, stabilisation, labels,
        force_names=names, invariants=None if symbols.time is not None else invariants, **_parts(made, motion),
        system={**made.system, "baumgarte": [stabilisation.alpha, stabilisation.beta]},
    )  # fmt: skip


def _checked(made: _Drawing, motion: _Energies, phi: ca.SX, names: Sequence[str]) -> tuple[np.ndarray, list[int]]:
    """An assembled configuration (n) near the pose, and the rows of phi(q, p) that are independent there."""
    n, q, p, given = len(motion.names), motion.symbols.coordinates, motion.symbols.arguments[3], made.tables("pose")
    if len(names) >= n and made.system.get("redundant") != "drop":  # Kutzbach's count
        last = made.closing[-1]
        raise InputError(
            f"joints: over-constrained, {n} coordinates of the tree and {plural(len(names), 'equation')} of "
            f"{', '.join(repr(closing.name) for closing in made.closing)} leave {n - len(names)} degrees of freedom "
            f"(Kutzbach); take away joint {last.name!r} between {' and '.join(map(repr, last.table['between']))}, "
            "or with redundant = 'drop' equations that repeat others"
        )
    for name in given:
        if name not in motion.names:
            known = ", ".join(motion.names)
            raise InputError(f"pose: unknown coordinate {name!r}{closest(name, motion.names)}; use {known}")
    function, values = ca.Function("phi", [q, p], [phi, ca.jacobian(phi, q)]), np.array(motion.symbols.parameter_values)
    closure = LoopClosure(function, values, np.where(motion.angles, 1.0, made.size), names, made.tables("joints"))
    place = closure.near(np.array([given.get(name, 0.0) for name in motion.names]))
    return place, independent_rows_at(closure, place, motion.names, made.system.get("redundant") == "drop")


def body_point(model: Model, body: str, at: Sequence[float]) -> Callable[[Sequence[Any], Sequence[Any]], ca.SX]:
    """point(x, p): where a point (m, in its own axes) of a body of a mechanism without loops is (2 or 3, m), for the
    contacts of `of.impact`, the guards of `of.Transition` and the like. x are the states and p the parameters in order.
    """
    system, names = model.system, model.coordinates
    if "bodies" not in system or model.constraint is not None or "independent" in system or model.forced:
        raise InputError("body_point: needs a mechanism without loops and prescribed motions")
    numbers = _Numbers(system.get("parameters", {}), system.get("values", {}))
    made, q = _drawn(system, numbers), ca.SX.sym("q", len(names))
    if body not in made.bodies:
        raise InputError(f"body: unknown {body!r}{closest(body, made.bodies)}; bodies are {', '.join(made.bodies)}")
    for node in made.nodes:
        node.q = q[names.index(node.name)]
    place = np.zeros(3)
    place[: len(at)] = at
    there = ca.densify(made.point(body, ca.SX(place)))[: made.dimension]
    function = ca.Function("point", [q, numbers.vector], [there])
    return lambda x, p: function(ca.vertcat(*x[: len(names)]), ca.vertcat(*p[: len(numbers.names)]))
