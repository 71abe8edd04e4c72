"""Robots as others describe them: URDF and MJCF files read into a mechanism (see `mechanism`).

Every body's axes are turned as the ground's in the robot's zero position, so that no joint is turned, and the file's z,
which points up, becomes x, down: (x, y, z) of a file is (-z, y, x) here. Links that are fixed to each other, and joints
that are locked, are a single body. Files are read by the libraries that define them: `urdf_parser_py` and `mujoco`, the
extra [robot].
"""

from __future__ import annotations

import codecs
import hashlib
import html
import os
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.parsers import expat

import numpy as np
from scipy.spatial.transform import Rotation

from orbitfinder._runtime.processes import alone
from orbitfinder._runtime.quiet import captured
from orbitfinder.errors import Hint, InputError, LimitError, closest, plural
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanisms import shapes
from orbitfinder.mechanisms.mechanism import GROUND, JOINTS, JointKind, mechanism
from orbitfinder.records.reading import Entries, file_bytes

DOWN = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""From a file's axes (z up) to ours (x down)"""
KINDS = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "fixed"}
LARGEST, MOST_BODIES, IGNORED = 4_000_000, 1000, ("friction", "fluid", "tendons", "equalities", "contact", "limits")
"""Bytes of a file, and bodies in it; what of it may be left out"""
SECONDS, MEMORY = 30.0, 4_000_000_000
"""What MuJoCo gets to read a file: s, bytes"""
MJCF, MUJOCO = {"damping": "damping", "rotor": "armature", "friction": "frictionloss"}, {
    "mjJNT_HINGE": "revolute", "mjJNT_SLIDE": "prismatic", "mjJNT_FREE": "free", "mjJNT_BALL": "spherical",
    "mjEQ_CONNECT": "connect", "mjEQ_WELD": "weld",
}  # fmt: skip
BASE, WORLD = "base_joint", "world_of_base"
"""The free joint of a floating base, and what it hangs on"""


@dataclass
class _RigidBody:
    """A link: mass, centre of mass (3), inertia about it (3 x 3), axes (3 x 3) and origin (3) in the ground's at 0."""

    mass: float = 0.0
    com: np.ndarray = field(default_factory=lambda: np.zeros(3))
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))
    place: np.ndarray = field(default_factory=lambda: np.zeros(3))
    solids: list[shapes.Solid] = field(default_factory=list)
    """how it looks"""


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
    friction: float = 0.0
    range: tuple[float, float] | None = None
    mimics: tuple[str, float, float] | None = None
    """(joint, ratio, offset): where it is another joint's coordinate times a ratio, plus an offset"""

    @property
    def free(self) -> str:
        """What it leaves free, in its order: slides P and turns R."""
        return self.sort.free

    @property
    def sort(self) -> JointKind:
        """What its kind is."""
        return JOINTS[3][self.kind]


@dataclass
class _Read:
    """What a file says of a robot."""

    name: str
    bodies: dict[str, _RigidBody]
    joints: dict[str, _Joint]
    root: str
    gravity: Sequence[float] = (0.0, 0.0, -9.80665)
    """m/s^2, in the file's axes"""


