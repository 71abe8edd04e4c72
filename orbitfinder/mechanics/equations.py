"""Systems whose equations are text, as a kind of [system]: parsed, never executed."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime.arguments import checked
from orbitfinder.errors import InputError, closest, shortened
from orbitfinder.mechanics.conserved import discrepancy
from orbitfinder.mechanics.controls import Limits, with_controls
from orbitfinder.mechanics.expression import FUNCTIONS, expression
from orbitfinder.mechanics.first_order import TAKEN, Named, hamiltonian, ode
from orbitfinder.mechanics.hybrid import Transition, changed, hybrid
from orbitfinder.mechanics.kind import KINDS, SystemKind
from orbitfinder.mechanics.lagrange import Symbols, lagrange, mirrors
from orbitfinder.mechanics.model import USUAL_SYMMETRIES, Model, altered, images
from orbitfinder.mechanics.scales import with_units
from orbitfinder.records.reading import Entries, Table

Reader = Callable[[str, str], Any]
"""(text, its field) -> its value in symbols"""
FORMS = {
    "rates": {"states", "invariants", "events", "cycle"}, "hamiltonian": {"coordinates", "momenta", "invariants"},
    "kinetic": {"coordinates", "potential", "forces"},
}  # fmt: skip
"""What says the equations, with the keys that only some have"""
RESERVED, MOST, EVENT = (
    {"t", "pi", "and", "or", "not", "True", "False", "None", *FUNCTIONS} - {"sign", "floor", "erf", "mod"}, 200_000,
    {"guard", "direction", "reset"},
)  # fmt: skip
"""What nothing else may be called, but for functions that came later; letters of all texts, and operations that
functions become where they are called; what an event says"""
HEAD, WORD = re.compile(r"(\w+)\s*(?:\(([\w\s,]*)\))?"), re.compile(r"\b[^\W\d]\w*")


@checked
def equations(
    rates: Mapping[str, str] | None = None,
    parameters: Mapping[str, float] | None = None,
    *,
    let: Mapping[str, str] | None = None,
    states: Sequence[str] = (),
    hamiltonian: str | None = None,
    kinetic: str | None = None,
    potential: str | None = None,
    forces: Mapping[str, str] | Sequence[str] | None = None,
    coordinates: Sequence[str] = (),
    momenta: Sequence[str] = (),
    invariants: Mapping[str, str] | None = None,
    symmetries: Mapping[str, Mapping[str, Any]] | None = None,
    events: Mapping[str, Mapping[str, Any]] | None = None,
    cycle: Sequence[str] = (),
    left_out: Sequence[str] = (),
    controls: Limits | None = None,
    angles: Sequence[str] = (),
    period: str | float | None = None,
    units: Mapping[str, str] | None = None,
    find_invariants: bool = True,
) -> Model:
    """The Model of equations as text: x' = f(t, x, p), Hamilton's of H(q, p), or Lagrange's of T - V with forces.

    Of names, numbers, pi, the time t, + - * / ^ **, comparisons, `and`, `or`, `not`, and sin, cos, tan, asin, acos,
    atan, atan2, sinh, cosh, tanh, exp, log, sqrt, erf, abs, sign, floor, mod, min, max, if(condition, then, else).
    Nothing is executed.

    Args:
        rates: x' by the name of each state.
        parameters: physical parameters with their values.
        let: quantities that several texts use, by name, and functions as "ramp(u)"; in any order.
        states: the order of the states; that of the rates when left out.
        hamiltonian: H of coordinates and momenta, instead of rates.
        kinetic: T of coordinates and their velocities (q and qdot), instead of rates.
        potential: V of the coordinates, 0 when left out.
        forces: generalized forces in the order of the coordinates or by their names, of these, velocities and time.
        coordinates: names of q, for hamiltonian and kinetic.
        momenta: names of p in the same order, for hamiltonian.
        invariants: first integrals by name, which keep their value along motions; the energy of others is known.
        symmetries: by name, mirrors {"time": -1, "signs": {"y": -1}}, which change the time (1 unless said) and states
            or coordinates by their signs; and shifts and rotations of coordinates, {"generator": {"x": "-y", "y":
            "x"}}, whose momentum is an invariant of that name. The equations must have them whichever values the
            parameters have.
        events: of rates, resets by name, {"guard": "v - 30", "direction": 1, "reset": {"v": "c", "u": "u + d"}}: where
            the guard rises (1) or falls (-1) through 0 the states of `reset` get these values of the state before.
        cycle: names of the events of one period in their order, those of the guess's motion when left out.
        left_out: what a file from elsewhere says beside this, in words; nothing is made of it.
        controls: parameters that may vary in time, each with its greatest magnitude or [lowest, highest]; inf without.
        angles: states or coordinates that may turn.
        period: of the explicit dependence on the time, a number or a text of parameters such as "2*pi/omega".
        units: words for time, length, mass, angle, or a state or parameter by name ("ms", "mV"); nothing is converted.
        find_invariants: whether linear ones of rates, c.x with c.x' = 0 as "S + I + R", are searched for and described.

    Returns:
        A Model, which files describe by its text.

    Raises:
        InputError: naming the text, what is wrong in it and what is known.

    Examples:
        >>> clock = of.equations({"x": "a + x^2*y - (b + 1)*x", "y": "b*x - x^2*y"}, {"a": 1.0, "b": 1.8})
        >>> rest = of.follow_equilibria(clock, [1.0, 1.8], "b", until=2.5)
        >>> [round(event.parameter, 12) for event in rest.events]
        [2.0]

    See Also:
        `of.ode`, `of.hamiltonian` and `of.lagrange` from Python functions, `of.from_xpp` for XPPAUT's files.
    """
    given = {k: _plain(value) for k, value in locals().items()
             if value is not None and value not in ((), []) and k not in ("units", "find_invariants")}  # fmt: skip
    given = {"kind": "equations", "parameters": {}} | given
    form = _form(given)
    names = [*(states or rates or ())] if form == "rates" else [*coordinates, *momenta]
    if form == "rates":
        given["states"] = names  # whoever sorts keys keeps the order
    if isinstance(acting := given.get("forces", {}), list):
        if len(acting) != len(names):
            raise InputError(f"forces: {len(acting)} for {len(names)} coordinates; give one each, '0' where none acts")
        given["forces"] = dict(zip(names, acting, strict=True))
    _check_names(given, form, names)
    _check_time(given, form)
    make: dict[str, Callable[..., Model]] = {
        "rates": partial(_first_order, find_invariants), "hamiltonian": _hamiltonian, "kinetic": _lagrange
    }  # fmt: skip
    made = make[form](given, names)
    _check_mirrors(made)
    return with_units(with_controls(made, [*controls], controls) if controls else made, units)


def _plain(value: Any) -> Any:
    """A value as JSON has it, numbers as floats."""
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    return value if isinstance(value, str) else float(value) if np.ndim(value) == 0 else list(value)


def _form(given: Table) -> str:
    """What says the equations; `InputError` for several, for none and for what has no meaning then."""
    forms = [form for form in FORMS if form in given]
    if len(forms) != 1:
        raise InputError(f"rates: {' and '.join(forms) or 'nothing'} given; give rates, or hamiltonian with "
                         "coordinates and momenta, or kinetic and potential with coordinates")  # fmt: skip
    for key in sorted(set(given) & set[str]().union(*FORMS.values()) - FORMS[forms[0]]):
        raise InputError(f"{key}: has no meaning beside {forms[0]}; leave it out")
    if "coordinates" in FORMS[forms[0]] and "coordinates" not in given:
        raise InputError(f"coordinates: missing; name those that {forms[0]} is written in")
    return forms[0]


def _check_names(given: Table, form: str, names: Sequence[str]) -> None:
    """`InputError` for names that texts cannot have, and for those of two things."""
    if form == "rates" and sorted(names) != sorted(given["rates"]):
        raise InputError(f"states: {', '.join(names)}, but rates of {', '.join(given['rates'])}; name each state once")
    called = [(name, "coordinates" if form != "rates" else "rates") for name in names]
    called += [(f"{name}dot", "coordinates") for name in names if form == "kinetic"]
    called += [(name, key) for key in ("parameters", "let", "symmetries") for name in given.get(key, ())]
    seen: dict[str, str] = {}
    for name, key in called:
        word, arguments = _head(name) if key == "let" else (name, ())
        for part in (word, *(arguments or ())):
            taken = (*USUAL_SYMMETRIES, *TAKEN) if key == "symmetries" else RESERVED
            if not part.isidentifier() or not part.isascii() or part in taken:
                raise InputError(f"{key}.{name}: {part!r} is no name that is free; use letters, digits and _, such as "
                                 f"{re.sub('[^A-Za-z0-9_]', '', part) or 'x'}_1")  # fmt: skip
        if word in seen:
            raise InputError(f"{key}.{name}: {word!r} is in {seen[word]} too; give each thing a name of its own")
        seen[word] = key
    if len(declared := given.get("symmetries", {})) > 20:
        raise InputError(f"symmetries: {len(declared)} are declared, at most 20 are tried; leave some out")
    for name, said in declared.items():
        moved = said.get("signs", said.get("generator"))
        known = given.get("coordinates", ()) if "generator" in said else names
        told = sorted(said) in (["generator"], ["signs"], ["signs", "time"]) and isinstance(moved, Mapping)
        if not (told and moved and moved.keys() <= {*known}):
            raise InputError(f"symmetries.{name}: got {shortened(repr(said))}; give time = 1 or -1, and signs = {{x = "
                             f"-1}} of {', '.join(names)}, or generator = {{x = '-y'}} of coordinates")  # fmt: skip
    for key in ("angles", "forces"):
        if strange := [name for name in given.get(key, ()) if name not in names]:
            raise InputError(f"{key}: {strange[0]!r} is none{closest(strange[0], names)}; known are {', '.join(names)}")
    for name, value in given["parameters"].items():
        if not np.isfinite(value):
            raise InputError(f"parameters.{name}: must be a finite number, got {value}; check the value")


def _head(name: str) -> tuple[str, list[str] | None]:
    """f and [u, v] of "f(u, v)", x and None of "x"."""
    found = HEAD.fullmatch(name.strip())
    if found is None:
        return name, None
    return found[1], None if found[2] is None else [part.strip() for part in found[2].split(",")]


def _check_time(given: Table, form: str) -> None:
    """`InputError` for texts that are too long, for a dependence on time without its period, and the reverse."""
    tables = {f"{key}.{name}": str(text) for key in ("rates", "let", "forces", "invariants", "symmetries")
              for name, text in given.get(key, {}).items()}  # fmt: skip
    for name, event in given.get("events", {}).items():
        tables |= {f"events.{name}": " ".join(map(str, (event.get("guard"), *event.get("reset", {}).values())))}
    texts = tables | {key: given[key] for key in ("hamiltonian", "kinetic", "potential") if key in given}
    if (letters := sum(map(len, texts.values()))) > MOST:
        raise InputError(f"{form}: {letters} letters of text, at most {MOST} are read; use of.ode for such a system")
    timed = [where for where, text in texts.items() if "t" in WORD.findall(text)]
    if timed and "period" not in given:
        raise InputError(f"{timed[0]}: {shortened(repr(texts[timed[0]]))} depends on the time t; give the period of "
                         "that, period = '2*pi/omega'")  # fmt: skip
    if "period" in given and not timed:
        raise InputError("period: nothing depends on the time t; leave it out, an orbit's period belongs to the guess")


@dataclass(frozen=True)
class _Defined:
    """A function of the user's, written out where it is called."""

    where: str
    inputs: tuple[Any, ...]
    body: Any
    spent: list[int]

    @property
    def count(self) -> int:
        """How many arguments it takes."""
        return len(self.inputs)

    def __call__(self, *given: Any) -> Any:
        """Its value. Raises `InputError` where functions of functions become too large."""
        self.spent[0] += max(20, ca.n_nodes(self.body))  # a call costs as much as twenty operations
        if self.spent[0] > MOST:
            raise InputError(f"{self.where}: more than {MOST} operations where functions are written out; call fewer, "
                             "or name what they have in common")  # fmt: skip
        return ca.substitute(self.body, ca.vertcat(*self.inputs), ca.vertcat(*given))


