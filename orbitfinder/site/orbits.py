"""The page and the gallery card of one orbit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from orbitfinder.site.gather import OrbitFile
from orbitfinder.site.motion import Motion, histories, packed
from orbitfinder.site.recipe import commands, problem_name, problem_text
from orbitfinder.site.text import Html, escaped, fill, joined, number
from orbitfinder.site.verdicts import Verdict
from orbitfinder.site.words import coordinate, mechanism

MOST_PORTRAITS = 6
"""Phase portraits on an orbit page; of more coordinates these many are chosen evenly."""
TOML = Html(
    '<button type="button" data-copy="problem">Copy problem file</button>'
    '<button type="button" id="save-toml">Problem file (TOML)</button>'
)
SYMMETRIES = {"none": "no symmetry"}


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


def symmetry_words(name: str) -> str:
    """A symmetry for reading."""
    return SYMMETRIES.get(name, name.replace("+", " and "))


def verdict_badge(verdict: Verdict) -> Html:
    """A badge that says whether the orbit passed the checks when this page was made."""
    if verdict.certified is None:
        word = "not checked here" if verdict.checks else "no certificate"
        return Html(f'<span class="badge">{word}</span>')
    word, style = ("certified", "good") if verdict.certified else ("rejected", "bad")
    return Html(f'<span class="badge {style}">{word}</span>')


def stability_badge(stability: str) -> Html:
    """A badge for the stability; a sign beside the word, so that colour is not needed to tell them apart."""
    style = {"unstable": "bad", "asymptotically stable": "good", "elliptic": "good"}.get(stability, "plain")
    sign = "\N{BLACK DIAMOND}" if stability == "unstable" else "\N{BLACK CIRCLE}"
    return Html(f'<span class="badge {style}"><span aria-hidden="true">{sign}</span> {escaped(stability)}</span>')


def card(entry: Entry) -> Html:
    """The orbit's card in the gallery; what it is sorted and filtered by stands in its data attributes."""
    document = entry.document
    return fill(
        "card",
        slug=entry.slug, title=entry.title, mechanism=entry.mechanism, series=entry.series,
        energy=repr(float(document["energy"])), period=repr(float(document["period"])),
        energy_text=number(document["energy"]), period_text=number(document["period"]),
        stability=document["stability"], symmetry=document["symmetry"], largest=repr(entry.largest),
        badge=Html(_doubt(entry.verdict) + stability_badge(document["stability"])),
        symmetry_text=symmetry_words(document["symmetry"]),
    )  # fmt: skip


def _doubt(verdict: Verdict) -> str:
    """The badge of an orbit that was not certified when this page was made, else nothing."""
    return "" if verdict.certified else f"{verdict_badge(verdict)} "


def orbit_main(entry: Entry) -> Html:
    """What stands inside <main> of an orbit page."""
    document, problem = entry.document, problem_text(entry.document)
    return fill(
        "orbit",
        title=entry.title, mechanism=entry.mechanism, source=_source(document),
        verdict=Html(f"{verdict_badge(entry.verdict)} {proof_badge(entry)}"),
        stability=stability_badge(document["stability"]),
        symmetry=symmetry_words(document["symmetry"]), facts=_facts(entry),
        player=player(f"Moving picture of {entry.title}", entry.motion),
        portraits=_portraits(entry.motion),
        missing=Html("") if entry.motion else _missing(), note=_chosen_note(entry.motion),
        multipliers=_multipliers(document),
        certificate=_certificate(entry.verdict), whose=_whose(entry.verdict), proof=_proof(entry),
        name=problem_name(document),
        toml=TOML if problem else Html(""),
        problem=problem or "This system was built in Python; no problem file describes it.",
        commands=commands(document) if problem else f"orbitfinder verify {problem_name(document)}.json\n",
    )  # fmt: skip


def player(label: str, motion: Motion | None = None) -> Html:
    """A canvas with play, speed, trace and time; as wide for its height as the motion, within limits."""
    aspect = 1.25
    if motion is not None:
        spans = np.ptp(motion.points, axis=(0, 2))
        down, right = spans + 0.15 * max(float(spans.max()), 1e-12)
        aspect = float(np.clip(right / down, 0.95, 2.4))
    return fill("player", label=label, aspect=f"{aspect:.2f}")


def _portraits(motion: Motion | None) -> Html:
    """A box for each phase portrait, so that nothing moves when the plots are drawn."""
    if motion is None:
        return Html("")
    n = len(motion.names) // 2
    return joined(fill("portrait", component=k, name=motion.names[k], rate=motion.names[k + n]) for k in shown(motion))


def _source(document: Mapping[str, Any]) -> Html:
    source = document.get("source")
    return Html(f'<p class="source">Source: {escaped(source)}</p>') if source else Html("")


def _missing() -> Html:
    return Html(
        '<p class="notice">This orbit cannot be drawn: its system cannot be rebuilt from the file, or its nodes do not '
        "join up. The numbers below are those of the file.</p>"
    )


def _facts(entry: Entry) -> Html:
    document = entry.document
    rows = [
        ("Period", f"{float(document['period'])!r} s"),
        ("Frequency", f"{number(1.0 / document['period'], 8)} 1/s"),
        ("Energy", f"{number(document['energy'], 12)} J"),
        ("Action", f"{number(document['action'], 10)} J s"),
        ("Closure", number(document["closure"], 2)),
        ("Largest multiplier", number(entry.largest, 6)),
    ]
    turns = list(document.get("winding") or ())
    if any(turns):
        names = entry.motion.names if entry.motion else [f"q{k + 1}" for k in range(len(turns))]
        rows.append(("Turns", ", ".join(f"{name} {k}" for name, k in zip(names, turns, strict=False) if k)))
    return fact_list(rows)