def robot(
    file: str | Path,
    *,
    locked: Mapping[str, float] | Sequence[str] = (),
    stiffness: Mapping[str, float] | float | None = None,
    rest: Mapping[str, float] | None = None,
    damping: Mapping[str, float] | float | None = None,
    motors: Sequence[str] | str = (),
    floating: bool = False,
    quaternions: bool = False,
    pose: Mapping[str, float] | None = None,
    gravity: Sequence[float] | float | None = None,
    ignore: Sequence[str] = (),
    values: Mapping[str, float] | None = None,
) -> Model:
    """The Model of a robot in a URDF or MJCF file; needs the extra [robot].

    Contacts, actuators and sensors are left out; what else acts and is not known is refused by name, unless it is to be
    ignored. A coordinate is 0 as the file draws the robot. Stops of joints do not act, and a found orbit that passes
    one is hinted at. Joints that mimic another follow it; what MJCF connects or welds closes a loop, rigidly. Numbers
    are physical parameters named after links and joints ("link3_mass"), in the axes of the zero position, x down. Links
    are drawn by what the file says of their looks: boxes, cylinders, balls, meshes (STL, OBJ, Collada); a mesh that is
    not there is hinted at.

    Args:
        file: the URDF or MJCF file, in a problem file beside it unless the path says otherwise.
        locked: joints that stay at 0, or at the angles given.
        stiffness: springs in all joints, or in each by name (N m/rad, N/m); the file's own when left out.
        rest: where springs are at ease, by joint, 0 otherwise.
        damping: dampers in all joints, or in each by name; the file's own when left out, whose Coulomb friction is
            refused.
        motors: joints with a control torque of their own, within the file's effort; "all" for all.
        floating: the base moves freely instead of being fixed to the ground.
        quaternions: ball joints and free ones turn by unit quaternions, not by three angles.
        pose: coordinates near which loops are assembled, 0 otherwise.
        gravity: m/s^2, along the file's -z, or [x, y, z] in the file's axes; the file's own, or 9.80665.
        ignore: what acts in the file and is to be left out: "friction" (Coulomb's), "fluid" (drag), "tendons",
            "equalities"; "contact" and "limits" never act. The record names it.
        values: physical parameters that replace the file's, such as link3_mass.

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
    try:
        data = file_bytes(path, "URDF or MJCF file", LARGEST)
    except InputError as error:
        raise InputError(f"file: {error}") from error
    read = {"robot": _urdf, "mujoco": _mjcf}.get(_root(data))
    if read is None:
        raise InputError(f"file: {path.name} is no robot; give a URDF (<robot ...>) or an MJCF file (<mujoco ...>)")
    if unknown := [name for name in ignore if name not in IGNORED]:
        raise InputError(
            f"ignore: unknown {unknown[0]!r}{closest(unknown[0], IGNORED)}; known are {', '.join(IGNORED)}"
        )
    made = _checked(read(path, data, ignore))
    if floating:  # its base on a free joint
        if BASE in made.joints or WORLD in made.bodies:
            raise InputError(f"floating: the file has a joint {BASE!r} or a link {WORLD!r} already; rename it")
        joint = _Joint("free", WORLD, made.root, np.zeros(3), np.eye(3), np.eye(3)[0])
        bodies, joints = {WORLD: _RigidBody(), **made.bodies}, {BASE: joint, **made.joints}
        made = replace(made, bodies=bodies, joints=joints, root=WORLD)
    system, moving, solids = _tables(made, locked, quaternions)
    system |= _acting(made, moving, stiffness, rest or {}, damping, motors)
    drawn: Entries = {"file": path.name, "sha256": hashlib.sha256(data).hexdigest()}
    drawn |= {"solids": shapes.described(solids)} if solids else {}
    drawn |= {"ignored": sorted(ignore)} if ignore else {}
    given = np.asarray(made.gravity if gravity is None else gravity, float)
    fall = np.array([0.0, 0.0, -float(given)]) if given.ndim == 0 else given
    if fall.shape != (3,) or not np.all(np.isfinite(fall)):
        raise InputError(f"gravity: {gravity}; give m/s^2 along the file's -z, or three numbers (x, y, z)")
    return mechanism(**system, dimension=3, gravity=_listed(DOWN @ fall), pose=pose, drawn=drawn, values=values)


def _root(data: bytes) -> str:
    """The name of an XML text's first element, in whatever encoding and after whatever comments; "" of other texts."""

    def first(name: str, _: Any) -> None:
        raise StopIteration(name)

    parser = expat.ParserCreate()
    parser.StartElementHandler = first
    try:
        parser.Parse(data, True)
    except StopIteration as stop:
        return str(stop.value)
    except (expat.ExpatError, ValueError, LookupError):
        pass
    return ""


def _put(table: Entries, kinds: str, name: str, value: Any) -> None:
    """Add a body or a joint; `InputError` where there is another of that name."""
    if name in table:
        raise InputError(f"file: two {kinds} are named {name!r}; rename one")
    table[name] = value


def _checked(made: _Read) -> _Read:
    """What was read; `InputError` for numbers that are none, and for names that are the same as identifiers."""
    if len(made.bodies) > MOST_BODIES:
        raise InputError(f"file: {len(made.bodies)} bodies, {MOST_BODIES} can be read; give a part of the robot")
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
        numbers = [*joint.place, *joint.turn.ravel(), *joint.axis, joint.damping, joint.limit, joint.friction]
        if not np.all(np.isfinite([*numbers, *(joint.range or ()), *(joint.mimics or ())[1:]])):
            raise InputError(
                f"file: joint {name!r} has an origin, axis, damping or effort that is no finite number; correct it"
            )
    return made


