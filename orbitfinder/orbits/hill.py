"""Stability of motions by harmonic balance, from Hill's matrix: the Floquet exponents that may cross the axis.

A small motion e^(s tau) u(tau) beside a periodic unit has A(s) u = 0, A(s) the matrix of harmonic balance with d/dtau +
s for d/dtau; exponents come again with every i, or 2 i among odd orders. About shifts sigma along the axis

    A(sigma + theta) = A + theta B + theta^2 C,      (u, mu u) -> (mu u, -A^-1 (B mu u + C u)),   mu = 1 / theta,

and Arnoldi's method finds the largest mu, a sparse factorisation a shift.

All multipliers of up to `ALL` driven coordinates, and of free motions of up to `MOST_MODES`, are computed by sparse
steps of Gauss' method over the series. Where that takes too many steps, and of more coordinates, the energy of
`orbits.decay` is asked first. Where it proves nothing, averaging says which shifts there are: with frequencies w_i,
rates of decay g_i and modes of the mean matrices, the k-th harmonic K of the stiffness couples two modes by c = K_ij /
2 sqrt(w_i w_j), and where they are d = w_i + w_j - k off a resonance they grow by Re sqrt(((g_i - g_j + i d) / 2)^2 +
c^2) - (g_i + g_j) / 2. The next order couples them by sums of c_il c_lj / |w_i +- w_l - k| over all modes l, by as much
as which d is off too; each further order is smaller by the norm of the c / |w_i +- w_l - k|, the share, and where that
is not small nothing is known. With twice the sum of the orders, pairs that grow are looked for, and what all others do
at most bounds the `rest`. Of free motions only those that grow are looked for. Of more coordinates than all modes are
known of, slow modes are looked at: with kappa the size of K_k beside the mean K, c <= kappa sqrt(w_i w_j) / 2, so w_i +
w_j <= k / (1 - kappa / 4 q) where a pair grows, q the least sqrt(g_i g_j) / (g_i + g_j), and none where kappa k / 4 is
below all rates of decay.
Sources: B. Bentvelsen, A. Lazarus, Nonlinear Dyn. 91 (2018) 1349-1370; A. Nayfeh, D. Mook, Nonlinear Oscillations
(1979), section 5.4.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
from scipy.linalg import eig, eigh
from scipy.sparse.linalg import ArpackError, ArpackNoConvergence, LinearOperator, eigs, eigsh, splu

from orbitfinder._runtime import limit
from orbitfinder._runtime.sizes import nonzero, relative
from orbitfinder.errors import ConvergenceError
from orbitfinder.integrate.collocation import tableau
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.loops.symmetry import symplectic
from orbitfinder.orbits.decay import Beside, Decay, decay, definite, extreme
from orbitfinder.orbits.floquet import Floquet, judged, reduce_monodromy, verdict
from orbitfinder.orbits.harmonics import Balanced, Coefficients, Pattern
from orbitfinder.orbits.implicit import RESOLVED, SMALL, STAGES, Variations, truncated

SOUGHT, MOST_SOUGHT, VECTORS, RESTARTS, CONVERGED = 2, 24, 12, 8, 1e-5
"""Exponents about a shift, at first and at most, vectors that they are sought in, restarts with so few, their relative
error"""
STEP, SPARSE, MOST_STEPS = 0.5, 1.0, 4096
"""Steps of a march for all exponents, in units of the fastest motion, of free motions, and how many at most"""
INSTANTS, EVEN, GROWN, PARTNER = 8, 1e-11, 1e-5, 1e-2
"""At which the fastest motion is looked for; share of a motion's largest coefficient that is none; real parts of
exponents that grow where nothing damps, and what share of them their partners may be off"""
ALIKE, ROUND_OFF = 1e-7, 1e-8
"""Exponents nearer than this are the same. Real parts below it are none"""
MARGIN, SLIGHT, MOST_SHARE, NEARBY, MOST_SHIFTS = 2.0, 1e-6, 0.5, 0.05, 8
"""By how much couplings may be larger than by two orders; share of the largest harmonic that is none; share of an order
in the one before it; how far apart shifts are; shifts at most"""
ALL, EXACT = 100, 1e-14
"""Coordinates up to which all exponents of driven motions are computed; relative error of a monodromy at least"""
SYMMETRIC, MOST_MODES, MODES = 1e-9, 400, 80
"""Relative difference from a matrix's transpose that is none; coordinates up to which all modes are known, and modes
of more that may be looked at"""


@dataclass(frozen=True)
class Exponents:
    """Exponents s (in units of omega), the least stable first, and the largest real part that any `rest` may have:
    infinite where nothing is known of it, and `why`."""

    values: np.ndarray
    rest: float
    why: str = ""
    whole: Floquet | None = None
    """where all are known"""
    root: int = 1
    indices: np.ndarray = field(default_factory=lambda: np.zeros(0, complex))
    """of free motions, of the map whose power `root` the monodromy is"""

    @property
    def multipliers(self) -> np.ndarray:
        """e^(2 pi s), each with its conjugate."""
        if self.whole is not None:
            return self.whole.multipliers
        picked = np.exp(2 * np.pi * self.values)
        pairs = self.values[(self.values.imag > ALIKE) & (np.abs(self.values.imag % 0.5 - 0.25) < 0.25 - ALIKE)]
        return picked if np.any(self.values.imag < -ALIKE) else np.append(picked, np.exp(2 * np.pi * pairs.conj()))

    @property
    def stability(self) -> str:
        """In the words of other orbits, or that it is undecided."""
        if self.whole is not None:
            return self.whole.stability
        worst = float(self.values.real.max(initial=-np.inf))
        if worst > ROUND_OFF:
            return "unstable"
        if not self.rest < 0:
            return "undecided"
        return "asymptotically stable" if worst < -ROUND_OFF else "marginal"


def exponents(problem: Balanced, w: Coefficients) -> Exponents:
    """Those of a motion, remembered with it. Raises `ConvergenceError` where Arnoldi's method finds none."""
    if "exponents" not in w.known:
        w.known["exponents"] = _all(problem, w) or _few(problem, w)
    return w.known["exponents"]  # type: ignore[no-any-return]


