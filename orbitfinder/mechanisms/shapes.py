"""The shapes of a robot's links as few triangles: of boxes, cylinders, balls and files (STL, OBJ, Collada).

A solid is its corners (V x 3, m) and its triangles (F x 3 numbers of corners), counterclockwise seen from outside.
"""

from __future__ import annotations

import base64
import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import InputError, shortened
from orbitfinder.records.reading import file_bytes

Solid = tuple[np.ndarray, np.ndarray]
MOST, LEAST, SIDES = 4000, 60, 20
"""Triangles of a robot at most, of a body of many at least; sides of what is round"""
LARGEST, MOST_ELEMENTS = 100_000_000, 2_000_000
"""Bytes of a file; elements of a Collada file, and of what its scene has"""


def turned(heights: np.ndarray, radii: np.ndarray) -> Solid:
    """What is round about z: rings of radii (m) at heights (m), upwards, the first and the last of which are points."""
    angles = 2 * np.pi * np.arange(SIDES) / SIDES
    ring = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    corners = np.vstack([radius * ring + [0, 0, z] for z, radius in zip(heights, radii, strict=True)])
    here, after = np.arange(SIDES), np.roll(np.arange(SIDES), -1)
    faces = [
        triangle + SIDES * k
        for k in range(len(radii) - 1)
        for triangle in (
            np.stack([here, after, SIDES + after], axis=1), np.stack([here, SIDES + after, SIDES + here], axis=1)
        )
    ]  # fmt: skip
    return merged(corners, np.vstack(faces))


def box(sides: Sequence[float]) -> Solid:
    """A box of three sides (m) about its centre."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * np.asarray(sides, float) / 2
    squares = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return corners, np.array([face for a, b, c, d in squares for face in ((a, b, c), (a, c, d))])


def cylinder(radius: float, length: float) -> Solid:
    """A cylinder (m) about z and its centre."""
    return turned(np.array([-1, -1, 1, 1]) * length / 2, np.array([0, 1, 1, 0]) * radius)


def ball(radius: float, length: float = 0.0) -> Solid:
    """A ball (m), or a cylinder of a length between two halves of it, about z and its centre."""
    up = np.linspace(-np.pi / 2, np.pi / 2, 10)
    return turned(radius * np.sin(up) + np.sign(up) * length / 2, radius * np.cos(up).clip(0.0))


def merged(corners: np.ndarray, faces: np.ndarray) -> Solid:
    """The same with each corner and triangle once, without triangles that are none."""
    _, first, of = np.unique(_cells(corners, 1_000_000), return_index=True, return_inverse=True)
    return corners[first], _distinct(of[faces])


def _cells(corners: np.ndarray, cells: int) -> np.ndarray:
    """Which cell of a grid, so many along the longest side, each corner is in."""
    low, size = corners.min(axis=0), nonzero(float(np.ptp(corners, axis=0).max()))
    x, y, z = np.floor((corners - low) / size * cells + 0.5).astype(np.int64).T
    return np.asarray((x * (cells + 2) + y) * (cells + 2) + z)


def joined(solids: Sequence[Solid]) -> Solid:
    """Several as a single solid."""
    before = np.cumsum([0, *(len(corners) for corners, _ in solids)])
    faces = [triangles + start for (_, triangles), start in zip(solids, before[:-1], strict=True)]
    return np.vstack([corners for corners, _ in solids]), np.vstack(faces)


def read(path: Path) -> Solid:
    """The solid of a file by its name's ending. Raises `InputError`."""
    readers = {".stl": _stl, ".obj": _obj, ".dae": _collada}
    if (reader := readers.get(path.suffix.lower())) is None:
        raise InputError(f"{path.name}: meshes are read from {', '.join(readers)}; convert it")
    data = file_bytes(path, "mesh", LARGEST)
    try:
        with np.errstate(all="ignore"):
            corners, faces = reader(data)
        if not len(faces) or faces.min() < 0 or faces.max() >= len(corners):
            at = f", with corner {faces.max() + 1}" if len(faces) else ""
            raise ValueError(f"{len(corners)} corners and {len(faces)} triangles{at}")
        if not (np.abs(corners) < 1e100).all():
            raise ValueError("a corner is not a finite number below 1e+100")
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError, ElementTree.ParseError,
            ) as error:  # fmt: skip
        why = f"no {error} in it" if isinstance(error, KeyError) else shortened(error, 120)
        kind = path.suffix[1:].upper()
        raise InputError(f"{path.name}: cannot be read as {kind} ({why}); export it again") from error
    return merged(corners, faces)