def _urdf(path: Path, data: bytes, ignore: Sequence[str]) -> _Read:
    try:
        from urdf_parser_py.urdf import URDF  # noqa: PLC0415
    except ImportError as error:
        raise InputError("file: URDF files need the extra: pip install 'orbitfinder[robot]'") from error
    try:
        with captured():
            try:
                robot_model = URDF.from_xml_string(data)
            except LimitError:
                raise
            except Exception:
                robot_model = URDF.from_xml_string(_plain(data))
            root = robot_model.get_root()
    except LimitError:
        raise
    except Exception as error:
        said = " ".join(str(error).split())
        said = f"{type(error).__name__}: {said}"
        raise InputError(f"file: {path.name} is no URDF that can be read ({said}); correct it there") from error
    bodies, joints, unseen = dict[str, _RigidBody](), dict[str, _Joint](), list[str]()
    for link in robot_model.links:
        _put(bodies, "links", link.name, body := _RigidBody())
        if (weight := link.inertial) is not None:
            turn, place = _placed(weight.origin)
            tensor = weight.inertia
            matrix = np.array(
                [
                    [tensor.ixx, tensor.ixy, tensor.ixz],
                    [tensor.ixy, tensor.iyy, tensor.iyz],
                    [tensor.ixz, tensor.iyz, tensor.izz],
                ]
            )
            body.mass, body.com, body.inertia = float(weight.mass), place, turn @ matrix @ turn.T
        for visual in link.visuals:
            try:
                body.solids.append(_seen(path.parent, visual))
            except (InputError, TypeError, ValueError) as error:
                unseen.append(f"of link {link.name!r} {error}")
    if unseen:
        more = f" (and {len(unseen) - 1} more)" if unseen[1:] else ""
        said = f"file: {path.name}: {unseen[0]}{more}; without its shapes a link is drawn as a line"
        warnings.warn(said, Hint, stacklevel=4)
    for joint in robot_model.joints:
        if joint.type not in KINDS:
            raise InputError(f"file: joint {joint.name!r} is {joint.type}; known are {', '.join(KINDS)}")
        turn, place = _placed(joint.origin)
        axis = np.array(joint.axis if joint.axis is not None else [1.0, 0.0, 0.0], float)
        worn, limit, rule = joint.dynamics, joint.limit, joint.mimic
        low, high = (float(getattr(limit, name, None) or 0.0) for name in ("lower", "upper"))
        ratio, offset = getattr(rule, "multiplier", None), float(getattr(rule, "offset", None) or 0.0)
        _put(joints, "joints", joint.name, _Joint(
            KINDS[joint.type], joint.parent, joint.child, place, turn, axis,
            damping=float(getattr(worn, "damping", None) or 0.0),
            friction=0.0 if "friction" in ignore else float(getattr(worn, "friction", None) or 0.0),
            limit=float(getattr(limit, "effort", None) or 0.0),
            range=(low, high) if low < high and joint.type != "continuous" else None,
            mimics=(str(rule.joint), 1.0 if ratio is None else float(ratio), offset) if rule is not None else None,
        ))  # fmt: skip
    return _Read(str(robot_model.name), bodies, joints, str(root))


def _plain(data: bytes) -> bytes:
    """A URDF without what moves nothing and the parser may not take: materials, transmissions, plugins; with a name."""
    from lxml import etree  # noqa: PLC0415

    tree = etree.fromstring(data, etree.XMLParser(resolve_entities=False, no_network=True))
    for each in [*tree.iter("material", "transmission", "gazebo", "sensor")]:
        if each.getparent() is not None:
            each.getparent().remove(each)
    tree.set("name", tree.get("name") or "robot")
    return bytes(etree.tostring(tree))


def _seen(folder: Path, visual: Any) -> shapes.Solid:
    """The solid of a <visual> in its link's axes. Raises `InputError`, `TypeError`, `ValueError`."""
    shape, (turn, place) = visual.geometry, _placed(visual.origin)
    if hasattr(shape, "filename"):
        corners, faces = shapes.read(_beside(folder, shape.filename))
        scale = np.broadcast_to(np.array([1.0] if shape.scale is None else shape.scale, float), 3)
        faces = faces if np.prod(scale) > 0 else faces[:, ::-1]  # a mirrored one is turned inside out
        corners = corners * scale
    elif hasattr(shape, "size"):
        corners, faces = shapes.box(shape.size)
    else:
        round_ = shapes.cylinder if hasattr(shape, "length") else shapes.ball
        corners, faces = round_(float(shape.radius), *([float(shape.length)] if hasattr(shape, "length") else []))
    corners = corners @ turn.T + place
    if not np.all(np.isfinite(corners)) or not np.ptp(corners, axis=0).any():
        raise InputError("a shape has sizes or a place that are no finite numbers")
    return corners, faces


def _tree(folder: Path) -> Path:
    """The robot's own folder: of its ROS package (package.xml), else that above the file's, as in urdf/ and meshes/."""
    above = [folder.resolve(), *folder.resolve().parents]
    return next((base for base in above if (base / "package.xml").is_file()), folder.resolve().parent)


