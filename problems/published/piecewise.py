"""Two smooth fields on either side of x = 0, both turning about the origin: COCO's example `piecewise`.

With r^2 = x^2 + y^2, on the left r' = r (1 - r), angle' = 1, on the right r' = al r (be - r), angle' = ga + be - r;
both are solved in closed form. Source: H. Dankowicz, F. Schilder, Recipes for Continuation (SIAM, 2013), example 9.2.
    orbitfinder run problems/published/piecewise.py --trust
"""

import casadi as ca

import orbitfinder as of


def piecewise(al=1.0, be=2.0, ga=1.5):
    """The hybrid Model: its cycle begins where the right half begins, at x = 0, y < 0."""
    states, values = ("x", "y"), {"al": al, "be": be, "ga": ga}

    def left(_, x, __):
        grown = 1 - ca.sqrt(x.x**2 + x.y**2)
        return [grown * x.x - x.y, x.x + grown * x.y]

    def right(_, x, p):
        grown = p.be - ca.sqrt(x.x**2 + x.y**2)
        return [p.al * grown * x.x - (p.ga + grown) * x.y, p.al * grown * x.y + (p.ga + grown) * x.x]

    modes = [of.Mode("left", of.ode(left, states, values)), of.Mode("right", of.ode(right, states, values))]
    ways = [
        of.Transition("leave", "right", "left", guard=lambda x, p: x.x),
        of.Transition("enter", "left", "right", guard=lambda x, p: x.x, direction=1),
    ]
    return of.hybrid(modes, ways, ["leave", "enter"])


def problem():
    """The cycle at COCO's first point: al = 1, be = 2, ga = 1.5."""
    return of.Problem(piecewise(), of.Guess([0.0, -1.1], 5.0), name="piecewise", title="Two fields")