def _all(problem: Balanced, w: Coefficients) -> Exponents | None:
    """Those of up to `ALL` coordinates that are not stiff, and of free motions of more."""
    equations, first = problem.equations, problem.equations.model.rates is not None
    if equations.size > (SMALL if first else ALL if equations.names else MOST_MODES):
        return None
    whole, power, error = (monodromy(problem, w), 1, 0.0) if first else _reduced(problem, w)
    if whole is None:
        return None
    keeps, (values, left, right) = symplectic(equations.model), eig(whole, left=True)
    about, root = (judged(each, keeps, error) for each in (values**power, values))
    if not keeps:  # an eigenvalue is off by what its matrix is, times its condition
        condition = np.linalg.norm(whole) / nonzero(np.abs(values * (left.conj() * right).sum(axis=0)))
        lost = np.minimum(power * max(error, EXACT) * condition, 1.0)
        about = replace(about, stability=verdict(values**power, lost))
    with np.errstate(divide="ignore"):
        picked = power * np.log(root.multipliers) / (2 * np.pi)
    return Exponents(picked[np.argsort(-picked.real)], -np.inf, "", about, power, root.indices.astype(complex))


def proved(problem: Balanced, w: Coefficients) -> bool:
    """Whether all that is known of a motion's exponents is that an energy falls."""
    about = exponents(problem, w)
    return problem.equations.size > MOST_MODES and not about.values.size and about.rest < 0