def _beside(folder: Path, name: str) -> Path:
    """Where a mesh lies: beside the file, or for package://PACKAGE/PATH in a folder above it. Raises `InputError`."""
    scheme, _, rest = name.rpartition("://")
    tree, outside, package = _tree(folder), False, scheme == "package"
    for base in [folder.resolve(), *folder.resolve().parents] if package else [folder]:
        for part in (rest, rest.partition("/")[2]) if package else (rest,):
            if part and os.path.isfile(base / part):
                if (place := (base / part).resolve()).is_relative_to(tree):
                    return place
                outside = True
    where = f"lies outside the robot's folder {tree.name}" if outside else "is not there"
    raise InputError(f"the mesh {name} {where}; put it beside the file as it says")


def _check_files(path: Path) -> None:
    """`InputError` for a file outside the robot's folder that an MJCF file, or what it includes, names."""
    tree, files, names, folders = _tree(path.parent), [path.resolve()], set[str](), set[Path]()
    for file in files:
        text = html.unescape(file_bytes(file, "MJCF file", LARGEST).decode(errors="replace"))
        told = re.findall(r"""\b(file\w*|\w*dir)\s*=\s*["']([^"']*)""", text)
        names |= {value for key, value in told if not key.endswith("dir")}
        folders |= {file.parent, *(file.parent / value for key, value in told if key.endswith("dir"))}
        if len(names) * len(folders) > 10_000:
            raise InputError(f"file: {path.name} names {len(names)} files in {len(folders)} folders; give fewer")
        for place in (folder / name for folder in folders for name in names):
            if not os.path.isfile(place) or place.resolve() in files:
                continue
            if not place.resolve().is_relative_to(tree):
                raise InputError(f"file: {path.name}: {place.name} lies outside the robot's folder {tree.name}; put it "
                                 "inside")  # fmt: skip
            if place.suffix == ".xml":
                files.append(place.resolve())


def _placed(origin: Any) -> tuple[np.ndarray, np.ndarray]:
    """Turn (3 x 3) and place (3) of an <origin>: fixed-axis roll, pitch and yaw."""
    if origin is None:
        return np.eye(3), np.zeros(3)
    roll, pitch, yaw = origin.rpy if origin.rpy is not None else (0.0, 0.0, 0.0)
    place = np.array(origin.xyz if origin.xyz is not None else (0.0, 0.0, 0.0), float)
    return _straight(Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()), place


def _straight(turn: np.ndarray) -> np.ndarray:
    """A turn whose entries that are 0 or 1 but for a file's rounding are so."""
    near = np.round(turn)
    return near if np.abs(turn - near).max() < 1e-9 else turn


def compiled(file: str) -> Entries:
    """What MuJoCo makes of a file, as lists; or why it makes nothing of it, `refused`."""
    import mujoco  # noqa: PLC0415

    try:
        model = mujoco.MjModel.from_xml_path(file)
    except LimitError:
        raise
    except Exception as error:
        return {"refused": " ".join(str(error).split())}
    read = ("qpos", "body_", "jnt_", "dof_", "eq_", "site_", "tendon_")
    lists = {name: getattr(model, name).tolist() for name in dir(model) if name.startswith(read)}
    lists["solids"] = [[part.tolist() for part in solid] for solid in _bare(mujoco, model)]
    lists |= {name: np.asarray(getattr(model.opt, name)).tolist() for name in ("gravity", "density", "viscosity")}
    return lists | {
        "nflex": model.nflex,
        "bodies": [_word(model.body(k).name or f"body{k}") for k in range(model.nbody)],
        "joints": [_word(model.joint(k).name or f"joint{k}") for k in range(model.njnt)],
        "kinds": [mujoco.mjtJoint(k).name for k in model.jnt_type.tolist()],
        "equalities": [mujoco.mjtEq(k).name for k in model.eq_type.tolist()],
        "loops": [model.equality(k).name or f"equality{k}" for k in range(model.neq)],
        "sites": (model.eq_objtype == mujoco.mjtObj.mjOBJ_SITE).tolist(),
        "off": [name for name, bit in mujoco.mjtDisableBit.__members__.items() if model.opt.disableflags & int(bit)],
    }


