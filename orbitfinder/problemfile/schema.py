"""The problem file as data: every table, key, unit and default, checked by pydantic.

The reference in docs/problem-file.md is generated from this module (`python -m orbitfinder.problemfile.reference`).
Sizes that depend on the system (numbers per link, length of a state) are checked where the Model is known.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, model_validator
from pydantic_core import PydanticCustomError

from orbitfinder.errors import closest
from orbitfinder.problemfile.systems import SYSTEMS as SYSTEMS
from orbitfinder.problemfile.systems import Energies, Line, Positive, Table

MOST_SEGMENTS = 1000
USUAL_SYMMETRIES = ("none", "brake", "reflection", "reversal", "brake+reflection")
"""Those that need no declaration by the system"""


def check_name(name: str) -> str:
    """A name that is safe as a folder: letters, digits, -, _ and ., not starting with a dot."""
    if not re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,99}", name) or ".." in name:
        raise PydanticCustomError(
            "name", "must consist of letters, digits, -, _ and ., must not start with . nor contain .., at most 100"
        )
    return name


def _known_symmetry(name: str, info: ValidationInfo) -> str:
    """A usual symmetry; of a system made by Python, whose Model may declare others, any: the Problem will tell."""
    if name not in USUAL_SYMMETRIES and not (info.context or {}).get("declares"):
        known = ", ".join(f"'{one}'" for one in USUAL_SYMMETRIES[:-1])
        raise PydanticCustomError("literal_error", f"Input should be {known} or '{USUAL_SYMMETRIES[-1]}'")  # type: ignore[misc]
    return name


Name = Annotated[str, AfterValidator(check_name)]
Mode = Annotated[int, Field(ge=1)] | Annotated[list[Annotated[int, Field(ge=1)]], Field(min_length=1, max_length=20)]
Amplitude = Positive | Annotated[list[float], Field(min_length=1, max_length=20)]


def _system_of_its_kind(value: Any) -> Any:
    if not isinstance(value, Mapping):
        raise PydanticCustomError("table", "must be a table")
    kind, known = value.get("kind"), ", ".join(map(repr, SYSTEMS))
    if "kind" not in value:
        raise PydanticCustomError("kind", "missing; use one of {known}", {"known": known})
    if kind not in list(SYSTEMS):
        hint = closest(str(kind), SYSTEMS)
        raise PydanticCustomError(
            "kind", "unknown {kind}{hint}; use one of {known}", {"kind": repr(kind), "hint": hint, "known": known}
        )
    return SYSTEMS[str(kind)].model_validate(value)


class GuessTable(Table):
    """Where the search starts: `state` and `period`, `state` and `duration`, `mode` and `amplitude`, or `csv`."""

    state: list[float] | None = Field(
        None, description="state at t = 0: the n angles in rad, then the n rates in rad/s"
    )
    period: Positive | None = Field(None, description="period in s, positive; goes with state")
    duration: Positive | None = Field(
        None, description="instead of period: simulate from state this long in s and start from the closest return"
    )
    mode: Mode | None = Field(
        None,
        description="number of a linear normal mode of the equilibrium at 0, the slowest is 1, or a list of them",
    )
    amplitude: Amplitude | None = Field(
        None,
        description="largest angle (or coordinate) of the mode in rad (or m), positive; goes with mode; "
        "for a list of modes a list, entries may be negative",
    )
    csv: str | None = Field(
        None,
        description="trajectory over one period, a CSV file in the problem file's folder "
        "with columns t (s), angles (rad), rates (rad/s); a header line is allowed",
    )

    angles: dict[str, float] | None = Field(
        None,
        description="linkages: some link angles at t = 0 in rad, such as { theta1 = 0.6 }, as many as degrees of "
        "freedom; the rest follows by assembly",
    )
    branch: Literal[1, -1] | None = Field(
        None, description="linkages: which of the two assemblies, the sign of sin(theta_j - theta_i) of the other bars"
    )
    rates: dict[str, float] | None = Field(
        None, description="linkages: some rates at t = 0 in rad/s, such as { theta1dot = 2.0 }; at rest when left out"
    )
    equilibrium: list[float] | None = Field(
        None, description="linkages: link angles near the equilibrium of the mode, the lowest one when left out"
    )

    @model_validator(mode="after")
    def _one_form(self) -> GuessTable:
        given = [name for name in ("state", "mode", "csv", "angles") if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(given) or "none of them"
            raise PydanticCustomError(
                "guess",
                "give exactly one of state (with period), mode (with amplitude), angles or csv, not {f}",
                {"f": found},
            )
        if self.duration is not None and (self.state is None or self.period is not None):
            raise PydanticCustomError("guess", "duration goes with state and takes the place of period")
        timed = "period" if self.duration is None else "duration"
        for name, partner in (("state", timed), ("mode", "amplitude")):
            if (getattr(self, name) is None) != (getattr(self, partner) is None):
                raise PydanticCustomError("guess", "{a} goes with {b}; give both or neither", {"a": name, "b": partner})
        return self


class FindTable(Table):
    """Which orbit is meant, and how closely it must close."""

    pin: dict[str, float] | None = Field(
        None,
        description="the number that selects one orbit of its family: energy in J (potential zero at the fixed "
        "joint), period in s, or a state component at t = 0 such as theta1; "
        "when left out, the orbit nearest to the guess",
    )
    symmetry: Annotated[str, AfterValidator(_known_symmetry)] = Field(
        "none",
        description="symmetry imposed on the orbit: none, brake, reflection, reversal (q(-t) = -q(t), running orbits "
        "included), brake+reflection, or one that a Python system declares (mirror of restricted_three_body)",
    )
    winding: list[int] | None = Field(
        None, description="whole turns of each coordinate in one period, one whole number per coordinate"
    )
    segments: int | None = Field(
        None, ge=1, le=MOST_SEGMENTS, description="shooting segments, at least 1; chosen automatically when left out"
    )
    tolerance: float = Field(
        1e-12,
        gt=0,
        le=1e-6,
        description="closure that the certificate asks for, in extents of the motion, times what errors grow by; "
        "larger than 1e-12 buys nothing",
    )
    free: list[str] = Field([], description='physical parameters that the solver may change, such as ["length3"]')
    objective: Literal["nearest", "min_instability", "max_amplitude", "min_peak_rate"] = Field(
        "nearest",
        description="what chooses among the orbits that the pins leave: nearest to the guess, min_instability "
        "(smallest spectral radius of the monodromy), max_amplitude (largest value of a coordinate) or min_peak_rate "
        "(smallest peak of its rate)",
    )
    coordinate: str | None = Field(
        None,
        description="the coordinate of max_amplitude or min_peak_rate, such as theta2; the one that moves most when "
        "left out",
    )
    bounds: dict[str, list[float]] = Field(
        {},
        description="ranges [smallest, largest] of the period (s), the energy (J), freed parameters or state "
        "components at t = 0, such as { period = [1.5, 3.0], length3 = [0.5, 2.0] }",
    )
    starts: int = Field(
        200, ge=1, le=100_000,
        description="searches for min_instability at a pinned energy with nothing free, where the orbits stand alone "
        "and the least unstable of those found in bounds.period is taken",
    )  # fmt: skip
    seed: int = Field(0, ge=0, description="seed of those searches; the same seed gives the same orbit")

    @model_validator(mode="after")
    def _ranges(self) -> FindTable:
        for name, ends in self.bounds.items():
            if len(ends) != 2 or not ends[0] < ends[1]:
                raise PydanticCustomError(
                    "period", "bounds.{n}: must be [smallest, largest] with smallest below largest, got {v}",
                    {"n": name, "v": str(ends)[:60]},
                )  # fmt: skip
        return self


class SearchTable(Table):
    """What `orbitfinder search` looks for."""

    period: list[Positive] = Field(
        min_length=2, max_length=2, description="smallest and largest minimal period wanted, in s"
    )
    energy: Energies | None = Field(
        None, description="energy of the orbits wanted in J, one number or a list; find.pin.energy when left out"
    )

    @model_validator(mode="after")
    def _ordered(self) -> SearchTable:
        if self.period[0] >= self.period[1]:
            raise PydanticCustomError(
                "period", "period: must be [smallest, largest] with smallest below largest, got {v}",
                {"v": str(self.period)},
            )  # fmt: skip
        return self


class SimulateTable(Table):
    """What `orbitfinder simulate` does."""

    duration: Positive | None = Field(None, description="time to simulate in s, 10 s when left out")
    state: list[float] | None = Field(
        None, description="state at t = 0: angles in rad, then rates in rad/s; the guess when left out"
    )


class ExpectedNumber(Table):
    """A number known from elsewhere."""

    value: float = Field(description="the number expected, in SI units")
    tolerance: Positive = Field(description="largest difference allowed, positive, in the same unit")


class ExpectedTable(Table):
    """Numbers that the orbit must reproduce; the certificate fails when it does not."""

    period: ExpectedNumber | None = Field(None, description="minimal period in s, as { value, tolerance }")
    energy: ExpectedNumber | None = Field(None, description="total energy in J, as { value, tolerance }")
    action: ExpectedNumber | None = Field(None, description="integral of p dq in J s, as { value, tolerance }")
    parameters: dict[str, ExpectedNumber] = Field(
        {}, description="freed physical parameters by name, as { length3 = { value, tolerance } }"
    )


class ProblemTable(Table):
    """The whole file."""

    name: Name | None = Field(
        None,
        description="name of the orbit and of its output folder: letters, digits, -, _ and . "
        "(not starting with a dot); the file's own name when left out",
    )
    title: Line = Field("", description="one line for figures and pages")
    source: Line = Field("", description="where the problem or its numbers come from")
    system: Annotated[Any, BeforeValidator(_system_of_its_kind)] = Field(description="the mechanical system")
    guess: GuessTable | None = Field(None, description="where the search starts")
    find: FindTable = Field(FindTable(), description="which orbit is meant")
    search: SearchTable | None = Field(None, description="what `orbitfinder search` looks for")
    simulate: SimulateTable = Field(SimulateTable(), description="what `orbitfinder simulate` does")
    expected: ExpectedTable = Field(ExpectedTable(), description="numbers that the orbit must reproduce")

    @model_validator(mode="after")
    def _something_to_do(self) -> ProblemTable:
        if self.guess is None and self.search is None and self.simulate.state is None:
            raise PydanticCustomError(
                "guess", "guess is missing; add a [guess] table with state and period, mode and amplitude, or csv"
            )
        return self
