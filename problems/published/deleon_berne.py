"""Isomerisation after De Leon and Berne: two wells in y, and a Morse bond in x.

V = depth (1 - e^(-rate x))^2 + 4 y^2 (y^2 - 1) e^(-zeta rate x) + saddle, both masses 8. The unstable orbit over the
saddle is the motion in x alone. Source: N. De Leon, B. J. Berne, Journal of Chemical Physics 75 (1981) 3495-3510, with
the values of UPOsHam (tests/data/peers.json).
    orbitfinder run problems/published/deleon_berne.py --trust
"""

import casadi as ca

import orbitfinder as of


def deleon_berne():
    """The Model with the values of UPOsHam."""

    def energy(x, c):
        bond = c.depth * (1 - ca.exp(-c.rate * x.x)) ** 2
        wells = 4 * x.y**2 * (x.y**2 - 1) * ca.exp(-c.zeta * c.rate * x.x)
        return (x.px**2 + x.py**2) / (2 * c.mass) + bond + wells + c.saddle

    values = {"mass": 8.0, "depth": 10.0, "rate": 1.5, "zeta": 1.0, "saddle": 1.0}
    return of.hamiltonian(energy, ("x", "y"), ("px", "py"), values)


def problem(energy=2.0, place=(-0.183, 0.0), period=2.79):
    """The orbit over the saddle, a brake orbit from a point at rest near `place`."""
    guess = of.Guess([*place, 0.0, 0.0], period)
    pinned = of.pin(energy=energy)
    return of.Problem(deleon_berne(), guess, pinned, symmetry="brake", name="deleon-berne", title="Isomerisation")
