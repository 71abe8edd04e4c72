"""Periods of first-order systems without orbitfinder: Newton's method over SciPy's DOP853, equations written by hand.

The flow is integrated with its variational equations, whose Jacobian is a complex step (W. Squire, G. Trapp, SIAM
Review 40 (1998) 110-112). No part of orbitfinder takes part; problem files are read as TOML for guesses and numbers.
The short orbits of the Lorenz attractor start from close returns of one simulation to tops of z and are counted by
their words (L and R, the wings in turn), of which every one that is no repetition occurs once at these parameters.

    python benchmarks/first_order.py            writes results/benchmarks/first_order.md
"""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from machine import processor, versions
from scipy.integrate import solve_ivp

ROOT = Path(__file__).parents[1]
Field = Callable[[np.ndarray], np.ndarray]
STEP = 1e-30
ITERATIONS = 12
LONGEST_WORD = 5
SIMULATED = 1000.0
MOST_TRIES = 8
"""Close returns of a word that Newton's method is started from"""


def lorenz(u: np.ndarray) -> np.ndarray:
    x, y, z = u
    return np.array([10.0 * (y - x), 28.0 * x - y - x * z, x * y - 8.0 / 3.0 * z])


def rossler(u: np.ndarray) -> np.ndarray:
    x, y, z = u
    return np.array([-y - z, x + 0.2 * y, 0.2 + x * z - 5.7 * z])


def brusselator(u: np.ndarray) -> np.ndarray:
    x, y = u
    return np.array([1.0 + x * x * y - 4.0 * x, 3.0 * x - x * x * y])


def fitzhugh_nagumo(u: np.ndarray) -> np.ndarray:
    v, w = u
    return np.array([v - v * v * v / 3.0 - w + 0.5, 0.08 * (v + 0.7 - 0.8 * w)])


def hodgkin_huxley(u: np.ndarray) -> np.ndarray:
    v, m, h, n = u
    opens_m, closes_m = 0.1 * (v + 40.0) / (1.0 - np.exp(-(v + 40.0) / 10.0)), 4.0 * np.exp(-(v + 65.0) / 18.0)
    opens_h, closes_h = 0.07 * np.exp(-(v + 65.0) / 20.0), 1.0 / (1.0 + np.exp(-(v + 35.0) / 10.0))
    opens_n, closes_n = 0.01 * (v + 55.0) / (1.0 - np.exp(-(v + 55.0) / 10.0)), 0.125 * np.exp(-(v + 65.0) / 80.0)
    sodium, potassium, leak = 120.0 * m**3 * h * (v - 50.0), 36.0 * n**4 * (v + 77.0), 0.3 * (v + 54.387)
    return np.array([
        10.0 - sodium - potassium - leak, opens_m * (1.0 - m) - closes_m * m, opens_h * (1.0 - h) - closes_h * h,
        opens_n * (1.0 - n) - closes_n * n,
    ])  # fmt: skip


GALLERY: dict[str, Field] = {
    "lorenz": lorenz, "rossler": rossler, "brusselator": brusselator, "fitzhugh-nagumo": fitzhugh_nagumo,
    "hodgkin-huxley": hodgkin_huxley,
}  # fmt: skip


@dataclass(frozen=True)
class Closed:
    """A closed orbit: a state (d), its period, how far DOP853 misses the state after it, its multipliers."""

    state: np.ndarray
    period: float
    closure: float
    multipliers: np.ndarray


def slopes(field: Field, x: np.ndarray) -> np.ndarray:
    """df/dx (d x d) by complex steps, exact to round-off."""
    return np.column_stack([field(x + 1j * STEP * unit).imag / STEP for unit in np.eye(x.size)])


