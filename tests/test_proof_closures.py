"""Proofs under constraints: a bead on an ellipsoid, the four-bar; planted faults, doctored records, what is refused."""

from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

pytest.importorskip("flint")

from no_evaluators import printed

import orbitfinder as of
from orbitfinder.errors import InputError
from orbitfinder.proof.balls import arb, decimal, precision
from orbitfinder.proof.closures import comes_back
from orbitfinder.proof.field import make_field, programs
from orbitfinder.proof.formulation import Formulation
from orbitfinder.proof.record import contradictions, entry, options_of, replay
from orbitfinder.proof.theorem import Options, provable_model, prove, refine, settings_for
from orbitfinder.proof.trajectory import Trajectory
from orbitfinder.records.registry import load_orbit

pytestmark = pytest.mark.needs("proof")
ROOT = Path(__file__).parents[1]
LINKAGES = sorted((ROOT / "results/proofs/linkages").glob("*.json"))
G = arb(9.8)  # the double, as in the graph
ROCKING = ROOT / "results/proofs/linkages/four-bar-rocking.json"


def bead(gravity=9.8, rows=1):
    """A point of 1 kg on x^2 + y^2 + z^2 / 2 = 1, x down; its section z = 0 is a pendulum of 1 m."""
    q, v = ca.SX.sym("q", 3), ca.SX.sym("v", 3)
    phi = q[0] ** 2 + q[1] ** 2 + q[2] ** 2 / 2 - 1
    held = phi if rows == 1 else ca.vertcat(phi, q[1] * phi)
    return of.constrained(ca.sumsqr(v) / 2, -gravity * q[0], held, of.Symbols(q, v), names=["x", "y", "z"],
                          baumgarte=of.Baumgarte(10, 10))  # fmt: skip


@pytest.fixture(scope="module")
def swinging():
    """The bead in the plane z = 0, 0.8 rad up; what is proved of it, as rest to rest and over the whole period."""
    guess = of.Guess([np.cos(0.8), np.sin(0.8), 0, 0, 0, 0], 2.09)
    orbit = of.find_orbit(of.Problem(bead(), guess))
    return orbit, prove(orbit, bead()), prove(orbit, bead(), Options(symmetry="none"))


def test_a_bead_has_the_period_of_a_pendulum(swinging):
    """Both formulations hold the elliptic integral and the point's constraint; multipliers as found."""
    orbit, *proofs = swinging
    for proof, name in zip(proofs, ("brake", "none"), strict=True):
        assert proof.proved and proof.symmetry == name and proof.minimal and proof.radius < 1e-9, proof.reason
        assert proof.stability.verdict == "linearly stable" and len(proof.stability.multipliers) == 2
        for mu in proof.stability.multipliers:
            value = complex(float(mu.real.mid()), float(mu.imag.mid()))
            assert np.abs(orbit.floquet_multipliers - value).min() < 1e-9
        with precision(120):
            sine = (((decimal(orbit.energy) / G) + 1) / 2).sqrt()  # of half the amplitude
            assert proof.period.overlaps(2 * arb.pi() / arb(1).agm((1 - sine**2).sqrt()) / G.sqrt())
            assert proof.period.rad() < 1e-14
            x, y, z = proof.state[:3]
            assert (x**2 + y**2 + z**2 / 2 - 1).contains(0) and (x**2 + y**2).rad() < 1e-14


def test_digits_of_a_bead(swinging):
    """Thirty digits are enclosed, those of the elliptic integral."""
    orbit = swinging[0]
    with precision(200):
        sine = (((decimal(orbit.energy) / G) + 1) / 2).sqrt()
        digits = refine(orbit, settings_for(30), 30, bead())
        exact = 2 * arb.pi() / arb(1).agm((1 - sine**2).sqrt()) / G.sqrt()
        assert digits.enclosed and digits.period.contains(exact) and digits.period.rad() < 1e-30, digits.reason


def test_what_is_no_orbit_of_the_bead_is_not_proved(swinging):
    """Gravity changed by 1e-3; a state off the constraint."""
    orbit, *_ = swinging
    assert not prove(orbit, bead(9.8 * 1.001)).proved
    assert not prove(replace(orbit, state=orbit.state + 1e-5 * np.eye(6)[0]), bead()).proved