def _bare(mujoco: Any, model: Any) -> list[shapes.Solid]:
    """How each body but the world looks in its own axes, by the geoms that MuJoCo's viewer shows (groups 0 to 2)."""
    made, kinds = [list[shapes.Solid]() for _ in range(model.nbody)], mujoco.mjtGeom
    for k in np.flatnonzero(model.geom_group < 3).tolist():
        kind, (a, b, c) = kinds(model.geom_type[k]), model.geom_size[k].tolist()
        mesh = model.geom_dataid[k]
        if kind == kinds.mjGEOM_MESH:
            corner, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
            corners = np.asarray(model.mesh_vert[corner : corner + model.mesh_vertnum[mesh]], float)
            solid = shapes.merged(corners, model.mesh_face[face : face + model.mesh_facenum[mesh]])
        elif kind == kinds.mjGEOM_BOX:
            solid = shapes.box([2 * a, 2 * b, 2 * c])
        elif kind == kinds.mjGEOM_CYLINDER:
            solid = shapes.cylinder(a, 2 * b)
        elif kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_CAPSULE):
            solid = shapes.ball(a, 2 * b * (kind == kinds.mjGEOM_CAPSULE))
        elif kind == kinds.mjGEOM_ELLIPSOID:
            corners, faces = shapes.ball(1.0)
            solid = corners * [a, b, c], faces
        else:  # floors and landscapes are no parts of a robot
            continue
        turn = Rotation.from_quat(np.roll(model.geom_quat[k], -1)).as_matrix()
        made[model.geom_bodyid[k]].append((solid[0] @ turn.T + model.geom_pos[k], solid[1]))
    empty = np.zeros((0, 3)), np.zeros((0, 3), int)
    return [empty, *(shapes.reduced(shapes.joined(parts), shapes.MOST) if parts else empty for parts in made[1:])]


def _mjcf(path: Path, data: bytes, ignore: Sequence[str]) -> _Read:
    """Bodies and joints of a MuJoCo model, as MuJoCo itself compiles them, in a process of its own."""
    if find_spec("mujoco") is None:
        raise InputError("file: MJCF files need the extra: pip install 'orbitfinder[robot]'")
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        raise InputError(f"file: {path.name} is UTF-16, which MuJoCo does not read; save it as UTF-8")
    _check_files(path)
    lists = alone(__name__, "compiled", str(path.resolve()), SECONDS, MEMORY)
    if lists is None:
        raise InputError(
            f"file: {path.name} was not read within {SECONDS:g} s and {MEMORY / 1e9:g} GB; take out keyframes, "
            "<replicate> and meshes that the motion does not need"
        )
    if "refused" in lists:
        raise InputError(f"file: {path.name} is no MJCF that can be read ({lists['refused']}); correct it there")
    model = SimpleNamespace(**lists)
    _check_smooth(model, ignore)
    names, gravity = model.bodies, [0.0] * 3 if "mjDSBL_GRAVITY" in model.off else model.gravity
    made, frames = _Read(path.stem, {names[0]: _RigidBody()}, {}, names[0], gravity), {0: names[0]}
    for k in range(1, len(names)):
        turn = _axes(model.body_iquat[k])
        inertia = turn @ np.diag(model.body_inertia[k]) @ turn.T
        corners, faces = model.solids[k]
        solids = [(np.array(corners), np.array(faces))] if faces else []
        body = _RigidBody(model.body_mass[k], np.array(model.body_ipos[k]), inertia, solids=solids)
        place, parent = np.array(model.body_pos[k]), frames[model.body_parentid[k]]
        turned = _axes(model.body_quat[k])
        hung = range(model.body_jntadr[k], model.body_jntadr[k] + model.body_jntnum[k])
        for j in hung:  # in their order, each on a body without mass at the joint's place
            anchor = np.array(model.jnt_pos[j])
            child = names[k] if j == hung[-1] else f"{names[k]}_on_{model.joints[j]}"
            joint = _Joint("fixed", parent, child, place + turned @ anchor, turned, np.eye(3)[0])
            _put(made.joints, "joints", *_mjcf_joint(model, j, joint, ignore))
            if j != hung[-1] or anchor.any():
                _put(made.bodies, "bodies", child, _RigidBody())
            parent, place, turned = child, -anchor, np.eye(3)
        frames[k] = names[k] if not hung or not place.any() else f"{names[k]}_frame"
        if frames[k] != parent:
            weld = _Joint("fixed", parent, frames[k], place, turned, np.eye(3)[0])
            _put(made.joints, "joints", f"{names[k]}_weld", weld)
        _put(made.bodies, "bodies", frames[k], body)
    for k in _held(model, ignore):
        if model.equalities[k] in MUJOCO:
            _close(made, model, k, frames)
    return made


def _axes(quaternion: Sequence[float]) -> np.ndarray:
    """The axes (3 x 3, in columns) of what a MuJoCo model turns by a quaternion, whose real part is its first."""
    return _straight(Rotation.from_quat(np.roll(quaternion, -1)).as_matrix())


