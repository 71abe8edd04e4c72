"""What equations say beside a motion, and not on it: x swings along y = 0, where nothing of y is felt, and

y'' = -(0.3 + A exp(-((x - b) / w)^2)) y

decides on its multipliers. A pulse may be narrower than a step, lie where a family comes later, and breaks x -> -x.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import orbitfinder as of


def swinging(height, width, place, energy, directory):
    """The problem of the orbit of this energy."""
    file = directory / "swing.toml"
    file.write_text(f"""
name = "swing"
[system]
kind = "equations"
coordinates = ["x", "y"]
kinetic = "(xdot**2 + ydot**2)/2"
potential = "x**2/2 + 0.1*x**4 + y**2/2*(0.3 + A*exp(-((x - b)/w)**2))"
parameters = {{A = {height}, w = {width}, b = {place}}}
[guess]
state = [{np.sqrt(2 * energy)}, 0, 0, 0]
period = 5.5
[find.pin]
energy = {energy}
""")
    return of.load_problem(file)


def trace(orbit, height, width, place):
    """The trace of Hill's equation over a period, in steps that a pulse cannot hide from."""

    def rates(_, s):
        x, v, first, one, second, two = s
        k = 0.3 + height * np.exp(-(((x - place) / width) ** 2))
        return [v, -x - 0.4 * x**3, one, -k * first, two, -k * second]

    start = [orbit.state[0], orbit.state[2], 1, 0, 0, 1]
    fine = dict(method="DOP853", rtol=1e-12, atol=1e-13, max_step=width / 4)
    end = solve_ivp(rates, (0, orbit.period), start, **fine).y[:, -1]
    return end[2] + end[5]


def off(orbit, *pulse):
    """How far a record's multipliers are from those of Hill's equation, by mu^2 - trace mu + 1."""
    mu, known = orbit.floquet_multipliers, trace(orbit, *pulse)
    return np.abs(mu**2 - known * mu + 1).max() / max(1.0, known**2)


def test_multipliers_that_only_a_pulse_between_steps_decides_are_not_certified(tmp_path):
    narrow = of.find_orbit(swinging(300, 1e-3, 1.5, 3.0, tmp_path))
    assert "resolution" in narrow.certificate.failures


@pytest.mark.slow
def test_multipliers_that_a_wider_pulse_decides_are(tmp_path):
    wide = of.find_orbit(swinging(3, 0.02, 1.5, 3.0, tmp_path))
    assert wide.certificate.passed
    assert off(wide, 3, 0.02, 1.5) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("pulse", [(3, 0.1, 1.3), (3, 0.02, 1.3)])
def test_a_family_sees_a_pulse_that_it_comes_to(pulse, tmp_path):
    """x -> -x holds as far as the first orbit goes, and a mesh for it would do for all motions."""
    family = of.follow_family(of.find_orbit(swinging(*pulse, 0.5, tmp_path)), until=1.6, points=12)
    assert family.ends[-1].kind == "target"
    assert max(off(point, *pulse) for point in family.points) < 1e-7
    assert family.points[-1].certified


@pytest.mark.slow
def test_a_family_ends_where_its_equations_lose_its_symmetry(tmp_path):
    pulse = (3, 0.1, 2.0)
    orbit = of.find_orbit(swinging(*pulse, 0.05, tmp_path))
    family = of.follow_family(orbit, until=4.5, points=40)
    assert orbit.symmetry == "brake+reflection"
    assert "the equations lose the symmetry of the family's orbits" in family.ends[-1].reason
    assert max(off(point, *pulse) for point in family.points) < 1e-7
    beyond = of.follow_family(of.find_orbit(swinging(*pulse, 4.5, tmp_path)), until=4.6, points=3)
    assert max(off(point, *pulse) for point in beyond.points) < 1e-7