def test_coordinates_that_are_not_compared_must_follow(swinging):
    """At the lowest point y does not follow from x and z: a planted choice of y is found out."""
    _, _, whole = swinging
    with precision(106):
        model = bead()
        codes = programs(model, True)
        form = Formulation(of.loops.symmetry.NONE, 3, 1, (0,) * 6, (0,) * 3, True, None, (0,))
        lowest = [arb(1), arb(0, 1e-9), arb(0, 1e-9), arb(0), arb(1), arb(0)]

        class Still(Trajectory):
            def state(self, fraction):
                return lowest

        field = make_field(model, codes)
        box = [*lowest, arb(0), whole.period]
        assert comes_back(Still(field, form, box, [], None))
        assert not comes_back(Still(field, replace(form, dependent=(1,)), box, [], None))


def test_each_claim_of_a_record_is_compared(swinging):
    """The same entry proves itself; a ball moved by 1e-9 or shrunk, a radius, count, phase or word changed is named."""
    orbit, proof, _ = swinging
    recorded = entry(proof)
    again, wrong = replay(orbit, recorded, bead())
    assert again.proved and wrong == []
    fresh = entry(again, 1.0, 60)
    moved = {"value": str(Decimal(recorded["period"]["value"]) + Decimal("1e-9"))}
    doctored = {
        "period": {**recorded["period"], **moved}, "energy": {**recorded["energy"], "radius": 1e-40},
        "state": [{**ball, "radius": 1e-40} for ball in recorded["state"]], "stability": "unstable",
        "nodes": recorded["nodes"][:1], "multipliers": recorded["multipliers"][:1], "box_radius": 1e-3,
        "contraction": 1e-12, "steps": 3, "distance": 1e-30, "period_distance": 1e-3, "symmetry": "none", "segments": 3,
        "enclosure_radius": 1e-60, "phase": (recorded["phase"] + 1e-4) % 1.0,
        "minimal_period": {"proved": True, "divisors_excluded_up_to": 99},
    }  # fmt: skip
    for name, claim in doctored.items():
        assert name in contradictions(recorded | {name: claim}, fresh), name


def test_what_constraints_cannot_have_is_refused(swinging):
    """Other symmetries, rows that repeat others, minimal forms, massless coordinates, parts of families."""
    orbit, *_ = swinging
    with pytest.raises(InputError, match="under constraints it is brake or none"):
        prove(orbit, bead(), Options(symmetry="reflection"))
    with pytest.raises(InputError, match="1 of 2 are independent"):
        prove(orbit, bead(rows=2))
    with pytest.raises(InputError, match="no parts nor events of families"):
        programs(bead())
    four_bar = of.linkage([0.5, 1.2, 1.0], ground=(0.2, 1.0))
    with pytest.raises(InputError, match="find the orbit without it"):
        programs(of.linkages.minimal_linkage(four_bar, [1]), True)
    q, v = ca.SX.sym("q", 3), ca.SX.sym("v", 3)
    light = of.constrained(v[0] ** 2 / 2, q[0] ** 2, q[1] - q[0], of.Symbols(q, v), names=["x", "y", "z"])
    with pytest.raises(InputError, match="move no mass"):
        programs(light, True)


REPLAY = """
import sys
from no_evaluators import forbid
from orbitfinder.proof.record import read_entry, replay
from orbitfinder.proof.theorem import provable_model
from orbitfinder.records.registry import load_orbit
orbit = load_orbit(sys.argv[1])
model = provable_model(orbit)
forbid()
print(replay(orbit, read_entry(orbit, sys.argv[1]), model)[1])
"""


@pytest.mark.slow
def test_the_four_bar_is_replayed_in_another_process_without_evaluators():
    """NumPy's functions, DOP853 and CasADi's evaluation of numbers raise there once the model is made."""
    said = printed(REPLAY, ROCKING)
    assert said.splitlines() == ["[]"]


@pytest.mark.slow
@pytest.mark.parametrize("file", LINKAGES, ids=lambda file: file.stem)
def test_linkages_replay(file):
    """The records of every linkage of problems/linkages: nothing that is recorded is contradicted."""
    orbit = load_orbit(file)
    proof, wrong = replay(orbit, orbit.proof)
    assert proof.proved and wrong == []


