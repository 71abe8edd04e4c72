"""Robots as others describe them: URDF and MJCF files read into a mechanism (see `mechanism`).

Every body's axes are turned as the ground's in the robot's zero position, so that no joint is turned, and the file's z,
which points up, becomes x, down: (x, y, z) of a file is (-z, y, x) here. Links that are fixed to each other, and joints
that are locked, are one body. Files are read by the libraries that define them: `urdf_parser_py` and `mujoco`, the
extra [robot].
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.quiet import captured
from orbitfinder.errors import InputError, closest, plural
from orbitfinder.mechanics.mechanism import GROUND, mechanism
from orbitfinder.mechanics.model import Model
from orbitfinder.records.reading import file_bytes

DOWN = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""From a file's axes (z up) to ours (x down)"""
STRAIGHT = 1e-9
"""What entries of a turn are 0 or 1 to, where angles of a file are rounded"""
KINDS = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "fixed"}
DIGITS = 15
BASE, WORLD = "base_joint", "world_of_base"
"""The free joint of a floating base, and what it hangs on"""


@dataclass
class _Body:
    """A link: mass, centre of mass (3), inertia about it (3 x 3), axes (3 x 3) and origin (3) in the ground's at 0."""

    mass: float = 0.0
    com: np.ndarray = field(default_factory=lambda: np.zeros(3))
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))
    place: np.ndarray = field(default_factory=lambda: np.zeros(3))


@dataclass
class _Joint:
    """A joint: kind, bodies, its place (3) and turn (3 x 3) in the parent, axis (3) in its own, what acts in it."""

    kind: str
    parent: str
    child: str
    place: np.ndarray
    turn: np.ndarray
    axis: np.ndarray
    damping: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    rotor: float = 0.0
    limit: float = 0.0


@dataclass
class _Read:
    """What a file says of a robot."""

    name: str
    bodies: dict[str, _Body]
    joints: dict[str, _Joint]
    root: str


def robot(
    file: str | Path,
    *,
    locked: Mapping[str, float] | Sequence[str] = (),
    stiffness: Mapping[str, float] | float | None = None,
    rest: Mapping[str, float] | None = None,
    damping: Mapping[str, float] | float | None = None,
    motors: Sequence[str] | str = (),
    floating: bool = False,
    gravity: float = 9.80665,
    values: Mapping[str, float] | None = None,
) -> Model:
    """The Model of a robot in a URDF or MJCF file.

    Coulomb friction, contacts and limits of joints are left out. Numbers are physical parameters named after links
    and joints ("link3_mass"), in the axes of the zero position, x down.

    Args:
        file: .urdf or .xml.
        locked: joints that stay at 0, or at the angles given.
        stiffness: of all joints or of each by name (N m/rad or N/m); replaces the file's.
        rest: where springs are at ease, by joint; 0 otherwise.
        damping: of all joints or of each by name; replaces the file's.
        motors: joints with a control torque of their own, within the file's effort; "all" for all.
        floating: whether the base moves freely instead of being fixed to the ground.
        gravity: m/s^2, along the file's -z.
        values: numbers that replace parameters.

    Returns:
        A Model.

    Raises:
        InputError: naming link and joint, and where the extra `[robot]` is not installed.

    Examples:
        >>> from pathlib import Path
        >>> _ = Path("arm.urdf").write_text('''<robot name="arm"><link name="base"/><link name="arm"><inertial>
        ... <origin xyz="0 0 -0.5"/><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>
        ... </inertial></link><joint name="hinge" type="continuous"><parent link="base"/><child link="arm"/>
        ... <axis xyz="0 1 0"/></joint></robot>''')
        >>> of.robot("arm.urdf").state_names
        ('hinge', 'hingedot')

    See Also:
        `of.mechanism`, which it makes.
    """
    path = Path(file)
    made = _numbers(path, _file(path))
    return mechanism(**tables(path, made, locked=locked, stiffness=stiffness, rest=rest, damping=damping,
                              motors=motors, floating=floating, gravity=gravity), values=values)  # fmt: skip