def fact_list(rows: list[tuple[str, str]]) -> Html:
    """Names and values for a <dl>."""
    return joined(Html(f"<div><dt>{escaped(name)}</dt><dd>{escaped(value)}</dd></div>") for name, value in rows)


def shown(motion: Motion) -> list[int]:
    """The coordinates that are plotted: of a linkage its angles; evenly chosen where there are many."""
    n = len(motion.names) // 2
    candidates = list(range(n))
    if n > 6 and any(motion.angles) and not all(motion.angles):
        candidates = [k for k in candidates if motion.angles[k]]
    picks = np.linspace(0, len(candidates) - 1, min(len(candidates), MOST_PORTRAITS)).round().astype(int)
    return [candidates[k] for k in np.unique(picks)]


def _chosen_note(motion: Motion | None) -> str:
    if motion is None:
        return ""
    n, some = len(motion.names) // 2, len(shown(motion))
    return "" if n == some else f"{some} of {n} coordinates are plotted; the CSV holds all."


def _multipliers(document: Mapping[str, Any]) -> Html:
    """The unit circle and the table of the multipliers, or a sentence where there are none."""
    pairs, defect = document["floquet_multipliers"], document.get("pair_defect")
    if not pairs:
        return Html("<p>None besides the trivial ones.</p>")
    rows = []
    for re, im in sorted(pairs, key=lambda pair: (-abs(complex(*pair)), pair[1])):
        angle = float(np.degrees(np.angle(complex(re, im))))
        cells = (number(re, 8), number(im, 8), number(abs(complex(re, im)), 8), number(angle, 5))
        rows.append(Html("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"))
    note = ""
    if isinstance(defect, (int, float)) and len(pairs) > 1:
        note = f"Defect of the reciprocal pairs, their error bar: {number(float(defect), 2)}."
    return fill("multipliers", rows=joined(rows), defect=note)


def _whose(verdict: Verdict) -> Html:
    """Who says what the table of checks says, and what failed."""
    said = f'<p class="meta">{escaped(verdict.words)}</p>'
    if verdict.certified is False:
        said += f'<p class="notice">Not an orbit, by these checks: {escaped(verdict.failures)}.</p>'
    return Html(said)


def _certificate(verdict: Verdict) -> Html:
    if not verdict.checks:
        return Html('<tr><td colspan="5">No checks; run orbitfinder verify.</td></tr>')
    return joined(_check(check, not verdict.unchecked) for check in verdict.checks)


def _recorded_proof(entry: Entry) -> Mapping[str, Any] | None:
    """What `orbitfinder prove` recorded, where it proved something; of a rejected orbit nothing is proved."""
    proof = entry.document.get("proof")
    if not isinstance(proof, Mapping) or proof.get("proved") is not True or entry.verdict.certified is False:
        return None
    return proof


def _proof(entry: Entry) -> Html:
    proof = _recorded_proof(entry)
    if proof is None:
        return Html("")
    period, enclosed = proof.get("period"), ""
    radius = period.get("radius") if isinstance(period, Mapping) else None
    if isinstance(period, Mapping) and isinstance(radius, (int, float)):
        enclosed = f"Its period is {period.get('value')} s within {number(float(radius), 2)} s."
    versions = proof.get("versions")
    by = f" by orbitfinder {versions.get('orbitfinder', '')}" if isinstance(versions, Mapping) else ""
    return fill("proof", theorem=str(proof.get("theorem", "")), period=enclosed, by=by)


def proof_badge(entry: Entry) -> Html:
    """A badge for an orbit whose file records a proof, else nothing."""
    return Html("") if _recorded_proof(entry) is None else Html('<span class="badge plain">proof recorded</span>')


def _check(check: Mapping[str, Any], ours: bool) -> Html:
    def figure(name: str) -> str:
        value = check.get(name)
        return number(float(value) if isinstance(value, (int, float)) else None, 3)

    cells = [
        str(check.get("name", "")).replace("_", " "), figure("value"), figure("tolerance"),
        "passed" if check.get("passed") else "FAILED", check.get("note", ""),
    ]  # fmt: skip
    style = ("good" if check.get("passed") else "bad") if ours else "plain"
    inner = "".join(f"<td>{escaped(cell)}</td>" for cell in cells[1:3])
    return Html(
        f'<tr><th scope="row">{escaped(cells[0])}</th>{inner}'
        f'<td><span class="badge {style}">{cells[3]}</span></td><td>{escaped(cells[4])}</td></tr>'
    )


def orbit_data(entry: Entry) -> dict[str, Any]:
    """What the orbit page's script works with."""
    document, motion = entry.document, entry.motion
    data: dict[str, Any] = {
        "name": problem_name(document),
        "title": entry.title,
        "period": float(document["period"]),
        "multipliers": document["floquet_multipliers"],
        "json": entry.file.text,
        "motion": None,
    }
    if motion is not None:
        n = len(motion.names) // 2
        data |= {
            "motion": packed(motion),
            "histories": histories(motion),
            "names": list(motion.names),
            "labels": [coordinate(name) for name in motion.names[:n]],
            "units": ["rad" if angle else "m" for angle in motion.angles],
            "shown": shown(motion),
        }
    return data
