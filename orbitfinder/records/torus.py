"""Invariant tori as plain numbers, and their file (format "orbitfinder/tori")."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.errors import InputError
from orbitfinder.records.family import plain
from orbitfinder.records.orbit import Certificate, Check, certificate_to_document, energy_entry, energy_of
from orbitfinder.records.reading import json_bytes, json_file, write_atomically

FORMAT, VERSION = "orbitfinder/tori", 1
AGAIN = "compute the tori again"


@dataclass(frozen=True)
class Torus(Shown):
    """One quasi-periodic motion: a closed curve X(theta) that the flow over T turns by 2 pi `rotation`.

    `frequencies` are those of the returns and of the turning (rad/s).

    Args:
        curve: states at equal angles (N x d, N odd).
        period: T in s.
        rotation: turns a return.
        energy: J, nan without one.
        tail: size of the highest harmonics relative to the curve's.
        strip: width of the strip of complex angles in which the series converges (0: the torus breaks down).
        free: physical parameters that were found with it.
        certificate: its checks.

    Examples:
        >>> one = tori.tori[-1]
        >>> one.curve.shape[1], round(one.rotation, 9)
        (4, 0.197056417)
    """

    __repr__ = brief("period", "rotation", "energy", "frequencies", "certificate")

    curve: np.ndarray
    period: float
    rotation: float
    energy: float
    tail: float
    strip: float
    free: Mapping[str, float] = field(default_factory=dict)
    certificate: Certificate | None = None

    @property
    def frequencies(self) -> tuple[float, float]:
        """Angular frequencies (rad/s): of the returns, and of the turning."""
        first = 2 * np.pi / self.period
        return first, first * self.rotation


@dataclass(frozen=True)
class Tori(Shown):
    """A family of tori of one system.

    Args:
        name: a word for files.
        system: plain description that rebuilds the model.
        parameter: what changes along it.
        held: what is the same for all, by name.
        tori: in order.
        end: why it ends.

    Examples:
        >>> tori.parameter, list(tori.held)
        ('rotation', ['energy'])
    """

    __repr__ = brief("name", "parameter", "held", "tori", "end")

    name: str
    system: Mapping[str, Any]
    parameter: str
    held: Mapping[str, float]
    tori: tuple[Torus, ...]
    end: str = ""


def save_tori(found: Tori, path: str | Path) -> Path:
    """Write a tori.json.

    Args:
        found: the tori.
        path: where.

    Returns:
        The path.

    Raises:
        InputError: where it cannot be written.

    Examples:
        >>> of.save_tori(tori, "tori.json").name
        'tori.json'
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    document = {
        "format": FORMAT, "version": VERSION, "name": found.name, "system": plain(found.system),
        "parameter": found.parameter, "held": dict(found.held), "end": found.end,
        "tori": [torus_entry(one) for one in found.tori],
    }  # fmt: skip
    write_atomically(target, json_bytes(document))
    return target


def torus_entry(torus: Torus) -> dict[str, Any]:
    """A Torus in plain numbers."""
    numbers = {name: plain(getattr(torus, name)) for name in ("curve", "period", "rotation", "tail", "strip", "free")}
    return numbers | {"energy": energy_entry(torus.energy), "certificate": certificate_to_document(torus.certificate)}


def load_tori(path: str | Path) -> Tori:
    """Read a tori.json.

    Args:
        path: of the file.

    Returns:
        Tori.

    Raises:
        InputError: on anything unreadable.

    Examples:
        >>> _ = of.save_tori(tori, "tori.json")
        >>> len(of.load_tori("tori.json").tori)
        2
    """
    document = json_file(Path(path), "tori.json", AGAIN)
    if not isinstance(document, dict) or document.get("format") != FORMAT or document.get("version") != VERSION:
        raise InputError(f"{path}: format: expected {FORMAT!r} of version {VERSION}; give a tori.json")
    try:
        tori = tuple(torus_of(one) for one in document["tori"])
        size = {one.curve.shape[1] for one in tori}
        if not tori or len(size) > 1 or any(len(one.curve) % 2 == 0 for one in tori):
            raise ValueError("curves of an even number of states, or none")
        return Tori(str(document["name"]), dict(document["system"]), str(document["parameter"]),
                    {str(name): float(one) for name, one in document["held"].items()}, tori,
                    str(document["end"]))  # fmt: skip
    except (TypeError, ValueError, KeyError, AttributeError, IndexError) as error:
        raise InputError(f"{path}: malformed entry ({error}); {AGAIN}") from error


def torus_of(document: Mapping[str, Any]) -> Torus:
    """The Torus of its entry; `ValueError`, `KeyError` or `TypeError` where it is damaged."""
    curve = np.asarray(document["curve"], float)
    numbers = [float(document[name]) for name in ("period", "rotation", "tail", "strip")]
    if curve.ndim != 2 or not (np.isfinite(curve).all() and np.isfinite(numbers).all() and numbers[0] > 0):
        raise ValueError("a torus that is not of finite numbers")
    checks = tuple(
        Check(**{**one, "value": np.nan if one["value"] is None else float(one["value"])})
        for one in document["certificate"]["checks"]
    )
    return Torus(
        curve, numbers[0], numbers[1], energy_of(document["energy"]),
        numbers[2], numbers[3], {str(name): float(one) for name, one in document["free"].items()},
        Certificate(checks) if checks else None,
    )  # fmt: skip