def _stl(data: bytes) -> Solid:
    count = int.from_bytes(data[80:84], "little")
    if len(data) == 84 + 50 * count:
        layout = np.dtype([("normal", "<f4", 3), ("at", "<f4", (3, 3)), ("more", "<u2")])
        corners = np.frombuffer(data, layout, count, 84)["at"].reshape(-1, 3).astype(float)
    else:
        triples = re.finditer(rb"vertex\s++(\S++)\s++(\S++)\s++(\S++)", data)
        corners = np.fromiter((float(number) for triple in triples for number in triple.groups()), float).reshape(-1, 3)
    return corners, np.arange(len(corners)).reshape(-1, 3)


def _obj(data: bytes) -> Solid:
    corners, faces = array("d"), array("q")
    for line in BytesIO(data):
        what, *words = line.split() or [b""]
        if what == b"v":
            corners.extend(float(word) for word in words[:3])
        elif what == b"f":
            at = [int(word.partition(b"/")[0]) for word in words]
            faces.extend(_fan([k - 1 if k > 0 else k + len(corners) // 3 for k in at]))
    return np.array(corners).reshape(-1, 3), np.array(faces).reshape(-1, 3)


def _fan(at: Sequence[int]) -> Iterator[int]:
    """The triangles of a polygon, corner after corner."""
    return (corner for k in range(1, len(at) - 1) for corner in (at[0], at[k], at[k + 1]))


def _collada(data: bytes) -> Solid:
    """The geometries of a Collada file where its scene has them, in m, with z up."""
    if data.count(b"<") > MOST_ELEMENTS:
        raise ValueError(f"more than {MOST_ELEMENTS} elements")
    root = ElementTree.fromstring(data)
    for node in root.iter():
        node.tag = node.tag.rpartition("}")[2]
    known = {node.get("id"): node for node in root.iter() if node.get("id")}
    solids, spent = list[Solid](), 0

    def walk(node: ElementTree.Element, before: np.ndarray) -> None:
        nonlocal spent
        here, spent = before, spent + 500
        for part in node:
            made = np.eye(4)  # what the element does to places
            if part.tag == "matrix":
                made = _numbers(part).reshape(4, 4)
            elif part.tag == "translate":
                made[:3, 3] = _numbers(part)
            elif part.tag == "rotate":
                *axis, angle = _numbers(part)
                made[:3, :3] = Rotation.from_rotvec(np.array(axis) * np.radians(angle)).as_matrix()
            elif part.tag == "scale":
                made[:3, :3] = np.diag(_numbers(part))
            here = here @ made
        for part in node:
            if part.tag == "instance_geometry":
                for corners, faces in _geometry(known[part.attrib["url"][1:]], known):
                    solids.append((corners @ here[:3, :3].T + here[:3, 3], faces))
                    spent += len(corners) + len(faces)
            if spent > MOST_ELEMENTS:
                raise ValueError(f"its instances stand for more than {MOST_ELEMENTS} nodes, corners and triangles")
            if part.tag in ("node", "instance_node"):
                walk(part if part.tag == "node" else known[part.attrib["url"][1:]], here)

    meter, up = root.find("asset/unit"), root.findtext("asset/up_axis", "Y_UP").strip()
    turn = {"Y_UP": Rotation.from_euler("x", 90, degrees=True), "X_UP": Rotation.from_euler("y", -90, degrees=True)}
    first = np.eye(4)
    first[:3, :3] = turn.get(up, Rotation.identity()).as_matrix()
    first[:3, :3] *= float("1" if meter is None else meter.get("meter", "1"))
    for scene in root.iter("visual_scene"):
        walk(scene, first)
    return joined(solids)


def _numbers(node: ElementTree.Element | None, kind: type = float) -> np.ndarray:
    text = (node.text or "") if node is not None else ""
    return np.fromiter((kind(word[0]) for word in re.finditer(r"\S++", text)), kind)


def _geometry(node: ElementTree.Element, known: Mapping[str | None, ElementTree.Element]) -> Iterator[Solid]:
    """The solids of a Collada geometry, a piece for each of its materials."""
    for part in node.iterfind("mesh/*"):
        if part.tag not in ("triangles", "polylist", "polygons"):
            continue
        inputs = {entry.get("semantic"): entry for entry in part.iterfind("input")}
        stride = 1 + max(int(entry.get("offset", "0")) for entry in part.iterfind("input"))
        chosen = inputs["VERTEX"]
        vertices = known[chosen.attrib["source"][1:]].iterfind("input")
        place = {entry.get("semantic"): entry.attrib["source"] for entry in vertices}["POSITION"]
        corners = _numbers(known[place[1:]].find("float_array")).reshape(-1, 3)
        offset = int(chosen.get("offset", "0"))
        lists = [_numbers(indices, int)[offset::stride] for indices in part.findall("p")]
        if part.tag != "polygons" and lists:
            (all_of_them,) = lists
            counts = _numbers(part.find("vcount"), int)
            counts = counts if counts.size else np.full(len(all_of_them) // 3, 3)
            lists = np.split(all_of_them, np.cumsum(counts)[:-1])
        corner_numbers = (corner for polygon in lists for corner in _fan(polygon.tolist()))
        yield corners, np.fromiter(corner_numbers, int).reshape(-1, 3)


def reduced(solid: Solid, most: int) -> Solid:
    """A solid of at most so many triangles: corners in the same cell of a grid are merged where the planes of
    their triangles meet best. Source: P. Lindstrom, SIGGRAPH 2000, 259-262."""
    corners, faces = solid
    if len(faces) <= most:
        return solid
    coarse, fine, chosen = 1, 1024, np.zeros(len(corners), int)
    while fine - coarse > 1:
        cells = (coarse + fine) // 2
        _, of = np.unique(_cells(corners, cells), return_inverse=True)
        if len(_distinct(of[faces])) <= most:
            coarse, chosen = cells, of
        else:
            fine = cells
    a, b, c = (corners[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)  # longer by twice the area
    unit = normals / nonzero(np.linalg.norm(normals, axis=1, keepdims=True))
    number = int(chosen.max()) + 1
    counts = np.bincount(chosen, minlength=number)
    middle = np.stack([np.bincount(chosen, corners[:, k], number) for k in range(3)], axis=1) / counts[:, None]
    planes, right = np.zeros((number, 3, 3)), np.zeros((number, 3))
    for k in range(3):
        at = chosen[faces[:, k]]
        np.add.at(planes, at, normals[:, :, None] * unit[:, None, :])
        np.add.at(right, at, normals * (unit * (a - middle[at])).sum(axis=1, keepdims=True))
    soft = nonzero(np.trace(planes, axis1=1, axis2=2))[:, None, None] * 0.01 * np.eye(3)
    moved = np.linalg.solve(planes + soft, right[:, :, None])[:, :, 0]
    away = float(np.ptp(corners, axis=0).max()) / coarse
    places = middle + np.clip(moved, -away, away)
    return merged(places, chosen[faces])


def _distinct(faces: np.ndarray) -> np.ndarray:
    """Triangles of three corners, each once."""
    kept = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    a, b, c = np.sort(faces[kept].astype(np.int64), axis=1).T
    many = int(c.max(initial=0)) + 1
    return np.asarray(faces[kept][np.sort(np.unique((a * many + b) * many + c, return_index=True)[1])])


def described(solids: Mapping[str, Solid]) -> dict[str, list[float | str]]:
    """Solids as plain data: the centre of the box about it and half its sides (m), then corners as 16-bit shares of
    these and numbers of corners, little-endian, in base64."""
    total, entries = sum(len(faces) for _, faces in solids.values()), dict[str, list[float | str]]()
    for name, solid in solids.items():
        share = max(LEAST, MOST * len(solid[1]) // max(total, 1))
        corners, faces = reduced(solid, share) if total > MOST else solid
        low, high = corners.min(axis=0), corners.max(axis=0)
        half = np.maximum(high - low, 1e-3 * float((high - low).max())) / 2  # a sheet has two sides too
        places = np.rint((corners - (low + high) / 2) / half * 32767).astype("<i2")
        texts = (base64.b64encode(part.tobytes()).decode() for part in (places, faces.astype("<u2")))
        entries[name] = [*(float(f"{x:.6g}") for x in ((low + high) / 2).tolist() + half.tolist()), *texts]
    return entries


def undescribed(entry: Sequence[float | str]) -> Solid:
    """The solid of `described`, its corners as shares (-1 to 1) of half the sides of its box."""
    kinds = zip(entry[6:], ("<i2", "<u2"), strict=True)
    places, faces = (np.frombuffer(base64.b64decode(str(text)), kind) for text, kind in kinds)
    return places.reshape(-1, 3) / 32767, faces.reshape(-1, 3)
