"""An adaptive control system of Lur'e type: x' = y, y' = z, z' = -alpha z - beta y - x + x^2.

Its cycle is born at alpha = 1 and doubles its period on the way down, at alpha = 0.6303. Example of MatCont and of
BifurcationKit, whose documentation and tests print where (tests/data/peers.json).
    orbitfinder run problems/published/lure.py --trust
"""

import orbitfinder as of


def lure(alpha=0.9, beta=1.0):
    """The Model; stable cycles for alpha between 0.6303 and 1."""

    def field(_, x, p):
        return [x.y, x.z, -p.alpha * x.z - p.beta * x.y - x.x + x.x**2]

    return of.ode(field, ("x", "y", "z"), {"alpha": alpha, "beta": beta})


def problem():
    """The stable cycle at alpha = 0.9."""
    guess = of.Guess([0.3259, -0.162, -0.2459], 6.306)
    return of.Problem(lure(), guess, name="lure", title="A control system of Lur'e type")
