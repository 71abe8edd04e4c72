"""Functions of the energy as polynomials with ball coefficients, and the flow on them."""

import math

import numpy as np
import pytest

pytest.importorskip("flint")

from orbitfinder.mechanisms.chain import chain
from orbitfinder.proof import along as module
from orbitfinder.proof.along import Along, bundle, ranged
from orbitfinder.proof.balls import arb, arb_poly, precision
from orbitfinder.proof.enclosure import TaylorSettings, cloud, integrate
from orbitfinder.proof.field import make_field

pytestmark = pytest.mark.needs("proof")
PLACES = np.linspace(-1.0, 1.0, 9)
FUNCTIONS = {
    "product": (lambda x: x * x * x * x * x, lambda x: x**5),
    "quotient": (lambda x: 2 / x + x / 3 - 1 / (1 - x), lambda x: 2 / x + x / 3 - 1 / (1 - x)),
    "sine": (lambda x: x.sin() - x.cos(), lambda x: math.sin(x) - math.cos(x)),
    "growth": (lambda x: x.exp() * x.log(), lambda x: math.exp(x) * math.log(x)),
    "root": (lambda x: x.sqrt() + x ** arb(1.5), lambda x: math.sqrt(x) + x**1.5),
}


def value(found, place):
    """The ball of a function at one e."""
    return found.short(arb(float(place)))


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("spread", [0.0, 1e-3])
def test_every_value_is_enclosed_and_closely(name, spread):
    """Of 3 + e / 10 + e^2 / 100 and of what is within `spread` of it; the enclosure is as narrow as the spread."""
    on_balls, on_floats = FUNCTIONS[name]
    with precision(80):
        found = on_balls(Along(arb_poly([arb(3, spread), 0.1, 0.01])))
        for place in PLACES:
            there = value(found, place)
            for off in (-spread, 0.0, spread):
                exact = on_floats(3 + 0.1 * place + 0.01 * place**2 + 0.99 * off)
                assert (there - arb(exact, 1e-12 * abs(exact))).contains(0)
            assert there.rad() < 1e3 * spread + 1e-5


def test_what_is_cut_off_is_in_the_radius():
    """(1 + e / 2)^20 is of degree 20; without the balls of what is left out its enclosure would be wrong."""
    with precision(80):
        found = Along(arb_poly([1, 0.5]))
        for _ in range(19):
            found = found * Along(arb_poly([1, 0.5]))
        assert all(value(found, place).contains(arb(1 + 0.5 * place) ** 20) for place in PLACES)
        thin = found.thin
        assert not all(value(thin, place).contains(arb(1 + 0.5 * place) ** 20) for place in PLACES)


def test_a_function_that_may_be_zero_has_no_inverse():
    with precision(80), pytest.raises(ZeroDivisionError, match="denominator"):
        1 / Along(arb_poly([0.1, 1]))


@pytest.fixture(scope="module")
def swing():
    """The field of a pendulum, and (q, v, s, tau) as functions of e."""
    with precision(80):
        start = [Along(arb_poly([0.7, 0.1, 0.02])), Along(arb_poly([0.2, -0.05])), arb(0), Along(arb_poly([1.1, 0.1]))]
        yield make_field(chain(1)), start


def contained(field, start, settings):
    """Whether ball arithmetic's solutions and derivatives at single e meet the Bundle's, and the Bundle's end."""
    spread = [arb(0, 1e-7), arb(0, 1e-7), arb(0), arb(0, 1e-7)]
    end, steps = integrate(field, bundle(start, spread), settings)
    good = [sum(one.h for one in steps) == 1.0]
    for place in PLACES:
        there = [x.short(arb(float(place))) if isinstance(x, Along) else x for x in start]
        alone, _ = integrate(field, cloud(there), TaylorSettings(20, 106, 1e-20))
        good += [value(x, place).contains(y) for x, y in zip(end.point, alone.point, strict=False)]
        pairs = zip(end.derivatives.ravel(), alone.derivatives.entries(), strict=True)
        good += [value(x, place).contains(y) for x, y in pairs]
    return good, end


def test_the_flow_of_every_energy_is_enclosed(swing):
    """Against one integration for each of nine e; the derivatives vary 1e3 times more than their enclosure is wide."""
    good, end = contained(*swing, TaylorSettings(12, 80, 1e-12))
    assert all(good)
    width = max(float(x.short[0].rad()) for x in end.derivatives.ravel())
    varied = max(float(x.rad()) for x in ranged(end.derivatives).entries())
    assert width < 1e-3 * varied


def test_a_flow_without_what_is_cut_off_is_found_out(swing, monkeypatch):
    """Planted: polynomials that forget their remainder enclose nothing."""

    def forgetful(self):
        return self.whole.truncate(3)

    monkeypatch.setattr(module.Along, "short", property(forgetful))
    assert not all(contained(*swing, TaylorSettings(12, 80, 1e-12))[0])