def _reader(given: Table, t: Any, *named: Named) -> Reader:
    """What reads texts in these symbols and in what is defined by them."""
    values, calls, spent = {"t": t}, dict[str, _Defined](), [0]
    for each in named:
        values |= dict(zip(each.names, each, strict=True))
    let = given.get("let", {})
    for name in _ordered(let):
        word, arguments = _head(name)
        inputs = {part: ca.SX.sym(part) for part in arguments or ()}
        body = expression(let[name], values | inputs, f"let.{name}", calls)
        if arguments is None:
            values[word] = body
        else:
            calls[word] = _Defined(f"let.{name}", tuple(inputs.values()), ca.SX(body), spent)
    return lambda text, where: expression(text, values, where, calls)


def _ordered(let: Mapping[str, str]) -> Iterable[str]:
    """Definitions, each after those that it uses. Raises `InputError` where there is no such order."""
    heads = {_head(name)[0]: name for name in let}
    uses = {name: {heads[word] for word in WORD.findall(text) if word in heads and word not in (_head(name)[1] or ())}
            for name, text in let.items()}  # fmt: skip
    try:
        return list(TopologicalSorter(uses).static_order())
    except CycleError as error:
        circle = shortened(" -> ".join(reversed(error.args[1])))
        raise InputError(f"let.{error.args[1][0]}: is defined by itself ({circle}); break the circle") from None


