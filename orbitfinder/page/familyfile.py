"""The parts of a family.json that the pages show, checked by pydantic."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from orbitfinder.errors import InputError


class _Entry(BaseModel):
    """Unknown keys are left out; NaN and infinity are refused."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)


class _Place(_Entry):
    state: list[float] = Field(min_length=2)
    period: float = Field(gt=0)
    energy: float
    symmetry: str = "none"
    free: dict[str, float] = {}
    arclength: float | None = None


class _Point(_Place):
    value: float
    action: float
    closure: float
    stability: str
    floquet_multipliers: list[tuple[float, float]]


class _Event(_Place):
    kind: str
    parameter: float
    index: int = 0
    detail: str = ""


class _End(_Entry):
    kind: str = ""
    reason: str = ""


class _Family(_Entry):
    name: str
    system: dict[str, Any]
    parameter: str
    points: list[_Point] = Field(min_length=1)
    events: list[_Event]
    ends: list[_End]


def checked_family(document: dict[str, Any], where: str) -> dict[str, Any]:
    """A family document reduced to what the pages show; `InputError` names the first entry that is wrong."""
    try:
        return _Family.model_validate(document).model_dump(exclude_none=True)
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        place = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in fault["loc"]).lstrip(".")
        reason = str(fault["msg"])
        raise InputError(
            f"{where}: {place}: {reason[0].lower() + reason[1:]}, got {repr(fault['input'])[:60]}; "
            "continue the family again"
        ) from None