def _file(path: Path) -> bytes:
    try:
        return file_bytes(path, "URDF or MJCF file")
    except InputError as error:
        raise InputError(f"file: {error}") from error


def _numbers(path: Path, data: bytes) -> _Read:
    """A file's bodies and joints; `InputError` for what is no robot."""
    text = data[:4096].lower()
    if b"<robot" in text:
        return _checked(_urdf(path, data))
    if b"<mujoco" in text:
        return _checked(_mjcf(path, data))
    raise InputError(f"file: {path.name} is no robot; give a URDF (<robot ...>) or an MJCF file (<mujoco ...>)")


def _checked(made: _Read) -> _Read:
    """What was read; `InputError` for numbers that are none, and for names that are one once they are identifiers."""
    for kind, names in (("link", made.bodies), ("joint", made.joints)):
        whose = dict[str, str]()
        for name in names:
            if (other := whose.setdefault(_word(name), name)) != name:
                raise InputError(
                    f"file: {kind}s {other!r} and {name!r} are both {_word(name)!r} where names are letters, digits "
                    "and _; rename one"
                )
    for name, body in made.bodies.items():
        if not np.all(np.isfinite([body.mass, *body.com, *body.inertia.ravel()])):
            raise InputError(f"file: link {name!r} has a mass, place or inertia that is no finite number; correct it")
        if body.mass < 0:
            raise InputError(f"file: link {name!r} has the mass {body.mass:g} kg; give one that is not negative")
    for name, joint in made.joints.items():
        if not np.all(np.isfinite([*joint.place, *joint.turn.ravel(), *joint.axis, joint.damping, joint.limit])):
            raise InputError(
                f"file: joint {name!r} has an origin, axis, damping or effort that is no finite number; correct it"
            )
    return made


def _urdf(path: Path, data: bytes) -> _Read:
    try:
        from urdf_parser_py.urdf import URDF  # noqa: PLC0415
    except ImportError as error:
        raise InputError("file: URDF files need the extra: pip install 'orbitfinder[robot]'") from error
    try:
        with captured():
            found = URDF.from_xml_string(data)
            root = found.get_root()
    except Exception as error:
        said = " ".join(str(error).split())
        raise InputError(f"file: {path.name} is no URDF that can be read ({type(error).__name__}: {said})") from error
    bodies = {}
    for link in found.links:
        body = bodies[link.name] = _Body()
        if (weight := link.inertial) is not None:
            turn, place = _placed(weight.origin)
            one = weight.inertia
            matrix = np.array([[one.ixx, one.ixy, one.ixz], [one.ixy, one.iyy, one.iyz], [one.ixz, one.iyz, one.izz]])
            body.mass, body.com, body.inertia = float(weight.mass), place, turn @ matrix @ turn.T
    joints = {}
    for joint in found.joints:
        if joint.type not in KINDS:
            raise InputError(f"file: joint {joint.name!r} is {joint.type}; known are {', '.join(KINDS)}")
        if joint.mimic is not None:
            raise InputError(f"file: joint {joint.name!r} mimics {joint.mimic.joint!r}, which is not known; lock it")
        turn, place = _placed(joint.origin)
        axis = np.array(joint.axis if joint.axis is not None else [1.0, 0.0, 0.0], float)
        worn, limit = joint.dynamics, joint.limit
        joints[joint.name] = _Joint(
            KINDS[joint.type], joint.parent, joint.child, place, turn, axis,
            damping=float(worn.damping or 0.0) if worn is not None else 0.0,
            limit=float(limit.effort or 0.0) if limit is not None else 0.0,
        )  # fmt: skip
    return _Read(str(found.name), bodies, joints, str(root))


