"""The problem file as data: every table, key, unit and default, checked by pydantic.

The reference in docs/problem-file.md is generated from this module (`python docs/problem_file.py`).
Sizes that depend on the system (numbers per link, length of a state) are checked where the Model is known.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    create_model,
    model_validator,
)
from pydantic_core import PydanticCustomError

from orbitfinder.errors import closest, shortened
from orbitfinder.mechanics.kind import kinds
from orbitfinder.mechanisms.robot import robot


def _numbers(expected: str) -> Callable[[Any], Any]:
    """A validator: a number or a list of numbers, finite."""

    def check(value: Any) -> Any:
        items = value if isinstance(value, list) else [value]
        if not items or any(isinstance(item, bool) or not isinstance(item, (int, float)) for item in items):
            raise PydanticCustomError("numbers", "must be a number or a list {expected}", {"expected": expected})
        if any(not abs(item) < 1e300 for item in items):
            raise PydanticCustomError("finite_number", "must be finite and below 1e+300")
        return value

    return check


def _printable(text: str) -> str:
    if any(ord(letter) < 32 or ord(letter) == 127 for letter in text):
        raise PydanticCustomError("printable", "must be one line without control characters")
    return text


def _increasing(ends: list[float]) -> list[float]:
    if len(ends) != 2 or not ends[0] < ends[1]:
        what = "must be [smallest, largest] with smallest below largest, got {v}"
        raise PydanticCustomError("range", what, {"v": str(ends)[:60]})
    return ends


PerLink = Annotated[float | list[float], BeforeValidator(_numbers("with one number per link"))]
Energies = Annotated[float | list[float], BeforeValidator(_numbers("of numbers"))]
Line = Annotated[str, Field(max_length=300), AfterValidator(_printable)]
Positive = Annotated[float, Field(gt=0)]
Range = Annotated[list[float], AfterValidator(_increasing)]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Names = list[Line]
Entry = Annotated[float | str, BeforeValidator(lambda value: float(value) if isinstance(value, int) else value)]
Limits = dict[str, Positive | Pair]
Matrix = str | list[list[float]]


class Table(BaseModel):
    """A TOML table: no unknown keys, no silent conversions, no NaN."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


def key(about: str, default: Any = None, **limits: Any) -> Any:
    """A key that may be left out: what it is, its default, and limits of its value."""
    return Field(default, description=about, **limits)


TYPES: dict[str, Any] = {
    "int": int, "float": float, "bool": bool, "str": str, "Numbers": PerLink, "Numbers | None": PerLink | None,
    "Sequence[int]": list[int] | None, "Limits | None": Limits | None,
    "Sequence[str] | str": Names | Literal["all"] | None,
    "Mapping[str, float] | float | None": float | dict[str, float] | None,
    "Mapping[str, float] | None": dict[str, float] | None, "Mapping[str, str] | None": dict[str, str] | None,
    "Mapping[str, str] | Sequence[str] | None": dict[str, str] | Names | None,
    "Sequence[str]": Names | None, "str | None": str | None, "str | float | None": Entry | None,
    "Mapping[str, float] | Sequence[str]": dict[str, float] | Names | None,
    "Sequence[float] | float | None": float | list[float] | None,
}  # fmt: skip
"""What a file takes for what a function takes"""