@one_thread()
def _reduced(problem: Balanced, w: Coefficients, finer: int = 1) -> tuple[np.ndarray | None, int, float]:
    """A root of the monodromy, of free motions on their level of energy modulo their own direction, of which power that
    is, and what it is known to; None where too many steps would be needed. Steps are `finer` times as many.

    Sparse steps go over half a period where G is odd, as Phi = (-Phi(pi))^2, and over half of that where the motion is
    even about 0, as then, with P = diag(1, -1), Phi over the whole is P A^-1 P A.
    """
    equations, basis, values = problem.equations, problem.basis, problem.values(w)
    linear, n, coefficients = Variations(equations), equations.size, problem.coefficients(w)
    fixed = np.broadcast_to(equations.fixed(values)[:, None], (len(equations.steady), STAGES))

    def slopes(times: np.ndarray) -> np.ndarray:
        varying = equations.moving(times, basis.motion(coefficients, times), values)
        return np.concatenate([varying, fixed[:, : times.size]])

    odd, sines = 0 not in basis.orders, [place + 1 for k, place in zip(basis.orders, basis.places, strict=True) if k]
    even = (
        not equations.names
        and equations.model.gyroscopic is None
        and bool(np.abs(coefficients[:, sines]).max() <= EVEN * np.abs(coefficients).max())
    )
    length = 2 * np.pi / (1 + odd) / (1 + even)
    instants = np.split(np.linspace(0.0, length, INSTANTS), INSTANTS)
    worth = np.abs(np.fft.rfft(problem.sampled(w)[1], axis=1)).max(axis=0, initial=0.0)  # in a step as z^13 times that
    turning = (1 + odd) * np.arange(worth.size) * (worth / nonzero(worth.max(initial=0.0))) ** (1 / (2 * STAGES + 1))
    fastest = max(1.0, turning.max(), *(linear.fastest(slopes(each)[:, 0]) for each in instants))
    steps = int(np.ceil(fastest * length / (RESOLVED if equations.names else SPARSE)))
    if steps > MOST_STEPS * length / (2 * np.pi):
        return None, 1, 0.0
    steps *= finer
    h, gone = length / steps, np.eye(2 * n) - 1.0 / n  # a reflection, and nothing in it is 0
    for k in range(steps):
        limit.check()
        gone = linear.over(h, slopes(h * (k + linear.rule.points)), gone)
    masses = linear.matrix(slopes(np.zeros(1))[:, 0] * (linear.table[:, 2] == 2)).diagonal()
    units = np.concatenate([masses**-0.5, masses**-0.5 * fastest**0.5])
    root = (gone - gone.sum(axis=1, keepdims=True) / n) * units / units[:, None]
    if even:
        back = np.repeat([1.0, -1.0], n)[:, None]
        root = back * np.linalg.solve(root, back * root)
    root = -root if odd else root
    off = (1 + even) * truncated(fastest * length, steps)
    if equations.names:
        return root, 1 + odd, off
    motion, pace = basis.motion(coefficients, np.zeros(1)), np.repeat([1.0, equations.pace(values)], n)
    state, ahead = (np.concatenate(pair)[:, 0] for pair in (motion[:2], motion[1:]))
    gradient = (pace * equations.at_start(equations.level, pace * state)[1])[None] * units  # of the energy
    along = ahead[None] / units
    lost = (relative(root @ along[0] - along[0], along[0]), relative(gradient[0] @ root - gradient[0], gradient[0]))
    return reduce_monodromy(root, gradient, along), 1 + odd, (1 + odd) * max(off, *lost)


def finer_indices(problem: Balanced, w: Coefficients) -> np.ndarray:
    """`Exponents.indices` of a free motion of which all are known, by twice as many steps."""
    root, _, _ = _reduced(problem, w, 2)
    assert root is not None
    keeps = symplectic(problem.equations.model)
    return judged(np.linalg.eigvals(root).astype(complex), keeps).indices.astype(complex)


