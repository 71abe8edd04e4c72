"""The `[system]` table of each kind of system, and what all tables have in common."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

MOST_LINKS = 2000
"""Chains longer than this are refused: their state-transition matrices alone fill the memory."""
MOST_BARS = 40
"""Bars of a linkage; its state-transition matrix has 6 rows per bar."""
LARGEST_NUMBER = 1e300
SIZE = f"must be finite and below {LARGEST_NUMBER:g}"


def _number_or_list(value: Any) -> Any:
    items = value if isinstance(value, list) else [value]
    if not items or any(isinstance(item, bool) or not isinstance(item, (int, float)) for item in items):
        raise PydanticCustomError("numbers", "must be a number or a list with one number per link")
    if any(not abs(item) < LARGEST_NUMBER for item in items):
        raise PydanticCustomError("finite_number", SIZE)
    return value


def _energies(value: Any) -> Any:
    items = value if isinstance(value, list) else [value]
    if not items or any(isinstance(item, bool) or not isinstance(item, (int, float)) for item in items):
        raise PydanticCustomError("numbers", "must be a number or a list of numbers")
    if any(not abs(item) < LARGEST_NUMBER for item in items):
        raise PydanticCustomError("finite_number", SIZE)
    return value


def _printable(text: str) -> str:
    if any(ord(letter) < 32 or ord(letter) == 127 for letter in text):
        raise PydanticCustomError("printable", "must be one line without control characters")
    return text


PerLink = Annotated[float | list[float], BeforeValidator(_number_or_list)]
Energies = Annotated[float | list[float], BeforeValidator(_energies)]
Line = Annotated[str, Field(max_length=300), AfterValidator(_printable)]
Positive = Annotated[float, Field(gt=0)]


class Table(BaseModel):
    """A TOML table: no unknown keys, no silent conversions, no NaN."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class ChainSystem(Table):
    """An n-link pendulum hanging from a fixed joint, angles from the downward vertical."""

    kind: Literal["chain"] = Field(description="which system this is")
    links: int = Field(ge=1, le=MOST_LINKS, description=f"number of links, 1 to {MOST_LINKS}")
    length: PerLink = Field(1.0, description="length of the links in m, positive, one number or one per link")
    mass: PerLink = Field(1.0, description="mass of the links in kg, positive, one number or one per link")
    inertia: PerLink | None = Field(
        None, description="inertia of the links about their centres of mass in kg m^2, m l^2 / 12 when left out"
    )
    com: PerLink = Field(
        0.5, description="centre of mass as a fraction of the length from the upper joint, one number or one per link"
    )
    gravity: float = Field(9.8, description="gravitational acceleration in m/s^2")
    formulation: str = Field("recursive", description="how the equations are derived; the motion is the same")


class LinkageSystem(Table):
    """A closed planar chain of bars between two pivots on the ground, as a native DAE in maximal coordinates."""

    kind: Literal["linkage"] = Field(description="which system this is")
    length: list[Positive] = Field(
        min_length=2, max_length=MOST_BARS,
        description=f"length of the bars in m, positive, 2 to {MOST_BARS} of them; three and the ground are a four-bar",
    )  # fmt: skip
    ground: list[float] = Field(
        min_length=2, max_length=2,
        description="position [x, y] in m of the pivot at the end of the last bar, x down, y right; the first is at 0",
    )  # fmt: skip
    mass: PerLink = Field(1.0, description="mass of the bars in kg, positive, one number or one per bar")
    inertia: PerLink | None = Field(
        None, description="inertia of the bars about their centres of mass in kg m^2, m l^2 / 12 when left out"
    )
    com: PerLink = Field(
        0.5, description="centre of mass as a fraction of the length from the upper joint, one number or one per bar"
    )
    gravity: float = Field(9.8, description="gravitational acceleration in m/s^2")
    baumgarte: list[Positive] = Field(
        [10.0, 10.0], min_length=2, max_length=2,
        description="stabilisation [alpha, beta] of the constraints in 1/s, both positive",
    )  # fmt: skip


class PythonSystem(Table):
    """A system made by a Python function: a built-in one, or with `--trust` any installed or neighbouring module's."""

    kind: Literal["python"] = Field(description="which system this is")
    module: Line = Field(
        "orbitfinder.systems",
        description="the function's module: orbitfinder.systems is always allowed; any other is imported from beside "
        "the file or from what is installed, and only with `--trust`",
    )
    function: Line = Field(description="name of the function, such as henon_heiles; it returns a Model")
    arguments: dict[str, float | int | bool | str | list[float]] = Field(
        {}, description="its arguments by name: numbers (SI units), text or lists of numbers"
    )


SYSTEMS: dict[str, type[Table]] = {"chain": ChainSystem, "linkage": LinkageSystem, "python": PythonSystem}
"""The `[system]` table of each `kind`; a new kind is added here and in `mechanics.catalogue`."""