def flow(field: Field, x: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """x(T) and dx(T)/dx(0), scaled by nothing."""
    d = x.size

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([field(y[:d]), (slopes(field, y[:d]) @ y[d:].reshape(d, d)).ravel()])

    start = np.concatenate([x, np.eye(d).ravel()])
    end = solve_ivp(rates, (0.0, period), start, method="DOP853", rtol=3e-14, atol=1e-14).y[:, -1]
    return end[:d], end[d:].reshape(d, d)


def closed(field: Field, x: np.ndarray, period: float) -> Closed | None:
    """The orbit that Newton's method finds from a state and a period, None if none: x(T) = x, f(x_0).(x - x_0) = 0."""
    across = field(x) / np.linalg.norm(field(x))
    anchor, before = x, np.inf
    for _ in range(ITERATIONS):
        end, matrix = flow(field, x, period)
        missed = end - x
        size = float(np.abs(missed).max() / max(1.0, np.abs(x).max()))
        if not np.isfinite(size) or size > 10.0:
            return None
        if size < 1e-11 and size > before / 10:
            return Closed(x, period, size, np.linalg.eigvals(matrix))
        before = size
        bordered = np.block([[matrix - np.eye(x.size), field(end)[:, None]], [across[None], np.zeros((1, 1))]])
        step = np.linalg.solve(bordered, -np.append(missed, across @ (x - anchor)))
        x, period = x + step[:-1], period + float(step[-1])
        if not 0.1 < period < 1e3:
            return None
    return Closed(x, period, before, np.linalg.eigvals(matrix)) if before < 1e-10 else None


def top(_: float, u: np.ndarray) -> float:
    """z', which falls through 0 at the top of each turn about a wing."""
    return float(u[0] * u[1] - 8.0 / 3.0 * u[2])


top.direction = -1.0  # type: ignore[attr-defined]


def tops(state: np.ndarray, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and states of the tops of a motion on the Lorenz attractor."""
    found = solve_ivp(lambda _, u: lorenz(u), (0.0, duration), state, method="DOP853", rtol=1e-10, atol=1e-10,
                      events=top)  # fmt: skip
    return found.t_events[0], found.y_events[0]


def word(one: Closed) -> str:
    """The wings that an orbit goes round, a letter for each top, from where the word is least."""
    return least(tops(one.state + 1e-9 * lorenz(one.state), one.period)[1][:, 0])


def least(heights: np.ndarray) -> str:
    """The word of tops at these x, from where it is least."""
    letters = "".join("R" if x > 0 else "L" for x in heights)
    return min((letters[k:] + letters[:k] for k in range(len(letters))), default="")


def words(most: int) -> list[str]:
    """All words of two to so many letters that are no repetitions, up to rotation, with both letters."""
    found = []
    for length in range(2, most + 1):
        for k in range(2**length):
            one = format(k, f"0{length}b").replace("0", "L").replace("1", "R")
            turned = [one[i:] + one[:i] for i in range(length)]
            if one == min(turned) and turned.count(one) == 1 and {"L", "R"} <= set(one):
                found.append(one)
    return found


def attractor(most: int = LONGEST_WORD) -> dict[str, Closed]:
    """The orbits of the Lorenz attractor by their words, from close returns."""
    times, states = (one[20:] for one in tops(np.array([1.0, 2.0, 20.0]), SIMULATED))
    wanted, found = words(most), {}
    tried = dict.fromkeys(wanted, 0)
    for length in range(2, most + 1):
        gaps = np.linalg.norm(states[length:] - states[:-length], axis=1)
        for k in np.argsort(gaps):
            name = least(states[k : k + length, 0])
            if name in found or tried.get(name, MOST_TRIES) >= MOST_TRIES:
                continue
            tried[name] += 1
            orbit = closed(lorenz, states[k], times[k + length] - times[k])
            for sign in (1.0, -1.0) if orbit else ():  # the image under (x, y, z) -> (-x, -y, z)
                image = replace(orbit, state=orbit.state * [sign, sign, 1.0])
                found.setdefault(word(image), image)
    return {one: found[one] for one in wanted if one in found}


def page() -> str:
    """The results as a page."""
    lines = [
        "# First-order systems without orbitfinder", "",
        f"{processor()}; {versions()}. Newton's method over SciPy's DOP853 with variational equations (complex step), "
        "equations written by hand: `python benchmarks/first_order.py`.", "",
        "| problem file | period expected there | period found here | difference | closure |", "|---|---|---|---|---|",
    ]  # fmt: skip
    for name, field in GALLERY.items():
        given = tomllib.loads((ROOT / "problems" / "gallery" / f"{name}.toml").read_text(encoding="utf-8"))
        wanted = float(given["expected"]["period"]["value"])
        one = closed(field, np.array(given["guess"]["state"], float), float(given["guess"]["period"]))
        if one is None:
            lines.append(f"| {name} | {wanted!r} | none | | |")
            continue
        lines.append(f"| {name} | {wanted!r} | {one.period!r} | {one.period - wanted:.1e} | {one.closure:.1e} |")
    found = attractor()
    lines += [
        "", f"Orbits of the Lorenz attractor up to {LONGEST_WORD} letters: {len(found)} of {len(words(LONGEST_WORD))} "
        "words.", "", "| word | period | largest multiplier | closure |", "|---|---|---|---|",
    ]  # fmt: skip
    for name, one in found.items():
        largest = one.multipliers[np.abs(one.multipliers).argmax()].real
        lines.append(f"| {name} | {one.period:.12f} | {largest:.6f} | {one.closure:.1e} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks")
    chosen = parser.parse_args()
    text = page()
    print(text)
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / "first_order.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