def _few(problem: Balanced, w: Coefficients) -> Exponents:
    """Those near what may grow, of free motions those of them that do."""
    free, many = not problem.equations.names, problem.equations.size > MOST_MODES
    proof = Decay(0.0) if free else decay(problem, w)
    if proof.rate > 0:
        return Exponents(np.zeros(0, complex), -proof.rate)
    spacing = 1.0 if 0 in problem.basis.orders else 2.0
    suspects, reaches, rest, more = _suspects(problem, w)
    there = suspects - (spacing - 1.0)  # e^(i f tau) is e^(s tau) times an order, f - 1 is 0 among odd ones
    there = np.abs((there + spacing / 2) % spacing - spacing / 2)
    shifts = np.rint(there / NEARBY) * NEARBY
    values, places = [], sorted({*shifts.tolist(), *([0.0] if more else [])})
    for shift in places[:MOST_SHIFTS]:
        own = shifts == shift
        needed = float((np.abs(there[own] - shift) + reaches[own]).max(initial=0.0))
        count, radius = SOUGHT + 2 * int(own.sum()), -1.0
        while radius < needed and count <= MOST_SOUGHT:
            picked, radius = _about(problem, w, complex(0.0, shift), count)
            values += picked.tolist()
            count *= 2
        if radius < needed:
            rest, more = np.inf, f"more exponents than {MOST_SOUGHT} lie about {shift:.3g} i"
    if len(places) > MOST_SHIFTS:
        rest, more = np.inf, f"modes at more than {MOST_SHIFTS} frequencies may grow"
    if free:
        values, rest = _growing(problem, w, values), np.inf
        more = f"it has more than {MOST_MODES} coordinates" if many else f"its modes ask for over {MOST_STEPS} steps"
        more = "" if values else f"nothing damps it; {more}"
    alone: list[complex] = []
    for value in sorted(values, key=lambda s: -s.real):
        there_ = complex(value.real, abs((value.imag + spacing / 2) % spacing - spacing / 2))
        if not any(abs(there_ - other) < ALIKE for other in alone):
            alone.append(there_)
    return Exponents(
        np.array(alone, complex), rest, "; ".join(filter(None, (proof.why, more))) if np.isinf(rest) else ""
    )


def _growing(problem: Balanced, w: Coefficients, values: list[complex]) -> list[complex]:
    """Those of a free motion that grow, known far better from there, each with its partner that decays as fast."""
    picked = []
    for value in values:
        if value.real > GROWN:
            near = complex(_about(problem, w, value, 1)[0][0])
            partner = min(abs(other + near.conjugate()) for other in values)
            if near.real > GROWN and max(partner, abs(near - value)) < PARTNER * near.real:
                picked += [near, -near.conjugate()]
    return picked


@dataclass(frozen=True)
class _Modes:
    """Of the mean matrices: frequencies (m), shapes (n x m), their rates of decay, and the least of all there are."""

    frequencies: np.ndarray
    shapes: np.ndarray
    decays: np.ndarray
    least: float


def _modes(beside: Beside, harmonics: np.ndarray, period: int, free: bool) -> _Modes | str:
    """All modes, or of many those slow enough to grow, of free motions those nearest; or why they do not tell."""
    parts = beside.stiffness, beside.damping, beside.mass
    if beside.shifting or any(abs(part - part.T).max() > SYMMETRIC * abs(part).max() for part in parts):
        return "its matrices are not symmetric, or its masses change"
    stiffness, damping, mass = parts
    if not mass.nnz:
        return "it has no masses"
    if beside.n <= MOST_MODES:
        squares, shapes = eigh(stiffness.toarray(), mass.toarray())
    elif free:
        squares, shapes = eigsh(stiffness, MODES, mass, sigma=1.0, v0=np.ones(beside.n))
    else:
        top, stiff = 0.0, beside.varies[:, 2] == 0
        try:
            if not stiff.all():
                return "what damps it changes with the motion"
            slowest, fastest = (0.5 * extreme(damping, mass, end) for end in ("least", "largest"))
            for k in range(1, beside.degree + 1):
                sides = [beside.matrix(0, half) for half in (harmonics[:, k].real, harmonics[:, k].imag)]
                kappa = MARGIN * sum(extreme(side, stiffness, "largest") for side in sides if abs(side).max() > 0)
                apart = kappa * (slowest + fastest) / (4 * np.sqrt(slowest * fastest))
                if not apart < 1:
                    return "its stiffness changes by too much for single modes"
                if kappa * k * period > 4 * (1 - kappa / 2) * slowest:
                    top = max(top, k * period / (1 - apart))
            squares, shapes = eigsh(stiffness, MODES, mass, sigma=0.0, v0=np.ones(beside.n))
        except (ArpackError, RuntimeError):
            return "its modes are not found, or something is not damped"
        if squares.max() < top**2:
            return f"more modes than {MODES} may grow"
    if not squares.min() > 0:
        return "it has a mode without stiffness"
    frequencies = np.sqrt(squares)
    decays = np.zeros(frequencies.size) if free else np.einsum("ij,ij->j", shapes, damping @ shapes) / 2
    if not free and not decays.min() > 0:
        return "some of it is not damped"
    if not free and not definite(damping):  # what couples modes may then feed what each of them alone would damp
        if beside.n > MOST_MODES:
            return "some of it is not damped"
        size, coupled = np.eye(beside.n), shapes.T @ (damping @ shapes)
        slowest = -np.linalg.eigvals(np.block([[0 * size, size], [-np.diag(squares), -coupled]])).real.max()
        if not slowest > ROUND_OFF:
            return "some of it is not damped"
        decays = np.full(beside.n, slowest)
    slow = decays - np.sqrt(np.maximum(decays**2 - squares, 0.0))
    return _Modes(
        frequencies, shapes, decays,
        float(slow.min() if free or shapes.shape[1] == beside.n else min(slow.min(), slowest)),
    )  # fmt: skip


