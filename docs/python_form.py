"""A problem file as the Python program that builds and finds the same: what the gallery shows beside each file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from orbitfinder.mechanics.kind import BUILT_IN
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.guesses.modes import rest_near
from orbitfinder.problemfile.read import ProblemFile

FIRST = {
    "chain": ("links",),
    "linkage": ("length",),
    "mechanism": ("bodies", "joints"),
    "robot": ("file",),
    "equations": (),
    "structure": ("mass", "damping", "stiffness"),
}
"""What each function that makes a system takes first; the rest is given by name"""
BEYOND = ("controls", "limits", "cycle", "scales")
"""What a file says of a built-in system that its function does not take"""


class Code(str):
    """Text that is Python already."""

    __slots__ = ()


def python_form(loaded: ProblemFile) -> str:
    """The program, one statement a line (a formatter wraps them); of a file without a guess it ends with the model."""
    system, document = loaded.document["system"], dict(loaded.document)
    if "catalogue" in document.get("guess", {}):  # a row of it, as a file would state it
        guess = loaded.wanted.guess
        document |= {
            "guess": {"state": guess.state.tolist(), "period": guess.period},
            "name": loaded.name,
        }
    lines = ["import orbitfinder as of"]
    if needs_description(system):
        lines.append("from orbitfinder.mechanics.kind import build_model")
    lines += ["", f"model = {system_call(system)}"]
    if loaded.problem is not None:
        lines += [
            *guess_lines(document["guess"], loaded.model),
            *problem_lines(document),
        ]
    return "\n".join(lines) + "\n"


def needs_description(system: Mapping[str, Any]) -> bool:
    """True where a built-in system is given more than its function takes."""
    return system["kind"] == "python" and any(key in system for key in BEYOND)


def system_call(system: Mapping[str, Any]) -> str:
    """The call that makes the Model of a `[system]` table."""
    kind = system["kind"]
    if needs_description(system):
        return call("build_model", [{"module": BUILT_IN, **system}])
    if kind == "python":
        return call(f"of.systems.{system['function']}", [], system.get("arguments", {}))
    rest = {
        key: value
        for key, value in system.items()
        if key not in ("kind", "independent", *FIRST[kind])
    }
    made = call(f"of.{kind}", [system.get(key) for key in FIRST[kind]], rest)
    if "independent" in system:
        return call(f"of.linkages.minimal_{kind}", [Code(made), system["independent"]])
    return made


def guess_lines(given: Mapping[str, Any], model: Model) -> list[str]:
    """The statements that make the Guess of a `[guess]` table, in the order in which the reader takes its keys."""
    kind = model.system.get("kind")
    closed = model.constraint is not None and kind in ("linkage", "mechanism")
    if closed or "angles" in given:
        return closed_guess(given, model, kind == "mechanism")
    if given.get("linear"):
        return [f"guess = {call('of.guesses.linear_response', [Code('model')])}"]
    if isinstance(given.get("mode"), int):
        return [f"guess = {call('of.guesses.normal_mode', mode(given, model))}"]
    if "mode" in given:
        return [f"guess = {call('of.guesses.normal_mode_sum', mode(given, model))}"]
    if "period" in given:
        return [f"guess = {call('of.Guess', [given['state'], given['period']])}"]
    found = call("of.guesses.recurrences", [Code("model"), given["state"], given["duration"]])
    return [f"guess = {found}[0].guess"]


def mode(given: Mapping[str, Any], model: Model) -> list[Any]:
    """The arguments of a normal mode, the equilibrium in coordinates."""
    at = given.get("equilibrium")
    if at is None:
        return [Code("model"), given["mode"], given["amplitude"]]
    near = model.landmarks[at] if isinstance(at, str) else at
    rest = near if model.rates is not None else rest_near(model, near).tolist()
    return [Code("model"), given["mode"], given["amplitude"], rest]


def closed_guess(given: Mapping[str, Any], model: Model, drawn: bool) -> list[str]:
    """The same of a linkage, or of a mechanism (`drawn`): by a mode, or assembled."""
    if "mode" in given:
        near = given.get("equilibrium")
        rest = (
            [Code(call("of.linkages.linkage_equilibrium", [Code("model"), near]))]
            if near is not None
            else []
        )
        if near is not None and drawn:
            half = model.degrees_of_freedom
            near = Code(
                f"{call('of.linkages.mechanism_state', [Code('model')], {'near': near})}[:{half}]"
            )
            rest = [Code(call("of.linkages.linkage_equilibrium", [Code("model"), near]))]
        found = call(
            "of.linkages.linkage_mode", [Code("model"), given["mode"], given["amplitude"], *rest]
        )
        lines = [f"guess = {found}"]
        return (
            [*lines, f"guess = of.Guess(guess.state, {given['period']})"]
            if "period" in given
            else lines
        )
    return [
        *assembled(given, drawn),
        f"guess = {call('of.Guess', [Code('state'), returned(given, model)])}",
    ]


def assembled(given: Mapping[str, Any], drawn: bool) -> list[str]:
    """The statements that make `state`."""
    if "angles" not in given:
        return [f"state = {call('of.linkages.maximal_states', [Code('model'), given['state']])}"]
    angles, rates = given["angles"], given.get("rates")
    if drawn:
        more = [] if rates is None else [rates]
        return [f"state = {call('of.linkages.mechanism_state', [Code('model'), angles, *more])}"]
    branch = {"branch": given["branch"]} if "branch" in given else {}
    lines = [f"angles = {call('of.linkages.assemble', [Code('model'), angles], branch)}"]
    moving = [Code("angles")]
    if rates:
        lines.append(
            f"rates = {call('of.linkages.linkage_rates', [Code('model'), Code('angles'), rates])}"
        )
        moving.append(Code("rates"))
    return [*lines, f"state = {call('of.linkages.linkage_state', [Code('model'), *moving])}"]


def returned(given: Mapping[str, Any], model: Model) -> Any:
    """The period: as given, that of the forcing, or the first return."""
    if "period" in given:
        return given["period"]
    if model.forcing_period is not None:
        return float(model.forcing_period(model.parameter_values))
    span = [given["duration"]] if "duration" in given else []
    return Code(call("of.linkages.first_return", [Code("model"), Code("state"), *span]))


def problem_lines(document: Mapping[str, Any]) -> list[str]:
    """The statements that make the Problem, find its orbit and print what it is."""
    find = dict(document.get("find", {}))
    named: dict[str, Any] = {}
    if pins := find.pop("pin", {}):
        named["pin"] = Code(call("of.pin", [], pins))
    starts = {key: find.pop(key) for key in ("starts", "seed") if key in find}
    for key, value in find.items():
        named[key] = (
            paired(value) if key == "bounds" else tuple(value) if isinstance(value, list) else value
        )
    if "control" in document:
        named["control"] = Code(control(document["control"]))
    named["name"] = document["name"]
    lines = [f"problem = {call('of.Problem', [Code('model'), Code('guess')], named)}"]
    choosing = find.get("objective") == "min_instability" and "period" in find.get("bounds", {})
    finder = call(
        "of.least_unstable" if choosing else "of.find_orbit",
        [Code("problem")],
        starts if choosing else {},
    )
    return [*lines, f"orbit = {finder}", "print(orbit.period, orbit.certificate.passed)"]


def paired(bounds: Mapping[str, Any]) -> dict[str, tuple[Any, ...]]:
    """Ranges as pairs."""
    return {key: tuple(pair) for key, pair in bounds.items()}


def control(table: Mapping[str, Any]) -> str:
    """The call that makes a Control."""
    rest = {key: value for key, value in table.items() if key not in ("cost", "task")}
    if "task" in table:
        tasks = (call("of.Task", [one["expression"]], {k: v for k, v in one.items() if k != "expression"})
                 for one in table["task"])  # fmt: skip
        rest["tasks"] = Code(f"({', '.join(tasks)},)")
    return call("of.Control", [table["cost"]], rest)


def call(name: str, first: Iterable[Any] = (), named: Mapping[str, Any] | None = None) -> str:
    """A call with these arguments; numbers as they are in the file."""
    given = [written(one) for one in first]
    plain = all(key.isidentifier() for key in named or {})
    more = (
        [f"{key}={written(value)}" for key, value in (named or {}).items()]
        if plain
        else [f"**{written(named)}"]
    )
    return f"{name}({', '.join(given + more)})"


def written(value: Any) -> str:
    """A value as Python reads it; tables are dictionaries."""
    if isinstance(value, Code):
        return str(value)
    if isinstance(value, Mapping):
        return (
            "{" + ", ".join(f"{written(key)}: {written(one)}" for key, one in value.items()) + "}"
        )
    if isinstance(value, tuple):
        return f"({', '.join(map(written, value))}{',' if len(value) == 1 else ''})"
    if isinstance(value, list):
        return f"[{', '.join(map(written, value))}]"
    return repr(value)
