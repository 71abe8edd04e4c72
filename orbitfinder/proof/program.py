"""A CasADi SX graph walked once into a straight-line program that any number type can run.

CasADi evaluates in floating point only; here the same graph is evaluated on balls and on power
series with ball coefficients. The order of the operations is the graph's, so nothing is derived twice.

Where CasADi differentiates it folds numbers in floating point too: of v / 3 the derivative is 0.333... rounded. What is
differentiated for a theorem is `lifted` before, its numbers symbols.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError

OPERATIONS = {
    ca.OP_ADD: "add", ca.OP_SUB: "sub", ca.OP_MUL: "mul", ca.OP_DIV: "div", ca.OP_POW: "pow", ca.OP_CONSTPOW: "pow",
    ca.OP_NEG: "neg", ca.OP_SQ: "sq", ca.OP_SIN: "sin", ca.OP_COS: "cos", ca.OP_SQRT: "sqrt", ca.OP_EXP: "exp",
    ca.OP_LOG: "log", ca.OP_TWICE: "twice", ca.OP_INV: "inv", ca.OP_TAN: "tan", ca.OP_ASSIGN: "copy",
    ca.OP_SINH: "sinh", ca.OP_COSH: "cosh", ca.OP_TANH: "tanh",
}  # fmt: skip


@dataclass(frozen=True)
class ScalarProgram:
    """Operations (name, target, operand, operand or -1) on values numbered in order of creation.

    `constants` are (value, number), `inputs` (value, argument, entry) and `outputs` one dictionary
    entry -> value for each result (column-major entries; absent ones are structurally zero).
    """

    size: int
    constants: tuple[tuple[int, float], ...]
    inputs: tuple[tuple[int, int, int], ...]
    operations: tuple[tuple[str, int, int, int], ...]
    outputs: tuple[dict[int, int], ...]

    def run(self, arguments: Sequence[Sequence[Any]], ring: Ring) -> list[dict[int, Any]]:
        """The results on any number type; `arguments` are sequences of its numbers."""
        values = [None] * self.size
        for target, number in self.constants:
            values[target] = ring.constant(number)
        for target, argument, entry in self.inputs:
            values[target] = arguments[argument][entry]
        for name, target, a, b in self.operations:
            operands = (values[a],) if b < 0 else (values[a], values[b])
            values[target] = ring.functions[name](*operands)
        return [{entry: values[value] for entry, value in result.items()} for result in self.outputs]


@dataclass(frozen=True)
class Ring:
    """A number type: how a float becomes one of its numbers, and its operations by name."""

    constant: Callable[[float], Any]
    functions: dict[str, Callable[..., Any]]


def graphs(numbers: list[tuple[ca.SX, float]]) -> Ring:
    """The same operations as a graph again, on other symbols than those of the function; its numbers, powers
    of 2 left out, become symbols that join `numbers` with what they stand for."""

    def constant(number: float) -> ca.SX:
        if abs(np.frexp(number)[0]) in (0.0, 0.5):
            return ca.SX(number)
        numbers.append((ca.SX.sym(f"number{len(numbers)}"), number))
        return numbers[-1][0]

    plain = {name: getattr(operator, name) for name in ("add", "sub", "mul", "neg", "pow")}
    known = {name: getattr(ca, name) for name in ("sin", "cos", "sqrt", "exp", "log")}
    return Ring(constant, {**plain, **known, "div": operator.truediv, "sq": lambda a: a * a})


def program(function: ca.Function) -> ScalarProgram:
    """The program of an SX function. `InputError` names an operation that has no power series here."""
    if not function.is_a("SXFunction"):
        raise InputError(
            f"{function.name()}: only scalar graphs (SX) can be proved; systems solved numerically inside "
            "the graph (many coordinates, linkages) cannot"
        )
    graph = _Graph()
    for k in range(function.n_instructions()):
        graph.instruction(function, k)
    outputs = tuple(
        {int(function.sparsity_out(i).find()[nonzero]): value for nonzero, value in result.items()}  # column-major
        for i, result in ((i, graph.outputs.get(i, {})) for i in range(function.n_out()))
    )
    return ScalarProgram(graph.size, tuple(graph.constants), tuple(graph.inputs), tuple(graph.operations), outputs)


def derived(
    name: str, inputs: Sequence[ca.SX], expression: ca.SX, results: Callable[[ca.SX], Sequence[ca.SX]]
) -> ScalarProgram:
    """The program of what `results` makes of an expression, derivatives among it, none of its numbers rounded."""
    numbers = list[tuple[ca.SX, float]]()
    code = program(ca.Function(name, list(inputs), [expression]))
    entries = code.run([[given.nz[k] for k in range(given.nnz())] for given in inputs], graphs(numbers))[0]
    exact = ca.SX(*expression.shape)
    for entry, value in entries.items():
        exact[entry] = value
    return bound(name, inputs, results(exact), numbers)


def bound(
    name: str, inputs: Sequence[ca.SX], results: Sequence[ca.SX], numbers: Sequence[tuple[ca.SX, float]]
) -> ScalarProgram:
    """The program of results in which symbols stand for numbers (see `graphs`)."""
    symbols = ca.vertcat(ca.SX(0, 1), *(symbol for symbol, _ in numbers))
    code = program(ca.Function(name, [*inputs, symbols], list(results)))
    filled = [(value, numbers[entry][1]) for value, at, entry in code.inputs if at == len(inputs)]
    given = tuple(each for each in code.inputs if each[1] != len(inputs))
    return replace(code, constants=(*code.constants, *filled), inputs=given)


class _Graph:
    """The graph so far: CasADi reuses its work registers, a program numbers every value once."""

    def __init__(self) -> None:
        self.size = 0
        self.register: dict[int, int] = {}
        self.known: dict[tuple[Any, ...], int] = {}
        self.constants: list[tuple[int, float]] = []
        self.inputs: list[tuple[int, int, int]] = []
        self.operations: list[tuple[str, int, int, int]] = []
        self.outputs: dict[int, dict[int, int]] = {}

    def new(self) -> int:
        """A fresh value."""
        self.size += 1
        return self.size - 1

    def instruction(self, function: ca.Function, k: int) -> None:
        """One instruction of the graph."""
        code, taken, given = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if code == ca.OP_OUTPUT:
            self.outputs.setdefault(given[0], {})[given[1]] = self.register[taken[0]]
        elif code == ca.OP_INPUT:
            self.register[given[0]] = target = self.new()
            self.inputs.append((target, taken[0], taken[1]))
        elif code == ca.OP_CONST:
            self.register[given[0]] = self.constant(function.instruction_constant(k))
        elif code in OPERATIONS:
            self.register[given[0]] = self.apply(OPERATIONS[code], *(self.register[slot] for slot in taken))
        else:
            names = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}
            raise InputError(
                f"{function.name()}: the operation {names.get(code, code)} has no power series here; "
                f"proofs know {', '.join(sorted({*OPERATIONS.values()} - {'copy'}))}"
            )

    def constant(self, number: float) -> int:
        """The value of a number, one value for equal numbers."""
        key = ("constant", float(number).hex())
        if key not in self.known:
            self.known[key] = self.new()
            self.constants.append((self.known[key], float(number)))
        return self.known[key]

    def apply(self, name: str, a: int, b: int = -1) -> int:
        """The value of an operation; equal operations on equal values are one."""
        if name == "copy":
            return a
        if name == "tan":
            return self.apply("div", self.apply("sin", a), self.apply("cos", a))
        if name == "inv":
            return self.apply("div", self.constant(1.0), a)
        if name in ("sinh", "cosh"):
            grown, half = self.apply("exp", a), self.constant(0.5)
            rest = self.apply("inv", grown)
            return self.apply("mul", half, self.apply("add" if name == "cosh" else "sub", grown, rest))
        if name == "tanh":  # 1 - 2 / (exp(2 a) + 1)
            below = self.apply("add", self.apply("exp", self.apply("twice", a)), self.constant(1.0))
            return self.apply("sub", self.constant(1.0), self.apply("div", self.constant(2.0), below))
        if name == "twice":
            return self.apply("mul", self.constant(2.0), a)
        if name == "mul" and a == b:
            return self.apply("sq", a)
        key = (name, *sorted((a, b))) if name in ("add", "mul") else (name, a, b)
        if key not in self.known:
            self.known[key] = self.new()
            self.operations.append((name, self.known[key], a, b))
        return self.known[key]
