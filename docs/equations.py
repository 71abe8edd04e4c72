"""The equations of a Model in TeX: energies, forces, constraints, rates, guards and resets, as far as they fit a page.

Short expressions are CasADi's graphs, read into SymPy and typeset by it; what is too large is described by how it is
built and how large it is.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

import casadi as ca
import sympy
from sympy.printing.latex import LatexPrinter

from orbitfinder.exports.source import expanded, operations
from orbitfinder.mechanics.model import Model

MOST_OPERATIONS = 120
"""Elementary operations of an expression that is typeset"""
EASY = 40
"""Operations up to which trigonometric identities are tried"""
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
    "inertia": "I", "com": "c", "current": "I", "ratio": "\\mu", "feed": "a", "rate": "b", "restitution": "e",
    "angle": "\\alpha",
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


def expressions(
    function: ca.Function, arguments: Sequence[Sequence[str]], most: int = MOST_OPERATIONS
) -> list[Any]:
    """The entries of the first output in SymPy, its inputs under these names. Raises `TooLarge`."""
    if not function.is_a("SXFunction"):
        raise TooLarge(function.name())
    scalar, names = expanded(function), operations()
    work: dict[int, Any] = {}
    grown: dict[int, int] = {}
    found = [sympy.Integer(0)] * scalar.numel_out(0)
    read = [scalar.sparsity_in(k).find() for k in range(scalar.n_in())]
    written = scalar.sparsity_out(0).find()
    for step in range(scalar.n_instructions()):
        name, left = names[scalar.instruction_id(step)], scalar.instruction_output(step)
        used = scalar.instruction_input(step)
        if name != "OUTPUT":  # what is shared counts each time that it is written out
            grown[left[0]] = (
                0 if name in ("INPUT", "CONST") else 1 + sum(grown[place] for place in used)
            )
            if grown[left[0]] > most:
                raise TooLarge(function.name())
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

    def _print_Symbol(self, expr: Any, style: str = "plain") -> str:
        return self.letters[expr.name]


def letter(name: str) -> str:
    """A name in TeX: theta1dot is a dotted theta with index 1, stiffness a k."""
    if name.endswith("dot") and len(name) > 3:
        base, _, index = letter(name[:-3]).partition("_")
        return f"\\dot{{{base}}}{'_' + index if index else ''}"
    owner, _, what = name.rpartition("_")
    if owner and what in SHORT and name not in SHORT:
        return f"{SHORT[what]}_{{\\mathrm{{{owner.replace('_', ' ')}}}}}"
    found = re.fullmatch(r"([A-Za-z]\w*?)_?(\d+)|(\w+)_([xyz])|([A-Za-z])([xyz])", name)
    stem, index = (
        [one for one in found.groups() if one is not None]
        if found and name not in SHORT
        else (name, "")
    )
    if stem in GREEK:
        base = f"\\{stem}"
    elif len(stem) == 1:
        base = stem
    else:
        base = SHORT.get(stem) or f"\\mathrm{{{stem.replace('_', chr(92) + '_')}}}"
    if not index:
        return base
    return (
        f"{base[:-1]}{{{base[-1]},{index}}}" if re.search(r"_\d$", base) else f"{base}_{{{index}}}"
    )


def letters_of(names: Iterable[str]) -> dict[str, str]:
    """A letter for each name of a system, the same for no two: who comes to a letter that is taken is written out."""
    listed = list(names)
    found = {name: letter(name) for name in listed}
    for name in listed:
        if list(found.values()).count(found[name]) > 1 and len(name) > 1:
            found[name] = f"\\mathrm{{{name.replace('_', ' ')}}}"
    return found


def tidy(expression: Any) -> Any:
    """The shorter of an expression and its usual simplifications."""
    tried = [expression]
    ways = [sympy.trigsimp] if expression.count_ops() <= EASY else []
    for how in (*ways, sympy.expand, lambda one: sympy.collect_const(sympy.factor_terms(one))):
        try:
            tried.append(how(tried[0]))
        except (ValueError, TypeError, NotImplementedError, AttributeError):
            continue
    return min(tried, key=lambda one: (one.count_ops(), len(str(one))))


def signed(expression: Any) -> Any:
    """-(a + b) as -a - b, also within a sum."""

    def open_(one: Any) -> Any:
        head, rest = one.as_coeff_Mul()
        return sympy.Add(*(-each for each in rest.args)) if head == -1 and rest.is_Add else one

    return sympy.Add(*map(open_, sympy.Add.make_args(expression)))


def typeset(expression: Any, letters: Mapping[str, str]) -> str:
    """TeX of a SymPy expression, its symbols in these letters. Raises `TooLarge`."""
    found = Printer(letters).doprint(signed(tidy(expression)))
    if len(found) > LONGEST:
        raise TooLarge("letters")
    return str(found)


# --------------------------------------------------------------------------------------------------
# A Model as displayed equations: rows (left, right) of an aligned block, or sentences where it is too large.

Row = tuple[str, str]
CHAIN = [
    ("T", r"\tfrac12\sum_{i=1}^{n} m_i\left(\dot x_i^2+\dot y_i^2\right)+I_i\,\dot\theta_i^2"),
    ("V", r"-\sum_{i=1}^{n} m_i\,g\,x_i"),
    ("x_i", r"\sum_{j<i} l_j\cos\theta_j+c_i\,l_i\cos\theta_i"),
    ("y_i", r"\sum_{j<i} l_j\sin\theta_j+c_i\,l_i\sin\theta_i"),
]  # fmt: skip
"""A chain: angles from the downward vertical, centres of mass a fraction c of the length from the upper joint"""
CLOSED = [
    *CHAIN[:2],
    ("0=\\varphi_i", r"\left(x_i,\,y_i\right)-\sum_{j<i} l_j\left(\cos\theta_j,\,\sin\theta_j\right)"
     r"-c_i\,l_i\left(\cos\theta_i,\,\sin\theta_i\right),\qquad i=1\dots n"),
    ("0=\\varphi_{n+1}", r"\sum_{j=1}^{n} l_j\left(\cos\theta_j,\,\sin\theta_j\right)-\left(x_G,\,y_G\right)"),
    ("M a+h", r"J^{\mathsf T}\lambda,\qquad J=\partial\varphi/\partial q"),
]  # fmt: skip
"""A linkage in maximal coordinates q = (x, y, theta) of each bar, its end at the ground pivot G: a DAE of index 1"""
BODIES = [
    ("T", r"\tfrac12\sum_b m_b\left|\dot r_b\right|^2+\omega_b\cdot I_b\,\omega_b"),
    ("V", r"-\sum_b m_b\,g\cdot r_b+\tfrac12\sum_s k_s\left(l_s(q)-l_{s,0}\right)^2"),
]  # fmt: skip
"""Bodies b with springs s, r and omega of each from the joints' coordinates q"""
NERVE = [
    ("\\dot V", r"I-120\,m^3h\,(V-115)-36\,n^4(V+12)-0.3\,(V-10.613)"),
    ("\\dot s", r"\alpha_s(V)\,(1-s)-\beta_s(V)\,s,\qquad s\in\{m,h,n\}"),
]  # fmt: skip
LATTICE = [
    ("T", r"\tfrac{m}{2}\sum_{i=1}^{N}\dot y_i^2"),
    ("V", r"\sum_{i=0}^{N}\frac{k}{2}\,d_i^2+\frac{\alpha}{3}\,d_i^3+\frac{\beta}{4}\,d_i^4,"
     r"\qquad d_i=y_{i+1}-y_i,\quad y_0=y_{N+1}=0"),
]  # fmt: skip
STRUCTURE = [(r"M\ddot q+C\dot q+Kq+f(q,\dot q)", r"p\cos(\omega t+\varphi)")]
GENERAL = {
    "chain": CHAIN,
    "linkage": CLOSED,
    "mechanism": BODIES,
    "robot": BODIES,
    "structure": STRUCTURE,
}
NAMED = {"hodgkin_huxley": NERVE, "cart_chain": LATTICE}


