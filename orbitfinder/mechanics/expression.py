"""Expressions as text, such as "torque1**2 + 0.1 * cos(theta1)": of names, numbers and a few functions, nothing else.

Text is what files can carry, so that a cost can be recomputed from an orbit.json alone; nothing in it is executed.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca

from orbitfinder.errors import InputError, closest

FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": ca.sin, "cos": ca.cos, "tan": ca.tan, "sqrt": ca.sqrt, "exp": ca.exp, "log": ca.log, "tanh": ca.tanh,
    "atan2": ca.atan2,
}  # fmt: skip
"""What may be called in an expression."""
LONGEST, DEEPEST = 2000, 60
"""Letters of an expression, and how deeply it may be nested"""

_OPERATIONS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: lambda a, b: a + b, ast.Sub: lambda a, b: a - b, ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b, ast.Pow: lambda a, b: a**b, ast.USub: lambda a: -a, ast.UAdd: lambda a: a,
}  # fmt: skip


def expression(
    text: str, known: Mapping[str, Any], where: str, calls: Mapping[str, Callable[[Any], Any]] | None = None
) -> Any:
    """The value of a text in these names (numbers or symbols) and with further `calls` of one argument; `InputError`
    begins with `where`."""
    if not isinstance(text, str) or not text.strip() or len(text) > LONGEST:
        raise InputError(f"{where}: must be an expression as text, such as 'torque1**2', got {str(text)[:40]!r}")
    try:
        tree = ast.parse(text.strip().replace("^", "**"), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InputError(f"{where}: {text!r} is no expression ({error}); write it as 'torque1**2 + theta1'") from None
    return _value(tree.body, known, where, 0, FUNCTIONS | dict(calls or {}))


def _value(
    node: ast.AST, known: Mapping[str, Any], where: str, depth: int, calls: Mapping[str, Callable[..., Any]]
) -> Any:
    """The value of a part of the text, a real and finite one where it is a number."""
    if depth > DEEPEST:
        raise InputError(f"{where}: nested too deeply; write it in fewer brackets")
    try:
        value = _worked_out(node, known, where, depth, calls)
    except InputError:
        raise
    except (ArithmeticError, ValueError):
        value = math.nan
    if isinstance(value, complex) or (isinstance(value, float) and not math.isfinite(value)):
        raise InputError(f"{where}: {ast.unparse(node)[:60]!r} is no finite real number; write a smaller one, no root "
                         "of a negative one and nothing divided by 0")  # fmt: skip
    return value


def _worked_out(
    node: ast.AST, known: Mapping[str, Any], where: str, depth: int, calls: Mapping[str, Callable[..., Any]]
) -> Any:
    def value(part: ast.AST) -> Any:
        return _value(part, known, where, depth + 1, calls)

    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)) and not isinstance(node.value, bool):
        return float(node.value)
    if isinstance(node, ast.Name):
        if node.id == "pi":
            return 3.141592653589793
        if node.id not in known:
            listed = ", ".join(known)
            raise InputError(f"{where}: unknown name {node.id!r}{closest(node.id, known)}; known are {listed}")
        return known[node.id]
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATIONS:
        return _OPERATIONS[type(node.op)](value(node.left), value(node.right))
    if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATIONS:
        return _OPERATIONS[type(node.op)](value(node.operand))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        name = node.func.id
        if name in calls and len(node.args) == 1 + (name == "atan2"):
            return calls[name](*map(value, node.args))
    raise InputError(
        f"{where}: {ast.unparse(node)[:60]!r} is not allowed; use numbers, names, + - * / **, brackets and "
        f"{', '.join(calls)}"
    )