def _close(made: _Read, model: SimpleNamespace, k: int, frames: Mapping[int, str]) -> None:
    """A joint that closes a loop: an equality's place on its first body, and a link fixed at that on its second."""
    data, kind = np.array(model.eq_data[k]), MUJOCO[model.equalities[k]]
    bodies, places, turns = [model.eq_obj1id[k], model.eq_obj2id[k]], data[:6].reshape(2, 3), np.eye(4)[[0, 0]]
    if model.sites[k]:
        places, turns = (np.array(table)[bodies] for table in (model.site_pos, model.site_quat))
        bodies = [model.site_bodyid[site] for site in bodies]
    elif model.equalities[k] == "mjEQ_WELD":
        places, turns[0] = places[::-1], data[6:10]
    name, end = model.loops[k], f"{model.loops[k]}_end"
    kind = kind if data[10] else "connect"  # a weld whose torque is scaled by 0
    for label, what, body, place, turn in zip((name, end), (kind, "fixed"), bodies, places, turns, strict=True):
        _put(made.joints, "joints", label, _Joint(what, frames[body], end, place, _axes(turn), np.eye(3)[0]))
    _put(made.bodies, "bodies", end, _RigidBody())


def _mjcf_joint(model: SimpleNamespace, k: int, joint: _Joint, ignore: Sequence[str]) -> tuple[str, _Joint]:
    """Name and numbers of a MuJoCo model's joint, as its flags and equalities have it."""
    name, dof, place = model.joints[k], model.jnt_dofadr[k], model.jnt_qposadr[k]
    kind = MUJOCO[model.kinds[k]]
    loss = {
        "damping": model.dof_damping[dof],
        "rotor": model.dof_armature[dof],
        "friction": 0.0 if "friction" in ignore else model.dof_frictionloss[dof],
    }
    single = len(JOINTS[3][kind].free) == 1
    if not single and any({**loss, "stiffness": model.jnt_stiffness[k]}.values()):
        what = next((MJCF[entry] for entry, value in loss.items() if value), "stiffness")
        raise InputError(
            f"file: the {kind} joint {name!r} has {what}, which is not known; take it out, or write hinges"
        )
    for entry, flag in (("damping", "DAMPER"), ("friction", "FRICTIONLOSS")):
        loss[entry] *= f"mjDSBL_{flag}" not in model.off and "mjDSBL_PASSIVE" not in model.off
    sprung = not {"mjDSBL_SPRING", "mjDSBL_PASSIVE"} & {*model.off}
    stops = single and model.jnt_limited[k] and not {"mjDSBL_LIMIT", "mjDSBL_CONSTRAINT"} & {*model.off}
    drawn = model.qpos0[place] if single else 0.0  # its `ref`; equalities and ours count from there
    rules = ((model.joints[model.eq_obj2id[i]], model.eq_data[i][1], model.eq_data[i][0]) for i in _held(model, ignore)
             if (model.equalities[i], model.eq_obj1id[i]) == ("mjEQ_JOINT", k))  # fmt: skip
    return name, replace(
        joint, kind=kind, axis=np.array(model.jnt_axis[k]), **loss, stiffness=model.jnt_stiffness[k] * sprung,
        rest=model.qpos_spring[place] - drawn if single else 0.0, mimics=next(rules, None),
        range=tuple(end - drawn for end in model.jnt_range[k]) if stops else None,
    )  # fmt: skip


def _held(model: SimpleNamespace, ignore: Sequence[str]) -> list[int]:
    """The equalities that act."""
    off = "equalities" in ignore or {"mjDSBL_EQUALITY", "mjDSBL_CONSTRAINT"} & {*model.off}
    return [] if off else np.flatnonzero(model.eq_active0).tolist()


def _check_smooth(model: SimpleNamespace, ignore: Sequence[str]) -> None:
    """`InputError` naming what acts in a MuJoCo model and is not known here."""
    named = {"body": model.bodies, "jnt": model.joints, "dof": [model.joints[k] for k in model.dof_jntid]}
    drag = () if "fluid" in ignore else ("density", "viscosity")
    wrong = [f"{name} (drag of a fluid)" for name in drag if getattr(model, name)] + ["flex"] * model.nflex
    unknown = ["body_gravcomp", "jnt_stiffnesspoly", "jnt_springyield", "dof_dampingpoly"]
    if "tendons" not in ignore:
        unknown += ["tendon_stiffness", "tendon_damping", "tendon_frictionloss", "tendon_armature", "tendon_limited"]
    for name in unknown:
        owner, _, what = name.partition("_")
        acting = [k for k, value in enumerate(getattr(model, name, [])) if np.any(value)]
        wrong += [f"{what} of {owner} {named[owner][k] if owner in named else k!r}" for k in acting]
    bound: set[int] = set()
    for k in _held(model, ignore):
        if model.equalities[k] in MUJOCO:
            continue
        linear = model.equalities[k] == "mjEQ_JOINT" and model.eq_obj2id[k] >= 0 and not any(model.eq_data[k][2:5])
        wrong += [] if linear and model.eq_obj1id[k] not in bound else [f"equality {k} ({model.equalities[k]})"]
        bound.add(model.eq_obj1id[k])
    if wrong:
        raise InputError(f"file: {wrong[0]} acts in MuJoCo and is not known here; take it out, or give ignore "
                         f"({', '.join(map(repr, IGNORED))})")  # fmt: skip


