"""Systems derived by SymPy's mechanics, as PyDy users have them: LagrangesMethod and KanesMethod."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError, closest
from orbitfinder.mechanics.lagrange import Symbols, lagrange, mass_matrix_and_bias
from orbitfinder.mechanics.model import Model

TRIALS, AGREE = 6, 1e-10
"""Random states at which two derivations must agree, relative"""
FUNCTIONS = {"Abs": ca.fabs, "sign": ca.sign, "atan2": ca.atan2, "sin": ca.sin, "cos": ca.cos, "tan": ca.tan,
             "asin": ca.asin, "acos": ca.acos, "atan": ca.atan, "sinh": ca.sinh, "cosh": ca.cosh, "tanh": ca.tanh,
             "exp": ca.exp, "log": ca.log, "sqrt": ca.sqrt}  # fmt: skip


def from_sympy(
    method: Any,
    values: Mapping[Any, float],
    *,
    potential: Any = None,
    angles: Sequence[Any] | bool = True,
    points: Any = None,
    forcing_period: float | None = None,
    controls: Sequence[Any] = (),
) -> Model:
    """The Model of a `sympy.physics.mechanics` LagrangesMethod or KanesMethod without constraints.

    What either method's equations hold beyond the energies are forces. Speeds must be the coordinates' rates.

    Args:
        method: the LagrangesMethod, or the KanesMethod with its equations formed.
        values: a number for each constant symbol: they become physical parameters, named like the symbols.
        potential: of Kane's method, in place of what its bodies carry.
        angles: which coordinates are angles, or True for all.
        points: positions (2 x k, SymPy; x down, y right) that pictures draw.
        forcing_period: s, where the equations depend on time.
        controls: symbols that may vary in time.

    Returns:
        A Model.

    Raises:
        InputError: for constraints, foreign symbols, and energies that are not those of the equations.

    Examples:
        >>> import sympy
        >>> from sympy.physics.mechanics import LagrangesMethod, dynamicsymbols
        >>> theta, g = dynamicsymbols("theta"), sympy.Symbol("g")
        >>> method = LagrangesMethod(theta.diff() ** 2 / 2 + g * sympy.cos(theta), [theta])
        >>> _ = method.form_lagranges_equations()
        >>> of.from_sympy(method, {g: 9.8}).state_names
        ('theta', 'thetadot')
    """
    try:
        import sympy  # noqa: PLC0415
        from sympy.physics.mechanics import KanesMethod, LagrangesMethod, dynamicsymbols  # noqa: PLC0415
    except ImportError as error:
        raise InputError("method: SymPy is not installed; pip install 'orbitfinder[robot]'") from error
    if not isinstance(method, (KanesMethod, LagrangesMethod)):
        raise InputError(f"method: {type(method).__name__}; give a sympy LagrangesMethod or KanesMethod")
    _check_values(values)
    coordinates, speeds = list(method.q), list(method.u)
    if len(speeds) != len(coordinates) or len(getattr(method, "coneqs", ())):
        raise InputError("method: has constraints, which are not read from SymPy; see of.constrained")
    rates = [coordinate.diff(dynamicsymbols._t) for coordinate in coordinates]
    reader = _Reader(sympy, dynamicsymbols._t, coordinates, rates, values)
    if isinstance(method, KanesMethod):
        known = method.kindiffdict()
        for speed, rate in zip(speeds, rates, strict=True):
            if known.get(rate) != speed:
                raise InputError(
                    f"method: {rate} is {known.get(rate)} and not {speed}; give Kane's method the coordinates' rates "
                    "as speeds, in the order of the coordinates"
                )
        reader.renamed = dict(zip(speeds, rates, strict=True))
        if not method.bodies:
            raise InputError("method: has no bodies; form Kane's equations (kanes_equations(bodies, loads)) first")
        kinetic = sum(body.kinetic_energy(method._inertial) for body in method.bodies)
        level = kinetic - (sum(body.potential_energy for body in method.bodies) if potential is None else potential)
    else:
        level = method._L[0] if potential is None else method._L[0] - sympy.sympify(potential)
    energy = reader(level)
    varying = [str(control) for control in controls]
    forces = _beyond(method, energy, reader, varying)
    if forcing_period is None and reader.timed:
        raise InputError("forcing_period: the equations depend on time; give the period of what drives them, in s")
    symbols = Symbols(
        reader.q, reader.v, reader.p if reader.names else None, tuple(reader.names), tuple(reader.values),
        time=None if forcing_period is None else reader.t, forcing_period=forcing_period,
    )  # fmt: skip
    turning = (
        [True] * len(coordinates)
        if angles is True
        else [coordinate in list(angles or []) for coordinate in coordinates]
    )
    return lagrange(
        energy, ca.SX(0), symbols, forces=forces,
        names=[coordinate.func.__name__ for coordinate in coordinates], angles=turning,
        points=None if points is None else reader(sympy.Matrix(points)), controls=varying,
    )  # fmt: skip


def _check_values(values: Any) -> None:
    """`InputError` unless these are finite numbers by symbol."""
    if not isinstance(values, Mapping):
        raise InputError(f"values: must be numbers by symbol, got {values!r}; give such as {{m: 1.0}}")
    for symbol, value in values.items():
        try:
            finite = bool(np.isfinite(float(value)))
        except (TypeError, ValueError):
            finite = False
        if not finite:
            raise InputError(f"values.{symbol}: must be a finite number, got {value!r}; give one")


def _beyond(method: Any, lagrangian: ca.SX, reader: _Reader, controls: Sequence[str]) -> ca.SX | None:
    """The generalized forces (n) that SymPy's equations M q'' = f hold beyond those of a Lagrangian; None without any.

    Raises `InputError` where the two mass matrices differ: the energies are not those of the equations.
    """
    if hasattr(method, "form_lagranges_equations") and method.eom is None:
        method.form_lagranges_equations()
    matrix, forcing = reader(method.mass_matrix), reader(method.forcing)
    own, bias = mass_matrix_and_bias(lagrangian, ca.SX(0), reader.q, reader.v)
    rest, drive = _driven(forcing + bias, reader, controls)
    tried = ca.Function("tried", [reader.t, reader.q, reader.v, reader.p], [matrix, matrix - own, forcing, rest])
    random, there, worst = np.random.default_rng(0), False, 0.0
    for _ in range(TRIALS):
        q, v = random.uniform(-1, 1, (2, len(reader.coordinates)))
        p = np.where(np.array(reader.values) == 0, 1.0, reader.values) * random.uniform(0.5, 1.5, len(reader.values))
        mass, differs, force, more = (part.full() for part in tried(random.uniform(), q, v, p))
        worst = max(worst, float(np.abs(differs).max() / np.abs(mass).max()))
        there |= bool(np.abs(more).max() > AGREE * np.abs(force).max())
    if worst > AGREE:
        raise InputError(
            f"method: its mass matrix differs from that of its energies by {worst:.2g} of it; are bodies missing, or "
            "does the Lagrangian belong to another system?"
        )
    if not there:
        return drive if drive.nnz() else None
    return ca.simplify(rest) + drive


def _driven(rest: ca.SX, reader: _Reader, controls: Sequence[str]) -> tuple[ca.SX, ca.SX]:
    """Forces (n) without the controls, and what those add where they do so linearly, as torques do; none otherwise."""
    held = [k for k, name in enumerate(reader.names) if name in controls]
    u, own = reader.p[held], ca.DM([reader.values[k] for k in held])
    slope = ca.simplify(ca.jacobian(rest, u))
    if not held or ca.depends_on(slope, u):
        return rest, ca.SX(*rest.shape)
    return ca.substitute(rest, u, own), slope @ (u - own)


class _Reader:
    """SymPy expressions in coordinates, rates, constants and time as CasADi's."""

    def __init__(
        self, sympy: Any, clock: Any, coordinates: list[Any], rates: list[Any], values: Mapping[Any, float]
    ) -> None:
        self.sympy, self.clock, self.coordinates, self.rates = sympy, clock, coordinates, rates
        self.constants = {str(symbol): float(value) for symbol, value in values.items()}
        self.names, self.values = list(self.constants), list(self.constants.values())
        count = len(coordinates)
        self.t, self.q, self.v = ca.SX.sym("t"), ca.SX.sym("q", count), ca.SX.sym("v", count)
        self.p = ca.SX.sym("p", len(self.names))
        self.timed = False
        """whether anything read so far depends on time"""
        self.renamed: dict[Any, Any] = {}
        """speeds as rates"""
        self.plain = [sympy.Dummy(f"q{k}") for k in range(count)], [sympy.Dummy(f"v{k}") for k in range(count)]

    def flat(self, expression: Any) -> Any:
        """An expression in plain symbols in place of functions of time."""
        flat = self.sympy.sympify(expression).subs(self.renamed)
        flat = flat.subs(dict(zip(self.rates, self.plain[1], strict=True)))
        return flat.subs(dict(zip(self.coordinates, self.plain[0], strict=True)))

    def __call__(self, expression: Any) -> ca.SX:
        """The same in CasADi; `InputError` for symbols without a value."""
        flat = self.flat(expression)
        self.timed |= self.clock in flat.free_symbols
        own = {
            str(symbol): symbol
            for symbol in flat.free_symbols
            if symbol not in (*self.plain[0], *self.plain[1], self.clock)
        }
        left = flat.atoms(self.sympy.Derivative, self.sympy.core.function.AppliedUndef)
        for name in [*own, *map(str, left)]:
            if name not in self.names:
                raise InputError(
                    f"values: no number for {name!r}{closest(name, self.names)}; give one for each constant"
                )
        arguments = [*self.plain[0], *self.plain[1], self.clock, *own.values()]
        parameters = [self.p[self.names.index(name)] for name in own]
        function = self.sympy.lambdify(arguments, list(flat) if flat.is_Matrix else flat, [FUNCTIONS, "math"], cse=True)
        value = function(*ca.vertsplit(self.q), *ca.vertsplit(self.v), self.t, *parameters)
        if not flat.is_Matrix:
            return ca.SX(value)
        return ca.reshape(ca.vertcat(*value), flat.shape[1], flat.shape[0]).T