def test_records_are_of_every_linkage():
    """Each is proved, in a box, and names a problem of problems/linkages or of mechanisms with loops."""
    names = {file.stem for file in (ROOT / "problems/linkages").glob("*.toml")}
    assert names <= {file.stem for file in LINKAGES}
    for file in LINKAGES:
        proof = load_orbit(file).proof
        assert proof["proved"] and proof["box_radius"] < 1.1e-11 and proof["contraction"] < 1


def rocking_period(energy, points=220):
    """The four-bar's period by Gauss-Chebyshev quadrature over the crank angle, in arithmetic of 200 bits.

    T = 2 int dtheta / theta' with theta' from T + V = E; the two other bars close a triangle over the gap that the
    crank leaves. Masses 1 kg, rods, gravity 49/5.
    """
    crank, coupler, rocker, ground = arb(1) / 2, arb(6) / 5, arb(1), (arb(1) / 5, arb(1))

    def room(angle):
        """E - V, and the mass m of T = m theta'^2 / 2."""
        gap = ground[0] - crank * angle.cos(), ground[1] - crank * angle.sin()
        span = (gap[0] ** 2 + gap[1] ** 2).sqrt()
        second = arb.atan2(gap[1], gap[0]) - ((span**2 + coupler**2 - rocker**2) / (2 * span * coupler)).acos()
        third = arb.atan2(gap[1] - coupler * second.sin(), gap[0] - coupler * second.cos())
        turned = crank / (third - second).sin()  # of the closure's rates, by Cramer's rule
        rates = arb(1), turned * (angle - third).sin() / coupler, -turned * (angle - second).sin() / rocker
        joint, speed, mass, height = (arb(0), arb(0)), (arb(0), arb(0)), arb(0), arb(0)
        for length, theta, rate in zip((crank, coupler, rocker), (angle, second, third), rates, strict=True):
            along, across = (length * theta.cos(), length * theta.sin()), (-length * theta.sin(), length * theta.cos())
            middle = [s + rate * a / 2 for s, a in zip(speed, across, strict=True)]
            mass += middle[0] ** 2 + middle[1] ** 2 + length**2 / 12 * rate**2
            height += joint[0] + along[0] / 2
            joint = joint[0] + along[0], joint[1] + along[1]
            speed = speed[0] + rate * across[0], speed[1] + rate * across[1]
        assert abs(joint[0] - ground[0]) < 1e-30 and abs(speed[0]) < 1e-30 and abs(speed[1]) < 1e-30
        return energy + arb(49) / 5 * height, mass

    ends = []
    for sign in (-1, 1):
        inner, outer = arb("0.5"), arb("0.5")
        while room(outer)[0] > 0:
            inner, outer = outer, outer + sign * arb("0.01")
        for _ in range(150):
            middle = ((inner + outer) / 2).mid()
            inner, outer = (middle, outer) if room(middle)[0] > 0 else (inner, middle)
        ends.append((inner + outer) / 2)
    middle, half, total = (ends[0] + ends[1]) / 2, (ends[1] - ends[0]) / 2, arb(0)
    for k in range(points):
        node = (arb.pi() * (2 * k + 1) / (2 * points)).cos()
        left, mass = room((middle + half * node).mid())
        total += (mass / (2 * left)).sqrt() * half * (1 - node**2).sqrt()
    return 2 * total * arb.pi() / points


def test_the_four_bars_period_is_the_quadrature():
    """The enclosed period holds the quadrature's twenty digits, and the native DAE's period by IDAS is near."""
    orbit = load_orbit(ROCKING)
    ball = orbit.proof["period"]
    with precision(200):
        exact = rocking_period(decimal(orbit.energy))
        assert abs(exact - arb(ball["value"])) < ball["radius"] < 1e-15
    assert abs(orbit.period - float(ball["value"])) < 1e-14


@pytest.mark.slow
def test_a_four_bar_of_other_lengths_is_not_proved():
    """A bar longer by 1e-3; the record's settings say which proof is tried."""
    orbit = load_orbit(ROCKING)
    other = {**orbit.system, "length": [0.5, 1.2 * 1.001, 1.0]}
    proof = prove(replace(orbit, system=other), options=options_of(orbit.proof))
    assert not proof.proved and proof.reason and provable_model(orbit).constraint is not None