def _suspects(problem: Balanced, w: Coefficients) -> tuple[np.ndarray, np.ndarray, float, str]:
    """Frequencies (k) that may grow with another, how far their exponents may be off, what the rest does at most, and
    why nothing is known of that."""
    moving, samples = problem.equations.varying, problem.sampled(w)[1]
    harmonics = np.fft.rfft(samples, axis=1) / samples.shape[1]
    period = 1 if 0 in problem.basis.orders else 2
    seen = _modes(Beside(problem, w), harmonics, period, not problem.equations.names)
    if isinstance(seen, str):
        return np.zeros(0), np.zeros(0), np.inf, seen
    frequencies, decays = seen.frequencies, seen.decays
    worth = np.abs(harmonics[:, 1:]).max(axis=0, initial=0.0)
    rest, picked = -0.5 * seen.least, dict[int, float]()  # where c is less than half of what would let it grow
    upper, between = np.triu_indices(frequencies.size), np.sqrt(np.outer(frequencies, frequencies))
    allowed, sums = np.sqrt(np.outer(decays, decays))[upper], frequencies[:, None] + frequencies
    couplings, shares, seconds = {}, {}, defaultdict[int, Any](lambda: 0 * sums)
    for k in (np.flatnonzero(worth > SLIGHT * worth.max(initial=0.0)) + 1).tolist():
        coupling = 0 * sums
        for kind in (0, 1):
            own = moving[:, 2] == kind
            sides = seen.shapes[moving[own, 0]], seen.shapes[moving[own, 1]]
            part = np.abs((sides[0] * harmonics[own, k, None]).T @ sides[1])
            coupling += part * (frequencies if kind else 1.0)
        c = couplings[k] = (coupling + coupling.T) / (4 * between)
        if decays.any():
            turn, apart = k * period, abs(frequencies[:, None] - frequencies)
            near = abs(sums - turn)
            near = [np.where(near < 2 * MARGIN * c, np.inf, near), sums + turn, abs(apart - turn), apart + turn]
            shares[k] = sum(c / nonzero(np.maximum(each, c)) for each in near)
    for first, second in product(couplings, shares):
        for k in {first + second, abs(first - second)}:
            seconds[k] += couplings[first] @ shares[second]
    share = float(np.linalg.norm(sum(shares.values(), 0 * sums), 2))
    if not share < MOST_SHARE:
        return np.zeros(0), np.zeros(0), np.inf, f"the next order of averaging is {share:.2g} of the first"
    shifted = seconds[0].diagonal() / (1 - share)
    for k in {*couplings, *seconds} - {0}:
        most = MARGIN * (couplings.get(k, 0.0) + (seconds[k] + seconds[k].T) / (2 - 2 * share))[upper]
        strong = np.flatnonzero(most > 0.5 * allowed)
        i, j, c = upper[0][strong], upper[1][strong], most[strong]
        off = np.maximum(abs(sums[i, j] - k * period) - shifted[i] - shifted[j], 0.0)
        grown = np.sqrt((0.5 * (decays[i] - decays[j] + 1j * off)) ** 2 + c**2).real - 0.5 * (decays[i] + decays[j])
        rest = max(rest, float(grown[grown <= 0].max(initial=-np.inf)))
        for mode, reach in zip((*i[grown > 0], *j[grown > 0]), (*c[grown > 0], *c[grown > 0]), strict=True):
            picked[mode] = max(picked.get(mode, 0.0), float(reach))
    which = np.array(sorted(picked), int)
    return frequencies[which], np.array([picked[k] for k in which.tolist()]), rest, ""