def _tables(
    made: _Read, locked: Mapping[str, float] | Sequence[str], quaternions: bool
) -> tuple[Entries, list[str], dict[str, shapes.Solid]]:
    """The bodies and joints of the mechanism that a robot is, the names of the joints that move, how bodies look."""
    free = [name for name, joint in made.joints.items() if joint.free]
    still = dict(locked) if isinstance(locked, Mapping) else dict.fromkeys(locked, 0.0)
    _check_names("locked", still, free)
    still |= _following(made, still)
    moving = [name for name in free if name not in still]
    if not moving:
        raise InputError("locked: no joint is left to move; unlock one")
    bodies, whose = _lumped(made, still)
    system: Entries = {"bodies": {}, "joints": {}}
    held = whose[made.root]
    loops = [name for name, joint in made.joints.items() if not joint.sort.reaches]
    system |= {"redundant": "drop"} if loops else {}
    for name in [*moving, *loops]:
        joint, (turn, place), end = made.joints[name], _frame(made, name), made.bodies[made.joints[name].child]
        pair = [whose[joint.parent], whose[joint.child]]
        before = [bodies[body].place if body != held else np.zeros(3) for body in pair]
        table: Entries = {
            "kind": joint.kind, "between": [GROUND if body == held else _word(body) for body in pair],
            "at": [_listed(DOWN @ (at - start)) for at, start in zip((place, end.place), before, strict=True)],
        }  # fmt: skip
        if quaternions and joint.free.endswith("RRR"):
            table["axes"] = "quaternion"
        if not joint.free and "a" in joint.sort.rows:
            turned = Rotation.from_matrix(DOWN @ _straight(turn @ end.turn.T) @ DOWN.T)
            table["turned"] = _listed(turned.as_euler("xyz"))
        if len(joint.free) == 1:
            table["axis"] = _listed(DOWN @ turn @ joint.axis)
        if joint.rotor:
            table["rotor"] = joint.rotor
        table |= {"range": list(joint.range)} if joint.range is not None else {}
        table |= {"mimics": [_word(joint.mimics[0]), *joint.mimics[1:]]} if joint.mimics is not None else {}
        system["joints"][_word(name)] = table
    largest = max(np.abs(body.inertia).max() for body in bodies.values())
    for name, body in bodies.items():
        if name == held:
            continue
        if np.abs(body.inertia).max() < 1e-12 * largest:  # round-off of its turn
            body.inertia = np.zeros((3, 3))
        by = next(j for j in moving if whose[made.joints[j].child] == name)
        light = made.joints[by].mimics or any(whose[made.joints[j].parent] == name for j in moving)
        if not body.mass > 0 and not light:
            raise InputError(
                f"file: link {name!r} moves with joint {by!r} and has no mass; give it one, or lock the joint"
            )
        inertia = DOWN @ body.inertia @ DOWN.T
        six = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        system["bodies"][_word(name)] = {
            "mass": body.mass, "com": _listed(DOWN @ (body.com - body.place)), "inertia": _listed(six)
        }  # fmt: skip
    seen = {GROUND if name == held else _word(name): shapes.joined(b.solids) for name, b in bodies.items() if b.solids}
    return system, moving, {name: (corners @ DOWN.T, faces) for name, (corners, faces) in seen.items()}


def _following(made: _Read, still: Mapping[str, float]) -> dict[str, float]:
    """Where joints stay that mimic joints that do."""
    followed = {}
    for name, joint in made.joints.items():
        if joint.mimics is None or name in still or not joint.free:
            continue
        first, ratio, offset = joint.mimics
        if first not in made.joints or first == name or made.joints[first].mimics is not None:
            why = "which mimics" if first in made.joints else "which is not there"
            raise InputError(f"file: joint {name!r} mimics {first!r}, {why}; name one that moves by itself, or lock it")
        if first in still or not made.joints[first].free:
            followed[name] = ratio * still.get(first, 0.0) + offset
    return followed