def _placed(origin: Any) -> tuple[np.ndarray, np.ndarray]:
    """Turn (3 x 3) and place (3) of an <origin>: fixed-axis roll, pitch and yaw."""
    if origin is None:
        return np.eye(3), np.zeros(3)
    roll, pitch, yaw = origin.rpy if origin.rpy is not None else (0.0, 0.0, 0.0)
    place = np.array(origin.xyz if origin.xyz is not None else (0.0, 0.0, 0.0), float)
    return _straight(_about(2, yaw) @ _about(1, pitch) @ _about(0, roll)), place


def _about(axis: int, angle: float) -> np.ndarray:
    found, (i, j) = np.eye(3), [k for k in range(3) if k != axis]
    cosine, sine = np.cos(angle), np.sin(angle) * (-1.0 if axis == 1 else 1.0)
    found[[i, j], [i, j]], found[i, j], found[j, i] = cosine, -sine, sine
    return found


def _straight(turn: np.ndarray) -> np.ndarray:
    """A turn whose entries that are 0 or 1 but for a file's rounding are so."""
    near = np.round(turn)
    return np.where(np.abs(turn - near) < STRAIGHT, near, turn) if np.abs(turn - near).max() < STRAIGHT else turn


def _mjcf(path: Path, data: bytes) -> _Read:
    """Bodies and joints of a MuJoCo model, as MuJoCo itself compiles them."""
    try:
        import mujoco  # noqa: PLC0415
    except ImportError as error:
        raise InputError("file: MJCF files need the extra: pip install 'orbitfinder[robot]'") from error
    try:
        with captured():
            one = (
                mujoco.MjModel.from_xml_path(str(path))
                if path.is_file()
                else mujoco.MjModel.from_xml_string(data.decode())
            )
    except Exception as error:
        said = " ".join(str(error).split())
        raise InputError(f"file: {path.name} is no MJCF that can be read ({said})") from error
    names = [_word(one.body(k).name or f"body{k}") for k in range(one.nbody)]
    bodies, joints = {names[0]: _Body()}, dict[str, _Joint]()
    kinds = {int(mujoco.mjtJoint.mjJNT_HINGE): "revolute", int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic",
             int(mujoco.mjtJoint.mjJNT_FREE): "free"}  # fmt: skip
    for k in range(1, one.nbody):
        turn = _quaternion(one.body_iquat[k])
        bodies[names[k]] = _Body(
            float(one.body_mass[k]), np.array(one.body_ipos[k]), turn @ np.diag(one.body_inertia[k]) @ turn.T
        )
        count, first = int(one.body_jntnum[k]), int(one.body_jntadr[k])
        place, turned = np.array(one.body_pos[k]), _quaternion(one.body_quat[k])
        parent = names[int(one.body_parentid[k])]
        if count > 1:
            raise InputError(f"file: body {names[k]!r} has {count} joints; give each a body of its own")
        if not count:
            joints[f"{names[k]}_weld"] = _Joint("fixed", parent, names[k], place, turned, np.eye(3)[0])
            continue
        if (kind := kinds.get(int(one.jnt_type[first]))) is None:
            raise InputError(f"file: the joint of body {names[k]!r} is a ball, which is not known; use three hinges")
        dof, pivot = int(one.jnt_dofadr[first]), np.array(one.jnt_pos[first])
        if np.abs(pivot).max() > 0:
            raise InputError(f"file: the joint of body {names[k]!r} is off its origin; move the body's frame to it")
        joints[_word(one.joint(first).name or f"joint{first}")] = _Joint(
            kind, parent, names[k], place, turned, np.array(one.jnt_axis[first]),
            damping=float(one.dof_damping[dof]), stiffness=float(one.jnt_stiffness[first]),
            rest=float(one.qpos_spring[one.jnt_qposadr[first]]), rotor=float(one.dof_armature[dof]),
        )  # fmt: skip
    return _Read(path.stem, bodies, joints, names[0])


def _quaternion(numbers: Sequence[float]) -> np.ndarray:
    """The turn (3 x 3) of a unit quaternion (w, x, y, z)."""
    w, x, y, z = np.asarray(numbers, float) / np.linalg.norm(numbers)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return _straight(np.eye(3) + 2 * w * cross + 2 * cross @ cross)


