"""The error bar of a period: references of 20 digits lie inside, it is small, and a displaced record's is wider."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.records.certificate import Certificate
from orbitfinder.records.codec import entries_of

ROOT = Path(__file__).parents[1]


def brusselator(units=1.0, rate=2.5):
    """Its cycle from two digits, x and y in other units."""

    def field(t, x, p):
        a, b = x[0] / units, x[1] * units
        return [units * (1 - (p[0] + 1) * a + a**2 * b), (p[0] * a - a**2 * b) / units]

    model = of.ode(field, ["x", "y"], parameters={"rate": rate})
    return model, of.find_orbit(of.Problem(model, of.Guess([1.4 * units, 3.0 / units], 6.6)))


PERIODS = {2.5: 6.5772843419058333034, 3.1: 7.3055053451104074816, 5.0: 11.655589817031818519}


@pytest.mark.parametrize("rate", PERIODS)
@pytest.mark.parametrize("units", [1.0, 1e6])
def test_the_bar_holds_a_period_of_twenty_digits(rate, units):
    """road.json's periods, from starts of two or three digits."""
    start = {2.5: [1.4, 3.0], 3.1: [1.9, 3.7], 5.0: [4.3, 6.3]}[rate]
    model = brusselator(units, rate)[0] if rate == 2.5 else of.systems.brusselator(rate=rate)
    scale = np.array([units, 1 / units]) if rate == 2.5 else 1.0
    orbit = of.find_orbit(of.Problem(model, of.Guess(np.array(start) * scale, float(f"{PERIODS[rate]:.3g}"))))
    bar = orbit.certificate.period_error
    assert abs(orbit.period - PERIODS[rate]) <= bar <= 3e-12 * orbit.period


@pytest.mark.parametrize("moved", [1e-9, 1e-6])
def test_a_record_beside_the_orbit_knows_that_it_is(moved):
    """State and period displaced: the bar holds the true period still, and is no wider than it must be."""
    model, orbit = brusselator()
    beside = replace(orbit, period=orbit.period * (1 + moved), state=orbit.state * (1 + moved))
    bar = of.certify(beside, model).period_error
    assert abs(beside.period - orbit.period) <= bar <= 300 * moved * orbit.period


def test_a_conservative_orbit_is_compared_at_its_energy(report_orbits):
    """The report's orbits: neighbours of the family are no errors of the period."""
    for orbit in report_orbits.values():
        certificate = of.certify(orbit)
        assert 0 < certificate.period_error < 1e-9 * orbit.period


@pytest.mark.parametrize("name", ["four-bar-rotating", "four-bar-drag-link"])
def test_a_linkage_knows_its_period(name):
    """In coordinates that its loops bind: along what they forbid nothing changes a period. Was 2.3 and 8.9 of it."""
    orbit = of.load_orbit(ROOT / "results" / "proofs" / "linkages" / f"{name}.json")
    assert 0 < of.certify(orbit).period_error < 1e-11 * orbit.period


def test_a_forced_period_has_no_error():
    """It is prescribed."""
    model = of.systems.forced_duffing(stiffness=1.0, cubic=1.0, damping=0.1, force=0.3, frequency=0.8)
    orbit = of.find_orbit(of.Problem(model, of.Guess([0.5, 0.0], 2 * np.pi / 0.8)))
    assert orbit.certificate.period_error == 0.0


def test_it_is_written_and_older_files_have_none():
    """Beside the checks."""
    assert entries_of(Certificate((), 1.0, 1e-15, 2e-13))["period_error"] == 2e-13
    assert np.isnan(Certificate((), 1.0, 1e-15).period_error)
