"""Two wells joined by a saddle, and a coupling of the two coordinates.

H = (px^2 + py^2) / 2 - alpha x^2 / 2 + beta x^4 / 4 + omega y^2 / 2 + coupling (x - y)^2 / 2. The unstable orbit over
the saddle at energy 1; the coupled quartic Hamiltonian of UPOsHam (tests/data/peers.json).
    orbitfinder run problems/published/quartic_saddle.py --trust
"""

import orbitfinder as of


def quartic(coupling=0.1):
    """The Model with the values of UPOsHam, uncoupled for coupling = 0."""

    def energy(x, c):
        wells = -c.alpha * x.x**2 / 2 + c.beta * x.x**4 / 4 + c.omega * x.y**2 / 2
        return (x.px**2 + x.py**2) / 2 + wells + c.coupling * (x.x - x.y) ** 2 / 2

    values = {"alpha": 1.0, "beta": 1.0, "omega": 1.0, "coupling": coupling}
    return of.hamiltonian(energy, ("x", "y"), ("px", "py"), values)


def problem(energy=1.0, place=(0.067, -1.344), period=5.977, coupling=0.1):
    """The orbit over the saddle, a brake orbit from a point at rest near `place`."""
    guess = of.Guess([*place, 0.0, 0.0], period)
    pinned = of.pin(energy=energy)
    return of.Problem(quartic(coupling), guess, pinned, symmetry="brake", name="quartic-saddle", title="Over a saddle")