def _about(problem: Balanced, w: Coefficients, shift: complex, count: int) -> tuple[np.ndarray, float]:
    """So many exponents about a shift, and the radius of the disc in which there are no others."""
    varying, fixed = problem.sampled(w)[1], problem.equations.fixed(problem.values(w))
    a, b, c = (pattern.matrix(fixed, varying) for pattern in _shifted(problem, shift))
    try:
        factors = splu(a)
    except RuntimeError:
        return np.array([shift]), 0.0  # an exponent itself
    size = a.shape[0]
    kind = complex if shift.imag else float

    def applied(both: np.ndarray) -> np.ndarray:
        x, y = both[:size], both[size:]
        return np.concatenate([y, -factors.solve(np.asarray(b @ y + c @ x, kind))])

    start = np.random.default_rng(0).normal(size=2 * size).astype(kind)
    operator = LinearOperator((2 * size, 2 * size), matvec=applied, dtype=kind)
    for more in (1, 2, 4):  # of exponents close together many restarts are needed, or more vectors
        vectors, restarts = min(more * max(VECTORS, 3 * count), 2 * size - 1), RESTARTS if more < 4 else None
        try:
            picked = eigs(operator, count, which="LM", v0=start, ncv=vectors, maxiter=restarts, tol=CONVERGED,
                          return_eigenvectors=False)  # fmt: skip
            break
        except ArpackNoConvergence:
            continue
        except ArpackError as error:
            raise ConvergenceError(f"the exponents about {shift} are not told ({error})") from None
    else:
        raise ConvergenceError(f"the exponents about {shift} are not told by {vectors} vectors")
    theta = 1.0 / picked
    return shift + theta, float(np.abs(theta).max())


def _shifted(problem: Balanced, shift: complex) -> list[Pattern]:
    """A, B and C at a shift, kept with the orders."""
    known, basis = problem.pattern.derived, problem.basis
    if shift not in known:
        unit, moved = np.eye(basis.count), basis.slope + (shift if shift.imag else shift.real) * np.eye(basis.count)
        none = np.zeros_like(unit)
        powers: list[list[np.ndarray]] = [[unit, moved, moved @ moved], [none, unit, 2 * moved], [none, none, unit]]
        known[shift] = [Pattern(problem.equations, basis, each) for each in powers]
    return known[shift]  # type: ignore[no-any-return]


def monodromy(problem: Balanced, w: Coefficients) -> np.ndarray | None:
    """Of a first-order system over tau = 0 to 2 pi, by Gauss' steps of order twelve, all at once; None where stiff."""
    first = _rates(problem, w, np.zeros(1))[0]
    size, rule = len(first), tableau(6, "legendre")
    steps = 1 << int(np.ceil(np.log2(2 * np.pi * max(1.0, float(np.abs(np.linalg.eigvals(first)).max())) / STEP)))
    if steps > MOST_STEPS:
        return None
    h, count = 2 * np.pi / steps, rule.points.size
    times = (h * (np.arange(steps)[:, None] + rule.points)).ravel()
    rates = _rates(problem, w, times).reshape(steps, count, size, size)
    across = rule.inner[None, :, None, :, None] * rates[:, :, :, None, :]
    matrix = np.eye(count * size) - h * across.reshape(steps, count * size, count * size)
    stages = np.linalg.solve(matrix, rates.reshape(steps, count * size, size)).reshape(steps, count, size, size)
    maps = np.eye(size) + h * np.einsum("i,kiab->kab", rule.weights, stages)
    while len(maps) > 1:
        maps = maps[1::2] @ maps[::2]
    return np.asarray(maps[0])


def _rates(problem: Balanced, w: Coefficients, times: np.ndarray) -> np.ndarray:
    """The matrices (s x d x d) of the linearised equations of first order at times (rad)."""
    motion = problem.basis.motion(problem.coefficients(w), times)
    slopes = problem.equations.slopes(times, motion, problem.values(w))
    return -np.linalg.solve(slopes[1], slopes[0])
