"""Expressions as text, such as "torque1**2 + 0.1 * cos(theta1)": of names, numbers and a few functions, nothing else.

Text is what files can carry, so that a cost can be recomputed from an orbit.json alone; nothing in it is executed.
"""

from __future__ import annotations

import ast
import keyword
import math
import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce
from operator import add, mul, neg, sub, truediv
from typing import Any

import casadi as ca

from orbitfinder.errors import InputError, closest, shortened
from orbitfinder.records.reading import Table

FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": ca.sin, "cos": ca.cos, "tan": ca.tan, "sqrt": ca.sqrt, "exp": ca.exp, "log": ca.log, "tanh": ca.tanh,
    "sinh": ca.sinh, "cosh": ca.cosh, "asin": ca.asin, "acos": ca.acos, "atan": ca.atan, "atan2": ca.atan2,
    "abs": ca.fabs, "sign": ca.sign, "floor": ca.floor, "erf": ca.erf,
    "mod": lambda x, y: x - y * ca.floor(x / y),
    "min": lambda *each: reduce(ca.fmin, each), "max": lambda *each: reduce(ca.fmax, each),
    "if": lambda condition, this, that: (  # one of numbers alone is settled here
        (this if condition else that) if isinstance(condition, float) else ca.if_else(condition, this, that)
    ),
}  # fmt: skip
"""What may be called in an expression."""
LONGEST, DEEPEST, COUNTS = 20_000, 60, {"atan2": (2, 2), "mod": (2, 2), "if": (3, 3), "min": (2, 20), "max": (2, 20)}
"""Letters of an expression, how deeply it may be nested, and the fewest and most arguments of what does not take 1"""
OWN, MARK = sorted({*keyword.kwlist} - {"and", "or", "not", "True", "False", "None"}), "\u01c1"
WORDS = re.compile(rf"\b({'|'.join(OWN)})\b(?!\s*:)")
"""Python's own words, which are names here, such as `lambda` and `if`, by a letter after them"""

_OPERATIONS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: add, ast.Sub: sub, ast.Mult: mul, ast.Div: truediv, ast.Pow: pow, ast.USub: neg, ast.UAdd: lambda a: a,
    ast.Lt: ca.lt, ast.LtE: ca.le, ast.Gt: ca.gt, ast.GtE: ca.ge, ast.Eq: ca.eq, ast.NotEq: ca.ne,
    ast.And: ca.logic_and, ast.Or: ca.logic_or, ast.Not: ca.logic_not,
}  # fmt: skip


def expression(text: str, known: Table, where: str, calls: Mapping[str, Callable[..., Any]] | None = None) -> Any:
    """The value of a text in these names (numbers or symbols) and with further `calls`, of 1 argument or as many as
    their attribute `count` says; `InputError` begins with `where`."""
    if not isinstance(text, str) or not text.strip() or len(text) > LONGEST or "#" in text:
        raise InputError(f"{where}: must be an expression as text, such as 'torque1**2', of at most {LONGEST} letters, "
                         f"without comments, got {str(text)[:40]!r}")  # fmt: skip
    source = WORDS.sub(rf"\1{MARK}", " ".join(text.replace("^", "**").split()))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python's advice on its own programs
            tree = ast.parse(source, mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        said = str(error).replace(MARK, "").replace(" (<unknown>, line 1)", "")
        shown = shortened(repr(text), 120)
        raise InputError(f"{where}: {shown} is no expression ({said}); write it as 'torque1**2 + theta1'") from None
    counts = COUNTS | {name: (count := getattr(call, "count", 1), count) for name, call in (calls or {}).items()}
    return _Reading(source, known, where, FUNCTIONS | dict(calls or {}), counts).value(tree.body)


@dataclass(frozen=True)
class _Reading:
    """A text that is worked out, with what its names and calls mean."""

    source: str
    known: Table
    where: str
    calls: Mapping[str, Callable[..., Any]]
    counts: Mapping[str, tuple[int, int]]

    def value(self, node: ast.AST, depth: int = 0) -> Any:
        """The value of a part of the text, a real and finite one where it is a number."""
        if depth > DEEPEST:
            raise InputError(f"{self.where}: nested too deeply; write it in fewer brackets")
        try:
            return self._sound(self._worked_out(node, depth + 1), node)
        except InputError:
            raise
        except (ArithmeticError, ValueError):
            return self._sound(math.nan, node)

    def _sound(self, value: Any, node: ast.AST) -> Any:
        if isinstance(value, complex) or (isinstance(value, float) and not math.isfinite(value)):
            raise InputError(f"{self.where}: {self._shown(node)} is no finite real number; write a smaller one, no "
                             "root of a negative one and nothing divided by 0")  # fmt: skip
        return value

    def _shown(self, node: ast.AST) -> str:
        return repr(shortened((ast.get_source_segment(self.source, node) or "").replace(MARK, "")))

    def _worked_out(self, node: ast.AST, depth: int) -> Any:
        meant = ""
        if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)) and not isinstance(node.value, bool):
            return float(node.value)
        if isinstance(node, ast.Name):
            name = node.id.removesuffix(MARK)
            if name == "pi":
                return math.pi
            if name not in self.known:
                listed = shortened(", ".join(self.known), 300)
                raise InputError(
                    f"{self.where}: unknown name {shortened(repr(name))}{closest(name, self.known)}; known are {listed}"
                )
            return self.known[name]
        if isinstance(node, ast.BinOp) and type(node.op) in _OPERATIONS:
            # a + b + c + ..., from the left: as long as it may be, it is not nested
            terms: list[ast.BinOp] = []
            first: ast.expr = node
            while isinstance(first, ast.BinOp) and type(first.op) in _OPERATIONS:
                terms.append(first)
                first = first.left
            value = self.value(first, depth)
            for term in reversed(terms):
                value = self._sound(_OPERATIONS[type(term.op)](value, self.value(term.right, depth)), term)
            return value
        if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATIONS:
            return _OPERATIONS[type(node.op)](self.value(node.operand, depth))
        if isinstance(node, ast.BoolOp):
            return reduce(_OPERATIONS[type(node.op)], (self.value(part, depth) for part in node.values))
        if isinstance(node, ast.Compare) and all(type(sign) in _OPERATIONS for sign in node.ops):
            sides = [self.value(part, depth) for part in (node.left, *node.comparators)]
            pairs = zip(node.ops, sides, sides[1:], strict=False)
            return reduce(ca.logic_and, [_OPERATIONS[type(sign)](left, right) for sign, left, right in pairs])
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
            name = node.func.id.removesuffix(MARK)
            fewest, most = self.counts.get(name, (1, 1))
            if name in self.calls and fewest <= len(node.args) <= most:
                return self.calls[name](*(self.value(part, depth) for part in node.args))
            meant = "" if name in self.calls else closest(name, self.calls)
        raise InputError(
            f"{self.where}: {self._shown(node)} is not allowed{meant}; use numbers, names, + - * / **, brackets "
            f"and {', '.join(self.calls)}"
        )
