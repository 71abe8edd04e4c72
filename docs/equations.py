"""The equations of a Model in TeX: energies, forces, constraints, rates, guards and resets, as far as they fit a page.

Short expressions are CasADi's graphs, read into SymPy and typeset by it; what is too large is described by how it is
built and how large it is.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import sympy
from sympy.printing.latex import LatexPrinter

from orbitfinder.exports.source import expanded, operations
from orbitfinder.mechanics.model import Model

MOST_OPERATIONS = 90
"""Elementary operations of an expression that is typeset"""
LONGEST = 420
"""Letters of TeX of one expression, beyond which it is not read by anybody"""
GREEK = (
    "alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "kappa", "lambda", "mu", "nu", "xi", "rho",
    "sigma", "tau", "phi", "psi", "omega",
)  # fmt: skip
SHORT = {
    "length": "l", "mass": "m", "gravity": "g", "stiffness": "k", "damping": "c", "radius": "r", "frequency": "\\omega",
    "torque": "\\tau", "force": "F", "amplitude": "A", "depth": "D", "distance": "d", "coupling": "\\kappa",
    "cart": "M", "spin": "\\Omega", "gravitation": "G", "cubic": "k_3", "quartic": "k_4", "slope": "\\gamma",
    "inertia": "I", "current": "I", "ratio": "\\mu", "feed": "a", "rate": "b", "restitution": "e", "angle": "\\alpha",
}  # fmt: skip
"""Letters that the field gives to parameters; a page says which it uses"""

_BINARY = {
    "ADD": lambda a, b: a + b, "SUB": lambda a, b: a - b, "MUL": lambda a, b: a * b, "DIV": lambda a, b: a / b,
    "POW": lambda a, b: a**b, "CONSTPOW": lambda a, b: a**b, "ATAN2": sympy.atan2, "FMAX": sympy.Max,
    "FMIN": sympy.Min, "HYPOT": lambda a, b: sympy.sqrt(a**2 + b**2),
}  # fmt: skip
_UNARY = {
    "NEG": lambda a: -a, "SQ": lambda a: a**2, "TWICE": lambda a: 2 * a, "INV": lambda a: 1 / a, "SIN": sympy.sin,
    "COS": sympy.cos, "TAN": sympy.tan, "EXP": sympy.exp, "LOG": sympy.log, "SQRT": sympy.sqrt, "TANH": sympy.tanh,
    "FABS": sympy.Abs, "ASSIGN": lambda a: a, "ATAN": sympy.atan, "ASIN": sympy.asin, "ACOS": sympy.acos,
    "SINH": sympy.sinh, "COSH": sympy.cosh, "EXPM1": lambda a: sympy.exp(a) - 1, "SIGN": sympy.sign,
}  # fmt: skip


class TooLarge(Exception):
    """An expression that no page holds."""


def expressions(function: ca.Function, arguments: Sequence[Sequence[str]], most: int = MOST_OPERATIONS) -> list[Any]:
    """The entries of the first output in SymPy, its inputs under these names. Raises `TooLarge`."""
    if not function.is_a("SXFunction"):
        raise TooLarge(function.name())
    scalar, names = expanded(function), operations()
    if scalar.n_instructions() > most + 3 * sum(map(len, arguments)):
        raise TooLarge(function.name())
    work: dict[int, Any] = {}
    found = [sympy.Integer(0)] * scalar.numel_out(0)
    read = [scalar.sparsity_in(k).find() for k in range(scalar.n_in())]
    written = scalar.sparsity_out(0).find()
    for step in range(scalar.n_instructions()):
        name, left = names[scalar.instruction_id(step)], scalar.instruction_output(step)
        used = scalar.instruction_input(step)
        if name == "INPUT":
            work[left[0]] = sympy.Symbol(arguments[used[0]][read[used[0]][used[1]]], real=True)
        elif name == "OUTPUT":
            if left[0] == 0:
                found[written[left[1]]] = work[used[0]]
        elif name == "CONST":
            work[left[0]] = number(scalar.instruction_constant(step))
        elif name in _BINARY:
            work[left[0]] = _BINARY[name](work[used[0]], work[used[1]])
        elif name in _UNARY:
            work[left[0]] = _UNARY[name](work[used[0]])
        else:
            raise TooLarge(name)
    return found


def number(value: float) -> Any:
    """A constant as a fraction where it is a simple one."""
    near = sympy.nsimplify(value, rational=True, tolerance=1e-15)
    return near if near.q <= 1000 else sympy.Float(value, 6)


class Printer(LatexPrinter):
    """SymPy's, with rates as dotted letters and whole fractions in front."""

    def __init__(self, letters: Mapping[str, str]) -> None:
        super().__init__({"fold_short_frac": False, "ln_notation": True})
        self.letters = letters

    def _print_Symbol(self, expr: Any, style: str = "plain") -> str:  # noqa: N802
        return self.letters.get(expr.name) or letter(expr.name)


def letter(name: str) -> str:
    """A name in TeX: theta1dot is a dotted theta with index 1, stiffness a k."""
    if name.endswith("dot") and len(name) > 3:
        base, _, index = letter(name[:-3]).partition("_")
        return f"\\dot{{{base}}}{'_' + index if index else ''}"
    found = re.fullmatch(r"([A-Za-z]\w*?)_?(\d+)|(\w+)_([xyz])|([A-Za-z])([xyz])", name)
    stem, index = [one for one in found.groups() if one is not None] if found and name not in SHORT else (name, "")
    if stem in GREEK:
        base = f"\\{stem}"
    elif len(stem) == 1:
        base = stem
    else:
        base = SHORT.get(stem) or f"\\mathrm{{{stem.replace('_', chr(92) + '_')}}}"
    if not index:
        return base
    return f"{base[:-1]}{{{base[-1]},{index}}}" if re.search(r"_\d$", base) else f"{base}_{{{index}}}"


def tidy(expression: Any) -> Any:
    """The shorter of an expression and its usual simplifications."""
    tried = [expression]
    for how in (sympy.trigsimp, sympy.expand, lambda one: sympy.collect_const(sympy.factor_terms(one))):
        try:
            tried.append(how(tried[0]))
        except (ValueError, TypeError, NotImplementedError, AttributeError):
            continue
    return min(tried, key=lambda one: (one.count_ops(), len(str(one))))


def signed(expression: Any) -> Any:
    """-(a + b) as -a - b."""
    head, rest = expression.as_coeff_Mul()
    return sympy.Add(*(-one for one in rest.args)) if head == -1 and rest.is_Add else expression


def typeset(expression: Any, letters: Mapping[str, str] | None = None) -> str:
    """TeX of a SymPy expression. Raises `TooLarge`."""
    if expression.count_ops() > MOST_OPERATIONS:
        raise TooLarge("operations")
    found = Printer(letters or {}).doprint(signed(tidy(expression)))
    if len(found) > LONGEST:
        raise TooLarge("letters")
    return str(found)