def _clock(given: Table) -> Callable[[Named], Any] | float | None:
    """The period of the forcing as Models take it."""
    period = given.get("period")
    if not isinstance(period, str):
        return period
    return lambda p: expression(period, dict(zip(p.names, p, strict=True)), "period")


def _first_order(find: bool, given: Table, names: Sequence[str]) -> Model:
    def field(t: Any, x: Named, p: Named) -> list[Any]:
        read = _reader(given, t, x, p)
        return [read(given["rates"][name], f"rates.{name}") for name in names]

    flow = ode(field, names, given["parameters"], find_invariants=find, **_common(given))
    if "events" not in given:
        if "cycle" in given:
            raise InputError("cycle: has no meaning without events; leave it out")
        return flow
    return hybrid({"flow": flow}, [*_transitions(given, names)], given.get("cycle"), system=given)


def _transitions(given: Table, names: Sequence[str]) -> Iterator[Transition]:
    """The events of a text. Raises `InputError`."""
    for name, event in given["events"].items():
        where, reset = f"events.{name}", event.get("reset", {})
        direction, told = event.get("direction", 1), isinstance(event.get("guard"), str) and isinstance(reset, Mapping)
        if not told or event.keys() - EVENT or direction not in (-1, 1):
            raise InputError(f"{where}: got {shortened(repr(event))}; give guard = 'v - 30', direction = 1 or -1, and "
                             "reset = {v = 'c'}")  # fmt: skip
        if strange := [state for state in reset if state not in names]:
            raise InputError(f"{where}.reset: {strange[0]!r} is no state{closest(strange[0], names)}; states are "
                             f"{', '.join(names)}")  # fmt: skip

        def guard(x: Named, p: Named, text: str = event["guard"], where: str = where) -> Any:
            return _reader(given, ca.SX.sym("t"), x, p)(text, f"{where}.guard")

        def after(x: Named, p: Named, reset: Mapping[str, str] = reset, where: str = where) -> Any:
            read = _reader(given, ca.SX.sym("t"), x, p)
            return changed(x, **{state: read(str(text), f"{where}.reset.{state}") for state, text in reset.items()})

        yield Transition(name, "flow", "flow", guard, after, int(direction))


