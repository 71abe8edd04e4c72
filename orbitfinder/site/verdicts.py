"""What a page may call certified: what was found so when the page was made, not what a file says of itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from orbitfinder._runtime.version import __version__
from orbitfinder.errors import OrbitfinderError
from orbitfinder.mechanics.catalogue import build_model
from orbitfinder.orbits.certify import certify
from orbitfinder.records.orbit import certificate_to_document, orbit_from_document
from orbitfinder.site.gather import OrbitFile

NOT_ASKED = "it was not asked for"


@dataclass(frozen=True)
class Verdict:
    """The checks of an orbit, recomputed here or, where `unchecked` says why not, as its file has them."""

    checks: Sequence[Mapping[str, Any]]
    passed: bool
    unchecked: str = ""

    @property
    def certified(self) -> bool | None:
        """True or False by what was recomputed; None where nothing was."""
        return None if self.unchecked else self.passed

    @property
    def words(self) -> str:
        """Whose word it is."""
        if not self.unchecked:
            return f"Recomputed from the numbers of the file when this page was made, by orbitfinder {__version__}."
        if not self.checks:
            return f"The file carries no certificate, and none was computed here: {self.unchecked}."
        return f"As the file has it; not checked here: {self.unchecked}."

    @property
    def failures(self) -> str:
        """Names of the checks that failed."""
        return ", ".join(str(check.get("name", "")).replace("_", " ") for check in self.checks if not check["passed"])


class Judge:
    """Gives verdicts, each record once; or none, and says so."""

    def __init__(self, active: bool = True) -> None:
        self._active = active
        self._known: dict[str, Verdict] = {}

    def verdict(self, file: OrbitFile) -> Verdict:
        """The certificate of an orbit, recomputed as `orbitfinder verify` does without --trust."""
        if not self._active:
            return recorded(file.document, NOT_ASKED)
        if file.text not in self._known:
            self._known[file.text] = _judged(file.document)
        return self._known[file.text]


def _judged(document: Mapping[str, Any]) -> Verdict:
    orbit = orbit_from_document(document)
    try:
        model = build_model(orbit.system)
    except OrbitfinderError as error:
        return recorded(document, str(error))
    if (orbit.state.shape, len(orbit.winding)) != ((len(model.state_names),), model.degrees_of_freedom):
        return Verdict([_failed("record", "state or winding does not belong to the system")], False)
    try:
        found = certificate_to_document(certify(orbit, model))
    except OrbitfinderError as error:
        return Verdict([_failed("record", str(error))], False)
    return Verdict(found["checks"], found["passed"])


def _failed(name: str, note: str) -> dict[str, Any]:
    return {"name": name, "value": None, "tolerance": None, "passed": False, "note": note}


def recorded(document: Mapping[str, Any], why: str) -> Verdict:
    """What the file says."""
    found = document.get("certificate")
    listed = found.get("checks") if isinstance(found, Mapping) else None
    checks = [one for one in listed or () if isinstance(one, Mapping)] if isinstance(listed, list) else []
    told = [dict(one) | {"passed": one.get("passed") is True} for one in checks]
    return Verdict(told, False, " ".join(why.split()).rstrip("."))