def tables(
    path: Path,
    made: _Read,
    *,
    locked: Mapping[str, float] | Sequence[str] = (),
    stiffness: Mapping[str, float] | float | None = None,
    rest: Mapping[str, float] | None = None,
    damping: Mapping[str, float] | float | None = None,
    motors: Sequence[str] | str = (),
    floating: bool = False,
    gravity: float = 9.80665,
) -> dict[str, Any]:
    """The tables of the mechanism that a robot is, with `drawn`: the file's name and SHA-256."""
    if floating:
        made = _afloat(made)
    free = [name for name, one in made.joints.items() if one.kind != "fixed"]
    still = dict(locked) if isinstance(locked, Mapping) else dict.fromkeys(locked, 0.0)
    _check_names("locked", still, free)
    moving = [name for name in free if name not in still]
    if not moving:
        raise InputError("locked: no joint is left to move; unlock one")
    bodies, whose = _lumped(made, still)
    found: dict[str, Any] = {"dimension": 3, "gravity": [float(gravity), 0.0, 0.0], "bodies": {}, "joints": {}}
    held = whose[made.root]
    for name in moving:
        one = made.joints[name]
        parent, (turn, place) = whose[one.parent], _frame(made, name)
        before = bodies[parent].place if parent != held else np.zeros(3)
        table: dict[str, Any] = {
            "kind": one.kind, "between": [GROUND if parent == held else _word(parent), _word(whose[one.child])],
            "at": [_listed(DOWN @ (place - before)), [0.0, 0.0, 0.0]],
        }  # fmt: skip
        if one.kind != "free":
            table["axis"] = _listed(DOWN @ turn @ one.axis)
        if one.rotor:
            table["rotor"] = one.rotor
        found["joints"][_word(name)] = table
    for name, body in bodies.items():
        if name == held:
            continue
        if not body.mass > 0:
            joint = next(j for j, one in made.joints.items() if whose[one.child] == name)
            raise InputError(
                f"file: link {name!r} moves with joint {joint!r} and has no mass; give it one, or lock the joint"
            )
        inertia = DOWN @ body.inertia @ DOWN.T
        six = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        found["bodies"][_word(name)] = {
            "mass": body.mass, "com": _listed(DOWN @ (body.com - body.place)), "inertia": _listed(six)
        }  # fmt: skip
    _acting(found, made, moving, stiffness, rest or {}, damping, motors)
    found["drawn"] = {"file": path.name, "sha256": hashlib.sha256(_file(path)).hexdigest()}
    return found


def _afloat(made: _Read) -> _Read:
    """The same with its base on a free joint."""
    if BASE in made.joints or WORLD in made.bodies:
        raise InputError(f"floating: the file has a joint {BASE!r} or a link {WORLD!r} already; rename it")
    joint = _Joint("free", WORLD, made.root, np.zeros(3), np.eye(3), np.eye(3)[0])
    return _Read(made.name, {WORLD: _Body(), **made.bodies}, {BASE: joint, **made.joints}, WORLD)


def _acting(
    found: dict[str, Any], made: _Read, moving: list[str], stiffness: Any, rest: Mapping[str, float], damping: Any,
    motors: Sequence[str] | str,
) -> None:  # fmt: skip
    """Springs, dampers and motors of the moving joints."""
    moving = [name for name in moving if made.joints[name].kind != "free"]
    _check_names("rest", rest, moving)
    for key, given, entry in (("springs", stiffness, "stiffness"), ("dampers", damping, "damping")):
        own = {name: getattr(made.joints[name], entry) for name in moving}
        if isinstance(given, Mapping):
            _check_names(entry, given, moving)
            own |= given
        elif given is not None:
            own = dict.fromkeys(moving, float(given))
        table = {}
        for name, value in own.items():
            if value < 0:
                raise InputError(f"{entry}: of joint {name!r} must not be negative, got {value:g}")
            if value:
                table[f"{_word(name)}_{key[:-1]}"] = {"joint": _word(name), entry: float(value)}
                if key == "springs" and (ease := rest.get(name, made.joints[name].rest)):
                    table[f"{_word(name)}_spring"]["rest"] = float(ease)
        if table:
            found[key] = table
    chosen = moving if motors == "all" else [motors] if isinstance(motors, str) else list(motors)
    _check_names("motors", chosen, moving)
    if chosen:
        limits = {name: {"limit": one} if (one := made.joints[name].limit) else {} for name in chosen}
        found["motors"] = {f"{_word(name)}_torque": {"joint": _word(name)} | limits[name] for name in chosen}