def display(rows: Sequence[Row]) -> str:
    """An aligned block as HTML that KaTeX and MathJax find; wide ones scroll."""
    body = r" \\[2pt] ".join(f"{left} &{sign(left)} {right}" for left, right in rows)
    return f'<div class="arithmatex">{escape(f"{BEGIN}{body}{END}", quote=False)}</div>'


def sign(left: str) -> str:
    """Between both sides of a row: none after what is a name."""
    return r"\quad" if left.endswith(":}") else "="


BEGIN, END = r"\[\begin{aligned}", r"\end{aligned}\]"


def equations(model: Model) -> tuple[list[Row], list[str]]:
    """The rows of a Model, and in sentences what is too large for rows."""
    known = NAMED.get(str(model.system.get("function"))) or GENERAL.get(
        str(model.system.get("kind"))
    )
    if known is not None:
        rows, said = list(known), []
        if model.system.get("kind") in ("mechanism", "robot") and model.constraint is None:
            rows, said = smooth(model)
            rows = rows if not said else list(known)
    elif model.hybrid is not None:
        return hybrid(model)
    else:
        rows, said = smooth(model)
    return rows, [size(model)] if said or known is not None else []


def size(model: Model) -> str:
    """How large the equations are."""
    count, rows = (
        len(model.state_names),
        0 if model.constraint is None else len(model.constraint.force_names),
    )
    graph = model.rates or model.acceleration
    work = (
        f", their rates {graph.n_instructions()} elementary operations"
        if graph.is_a("SXFunction")
        else ""
    )
    held = f", {rows} constraint forces" if rows else ""
    return f"{count} states{held}, {len(model.parameter_names)} physical parameters{work}."


