"""The peroxidase reaction of Steinmetz and Larter, a stiff example of MatCont and of BifurcationKit.

A curve of torus bifurcations in (k7, k8) passes (1.757356, 0.9125773). Shooting fails, and collocation takes its place.
"""

import orbitfinder as of


def steinmetz_larter(k7=1.5, k8=0.75):
    """The Model with the values of BifurcationKit's tutorial."""

    def field(_, x, p):
        first, third = p.k1 * x.A * x.B * x.X, p.k3 * x.A * x.B * x.Y
        return [
            -first - third + p.k7 - p.km7 * x.A,
            -first - third + p.k8,
            first - 2 * p.k2 * x.X**2 + 2 * third - p.k4 * x.X + p.k6,
            -third + 2 * p.k2 * x.X**2 - p.k5 * x.Y,
        ]

    rates = {"k1": 0.1631021, "k2": 1250.0, "k3": 0.046875, "k4": 20.0, "k5": 1.104, "k6": 0.001, "km7": 0.1175}
    return of.ode(field, ("A", "B", "X", "Y"), {**rates, "k7": k7, "k8": k8})


def problem():
    """The stable cycle at k7 = 1.5, k8 = 0.75, from a simulation with an implicit method."""
    guess = of.Guess([2.516861, 5.623792, 0.023596, 1.356016], 16.02)
    return of.Problem(steinmetz_larter(), guess, name="steinmetz-larter", title="Peroxidase reaction")
