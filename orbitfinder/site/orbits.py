"""The page of one orbit, and how it stands in the gallery."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from orbitfinder.problemfile.write import orbit_name, orbit_text
from orbitfinder.site.gather import OrbitFile, Verdict, evenly
from orbitfinder.site.motion import Motion, histories, packed
from orbitfinder.site.text import coordinate, mechanism, number

MOST_PORTRAITS = 6
"""Phase portraits on an orbit page; of more coordinates these many are chosen evenly."""
UNJUDGED = Verdict((), False, "this orbit has no page of its own")


@dataclass(frozen=True)
class Entry:
    """One orbit of the site: its file, its motion, the name of its page and how its parts are called."""

    file: OrbitFile
    motion: Motion | None
    slug: str
    series: str = ""
    """name of the atlas it came from, empty for an orbit.json"""
    label: str = ""
    """what it is called where its document has no telling name of its own"""
    verdict: Verdict = UNJUDGED

    @property
    def document(self) -> Mapping[str, Any]:
        """The orbit document."""
        return self.file.document

    @property
    def title(self) -> str:
        """The title, or the name where there is none."""
        return self.label or str(self.document.get("title") or self.document["name"])

    @property
    def mechanism(self) -> str:
        """The kind of mechanism in words."""
        return mechanism(self.document["system"])

    @property
    def largest(self) -> float:
        """Largest modulus of the Floquet multipliers, 1 where there are none."""
        pairs = self.document["floquet_multipliers"]
        return float(max((abs(complex(*pair)) for pair in pairs), default=1.0))


def orbit_values(entry: Entry) -> dict[str, Any]:
    """What the template of an orbit page is filled with."""
    document, motion, name = entry.document, entry.motion, orbit_name(entry.document)
    problem = orbit_text(document)
    return {
        "entry": entry,
        "document": document,
        "verdict": entry.verdict,
        "motion": motion,
        "aspect": _aspect(motion),
        "shown": shown(motion) if motion else [],
        "coordinates": len(motion.angles) if motion else 0,
        "facts": _facts(entry),
        "multipliers": _multipliers(document),
        "proof": _recorded_proof(entry),
        "name": name,
        "problem": problem,
        "commands": (f"orbitfinder run {name}.toml\n" if problem else "") + f"orbitfinder verify {name}.json\n",
    }


def _aspect(motion: Motion | None) -> float:
    """Width over height of the moving picture: that of the motion, within limits."""
    if motion is None:
        return 1.25
    spans = np.ptp(motion.points, axis=(0, 2))
    down, right = spans + 0.15 * max(float(spans.max()), 1e-12)
    return float(np.clip(right / down, 0.95, 2.4))


def _facts(entry: Entry) -> list[tuple[str, str]]:
    """Names and values of an orbit's numbers."""
    document = entry.document
    rows = [
        ("Period", f"{float(document['period'])!r} s"),
        ("Frequency", f"{number(1.0 / document['period'], 8)} 1/s"),
        ("Energy", "none is conserved" if document["energy"] is None else f"{number(document['energy'], 12)} J"),
        ("Action", f"{number(document['action'], 10)} J s"),
        ("Closure", number(document["closure"], 2)),
        ("Largest multiplier", number(entry.largest, 6)),
    ]
    turns = list(document.get("winding") or ())
    if any(turns):
        names = entry.motion.names if entry.motion else [f"q{k + 1}" for k in range(len(turns))]
        rows.append(("Turns", ", ".join(f"{name} {k}" for name, k in zip(names, turns, strict=False) if k)))
    return rows


def shown(motion: Motion) -> list[int]:
    """The coordinates that are plotted: of a linkage its angles; evenly chosen where there are many."""
    n = len(motion.angles)
    candidates = list(range(n))
    if n > 6 and any(motion.angles) and not all(motion.angles):
        candidates = [k for k in candidates if motion.angles[k]]
    return [candidates[k] for k in evenly(len(candidates), MOST_PORTRAITS)]


def _multipliers(document: Mapping[str, Any]) -> list[tuple[float, float, float, float]]:
    """Real and imaginary part, modulus and angle (degrees) of each multiplier, the largest first."""
    pairs = sorted(document["floquet_multipliers"], key=lambda pair: (-abs(complex(*pair)), pair[1]))
    return [(re, im, abs(complex(re, im)), float(np.degrees(np.angle(complex(re, im))))) for re, im in pairs]


def _recorded_proof(entry: Entry) -> Mapping[str, Any] | None:
    """What `orbitfinder prove` recorded, where it proved something; of a rejected orbit nothing is proved."""
    proof = entry.document.get("proof")
    if not isinstance(proof, Mapping) or proof.get("proved") is not True or entry.verdict.certified is False:
        return None
    return proof


def orbit_data(entry: Entry) -> dict[str, Any]:
    """What the orbit page's script works with."""
    document, motion = entry.document, entry.motion
    data: dict[str, Any] = {
        "name": orbit_name(document),
        "title": entry.title,
        "period": float(document["period"]),
        "multipliers": document["floquet_multipliers"],
        "json": entry.file.text,
        "motion": None,
    }
    if motion is not None:
        n = len(motion.angles)
        data |= {
            "motion": packed(motion),
            "histories": histories(motion),
            "names": list(motion.names),
            "coordinates": n,
            "partners": motion.partners,
            "labels": [coordinate(name) for name in motion.names[:n]],
            "units": ["rad" if angle else "m" if n < len(motion.names) else "" for angle in motion.angles],
            "shown": shown(motion),
        }
    return data
