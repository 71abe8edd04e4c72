"""Compare atlases of results/atlas with enumerations that share nothing with orbitfinder's search.

Two degrees of freedom: the return map of the section x = 0, px > 0 on a grid of its plane, by a Runge-Kutta method on
equations written here; every dip of |P^k(z) - z| is a start of Newton's method. Lorenz: every primitive necklace of two
letters but the constant ones is the word of one orbit (D. Viswanath, Nonlinearity 16 (2003) 1035-1056 found all 111,011
of up to 20 letters); the words of the orbits in the atlas are read off by another integrator.

    python benchmarks/atlas_checks.py results/atlas          half a minute
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

import orbitfinder as of

STEP = 0.02
SIDE, LETTERS = 160, 9
NEWTON, MOVE, CLOSED = 12, 1e-6, 1e-9
SHIFTS = ((MOVE, 0.0), (-MOVE, 0.0), (0.0, MOVE), (0.0, -MOVE))
SAME = 2e-5
"""Period and action of one orbit in both enumerations, relative: what the Runge-Kutta method errs by."""


@dataclass(frozen=True)
class Plane:
    """A system in the plane by its potential V(x, y) and force, even in nothing; the section x = 0, px > 0."""

    potential: Callable[[np.ndarray, np.ndarray], np.ndarray]
    force: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
    energy: float
    reach: tuple[float, float, float]
    """y from, y to, largest |py|"""
    crossings: int
    """most returns to the section in the longest period"""

    def rates(self, s: np.ndarray) -> np.ndarray:
        """d/dt of (x, y, px, py, time, action)."""
        x, y, px, py = s[:4]
        return np.array([px, py, *self.force(x, y), np.ones_like(x), px**2 + py**2])

    def lifted(self, z: np.ndarray) -> np.ndarray:
        """States (6 x m) on the section at z = (y, py) (2 x m), NaN outside the energy."""
        y, py = z
        with np.errstate(invalid="ignore"):
            px = np.sqrt(2 * (self.energy - self.potential(np.zeros_like(y), y)) - py**2)
        return np.array([np.zeros_like(y), y, px, py, np.zeros_like(y), np.zeros_like(y)])

    def returns(self, z: np.ndarray, count: int, longest: float) -> np.ndarray:
        """The first `count` returns (count x 4 x m: y, py, time, action) of motions; NaN after `longest`."""
        s, met = self.lifted(z), np.zeros(z.shape[1], int)
        found = np.full((count, 4, z.shape[1]), np.nan)
        for _ in range(int(longest / STEP)):
            new = stepped(self.rates, s, STEP)
            hit = np.flatnonzero((s[0] < 0) & (new[0] >= 0) & (met < count))
            if hit.size:
                at = onto(self.rates, s[:, hit])
                found[met[hit], :, hit] = at[[1, 3, 4, 5]].T
                met[hit] += 1
            s = new
            if np.all(met >= count):
                break
        return found


def stepped(rates: Callable[[np.ndarray], np.ndarray], s: np.ndarray, h: float | np.ndarray) -> np.ndarray:
    """One step of the classical Runge-Kutta method."""
    a = rates(s)
    b = rates(s + h / 2 * a)
    c = rates(s + h / 2 * b)
    d = rates(s + h * c)
    return np.asarray(s + h / 6 * (a + 2 * b + 2 * c + d))


def onto(rates: Callable[[np.ndarray], np.ndarray], s: np.ndarray) -> np.ndarray:
    """States just before the section brought onto x = 0 by two steps in which x is the clock (Henon's trick)."""

    def by_x(one: np.ndarray) -> np.ndarray:
        found = rates(one)
        return found / found[0]

    middle = stepped(by_x, s, -s[0] / 2) if np.all(np.abs(s[2]) > 0.3 * STEP) else s
    return stepped(by_x, middle, -middle[0])


def scanned(plane: Plane, longest: float, side: int = 160) -> np.ndarray:
    """Period and action (m x 2) of the orbits that the section meets, images apart."""
    low, high, most = plane.reach
    y, py = np.meshgrid(np.linspace(low, high, side), np.linspace(-most, most, side), indexing="ij")
    z = np.array([y.ravel(), py.ravel()])
    whole = plane.returns(z, plane.crossings, 1.02 * longest)
    found: list[tuple[float, float]] = []
    for k in range(1, plane.crossings + 1):
        gap = np.linalg.norm(whole[k - 1, :2] - z, axis=0).reshape(side, side)
        starts = z[:, dips(gap).ravel()]
        for period, action in solved(plane, starts, k, longest):
            if not any(close((period, action), one) for one in found):
                found.append((period, action))
    return np.array(sorted(found))


def dips(gap: np.ndarray) -> np.ndarray:
    """Where a grid of gaps is not above any of its eight neighbours."""
    filled = np.where(np.isnan(gap), np.inf, gap)
    padded = np.pad(filled, 1, constant_values=np.inf)
    n, m = gap.shape
    around = [
        padded[1 + i : 1 + i + n, 1 + j : 1 + j + m] for i, j in product((-1, 0, 1), repeat=2) if (i, j) != (0, 0)
    ]
    return np.isfinite(filled) & np.all([filled <= one for one in around], axis=0)


def solved(plane: Plane, z: np.ndarray, k: int, longest: float) -> Iterator[tuple[float, float]]:
    """Period and action of the orbits of k returns, and no fewer, that Newton's method finds from starts (2 x m)."""
    for turn in range(NEWTON):
        m = z.shape[1]
        moved = np.hstack([z, *(z + np.reshape(one, (2, 1)) for one in SHIFTS)])
        ends = plane.returns(moved, k, 1.1 * longest)
        gap = ends[k - 1, :2, :m] - z
        if turn == NEWTON - 1:
            break
        right, left, up, down = (ends[k - 1, :2, (i + 1) * m : (i + 2) * m] for i in range(4))
        slopes = np.stack([right - left, up - down], axis=1) / (2 * MOVE)
        rows = np.moveaxis(slopes - np.eye(2)[:, :, None], 2, 0)
        good = np.all(np.isfinite(rows), axis=(1, 2)) & np.all(np.isfinite(gap), axis=0)
        z, rows, gap = z[:, good], rows[good], gap[:, good]
        step = np.array([np.linalg.lstsq(one, b, rcond=1e-9)[0] for one, b in zip(rows, gap.T, strict=True)]).T
        if not z.size:
            return
        size = np.maximum(1.0, np.linalg.norm(step, axis=0) / 0.03)
        z = z - step / size
    closed = np.linalg.norm(gap, axis=0) < CLOSED
    for j in np.flatnonzero(closed):
        earlier = [i for i in range(1, k) if k % i == 0]
        if any(np.linalg.norm(ends[i - 1, :2, j] - z[:, j]) < 1e-5 for i in earlier):
            continue
        if ends[k - 1, 2, j] <= longest:
            yield float(ends[k - 1, 2, j]), float(ends[k - 1, 3, j])


def close(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return all(abs(a - b) <= SAME * max(abs(a), abs(b)) for a, b in zip(one, other, strict=True))


def compared(file: Path, plane: Plane, longest: float, side: int) -> tuple[int, list, list]:
    """Orbits (up to images) in both, those of the scan that the atlas lacks, those of the atlas that it lacks."""
    with of.Atlas(file) as atlas:
        rows = atlas.rows(of.Filter(period=(0, longest), energy=(plane.energy - 1e-9, plane.energy + 1e-9)))
    known: list[tuple[float, float]] = []
    for row in rows:
        if not any(close((row.period, abs(row.action)), one) for one in known):
            known.append((row.period, abs(row.action)))
    scan = [tuple(one) for one in scanned(plane, longest, side)]
    missed = [one for one in scan if not any(close(one, other) for other in known)]
    unseen = [one for one in known if not any(close(one, other) for other in scan)]
    return len(known) - len(unseen), missed, unseen


def necklaces(length: int) -> set[str]:
    """Primitive words of two letters up to rotation, but the constant ones."""
    words = {"".join(one) for one in product("LR", repeat=length)}
    primitive = {word for word in words if all(word != word[i:] + word[:i] for i in range(1, length))}
    return {min(word[i:] + word[:i] for i in range(length)) for word in primitive}


def word_of(orbit: of.Orbit) -> str:
    """The sides of the maxima of z along an orbit of Lorenz's equations, written here, by scipy's LSODA."""

    def field(_: float, s: np.ndarray) -> list[float]:
        x, y, z = s
        return [10 * (y - x), x * (28 - z) - y, x * y - 8 / 3 * z]

    def top(_: float, s: np.ndarray) -> float:
        return float(s[0] * s[1] - 8 / 3 * s[2])

    top.direction = -1  # type: ignore[attr-defined]
    run = solve_ivp(field, (0, orbit.period), orbit.state, "LSODA", events=top, rtol=1e-11, atol=1e-11)
    word = "".join("R" if one[0] > 0 else "L" for one in run.y_events[0])
    return min(word[i:] + word[:i] for i in range(len(word)))


def lorenz(file: Path, longest: int) -> dict[int, tuple[int, int, int]]:
    """By length: words that exist, orbits in the atlas, words that they have."""
    with of.Atlas(file) as atlas:
        words = [word_of(atlas.orbit(row.id)) for row in atlas.rows()]
    return {
        n: (len(necklaces(n)), sum(len(one) == n for one in words), len({one for one in words if len(one) == n}))
        for n in range(2, longest + 1)
    }


HENON_HEILES = Plane(
    lambda x, y: (x**2 + y**2) / 2 + x**2 * y - y**3 / 3,
    lambda x, y: (-x - 2 * x * y, -y - x**2 + y**2),
    0.1, (-0.3977, 0.5, 0.4473), 6,
)  # fmt: skip
COUPLED = Plane(
    lambda x, y: (x**2 + 2 * y**2) / 2 + x**2 * y**2,
    lambda x, y: (-x - 2 * x * y**2, -2 * y - 2 * x**2 * y),
    3.0, (-1.7320, 1.7320, 2.4494), 6,
)  # fmt: skip
PLANES = (("henon-heiles", HENON_HEILES, 30.0), ("coupled-oscillators", COUPLED, 12.0))


def report(folder: Path, side: int) -> Iterator[str]:
    """What the comparisons come to, line by line."""
    for name, plane, longest in PLANES:
        both, missed, unseen = compared(folder / f"{name}.sqlite", plane, longest, side)
        found = f"{both} in both, {len(missed)} in the scan alone, {len(unseen)} in the atlas alone"
        yield f"{name}, energy {plane.energy:g}, periods to {longest:g}: {found}"
        for what, those in (("scan", missed), ("atlas", unseen)):
            yield from (f"  in the {what} alone: period {one:.6f}, action {two:.6f}" for one, two in those)
    for n, (known, orbits, words) in lorenz(folder / "lorenz.sqlite", LETTERS).items():
        yield f"lorenz, {n} letters: {known} words, {orbits} orbits in the atlas with {words} of them"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--side", type=int, default=SIDE, help="points along each side of the grid")
    arguments = parser.parse_args()
    for line in report(arguments.folder, arguments.side):
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