def _common(given: Table) -> Entries:
    """What states say beside their equations."""
    invariants = {name: partial(_integral, given, name, text) for name, text in given.get("invariants", {}).items()}
    return dict(invariants=invariants, angles=given.get("angles", ()), forcing_period=_clock(given), system=given,
                symmetries=_declared(given, "signs"))  # fmt: skip


def _declared(given: Table, key: str) -> Entries:
    """Sense of time and signs or a generator, as the `key` says, of symmetries by name."""
    declared = given.get("symmetries", {}).items()
    return {name: (said.get("time", 1), said[key]) for name, said in declared if key in said}


def _check_mirrors(made: Model) -> None:
    """`InputError` for declared signs under which the equations change; forwards, about half of the forcing too."""
    at = (made.rates or made.acceleration).mx_in()
    clock = made.forcing_period(at[-1]) / 2 if made.forcing_period else 0.0
    for name, sense, signs in made.symmetries:
        pairs = (images(made, sense, ca.diag(ca.DM(signs)), at, late) for late in (0.0, clock)[: 1 + (sense > 0)])
        if all(off := [discrepancy(at, pair, made.parameter_values) for pair in pairs]):
            raise InputError(f"symmetries: under {name!r} the equations change by {off[0]}; correct its signs, or "
                             "leave it out")  # fmt: skip