def smooth(model: Model) -> tuple[list[Row], list[str]]:
    """The rows of a smooth mode; what is too large is named."""
    n = model.degrees_of_freedom
    q, v, p = model.state_names[:n], model.state_names[n:], model.parameter_names
    letters = letters_of([*q, *v, *p, "t"])

    def listed(
        names: Sequence[tuple[str, int]], function: ca.Function, arguments: Any
    ) -> tuple[list[Row], list[str]]:
        return rows_of(names, function, arguments, letters)

    if model.rates is not None and not model.hamiltonian:
        return listed(
            [(f"\\dot{{{letters[name]}}}", k) for k, name in enumerate(q)],
            model.rates,
            [("t",), q, p],
        )
    if model.hamiltonian:
        rows, said = listed([("H", 0)], model.potential, [q, p])
        return [
            *rows,
            ("\\dot q", r"\partial H/\partial p,\qquad \dot p=-\partial H/\partial q"),
        ], said
    rows, said = listed([("T", 0)], model.kinetic, [q, v, p])
    if model.gyroscopic is not None:
        more, missing = listed([("L_1", 0)], model.gyroscopic, [q, v, p])
        rows, said = [*rows, ("L", "T+L_1-V"), *more], [*said, *missing]
    more, missing = listed([("V", 0)], model.potential, [q, p])
    rows, said = [*rows, *more], [*said, *missing]
    push = model.forces
    if push is not None:
        given = [(f"Q_{{{letters[name]}}}", k) for k, name in enumerate(q)]
        more, missing = listed(given, push, [("t",), q, v, p])
        rows, said = [*rows, *(one for one in more if one[1] != "0")], [*said, *missing]
    if model.constraint is not None:
        found, missing = listed([("0=\\varphi", 0)], model.constraint.phi, [q, p])
        rows, said = [*rows, *found], [*said, *missing]
    return rows, said


def rows_of(
    names: Sequence[tuple[str, int]],
    function: ca.Function,
    arguments: Sequence[Sequence[str]],
    letters: Mapping[str, str],
) -> tuple[list[Row], list[str]]:
    """Rows of some entries of a function; the first name where they are too large."""
    try:
        found = expressions(function, arguments)
        return [(name, typeset(found[k], letters)) for name, k in names], []
    except TooLarge:
        return [], [names[0][0]]


def hybrid(model: Model) -> tuple[list[Row], list[str]]:
    """The modes with what they hold, then guard and reset of each transition."""
    rows: list[Row] = []
    said: list[str] = []
    x, p, parts = model.state_names, model.parameter_names, model.hybrid
    several = len(parts.modes) > 1
    for mode in parts.modes:
        found, missing = smooth(mode.model)
        if several and found:
            found[0] = (
                f"\\text{{{mode.name.replace('_', ' ')}:}}\\quad {found[0][0]}",
                found[0][1],
            )
        rows += found
        if missing:
            said.append(f"{mode.name.replace('_', ' ').capitalize()}: {size(mode.model)}")
    for one in parts.transitions:
        rows += crossing(one, x, p)
        words = f"{one.name.replace('_', ' ')} (from {one.source} to {one.target})"
        reset = after(one, x, p)
        if reset is None:
            impact = (
                "an impact, M (v⁺ − v⁻) = Jᵀ P with J v⁺ = −e J v⁻"
                if one.impulse is not None
                else "a map"
            )
            said.append(f"At {words} the state goes through {impact}.")
        rows += reset or []
        if one.ignored:
            said.append(f"{words[:1].upper()}{words[1:]} ignores on purpose: {one.ignored}.")
    return rows, said


def crossing(one: Any, x: Sequence[str], p: Sequence[str]) -> list[Row]:
    """The guard of a transition."""
    arrow = r"\downarrow 0" if one.direction < 0 else r"\uparrow 0"
    name = f"\\text{{{one.name.replace('_', ' ')}:}}"
    try:
        return [
            (name, f"{typeset(expressions(one.guard, [x, p])[0], letters_of([*x, *p]))}\\;{arrow}")
        ]
    except TooLarge:
        return [(name, f"g(x,p)\\;{arrow}")]


def after(one: Any, x: Sequence[str], p: Sequence[str]) -> list[Row] | None:
    """What a transition changes, None where it is too large."""
    letters = letters_of([*x, *p])
    try:
        found = expressions(one.reset, [x, p])
        rows = [
            (f"{letters[name]}^+", typeset(value, letters))
            for name, value in zip(x, found, strict=True)
            if value != sympy.Symbol(name, real=True)
        ]
    except TooLarge:
        return None
    return rows or [("x^+", "x")]