@cache
def table_of(kind: str, build: Callable[..., Any]) -> type[Table]:
    """The `[system]` table of a function's arguments: their names, defaults, and what its docstring says of them."""
    text, own = inspect.getdoc(build) or "", OWN.get(kind, {})
    said = dict(re.findall(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", text, re.MULTILINE))
    fields: dict[str, Any] = {"kind": (Literal[kind], Field(description="which system this is"))}
    for name, given in inspect.signature(build).parameters.items():
        if name == "units":  # a table of the file itself
            continue
        known = TYPES.get(getattr(given.annotation, "__name__", given.annotation), Any)
        default = ... if given.default is given.empty else None if given.default == () else given.default
        if (taken := own.get(name, (known, default))) is not None:
            about = " ".join(said.get(name, "").split()).rstrip(".")
            fields[name] = (taken[0], Field(taken[1], description=about))
    more = {name: entry for name, entry in own.items() if entry is not None and len(entry) > 2}
    fields |= {name: (taken[0], Field(taken[1], description=taken[2])) for name, taken in more.items()}
    return create_model(f"{kind.title()}System", __base__=Table, __doc__=text.partition("\nArgs:")[0], **fields)


Entries = list[Entry]
TWO_POINTS = "the two points in m, one in each body's own axes, at their origins when left out"


class BodyTable(Table):
    """A body of a mechanism. Numbers may be text that uses a shared parameter, such as "-length / 2"."""

    mass: Entry = Field(description="mass in kg, positive; 0 of a body that only carries others")
    inertia: Entry | Entries = key(
        "about the centre of mass in kg m^2: a number in the plane, xx yy zz (xy xz yz) in space", 0.0
    )
    com: Entries | None = key("centre of mass in the body's axes in m, its origin when left out")
    shape: list[list[float]] | None = key("points of a line that pictures draw, in m")
    disc: Positive | None = key("radius in m of a disc that pictures draw about the centre of mass")


class JointTable(Table):
    """A joint between two bodies, or a body and the ground."""

    kind: str = Field(
        description="in the plane revolute, prismatic, slot (a pin in a straight slot of the first body), fixed, free; "
        "in space revolute, prismatic, cylindrical, universal, spherical, fixed, free; connect (two points), weld: "
        "they only close loops; rod, a bar without mass, in both"
    )
    between: list[str] = Field(min_length=2, max_length=2, description="the two bodies; one may be 'ground'")
    at: list[Entries] | None = key(TWO_POINTS)
    axis: list[float] | Entry | None = key(
        "of a turn (space) or a slide, in the first body's axes; in the plane also an angle in rad"
    )
    axes: list[list[float]] | str | None = key(
        "of a universal joint (two) or a spherical one (three), directions or letters; 'xyz' usually; 'quaternion' "
        "turns a spherical or free joint by a unit quaternion"
    )
    turned: Entry | Entries | None = key(
        "the second body's axes in the first's where the joint is at 0: an angle, or roll pitch yaw"
    )
    length: Entry | None = key("of a rod, in m")
    rotor: Entry | None = key("inertia that turns (kg m^2) or slides (kg) with it in its drive")
    range: list[float] | None = key(
        "from and to where it can go; nothing acts there, orbits beyond are hinted at", min_length=2, max_length=2
    )
    mimics: list[float | str] | None = key(
        "[joint, ratio, offset]: it is that joint times the ratio, plus the offset", min_length=3, max_length=3
    )


class SpringTable(Table):
    """A spring between two points, or in a joint."""

    stiffness: Entry = Field(description="in N/m, in a joint that turns N m/rad")
    between: list[str] | None = key("the two bodies; one may be 'ground'")
    at: list[Entries] | None = key(TWO_POINTS)
    length: Entry = key("length at which it pulls nothing, in m", 0.0)
    joint: str | None = key("instead of between: the coordinate it acts in")
    rest: Entry = key("value of that coordinate at which it pulls nothing, in rad or m", 0.0)


class DamperTable(Table):
    """A damper between two points, or in a joint."""

    damping: Entry = Field(description="in N s/m, in a joint that turns N m s/rad")
    between: list[str] | None = key("the two bodies; one may be 'ground'")
    at: list[Entries] | None = key(TWO_POINTS)
    joint: str | None = key("instead of between: the coordinate it acts in")


class MotorTable(Table):
    """A motor in a joint, torque + amplitude cos(frequency t + phase); its torque is the parameter of its name, and a
    control where neither is given.
    """

    joint: str = Field(description="the coordinate it acts in")
    torque: float = key("steady torque in N m, or force in N", 0.0)
    amplitude: Entry = key("amplitude of what varies, in N m or N", 0.0)
    phase: Entry = key("in rad", 0.0)
    limit: Positive | Pair | None = key(
        "how far a motor that is a control (without torque and amplitude) may go, in N m or N"
    )


class ElementTable(Table):
    """A nonlinear element of a structure, between a coordinate and the ground or another one: see `of.structure`."""

    kind: str = Field(description="cubic, stop, gap or friction")
    at: str = Field(description="a coordinate")
    to: str | None = key("another one; the ground when left out")
    stiffness: Entry | None = key("of a cubic spring in N/m^3, of contacts in N/m")
    gap: Entry | None = key("of contacts: how far it may go freely, in m")
    side: Literal[1, -1] | None = key("of a stop: towards which side it stops, 1 when left out")
    limit: Entry | None = key("of dry friction: the force in N")
    smoothing: Entry | None = key("of contacts in m, of friction in m/s: over how much their corner is smooth")


class LoadTable(Table):
    """The harmonic load of a structure, amplitude cos(frequency t + phase)."""

    at: str | dict[str, float] = Field(description="a coordinate, or several with their shares")
    amplitude: Entry = Field(description="in N")
    frequency: Entry = Field(description="in rad/s")
    phase: float = key("in rad", 0.0)


class MotionTable(Table):
    """A prescribed motion of a joint, offset + turns frequency t + amplitude cos(frequency t + phase)."""

    joint: str = Field(description="the coordinate that is moved, and is none any more")
    offset: Entry = key("in rad or m", 0.0)
    amplitude: Entry = key("in rad or m", 0.0)
    phase: Entry = key("in rad", 0.0)
    turns: float = key("whole turns in a period of the forcing", 0.0)


class PythonSystem(Table):
    """A system made by a Python function: a built-in one, or with `--trust` any installed or neighbouring module's."""

    kind: Literal["python"] = Field(description="which system this is")
    module: Line = key(
        "the function's module: orbitfinder.systems is always allowed; any other is imported from beside the file or "
        "from what is installed, and only with `--trust`",
        "orbitfinder.systems",
    )
    function: Line = Field(description="name of the function, such as henon_heiles; it returns a Model")
    arguments: dict[str, float | int | bool | str | list[float]] = key(
        "its arguments by name: numbers (SI units), text or lists of numbers", {}
    )
    cycle: list[Line] | None = key(
        "hybrid systems: the events of one period in their order, such as ['strike', 'strike'] for two steps; the "
        "system's own when left out",
    )
    scales: dict[str, Positive] | None = key(
        "sizes to measure in, where the motion does not show them: `length` of all coordinates that are no angles, "
        "coordinates or physical parameters by name, such as `{ length = 2e-6 }`",
    )
    controls: list[Line] | None = key("physical parameters that may vary in time; the system's own when left out")
    limits: Limits | None = key(
        "how far controls may go: the greatest magnitude, or [lowest, highest], by name, such as { torque1 = 5.0 }"
    )


OWN: dict[str, dict[str, tuple[Any, ...] | None]] = {
    "mechanism": {
        "bodies": (dict[str, BodyTable], ...), "joints": (dict[str, JointTable], ...),
        "springs": (dict[str, SpringTable] | None, None), "dampers": (dict[str, DamperTable] | None, None),
        "motors": (dict[str, MotorTable] | None, None), "motions": (dict[str, MotionTable] | None, None),
        "gravity": (list[float] | None, None), "dimension": (Literal[2, 3], 2), "frequency": (Positive | None, None),
        "parameters": (dict[str, float] | None, None), "redundant": (Literal["refuse", "drop"], "refuse"),
        "baumgarte": (Annotated[list[Positive], Field(min_length=2, max_length=2)] | None, None),
        "values": None, "scales": None, "drawn": (dict[str, str | dict[str, list[float | str]]] | None, None),
        "independent": (list[str] | None, None, "solve in these coordinates, as many as degrees of freedom, instead of "
                        "as a native DAE"),
    },
    "robot": {"file": (Line, ...)},
    "structure": {
        "mass": (Matrix, ...), "damping": (Matrix | None, None), "stiffness": (Matrix, ...),
        "elements": (dict[str, ElementTable] | None, None), "forcing": (LoadTable | None, None),
    },
    **{name: {"path": None, "file": (Line, ..., f"the {word} file, in the folder of the problem file"),
              "parameters": (dict[str, float] | None, None, "other values of its parameters")}
       for name, word in (("xpp", "XPPAUT"), ("sbml", "SBML"))},
    "chain": {"links": (Annotated[int, Field(ge=1, le=2000)], ...)},  # the matrices of longer ones fill the memory
    "linkage": {
        "length": (Annotated[list[Positive], Field(min_length=2, max_length=40)], ...),
        "ground": (Annotated[list[float], Field(min_length=2, max_length=2)], ...),
        "baumgarte": (Annotated[list[Positive], Field(min_length=2, max_length=2)] | None, None),
        "independent": (list[int] | None, None, "bars whose angles are the coordinates, n - 2 of them: the linkage in "
                        "minimal coordinates"),
        "branch": (Literal[1, -1], 1, "with independent: the sign of sin(theta_j - theta_i) of the other bars i < j"),
    },
}  # fmt: skip
"""Type and default that files take for arguments where that is not what Python takes, None of what they do not take; of
what is no argument also the description"""


def systems() -> dict[str, type[Table]]:
    """The `[system]` table of each `kind`: of what its function takes, see `mechanics.kind.KINDS`."""
    made = {name: table_of(name, kind.takes) for name, kind in kinds().items() if kind.takes}
    return made | {"robot": table_of("robot", robot), "python": PythonSystem}


def check_name(name: str) -> str:
    """A name that is safe as a folder: letters, digits, -, _ and ., not starting with a dot."""
    if not re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,99}", name) or ".." in name:
        raise PydanticCustomError(
            "name", "must consist of letters, digits, -, _ and ., must not start with . nor contain .., at most 100"
        )
    return name


Name = Annotated[str, AfterValidator(check_name)]
Mode = Annotated[int, Field(ge=1)] | Annotated[list[Annotated[int, Field(ge=1)]], Field(min_length=1, max_length=20)]
Amplitude = Positive | Annotated[list[float], Field(min_length=1, max_length=20)]


def _system_of_its_kind(value: Any) -> Any:
    if not isinstance(value, Mapping):
        raise PydanticCustomError("table", "must be a table")
    kind, known = value.get("kind"), ", ".join(map(repr, systems()))
    if "kind" not in value:
        raise PydanticCustomError("kind", "missing; use one of {known}", {"known": known})
    if kind not in list(systems()):
        hint = closest(str(kind), systems())
        raise PydanticCustomError(
            "kind", "unknown {kind}{hint}; use one of {known}", {"kind": repr(kind), "hint": hint, "known": known}
        )
    return systems()[str(kind)].model_validate(value)


class GuessTable(Table):
    """Where the search starts: `state` with `period` or `duration`, `mode` with `amplitude`, or one of the others."""

    state: list[float] | None = key("state at t = 0: the n angles in rad, then the n rates in rad/s")
    period: Positive | None = key(
        "period in s, positive; goes with state; without it a state is where `equilibria` starts, and the period of a "
        "forced system is its forcing's"
    )
    duration: Positive | None = key(
        "instead of period: simulate from state this long in s and start from the closest return"
    )
    mode: Mode | None = key(
        "number of a linear normal mode of the equilibrium at 0, the slowest is 1, or a list of them"
    )
    amplitude: Amplitude | None = key(
        "largest angle (or coordinate) of the mode in rad (or m), positive; goes with mode; for a list of modes a "
        "list, entries may be negative",
    )
    free: dict[str, float] = key(
        "where freed physical parameters start, such as { length3 = 1.2 }; the system's own when left out", {}
    )
    csv: str | None = key(
        "trajectory over one period, a CSV file in the problem file's folder with columns t (s), angles (rad), rates "
        "(rad/s); a header line is allowed",
    )
    catalogue: str | None = key(
        "published states, a CSV file in the problem file's folder whose header names its columns: name, period in s, "
        "states and physical parameters; states without a column are 0; `run` takes all rows, other commands the "
        "first, or that of FILE#NAME"
    )
    linear: Literal[True] | None = key("driven systems: the periodic response of the equations linearised about rest")
    angles: dict[str, float] | None = key(
        "linkages: some link angles at t = 0 in rad, such as { theta1 = 0.6 }, as many as degrees of freedom; the rest"
        " follows by assembly; mechanisms: coordinates in rad or m; period is the first return when left out",
    )
    branch: Literal[1, -1] | None = key(
        "linkages: which of the two assemblies, the sign of sin(theta_j - theta_i) of the other bars"
    )
    rates: dict[str, float] | None = key(
        "linkages, mechanisms: some rates at t = 0, such as { theta1dot = 2.0 }; at rest when left out"
    )
    equilibrium: list[float] | str | None = key(
        "coordinates near the equilibrium of the mode, or the name of a landmark such as L1; when left out the one at "
        "0, of a linkage (link angles) the lowest",
    )

    @model_validator(mode="after")
    def _one_form(self) -> GuessTable:
        given = [
            name
            for name in ("state", "mode", "csv", "catalogue", "angles", "linear")
            if getattr(self, name) is not None
        ]
        if len(given) != 1:
            forms = " and ".join(given) or "none of them"
            raise PydanticCustomError(
                "guess",
                "give exactly one of state (with period), mode (with amplitude), angles, linear, csv or catalogue, "
                "not {f}",
                {"f": forms},
            )
        if self.duration is not None and (self.state is None or self.period is not None):
            raise PydanticCustomError("guess", "duration goes with state and takes the place of period")
        if self.linear and self.period is not None:
            raise PydanticCustomError("guess", "period has no meaning beside linear, the drive has one; leave it out")
        timed = "period" if self.duration is None else "duration"
        for name, partner in (("state", timed), ("mode", "amplitude")):
            if partner == "period" and (self.angles is not None or self.state is not None):
                continue
            if (getattr(self, name) is None) != (getattr(self, partner) is None):
                raise PydanticCustomError("guess", "{a} goes with {b}; give both or neither", {"a": name, "b": partner})
        return self


class FindTable(Table):
    """Which orbit is meant, and how closely it must close."""

    pin: dict[str, float] | None = key(
        "the number that selects one orbit of its family: energy in J (potential zero at the fixed joint), period in "
        "s, or a state component at t = 0 such as theta1, and beside it values of physical parameters; when left out, "
        "the orbit nearest to the guess",
    )
    symmetry: Line = key(
        "symmetry imposed on the orbit: none, brake, reflection, reversal (q(-t) = -q(t), running orbits included), "
        "brake+reflection, or one that the system declares or has (mirror of restricted_three_body); of a hybrid "
        "system one that takes half of the events of its cycle to the other half",
        "none",
    )
    winding: list[int] | None = key("whole turns of each coordinate in one period, one whole number per coordinate")
    relative: list[str] = key(
        'cyclic coordinates along which the orbit comes back shifted by what is found, such as ["phi"]; each leaves '
        "room for one pin more, such as its momentum, momentum_phi",
        [],
    )
    method: str | None = key(
        "shooting, collocation for what is stiff, balance for what is driven; when left out, by a measured stiffness"
    )
    segments: int | None = key("shooting segments, at least 1; chosen automatically when left out", ge=1, le=1000)
    tolerance: float = key(
        "closure that the certificate asks for, in extents of the motion, times what errors grow by; larger than 1e-12"
        " buys nothing",
        1e-12,
        gt=0,
        le=1e-6,
    )
    free: list[str] = key('physical parameters that the solver may change, such as ["length3"]', [])
    objective: Literal["nearest", "min_instability", "max_amplitude", "min_peak_rate"] = key(
        "what chooses among the orbits that the pins leave: nearest to the guess, min_instability (smallest spectral "
        "radius of the monodromy), max_amplitude (largest value of a coordinate) or min_peak_rate (smallest peak of "
        "its rate); the last two not of hybrid systems",
        "nearest",
    )
    coordinate: str | None = key(
        "the coordinate of max_amplitude or min_peak_rate, such as theta2; the one that moves most when left out"
    )
    bounds: dict[str, Range] = key(
        "ranges [smallest, largest] of the period (s), the energy (J), freed parameters or state components at t = 0, "
        "such as { period = [1.5, 3.0], length3 = [0.5, 2.0] }",
        {},
    )
    starts: int = key(
        "searches for min_instability at a pinned energy with nothing free, where the orbits stand alone and the least"
        " unstable of those found in bounds.period is taken",
        200,
        ge=1,
        le=100_000,
    )
    seed: int = key("seed of those searches; the same seed gives the same orbit", 0, ge=0)


class SearchTable(Table):
    """What `orbitfinder search` looks for."""

    period: Annotated[list[Positive], Field(min_length=2, max_length=2), AfterValidator(_increasing)] = Field(
        description="smallest and largest minimal period wanted, in s"
    )
    energy: Energies | None = key(
        "energy of the orbits wanted in J, one number or a list; find.pin.energy when left out"
    )
    section: dict[str, Range] = Field(
        {}, description="hybrid systems: ranges of the state right after the event that ends the cycle, by component, "
        "such as `{ v = [-1.5, 0.0], phase = [0.0, 6.2832] }`; others follow from the event"
    )  # fmt: skip
    cycles: int = key("hybrid systems: how many cycles an orbit goes through at most", 3, ge=1, le=64)


class SimulateTable(Table):
    """What `orbitfinder simulate` does."""

    duration: Positive | None = key("time to simulate in s, 10 s when left out")
    state: list[float] | None = key("state at t = 0: angles in rad, then rates in rad/s; the guess when left out")


class ExpectedNumber(Table):
    """A number known from elsewhere."""

    value: float = Field(description="the number expected, in SI units")
    tolerance: Positive = Field(description="largest difference allowed, positive, in the same unit")


class ExpectedTable(Table):
    """Numbers that the orbit must reproduce; the certificate fails when it does not."""

    period: ExpectedNumber | None = key("minimal period in s, as { value, tolerance }")
    energy: ExpectedNumber | None = key("total energy in J, as { value, tolerance }")
    action: ExpectedNumber | None = key("integral of p dq in J s, as { value, tolerance }")
    parameters: dict[str, ExpectedNumber] = key(
        "freed physical parameters by name, as { length3 = { value, tolerance } }", {}
    )
    shift: dict[str, ExpectedNumber] = key(
        "shifts of a relative orbit in a period by name, as { phi = { value, tolerance } }", {}
    )


class TaskTable(Table):
    """What a controlled motion must do: an expression at a phase, always, or on average."""

    expression: Line = Field(
        description="text of states, controls, physical parameters and the period, such as 'cos(theta1) - 0.5'"
    )
    at: float | Literal["always", "mean"] = key(
        "a phase of the period, 0 to below 1; always; or mean, the average over the period", "always"
    )
    equals: float | None = key("the value asked for; not with lowest and highest")
    lowest: float | None = key("the least value allowed")
    highest: float | None = key("the largest value allowed")


class ControlTable(Table):
    """How the controls vary in time: in which form, at what cost, doing what."""

    cost: Line = Field(
        description="what is integrated over the period: text of states, controls and parameters by name, with "
        "+ - * / **, sin, cos, tan, sqrt, exp, log, tanh, atan2 and pi, such as 'torque1**2'"
    )
    average: bool = key("whether the mean is meant instead of the integral", False)
    final: str = key("a cost that is no integral: of the state at t = 0, parameters and the period", "")
    shape: Literal["zero-order", "linear", "cubic", "fourier"] = key(
        "held in each interval, linear or cubic (spline) between them, or a Fourier series", "linear"
    )
    intervals: int = key("intervals of the period, of a hybrid system of each arc", 20)
    harmonics: int = key("of a Fourier series, beside its constant", 5)
    method: Literal["shooting", "collocation"] = key("how intervals are integrated", "shooting")
    guess: dict[str, float | list[float]] = key(
        "where coefficients start, by control, one number or all of them: in the order of time, of a Fourier series "
        "constant, cos 1, sin 1, cos 2, sin 2, ...; 0 when left out",
        {},
    )
    numbers: dict[str, float] = key("named numbers that cost and tasks may mention, such as { weight = 0.1 }", {})
    task: list[TaskTable] = key("what the motion must do, each as [[control.task]]", [])


class ProblemTable(Table):
    """The whole file."""

    name: Name | None = key(
        "name of the orbit and of its output folder: letters, digits, -, _ and . (not starting with a dot); the file's"
        " own name when left out",
    )
    title: Line = key("one line for figures and pages", "")
    source: Line = key("where the problem or its numbers come from", "")
    system: Annotated[Any, BeforeValidator(_system_of_its_kind)] = Field(description="the mechanical system")
    guess: GuessTable | None = key("where the search starts")
    find: FindTable = key("which orbit is meant", FindTable())
    control: ControlTable | None = key("how controls vary in time; the motion of least cost")
    watch: dict[str, Line] = Field(
        {}, description="numbers of each orbit of a family by name: text of states, parameters, the period and max(), "
        "min() and mean() over the motion, amplitude(x, k) and phase(x, k) of harmonics, such as peak = 'max(theta1)'; "
        "`continue --stop peak=1.5` ends there",
    )  # fmt: skip
    units: dict[str, Line] = key(
        "words for the units of time, length, mass, angle, or of a state or parameter by name, such as time = 'ms' or "
        "V = 'mV', for texts, tables and pictures; nothing is converted",
        {},
    )
    search: SearchTable | None = key("what `orbitfinder search` looks for")
    simulate: SimulateTable = key("what `orbitfinder simulate` does", SimulateTable())
    expected: ExpectedTable = key("numbers that the orbit must reproduce", ExpectedTable())

    @model_validator(mode="after")
    def _something_to_do(self) -> ProblemTable:
        if self.guess is None and self.search is None and self.simulate.state is None:
            raise PydanticCustomError(
                "guess", "guess is missing; add a [guess] table with state and period, mode and amplitude, or csv"
            )
        return self


PYDANTIC = re.compile(r"(constrained-|function-|list\[|dict\[).*|float|int|bool|str")
"""What pydantic puts into the place of a fault where a value may be of several kinds."""


def sentence(fault: Mapping[str, Any], document: Mapping[str, Any]) -> str:
    """One pydantic fault as field, value and remedy."""
    names = [str(part) for part in fault["loc"] if not PYDANTIC.fullmatch(str(part))]
    table, description = _table_and_description(names, document)
    where = ".".join(names) or "file"
    if fault["type"] == "extra_forbidden":
        known = list(table.model_fields) if table else []
        return f"{where}: unknown key{closest(names[-1], known)}; use one of {', '.join(known)}"
    if fault["type"] == "missing":
        return f"{where}: missing; give {description}"
    if fault["type"] == "kind":
        return f"{where}.kind: {fault['msg']}"
    if fault["type"] == "name":
        return f"{where}: {fault['msg']}, got {shortened(repr(fault['input']))}; choose another name"
    if fault["type"] == "range":
        return f"{where}: {fault['msg']}"
    if fault["type"] == "guess" or not description:
        return f"{where}: {fault['msg']}" if names else str(fault["msg"]).replace(" is missing;", ": missing;")
    if fault["type"] == "finite_number":
        rule = fault["msg"] if str(fault["msg"]).startswith("must") else "must be finite"
        return f"{where}: {rule}, got {shortened(repr(fault['input']))}; replace NaN and infinity by numbers"
    reason = re.sub(r"^(Input|List|String|Dictionary) should", "must", str(fault["msg"]))
    if fault["type"] in ("model_type", "dict_type"):
        reason = "must be a table"
    return f"{where}: {reason[0].lower() + reason[1:]}, got {shortened(repr(fault['input']))}; expected {description}"


def _table_and_description(names: list[str], document: Mapping[str, Any]) -> tuple[type[BaseModel] | None, str]:
    """The table that the last key belongs to, and the description of the nearest described key."""
    table: type[BaseModel] | None = ProblemTable
    description = ""
    for depth, name in enumerate(names):
        if table is None or name not in table.model_fields:
            break
        entry = table.model_fields[name]
        description = entry.description or ""
        if depth + 1 < len(names):
            table = _nested(name, entry.annotation, document) or table
    return table, description


def _nested(name: str, annotation: Any, document: Mapping[str, Any]) -> type[BaseModel] | None:
    if name == "system":
        system = document.get("system")
        return systems().get(str(system.get("kind"))) if isinstance(system, Mapping) else None
    candidates = [annotation, *getattr(annotation, "__args__", ())]
    tables = [candidate for candidate in candidates if isinstance(candidate, type) and issubclass(candidate, BaseModel)]
    return tables[0] if tables else None
