"""What the report states, in numbers: its systems, its printed orbits, its claims.

Source: "MAE 5730 Final Report", sections 2 to 4; uniform rods of 1 m and 1 kg, g = 9.8 m/s^2.
"""

from __future__ import annotations

from dataclasses import dataclass

TOLERANCE = 1e-13
"""the tolerance of all simulations in the report (section 2.1)"""
METHODS = ("newton-euler", "dae", "lagrange", "recursive")
TITLES = {"newton-euler": "Newton-Euler", "dae": "native DAE", "lagrange": "Lagrange", "recursive": "O(n) recursion"}
FIGURE_OF_METHOD = {"newton-euler": 2, "dae": 4, "lagrange": 5}
SEPARATION = 17.0
"""s after which the report's solutions diverge (section 2.4)"""
HOURS_FOR_100_LINKS = 5.0
"""more than this to derive 100 links (section 2.3)"""
FORMULATIONS, SIZES = ("lagrange", "newton-euler", "dae", "recursive"), (3, 10, 30, 100, 300, 1000)
"""of the chains whose derivation is timed here"""


@dataclass(frozen=True)
class PrintedOrbit:
    """An orbit as the report prints it; its period is nowhere printed but hides in the last number."""

    name: str
    title: str
    figure: int
    state: tuple[float, ...]

    @property
    def links(self) -> int:
        """Number of links."""
        return len(self.state) // 2

    @property
    def period_guess(self) -> float:
        """Magnitude of the last printed component, which is the period to 2e-4 (s)."""
        return abs(self.state[-1])


ORBITS = (
    PrintedOrbit(
        "triple-1", "Triple pendulum, periodic solution", 11,
        (0.207821287890159, 0.230046723844060, -1.448527525250897,
         -0.323636324707770, 0.146094757260416, 1.655339043727058),
    ),
    PrintedOrbit(
        "triple-2", "Triple pendulum like a single pendulum", 12,
        (0.079855812687088, 0.518084913559499, 0.284825068342415,
         -1.489804015361900, 0.110953686219146, -2.925278615817591),
    ),
    PrintedOrbit(
        "quadruple-1", "Quadruple pendulum, first mode shown", 13,
        (-0.0291117263322667, -0.016045163432762, 0.022495297315480, 0.110974733413308,
         0.370089523425431, 0.214148128979260, -0.301259983532510, -1.411248973186850),
    ),
    PrintedOrbit(
        "quadruple-2", "Quadruple pendulum, second mode shown", 13,
        (-0.0054867762069077, 0.002813551901407, 0.010723510070385, -0.015650651510557,
         0.279933154790084, -0.143699045708179, -0.546710497761539, 0.798011124562596),
    ),
)  # fmt: skip
