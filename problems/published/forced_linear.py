"""x'' + x' + p x = cos t: COCO's example `linode`, whose periodic motion is known in closed form.

x = (sin t + (p - 1) cos t) / (p^2 - 2 p + 2). Source: H. Dankowicz, F. Schilder, Recipes for Continuation (SIAM, 2013),
example 10.2.
    orbitfinder run problems/published/forced_linear.py --trust
"""

import casadi as ca

import orbitfinder as of


def forced_linear(stiffness=1.0):
    """The Model; `stiffness` is COCO's p."""

    def field(t, x, p):
        return [x.v, ca.cos(t) - x.v - p.stiffness * x.x]

    return of.ode(field, ("x", "v"), {"stiffness": stiffness}, forcing_period=2 * ca.pi)


def problem(stiffness=1.0):
    """The response from COCO's rough guess."""
    guess = of.Guess([0.0, 1.0], float(2 * ca.pi))
    return of.Problem(forced_linear(stiffness), guess, name="forced-linear", title="COCO's linear oscillator")