def _integral(given: Table, name: str, text: str, x: Named, p: Named) -> Any:
    return _reader(given, ca.SX.sym("t"), x, p)(text, f"invariants.{name}")


def _hamiltonian(given: Table, names: Sequence[str]) -> Model:
    coordinates, common = given["coordinates"], _common(given)
    momenta = names[len(coordinates) :]
    for name, (_, moved) in _declared(given, "generator").items():
        terms = (f"{p}*({moved[q]})" for q, p in zip(coordinates, momenta, strict=False) if q in moved)
        common["invariants"][name] = partial(_integral, given, name, " + ".join(terms))
    return hamiltonian(
        lambda *at: _reader(given, *(ca.SX.sym("t"), *at)[-3:])(given["hamiltonian"], "hamiltonian"),
        coordinates, momenta, given["parameters"], **common,
    )  # fmt: skip


def _lagrange(given: Table, names: Sequence[str]) -> Model:
    t, parameters = ca.SX.sym("t"), given["parameters"]
    rates = [f"{name}dot" for name in names]
    q, v, p = (ca.vertcat(*map(ca.SX.sym, each)) for each in (names, rates, parameters))
    known = [Named.of(tuple(each), column) for each, column in ((names, q), (rates, v), (parameters, p))]
    read, clock, forces = _reader(given, t, *known), _clock(given), given.get("forces", {})
    symbols = Symbols(
        q, v, p if parameters else None, tuple(parameters), tuple(parameters.values()), None if clock is None else t,
        clock(known[2]) if callable(clock) else clock,
    )  # fmt: skip
    acting = [read(forces[name], f"forces.{name}") if name in forces else 0.0 for name in names]
    made = lagrange(
        ca.SX(read(given["kinetic"], "kinetic")), ca.SX(read(given.get("potential", "0"), "potential")), symbols,
        forces=ca.vertcat(*acting) if forces else None, names=names,
        angles=[name in given.get("angles", ()) for name in names], system=given, controls=[*given.get("controls", ())],
        generators={
            name: ca.SX(ca.vertcat(*(read(str(moved.get(each, 0)), f"symmetries.{name}.{each}") for each in names)))
            for name, (_, moved) in _declared(given, "generator").items()
        },
    )  # fmt: skip
    return altered(made, symmetries=mirrors(_declared(given, "signs"), names))


def _build(system: Table, _: Path | None) -> Model:
    """The Model of a description, with no other invariants than those in it unless a problem file lets find them."""
    try:
        return equations(**{"find_invariants": False} | {key: value for key, value in system.items() if key != "kind"})
    except InputError as error:
        raise InputError(f"system.{error}") from error


KINDS["equations"] = SystemKind(_build, lambda system: "system of equations", takes=equations)
