"""An electronic oscillator with a cubic nonlinearity, symmetric under (x, y, z) -> -(x, y, z).

The demo `tor` of AUTO and COCO's example of that name: from the Hopf point at nu = -0.5893 the cycles turn in a fold,
lose their symmetry at nu = -0.5870, and the lopsided ones meet a torus at -0.5917 and a doubling at -0.6150.
Source: E. Freire, A. J. Rodriguez-Luis, E. Gamero, E. Ponce, Physica D 62 (1993) 230-253.
    orbitfinder run problems/published/freire.py --trust
"""

import orbitfinder as of


def freire(nu=-0.588, beta=0.5):
    """The Model with the values of AUTO's demo."""

    def field(_, x, p):
        link = p.b3 * (x.y - x.x) ** 3
        left = (-(p.beta + p.nu) * x.x + p.beta * x.y - p.a3 * x.x**3 + link) / p.r
        return [left, p.beta * x.x - (p.beta + p.gamma) * x.y - x.z - link, x.y]

    values = {"nu": nu, "beta": beta, "gamma": -0.6, "r": 0.6, "a3": 0.328578, "b3": 0.933578}
    return of.ode(field, ("x", "y", "z"), values, symmetries={"turn": (1, {"x": -1, "y": -1, "z": -1})})


def problem():
    """A small unstable cycle next to the Hopf point."""
    guess = of.Guess([0.0428, -0.0068, 0.0511], 8.164)
    return of.Problem(freire(), guess, name="freire", title="An electronic oscillator")
