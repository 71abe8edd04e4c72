"""df/dx as products of sparse factors, so that a column costs O(n) where df/dx itself is dense.

    u_1 = D_1 [y],  u_2 = D_2 [y, u_1],  ...,  df/dx y = D [y, u]

An expression's instructions, linearised, are such a sequence with a row each. Rows are eliminated, first that
which leaves the fewest numbers, while there are no more of them after than before: all of them where df/dx is
sparse, and of a chain of bodies those inside each body. (Griewank and Walther, Evaluating Derivatives (2008), 9-10.)
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca

from orbitfinder.integrate.rk8 import slopes_of


@dataclass(frozen=True)
class SparseSlopes:
    """(f, S), the numbers of all rows and [df/ds | df/dfree] as a function of (t, x, s, free), and where they stand.

    Row i has the numbers from begins[i] to begins[i + 1], each times y[k] for its k in `columns`; the first `inner`
    rows are y's next components, the others df/dx y. Of positions, whose rates are the velocities that stand so many
    components behind them, there are no rows: they are `placed` first.
    """

    function: ca.Function
    begins: list[int]
    columns: list[int]
    inner: int = 0
    placed: int = 0


def sparse_slopes(field: ca.Function, quadrature: ca.Function | None, apart: ca.Function | None = None) -> SparseSlopes:
    """Of a field of scalars; df/dx without its zeros where that is shorter.

    `apart(t, x, s, free, y, a)` is the field again, at y = x and a = f(t, x, s, free), where it also has its df/dx with
    y and a held: written so that it has few numbers, as where accelerations follow from balances of forces.
    """
    inputs, rows = field.sx_in(), Elimination(apart or field)
    half, odd = divmod(field.size1_in(1), 2)
    placed = 0 if odd or not ca.is_equal(field(*inputs)[:half], inputs[1][half:]) else half
    if rows.count >= field.jac_sparsity(0, 1).nnz():
        rate, matrix, forcing, added = slopes_of(field, quadrature).call(inputs)
        across = matrix[placed:, :].T
        outputs, begins, columns = [across, ca.densify(forcing)], across.sparsity().colind(), across.sparsity().row()
    else:
        rate, (numbers, begins, columns) = field(*inputs), rows.table(placed)
        if apart:
            numbers = ca.Function("numbers", apart.sx_in(), [numbers])(*inputs, inputs[1], rate)
        else:
            numbers = ca.Function("numbers", inputs, [numbers])(*inputs)
        outputs = [numbers, ca.densify(ca.jacobian(rate, ca.vertcat(*inputs[2:])))]
        added = ca.SX(0, 1) if quadrature is None else quadrature(*inputs)
    function = ca.Function("slopes", inputs, ca.cse([ca.vertcat(rate, added), *outputs]))
    return SparseSlopes(function, begins, columns, len(begins) - 1 - field.size1_in(1) + placed, placed)


class Elimination:
    """The linearised instructions of a function by its second argument, as rows of numbers (expressions)."""

    def __init__(self, function: ca.Function) -> None:
        self.size, self.rows, self.users = function.size1_in(1), list[dict[int, ca.SX]](), list[set[int]]()
        for _ in range(self.size):
            self._add({})
        self.first = self._recorded(function)
        self.left = set(range(self.size, self.first))
        self._eliminate()
        self.count = sum(map(len, self.rows))

    def table(self, placed: int = 0) -> tuple[ca.SX, list[int], list[int]]:
        """Numbers, where rows begin among them, and their columns; without the first outputs' so many."""
        order = [*sorted(self.left), *range(self.first + placed, len(self.rows))]
        places = {row: k for k, row in enumerate([*range(self.size), *order])}
        begins, columns, numbers = [0], list[int](), list[ca.SX]()
        for row in order:
            columns += [places[k] for k in self.rows[row]]
            numbers += self.rows[row].values()
            begins.append(len(columns))
        return ca.densify(ca.vertcat(*numbers)), begins, columns

    def _add(self, row: dict[int, ca.SX]) -> int:
        self.rows.append(row)
        self.users.append(set())
        for k in row:
            self.users[k].add(len(self.rows) - 1)
        return len(self.rows) - 1

    def _recorded(self, function: ca.Function) -> int:
        """A row for each instruction, then for each output: where those begin."""
        inputs, values, own = function.sx_in(), dict[int, ca.SX](), dict[int, int]()
        results = dict[int, int | None]()
        for k in range(function.n_instructions()):
            code, given, made = (of(k) for of in (function.instruction_id, function.instruction_input,
                                                  function.instruction_output))  # fmt: skip
            row, place = None, made[-1] if code == ca.OP_OUTPUT else made[0]
            if code == ca.OP_OUTPUT:
                results[place] = own.get(given[0])
                continue
            if code == ca.OP_CONST:
                values[place] = ca.SX(function.instruction_constant(k))
            elif code == ca.OP_INPUT:
                values[place] = inputs[given[0]][given[1]]
                row = given[1] if given[0] == 1 else None
            else:
                value, *slopes = _linear(code, len(given))(*(values[at] for at in given))
                numbers = dict[int, ca.SX]()
                for at, slope in zip(given, slopes, strict=True):
                    if at in own and not slope.is_zero():
                        numbers[own[at]] = numbers.get(own[at], 0) + slope
                values[place] = value
                row = self._add(numbers) if numbers else None
            own.pop(place, None)
            if row is not None:
                own[place] = row
        first = len(self.rows)
        for row in map(results.get, range(self.size)):
            self._add({} if row is None else {row: ca.SX(1)})
        return first

    def _gain(self, row: int) -> int:
        """How many numbers fewer there are without a row."""
        users = self.users[row]
        return len(self.rows[row]) + len(users) - sum(len(users - self.users[k]) for k in self.rows[row])

    def _eliminate(self) -> None:
        waiting = [(-self._gain(row), row) for row in self.left]
        heapq.heapify(waiting)
        while waiting:
            loss, row = heapq.heappop(waiting)
            if row not in self.left or loss != -self._gain(row) or loss > 0:
                continue
            self.left.remove(row)
            near = {k for k in (*self.rows[row], *self.users[row]) if k in self.left}
            for k, slope in self.rows[row].items():
                self.users[k].remove(row)
                for user in self.users[row]:
                    self.rows[user][k] = self.rows[user].get(k, 0) + slope * self.rows[user][row]
                    self.users[k].add(user)
            for user in self.users[row]:
                del self.rows[user][row]
            self.rows[row] = {}
            for k in near:
                heapq.heappush(waiting, (-self._gain(k), k))


@lru_cache(maxsize=64)
def _linear(code: int, count: int) -> ca.Function:
    """An instruction's value and its derivatives."""
    given = [ca.SX.sym("a"), ca.SX.sym("b")][:count]
    value = ca.SX.binary(code, *given) if count == 2 else ca.SX.unary(code, *given)
    return ca.Function("linear", given, [value, *(ca.densify(ca.jacobian(value, each)) for each in given)])