def _acting(
    made: _Read, moving: list[str], stiffness: Any, rest: Mapping[str, float], damping: Any, motors: Sequence[str] | str
) -> Entries:
    """Springs, dampers and motors of the moving joints."""
    system = Entries()
    moving = [name for name in moving if len(made.joints[name].free) == 1]
    _check_names("rest", rest, moving)
    for key, given, entry in (("springs", stiffness, "stiffness"), ("dampers", damping, "damping")):
        own = {name: getattr(made.joints[name], entry) for name in moving}
        replaced = given if isinstance(given, Mapping) else () if given is None else moving
        rough = next((name for name in moving if made.joints[name].friction and name not in replaced), None)
        if key == "dampers" and rough is not None:
            raise InputError(
                f"file: joint {rough!r} has the friction {made.joints[rough].friction:g}, whose force jumps where the "
                f"rate changes sign; give a damping in its place (damping = {{ {_word(rough)} = 0.0 }}), or lock it"
            )
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
            system[key] = table
    chosen = moving if motors == "all" else [motors] if isinstance(motors, str) else list(motors)
    _check_names("motors", chosen, moving)
    if chosen:
        limits = {name: {"limit": most} if (most := made.joints[name].limit) else {} for name in chosen}
        system["motors"] = {f"{_word(name)}_torque": {"joint": _word(name)} | limits[name] for name in chosen}
    return system


def _check_names(field: str, given: Iterable[str], known: Sequence[str]) -> None:
    for name in given:
        if name not in known:
            raise InputError(f"{field}: no moving joint {name!r}{closest(name, known)}; they are {', '.join(known)}")


def _word(name: str) -> str:
    """A name of a file as an identifier."""
    word = "".join(letter if letter.isalnum() else "_" for letter in name)
    return word if word[:1].isalpha() or word[:1] == "_" else f"_{word}"


def _listed(numbers: Iterable[float]) -> list[float]:
    """Numbers without what the turning of axes leaves of round-off."""
    values = np.array(list(numbers), float)
    values[np.abs(values) < 1e-15 * np.abs(values).max(initial=0.0)] = 0.0
    return [float(f"{value:.15g}") for value in values]


def _frame(made: _Read, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Axes (3 x 3) and place (3) of a joint in the ground's, at the zero position."""
    joint = made.joints[name]
    parent = made.bodies[joint.parent]
    return parent.turn @ joint.turn, parent.place + parent.turn @ joint.place


def _lumped(made: _Read, still: Mapping[str, float]) -> tuple[dict[str, _RigidBody], dict[str, str]]:
    """Bodies that move, in the ground's axes at 0, and of which of them each link is a part."""
    whose, order = {made.root: made.root}, [made.root]
    for parent in order:
        for name, joint in made.joints.items():
            if joint.parent != parent or not joint.sort.reaches:
                continue
            if joint.child in whose:
                raise InputError(
                    f"file: link {joint.child!r} hangs on two joints, {name!r} the second; a URDF is a tree"
                )
            turn, place = _frame(made, name)
            fixed = not joint.free or name in still
            if name in still and joint.free == "R":
                turn = turn @ Rotation.from_rotvec(joint.axis / np.linalg.norm(joint.axis) * still[name]).as_matrix()
            elif name in still:
                place = place + turn @ joint.axis / np.linalg.norm(joint.axis) * still[name]
            body = made.bodies.get(joint.child)
            if body is None:
                raise InputError(f"file: joint {name!r} leads to link {joint.child!r}, which is not there")
            body.turn, body.place = _straight(turn), place
            whose[joint.child] = whose[parent] if fixed else joint.child
            order.append(joint.child)
    lost = [name for name in made.bodies if name not in whose]
    if lost:
        raise InputError(f"file: {plural(len(lost), 'link')} hang on nothing, {', '.join(lost[:3])}; join them")
    return {head: _together(made, [n for n, whole in whose.items() if whole == head], head) for head in
            dict.fromkeys(whose.values())}, whose  # fmt: skip


def _together(made: _Read, names: Sequence[str], head: str) -> _RigidBody:
    """Links that move together: mass, centre of mass and inertia about it in the ground's axes at 0 (Steiner)."""
    parts = [made.bodies[name] for name in names]
    mass = sum(part.mass for part in parts)
    centres = [part.place + part.turn @ part.com for part in parts]
    centre = sum((part.mass * at for part, at in zip(parts, centres, strict=True)), np.zeros(3)) / (mass or 1.0)
    inertia = np.zeros((3, 3))
    for part, at in zip(parts, centres, strict=True):
        away = at - centre
        inertia += part.turn @ part.inertia @ part.turn.T + part.mass * (away @ away * np.eye(3) - np.outer(away, away))
    origin = made.bodies[head].place
    solids = [(c @ part.turn.T + part.place - origin, faces) for part in parts for c, faces in part.solids]
    return _RigidBody(mass, centre, inertia, np.eye(3), origin, solids)
