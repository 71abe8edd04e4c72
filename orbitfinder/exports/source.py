"""What every exporter starts from: an orbit, its dense samples, and its equations in another language's source."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.interpolate import CubicHermiteSpline

from orbitfinder._runtime import __version__
from orbitfinder._runtime.inert import inert
from orbitfinder.errors import InputError
from orbitfinder.integrate.cvodes import build_flow, sample
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model, vector_field
from orbitfinder.mechanics.scales import worded
from orbitfinder.orbits.certify import shown
from orbitfinder.records.orbit import Orbit

SAMPLES = 513
"""Points of one period when orbit.npz is missing."""


@dataclass(frozen=True)
class Source:
    """An orbit ready to be written out.

    `rate(t, x, s, p)` is dx/dt (d) with unfolding parameters s and all physical parameters p;
    `energy(x, p)` is the total energy (J), 0 where there is none. `times` (k, s) and `samples` (k x 2n) cover one
    period.
    """

    orbit: Orbit
    model: Model
    rate: ca.Function
    energy: ca.Function
    times: np.ndarray
    samples: np.ndarray

    @property
    def identifier(self) -> str:
        """The orbit's name as a word that every language accepts."""
        return word_of(self.orbit.name)

    @property
    def rates(self) -> range:
        """Which components of the state, from 0, something may push: the velocities, of a first-order system all."""
        size = len(self.model.state_names)
        return range(self.model.degrees_of_freedom % size, size)

    @property
    def heading(self) -> list[str]:
        """Comment lines for the top of a file: what this is and where it comes from."""
        energy = f", energy {self.orbit.energy!r} J" if np.isfinite(self.orbit.energy) else ""
        numbers = worded(f"period {self.orbit.period!r} s{energy}", self.orbit.system)
        lines = (self.orbit.title or self.orbit.name, numbers, f"written by orbitfinder {__version__}")
        return [inert(line, "comment") for line in lines]


def word_of(name: str) -> str:
    """A name as a word that every language accepts."""
    word = re.sub(r"\W", "_", name, flags=re.ASCII)
    return word if word[:1].isalpha() else f"orbit_{word}"


def source_of(orbit: Orbit, model: Model | None = None) -> Source:
    """The Source of an orbit. `model` is needed only for systems that no file describes. Raises `InputError`."""
    model = model or build_model(orbit.system)
    n = model.degrees_of_freedom
    rate = vector_field(model, model.parameter_names, model.invariants)
    x, p = ca.SX.sym("x", len(model.state_names)), ca.SX.sym("p", len(model.parameter_names))
    total = model.kinetic(x[:n], x[n:], p) + model.potential(x[:n], p) if np.isfinite(orbit.energy) else ca.SX(0)
    return Source(orbit, model, rate, ca.Function("energy", [x, p], [total]), *samples_of(orbit, model))