def _check_names(field: str, given: Iterable[str], known: Sequence[str]) -> None:
    for name in given:
        if name not in known:
            raise InputError(f"{field}: no moving joint {name!r}{closest(name, known)}; they are {', '.join(known)}")


def _word(name: str) -> str:
    """A name of a file as an identifier."""
    found = "".join(one if one.isalnum() else "_" for one in name)
    return found if found[:1].isalpha() or found[:1] == "_" else f"_{found}"


def _listed(numbers: Iterable[float]) -> list[float]:
    """Numbers without what the turning of axes leaves of round-off."""
    values = np.array(list(numbers), float)
    values[np.abs(values) < 1e-15 * max(float(np.abs(values).max(initial=0.0)), 1e-300)] = 0.0
    return [float(f"{one:.{DIGITS}g}") for one in values]


def _frame(made: _Read, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Axes (3 x 3) and place (3) of a joint in the ground's, at the zero position."""
    one = made.joints[name]
    parent = made.bodies[one.parent]
    return parent.turn @ one.turn, parent.place + parent.turn @ one.place


def _lumped(made: _Read, still: Mapping[str, float]) -> tuple[dict[str, _Body], dict[str, str]]:
    """Bodies that move, in the ground's axes at 0, and of which of them each link is a part."""
    whose, order = {made.root: made.root}, [made.root]
    for parent in order:
        for name, one in made.joints.items():
            if one.parent != parent:
                continue
            if one.child in whose:
                raise InputError(f"file: link {one.child!r} hangs on two joints, {name!r} the second; a URDF is a tree")
            turn, place = _frame(made, name)
            fixed = one.kind == "fixed" or name in still
            if name in still and one.kind == "revolute":
                turn = turn @ _axis_turn(one.axis, still[name])
            elif name in still:
                place = place + turn @ one.axis / np.linalg.norm(one.axis) * still[name]
            body = made.bodies.get(one.child)
            if body is None:
                raise InputError(f"file: joint {name!r} leads to link {one.child!r}, which is not there")
            body.turn, body.place = _straight(turn), place
            whose[one.child] = whose[parent] if fixed else one.child
            order.append(one.child)
    lost = [name for name in made.bodies if name not in whose]
    if lost:
        raise InputError(f"file: {plural(len(lost), 'link')} hang on nothing, {', '.join(lost[:3])}; join them")
    return {head: _together(made, [n for n, one in whose.items() if one == head], head) for head in
            dict.fromkeys(whose.values())}, whose  # fmt: skip


def _axis_turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """The turn (3 x 3) about an axis."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def _together(made: _Read, names: Sequence[str], head: str) -> _Body:
    """Links that move as one: mass, centre of mass and inertia about it in the ground's axes at 0 (Steiner)."""
    parts = [made.bodies[name] for name in names]
    mass = sum(one.mass for one in parts)
    centres = [one.place + one.turn @ one.com for one in parts]
    centre = sum((one.mass * at for one, at in zip(parts, centres, strict=True)), np.zeros(3)) / (mass or 1.0)
    inertia = np.zeros((3, 3))
    for one, at in zip(parts, centres, strict=True):
        away = at - centre
        inertia += one.turn @ one.inertia @ one.turn.T + one.mass * (away @ away * np.eye(3) - np.outer(away, away))
    return _Body(mass, centre, inertia, np.eye(3), made.bodies[head].place)