def samples_of(orbit: Orbit, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Times (k, s) and states (k x d) over a period, integrated where orbit.npz is missing. Raises `InputError`.

    Events of a hybrid orbit come twice, with the state before and the state after.
    """
    if (given := shown(orbit, model)) is not None:
        return given
    if not model.smooth:
        raise InputError(f"{orbit.name}: no samples; keep orbit.npz beside orbit.json, or run it again")
    return np.linspace(0.0, orbit.period, SAMPLES), sample(build_flow(model), orbit.state, orbit.period, SAMPLES)


def dense_states(source: Source, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Equal times (rows) over the period and the states there (rows x 2n), by cubic Hermite interpolation."""
    p, samples = source.model.parameter_values, source.samples
    none = np.zeros(len(source.model.invariants))
    slopes = [source.rate(t, x, none, p).full().ravel() for t, x in zip(source.times, samples, strict=True)]
    times = np.linspace(0.0, source.orbit.period, rows)
    return times, CubicHermiteSpline(source.times, samples, np.asarray(slopes))(times)


# --------------------------------------------------------------------------------------------------
# CasADi's scalar graphs as straight-line programs in other languages.
# An SX function is a list of elementary operations on a work vector; each becomes one assignment. Nothing
# is simplified or reordered, so that the exported right-hand side agrees with ours to round-off.


@dataclass(frozen=True)
class Language:
    """How a language writes numbers, array entries and the operations that are not infix everywhere.

    `entry(name, k)` is element k (from 0) of an array, `calls` maps a CasADi operation to a template in
    {0} and {1}, `end` closes a statement and `longest` is the longest line that the language allows.
    """

    number: Callable[[float], str]
    entry: Callable[[str, int], str]
    calls: dict[str, str]
    end: str = ""


COMMON = {
    "ADD": "{0} + {1}", "SUB": "{0} - {1}", "MUL": "{0} * {1}", "DIV": "{0} / {1}", "NEG": "-{0}",
    "SIN": "sin({0})", "COS": "cos({0})", "TAN": "tan({0})", "ASIN": "asin({0})", "ACOS": "acos({0})",
    "ATAN": "atan({0})", "SINH": "sinh({0})", "COSH": "cosh({0})", "TANH": "tanh({0})", "EXP": "exp({0})",
    "LOG": "log({0})", "SQRT": "sqrt({0})", "SQ": "{0} * {0}", "TWICE": "2.0 * {0}", "ASSIGN": "{0}",
    "ASINH": "asinh({0})", "ACOSH": "acosh({0})", "ATANH": "atanh({0})", "HYPOT": "hypot({0}, {1})",
}  # fmt: skip
"""Operations that C, Julia and (with its own numbers) Fortran write alike."""


def c_number(value: float) -> str:
    """A double that C, Julia and Python read back exactly."""
    return repr(float(value))


def c_numbers(values: Iterable[float]) -> str:
    """Doubles for a list in C or Julia, without its brackets."""
    return ", ".join(map(c_number, values))


def fortran_number(value: float) -> str:
    """A double precision literal that Fortran reads back exactly."""
    text = repr(float(value))
    return text.replace("e", "d") if "e" in text else f"{text}d0"


C = Language(
    c_number,
    lambda name, k: f"{name}[{k}]",
    COMMON | {
        "INV": "1.0 / {0}", "POW": "pow({0}, {1})", "CONSTPOW": "pow({0}, {1})", "ATAN2": "atan2({0}, {1})",
        "FABS": "fabs({0})", "FMIN": "fmin({0}, {1})", "FMAX": "fmax({0}, {1})", "FLOOR": "floor({0})",
        "CEIL": "ceil({0})", "ERF": "erf({0})", "LT": "({0} < {1})", "LE": "({0} <= {1})", "EQ": "({0} == {1})",
        "NOT": "({0} == 0.0)",
        "NE": "({0} != {1})", "IF_ELSE_ZERO": "({0} != 0.0 ? {1} : 0.0)", "SIGN": "(({0} > 0.0) - ({0} < 0.0))",
        "FMOD": "fmod({0}, {1})", "LOG1P": "log1p({0})", "EXPM1": "expm1({0})",
    },
    ";",
)  # fmt: skip
JULIA = Language(
    c_number,
    lambda name, k: f"{name}[{k + 1}]",
    COMMON | {
        "INV": "1.0 / {0}", "POW": "{0} ^ {1}", "CONSTPOW": "{0} ^ {1}", "ATAN2": "atan({0}, {1})",
        "FABS": "abs({0})", "FMIN": "min({0}, {1})", "FMAX": "max({0}, {1})", "FLOOR": "floor({0})",
        "CEIL": "ceil({0})", "SIGN": "sign({0})", "LOG1P": "log1p({0})", "EXPM1": "expm1({0})",
        "FMOD": "rem({0}, {1})", "LT": "Float64({0} < {1})", "LE": "Float64({0} <= {1})",
        "EQ": "Float64({0} == {1})", "NE": "Float64({0} != {1})", "NOT": "Float64({0} == 0)",
        "IF_ELSE_ZERO": "({0} != 0 ? {1} : 0.0)",
    },
)  # fmt: skip
FORTRAN = Language(
    fortran_number,
    lambda name, k: f"{name}({k + 1})",
    COMMON | {
        "TWICE": "2.0d0 * {0}", "INV": "1.0d0 / {0}", "POW": "{0} ** {1}", "CONSTPOW": "{0} ** {1}",
        "ATAN2": "atan2({0}, {1})", "FABS": "abs({0})", "FMIN": "min({0}, {1})", "FMAX": "max({0}, {1})",
        "FMOD": "mod({0}, {1})", "LT": "merge(1.0d0, 0.0d0, {0} < {1})", "LE": "merge(1.0d0, 0.0d0, {0} <= {1})",
        "EQ": "merge(1.0d0, 0.0d0, {0} == {1})", "NE": "merge(1.0d0, 0.0d0, {0} /= {1})",
        "NOT": "merge(1.0d0, 0.0d0, {0} == 0.0d0)", "IF_ELSE_ZERO": "merge({1}, 0.0d0, {0} /= 0.0d0)",
    },
)  # fmt: skip


def operations() -> dict[int, str]:
    """CasADi's operation numbers and their names without the prefix OP_."""
    return {getattr(ca, name): name[3:] for name in dir(ca) if re.fullmatch(r"OP_[A-Z0-9_]+", name)}


def straight_line(
    function: ca.Function, language: Language, inputs: Sequence[str], outputs: Sequence[str]
) -> tuple[list[str], int]:
    """Assignments that evaluate `function`, and the length of the work vector they use.

    `inputs` and `outputs` name one array each, an array of length 1 being written as an array as well.
    Structural zeros of an output are assigned too. Raises `InputError` for what cannot be written out.
    """
    scalar = expanded(function)
    names, lines = operations(), list[str]()
    read = [scalar.sparsity_in(k).find() for k in range(scalar.n_in())]
    written = [scalar.sparsity_out(k).find() for k in range(scalar.n_out())]
    for k, output in enumerate(outputs):
        zeros = sorted({*range(scalar.numel_out(k))} - {*written[k]})
        lines += [f"{language.entry(output, e)} = {language.number(0.0)}{language.end}" for e in zeros]
    for step in range(scalar.n_instructions()):
        name, left = names[scalar.instruction_id(step)], scalar.instruction_output(step)
        used = scalar.instruction_input(step)
        target = language.entry("w", left[0])
        if name == "INPUT":
            value = language.entry(inputs[used[0]], read[used[0]][used[1]])
        elif name == "OUTPUT":
            target, value = language.entry(outputs[left[0]], written[left[0]][left[1]]), language.entry("w", used[0])
        elif name == "CONST":
            value = language.number(scalar.instruction_constant(step))
        else:
            value = operation(name, language).format(*(language.entry("w", place) for place in used))
        lines.append(f"{target} = {value}{language.end}")
    return lines, max(1, scalar.sz_w())


def operation(name: str, language: Language) -> str:
    """The template of one operation; `InputError` where the language has no word for it."""
    if name not in language.calls:
        raise InputError(f"export: the equations use {name.lower()}, which has no counterpart there; try c or csv")
    return language.calls[name]


def expanded(function: ca.Function) -> ca.Function:
    """The same function as scalar operations; `InputError` for a numerical factorisation inside it."""
    if function.is_a("SXFunction"):
        return function
    try:
        return function.expand()
    except RuntimeError as error:
        raise InputError(
            "export: these equations contain a numerical factorisation (more than 16 coordinates in dense form); "
            'use formulation = "recursive", or csv'
        ) from error
