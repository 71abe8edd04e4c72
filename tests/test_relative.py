"""Orbits that come back up to a shift along cyclic coordinates: against quadrature, against other formulations."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import orbitfinder as of
from orbitfinder.errors import ConvergenceError, CountError, InputError
from orbitfinder.loops.symmetry import NONE, Symmetry, beside, named, related, shifts_of
from orbitfinder.mechanics.model import altered
from orbitfinder.mechanisms.chain import chain_dae
from orbitfinder.orbits.reduction import held, reduction, steady
from orbitfinder.problemfile.write import orbit_text
from orbitfinder.proof.formulation import approach
from orbitfinder.records.orbit import orbit_to_document

GRAVITY = 9.8
PROBLEMS = Path(__file__).parents[1] / "problems" / "gallery"


GAUSS = cache(np.polynomial.legendre.leggauss)


def gauss(values) -> float:
    """Integral from 0 to pi."""
    at, weights = GAUSS(300)
    return float(np.pi / 2 * weights @ values(np.pi / 2 * (at + 1)))


def swing(energy: float, momentum: float) -> tuple[float, float]:
    """Period and turn of a spherical pendulum (m = l = 1): z'^2 = 2 (E + g z) (1 - z^2) - L^2, z = cos theta."""
    roots = np.roots([-2 * GRAVITY, -2 * energy, 2 * GRAVITY, 2 * energy - momentum**2])
    low, high = sorted(float(z.real) for z in roots if -1 < z.real < 1)
    (other,) = (float(z.real) for z in roots if not -1 < z.real < 1)

    def pace(s):
        z = (low + high) / 2 - (high - low) / 2 * np.cos(s)
        return z, 2 / np.sqrt(2 * GRAVITY * (z - other))

    return gauss(lambda s: pace(s)[1]), gauss(lambda s: momentum / (1 - pace(s)[0] ** 2) * pace(s)[1])


@pytest.fixture(scope="module")
def pendulum():
    return of.systems.spherical_pendulum()


def wanted(model, **changed):
    given = {"guess": of.Guess([1.2, 0.3, 0.0, 3.0], 1.2), "pin": of.pin(energy=-2.0, momentum_phi=2.0)}
    return of.Problem(model, **given | {"relative": ("phi",)} | changed)


@pytest.fixture(scope="module")
def orbit(pendulum):
    return of.find_orbit(wanted(pendulum))


@pytest.mark.parametrize(("energy", "momentum"), [(-2.0, 2.0), (-8.0, 0.4), (3.0, -1.5), (-2.0, 0.3)])
def test_spherical_pendulum_against_quadrature(pendulum, energy, momentum):
    """Also above the suspension, the other way round and nearly in a plane."""
    guess = of.Guess([1.0, 0.0, 0.5, np.sign(momentum)], 1.2)
    found = of.find_orbit(wanted(pendulum, guess=guess, pin=of.pin(energy=energy, momentum_phi=momentum)))
    period, turn = swing(energy, momentum)
    assert found.certificate.passed and found.winding == (0, 0) and found.floquet_multipliers.size == 0
    assert found.period == pytest.approx(period, rel=1e-12)
    assert found.shift["phi"] == pytest.approx(turn, rel=1e-12)
    assert held(pendulum, found)["momentum_phi"] == pytest.approx(momentum, rel=1e-13)


def test_a_central_spring_against_quadrature():
    """r'^2 = 2 (E - V) - L^2 / r^2 with V = k (r - 1)^2 / 2: (r r')^2 is a quartic in r."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    stiffness, energy, momentum = 40.0, 3.0, 1.7
    model = of.lagrange(
        (v[0] ** 2 + (q[0] * v[1]) ** 2) / 2, stiffness * (q[0] - 1) ** 2 / 2, of.Symbols(q, v), names=["r", "phi"],
        angles=[False, True],
    )  # fmt: skip
    found = of.find_orbit(of.Problem(
        model, of.Guess([1.2, 0.0, 0.3, 1.2], 0.9), of.pin(energy=energy, momentum_phi=momentum), relative=("phi",)
    ))  # fmt: skip
    roots = np.roots([-stiffness, 2 * stiffness, 2 * energy - stiffness, 0.0, -(momentum**2)])
    near, far = sorted(float(r.real) for r in roots if r.real > 0 and abs(r.imag) < 1e-9)[-2:]
    others = [r for r in roots if np.abs(r - [near, far]).min() > 1e-6]

    def radius(s):
        return (near + far) / 2 - (far - near) / 2 * np.cos(s)

    def pace(s):
        return 2 * radius(s) / np.sqrt((stiffness * (radius(s) - others[0]) * (radius(s) - others[1])).real)

    assert found.certificate.passed and found.period == pytest.approx(gauss(pace), rel=1e-12)
    turn = gauss(lambda s: momentum / radius(s) ** 2 * pace(s))
    assert found.shift["phi"] == pytest.approx(turn, rel=1e-12)


def test_a_cart_with_momentum_is_a_cart_at_rest_seen_from_a_train():
    """Galilei: momentum p shifts a period by p T / (M + m) and changes nothing else."""
    model, guess = of.systems.pendulum_on_cart(), of.Guess([0.0, 0.8, 0.0, 0.0], 1.5)
    still = of.find_orbit(of.Problem(model, guess, of.pin(energy=-8.0, momentum_y=0.0), relative=("y",)))
    moving = of.Guess([0.0, 0.8, 0.4, 0.0], 1.5)
    boosted = of.pin(energy=-8.0 + 0.8**2 / (2 * 2.0), momentum_y=0.8)
    found = of.find_orbit(of.Problem(model, moving, boosted, relative=("y",)))
    assert still.certificate.passed and found.certificate.passed and abs(still.shift["y"]) < 1e-13
    assert found.period == pytest.approx(still.period, rel=1e-12)
    assert found.shift["y"] == pytest.approx(0.8 * found.period / 2.0, rel=1e-12)


def test_a_free_chain_in_two_sets_of_angles():
    """Two links without gravity: absolute angles, whose shift turns both, and the first one with the elbow's."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    energy, momentum = 3.0, 1.5

    def kinetic(rates, bend):  # links of 1 kg and 1 m, thin rods
        return (4 / 3 * rates[0] ** 2 + rates[1] ** 2 / 3 + rates[0] * rates[1] * ca.cos(bend)) / 2

    elbow = of.lagrange(
        kinetic((v[0], v[0] + v[1]), q[1]), ca.SX(0), of.Symbols(q, v), names=["phi", "psi"], angles=[True, True]
    )
    one = of.find_orbit(of.Problem(
        elbow, of.Guess([0.0, 0.0, -2.07, 8.4], 1.46), of.pin(energy=energy, momentum_phi=momentum), relative=("phi",)
    ))  # fmt: skip
    chain = of.chain(2, gravity=0.0)
    assert shifts_of(chain)["angular_momentum"].direction == (1.0, 1.0)
    phi, psi, turn, bend = one.state
    guess = of.Guess([phi, phi + psi, turn, turn + bend], one.period * 1.01)
    other = of.find_orbit(of.Problem(
        chain, guess, of.pin(energy=energy, angular_momentum=momentum), relative=("angular_momentum",)
    ))  # fmt: skip
    assert one.certificate.passed and other.certificate.passed
    assert other.period == pytest.approx(one.period, rel=1e-12)
    assert other.shift["angular_momentum"] == pytest.approx(one.shift["phi"], rel=1e-11)
    assert other.winding == (0, one.winding[1])


@pytest.mark.slow
def test_five_swings_that_make_three_turns(pendulum):
    """A relative orbit whose shift is 3/5 of a turn closes after five periods: found both ways."""
    shifted = of.Constraint(lambda known: known.ends[-1][1] - known.start[1] - 6 * np.pi / 5)
    guess = of.Guess([1.2, 0.0, 0.0, 1.0], 1.1)
    part = of.find_orbit(wanted(pendulum, guess=guess, pin=of.pin(energy=-2.0), constraints=(shifted,)))
    assert part.certificate.passed and part.shift["phi"] == pytest.approx(6 * np.pi / 5, rel=1e-12)
    whole = of.find_orbit(of.Problem(
        pendulum, of.Guess(part.state, 5 * part.period), of.pin(energy=-2.0), winding=(0, 3)
    ))  # fmt: skip
    assert whole.certificate.passed and whole.period == pytest.approx(5 * part.period, rel=1e-12) and not whole.shift


def test_half_a_period_by_a_mirror(pendulum):
    """(phi, t) -> -(phi, t): over half the period, the shift free at its end."""
    model = altered(pendulum, symmetries=(("mirror", -1, (1, -1)),))
    problem = wanted(model, symmetry="mirror", guess=of.Guess([1.3, 0.0, 0.0, 2.0], 1.1))
    assert problem.count().freedom == 0 and problem.count().equations["boundary"] == 3
    found = of.find_orbit(problem)
    period, turn = swing(-2.0, 2.0)
    assert found.certificate.passed and found.symmetry == "mirror"
    assert (found.period, found.shift["phi"]) == pytest.approx((period, turn), rel=1e-12)
    refined = of.Refiner(problem).refine()
    assert refined.period == pytest.approx(period, rel=1e-12) and tuple(refined.turns) == (0, 0)


def test_warm_refinement(pendulum, orbit):
    refiner = of.Refiner(wanted(pendulum))
    found = refiner.orbit(refiner.refine())
    assert found.certificate.passed and found.shift["phi"] == pytest.approx(orbit.shift["phi"], rel=1e-12)
    other = refiner.refine(pin=of.pin(energy=-3.0, momentum_phi=1.8))
    assert other.period == pytest.approx(swing(-3.0, 1.8)[0], rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_no_pin_takes_the_nearest(pendulum, seed):
    start = np.array([1.2, 0.3, 0.0, 2.0]) + 0.1 * np.random.default_rng(seed).normal(size=4)
    found = of.find_orbit(wanted(pendulum, guess=of.Guess(start, 1.15), pin=()))
    period, turn = swing(found.energy, held(pendulum, found)["momentum_phi"])
    assert found.certificate.passed
    assert (found.period, found.shift["phi"]) == pytest.approx((period, turn), rel=1e-12)


# ---- what must not pass ------------------------------------------------------------------------------------


@pytest.mark.parametrize("off", [1e-9, -1e-6, 2 * np.pi, -4.0])
def test_a_wrong_shift_is_rejected(pendulum, orbit, off):
    false = of.certify(replace(orbit, shift={"phi": orbit.shift["phi"] + off}), pendulum)
    assert {"closure", "shift"} <= set(false.failures)


def test_a_relative_orbit_is_no_periodic_one(pendulum, orbit):
    assert "closure" in of.certify(replace(orbit, shift={}), pendulum).failures


def test_twice_the_period_is_not_minimal(pendulum, orbit):
    twice = replace(orbit, period=2 * orbit.period, shift={"phi": 2 * orbit.shift["phi"]}, nodes=orbit.nodes[:1])
    assert "minimal_period" in of.certify(twice, pendulum).failures
    far = of.find_orbit(wanted(pendulum, guess=of.Guess(orbit.state, 2 * orbit.period)))
    assert far.period == pytest.approx(orbit.period, rel=1e-12)


def test_a_shift_along_what_is_not_cyclic_is_refused(pendulum, orbit):
    with pytest.raises(InputError, match=r"shift: theta = 0.1 is none of this system, which has phi"):
        of.certify(replace(orbit, shift={"theta": 0.1}), pendulum)
    with pytest.raises(InputError, match=r"shift: phi = nan"):
        of.certify(replace(orbit, shift={"phi": float("nan")}), pendulum)


def test_a_generator_that_is_none_is_found_out(pendulum, orbit):
    """A model that claims a momentum along theta: the equations change with theta."""
    phi = pendulum.invariants[1]
    q, v, p = (ca.SX.sym(name, size) for name, size in (("q", 2), ("v", 2), ("p", 3)))
    along = ca.Function("shift_theta", [q, v, p], [ca.DM([1, 0, 0, 0])])
    false = replace(phi, name="momentum_theta", generator=along)
    model = altered(pendulum, invariants=(*pendulum.invariants[:1], false))
    found = of.certify(replace(orbit, shift={"theta": 0.0}), model)
    assert {"closure", "cyclic"} <= set(found.failures)


@pytest.mark.parametrize(
    ("changed", "error", "message"),
    [
        ({"relative": ("theta",)}, InputError, r"relative: 'theta' is no cyclic coordinate.*that of phi does"),
        ({"relative": ("ph",)}, InputError, r"relative: 'ph' is no cyclic coordinate.*phi"),
        ({"relative": ("phi", "phi")}, InputError, r"names a coordinate twice"),
        ({"winding": (0, 1)}, InputError, r"winding: \[0, 1\] turns a coordinate of relative"),
        ({"symmetry": "brake"}, InputError, r"relative: a brake orbit comes back, so nothing shifts"),
        ({"pin": of.pin(energy=-2.0)}, CountError, r"under-determined.*add 1 pins"),
        ({"relative": ()}, CountError, r"over-determined"),
    ],
)
def test_requests_that_make_no_sense(pendulum, changed, error, message):
    with pytest.raises(error, match=message):
        wanted(pendulum, **changed).check_count()


def test_no_shift_in_redundant_coordinates_or_where_nothing_is_cyclic():
    with pytest.raises(InputError, match=r"relative: not known in redundant coordinates"):
        of.Problem(chain_dae(2, gravity=0.0), of.Guess([0.1, 0.2, 0, 0], 1.0), relative=("theta1",))
    with pytest.raises(InputError, match=r"as that of none of this system does"):
        of.Problem(of.chain(2), of.Guess([0.1, 0.2, 0, 0], 1.0), relative=("theta1",))


def test_the_rows_of_a_relative_link():
    """Asked is what a shift does not change; with the shift of a motion the rows vanish."""
    pair = Symmetry(relative=((1.0, 1.0),))
    assert pair.asked(2).shape == (3, 4) and np.abs(pair.asked(2) @ [1, 1, 0, 0]).max() < 1e-15
    assert np.array_equal(Symmetry(relative=((0.0, 1.0),)).asked(2), np.eye(4)[[0, 2, 3]]) and NONE.asked(2) is None
    start, constant = np.array([0.1, 0.2, 0.3, 0.4]), np.array([0.0, 2 * np.pi, 0.0, 0.0])
    end = start + constant + [0.7, 0.7, 0.0, 0.0]
    found = pair.settled(constant, start, end)
    np.testing.assert_allclose(found, end - start, atol=1e-14)
    assert pair.shifts(found) == pytest.approx([0.7]) and tuple(pair.turns(found)) == (0, 1)
    assert tuple(beside(np.array([0.3, 1.3]), pair.relative)) == pytest.approx((0.0, 1.0))
    assert related(named("none", of.chain(2)), of.chain(2), ()) == NONE


# ---- files and families ------------------------------------------------------------------------------------


def test_a_file_keeps_the_shift_and_its_digest_covers_it(orbit, tmp_path):
    path = of.save_orbit(orbit, tmp_path / "orbit.json")
    again = of.load_orbit(path)
    assert again.shift == orbit.shift and of.certify(again).passed
    document = json.loads(path.read_text())
    document["shift"]["phi"] += 1e-15
    path.write_text(json.dumps(document))
    assert "record" in of.certify(of.load_orbit(path)).failures


def test_an_orbit_without_a_shift_has_the_file_it_had(tmp_path):
    found = of.find_orbit(of.Problem(of.systems.duffing(), of.Guess([0.5, 0.0], 6.0), of.pin(energy=0.2)))
    assert "shift" not in json.loads(of.save_orbit(found, tmp_path / "orbit.json").read_text())


@pytest.mark.parametrize("parameter", ["energy", "momentum_phi"])
def test_families_end_at_relative_equilibria(pendulum, orbit, parameter, tmp_path):
    """Every point against quadrature; the end is the conical pendulum of that momentum or energy."""
    found = of.follow_family(orbit, parameter=parameter, points=25, out=tmp_path, name="swings")
    for point in found.points:
        momentum = held(pendulum, point)["momentum_phi"]
        if abs(momentum) < 0.1:  # the integrand is nearly singular there
            continue
        assert momentum == pytest.approx(point.value if parameter == "momentum_phi" else 2.0, rel=1e-12)
        period, turn = swing(point.energy, momentum)
        assert (point.period, point.shift["phi"]) == pytest.approx((period, turn), rel=2e-11)
    (end,) = (one for one in found.ends if one.kind == "relative equilibrium")
    assert "moves phi by" in end.reason and not [one for one in found.events if one.kind != "turn"]
    again = of.load_family(tmp_path / "swings" / "family.json")
    assert [one.shift for one in again.points] == [one.shift for one in found.points]
    assert of.certify(again.points[2], pendulum).passed


def test_a_family_in_a_parameter_keeps_energy_and_momentum(pendulum, orbit):
    found = of.follow_family(orbit, parameter="length", points=10, until=1.05)
    last = found.points[-1]
    assert last.value == 1.05 and last.energy == pytest.approx(-2.0, rel=1e-12)
    changed = of.systems.spherical_pendulum(length=1.05)
    assert held(changed, last)["momentum_phi"] == pytest.approx(2.0, rel=1e-12) and of.certify(last, changed).passed


def test_a_closed_orbit_with_momentum_is_followed(pendulum):
    """Whole turns and a momentum that varies along the family (trial of 0.1.0, section 6: a traceback then)."""
    whole = of.find_orbit(of.Problem(pendulum, of.Guess([1.2, 0.0, 0.0, 1.0], 5.5), winding=(0, 3)))
    assert whole.certificate.passed
    found = of.follow_family(whole, points=3)
    assert len(found.points) == 7 and all(point.winding == (0, 3) for point in found.points)
    momenta = [held(pendulum, replace(point, shift={"phi": 0.0}))["momentum_phi"] for point in found.points]
    assert np.ptp(momenta) > 1e-3


# ---- relative equilibria -----------------------------------------------------------------------------------


def test_a_conical_pendulum_is_named(pendulum):
    tilt = 0.6
    rate = np.sqrt(GRAVITY / np.cos(tilt))
    found = of.find_orbit(of.Problem(pendulum, of.Guess([tilt, 0, 0, rate], 2 * np.pi / rate), winding=(0, 1)))
    assert found.certificate.passed and steady(pendulum, found.state, found.period)["phi"] == pytest.approx(
        2 * np.pi / found.period
    )
    assert reduction(pendulum, found).startswith("relative equilibrium: steady rates phi = 3.4")
    note = next(one.note for one in found.certificate.checks if one.name == "not_equilibrium")
    assert "a relative equilibrium" in note
    # (omega / sqrt(g cos))^2 (1 + 3 cos^2): the small nutation about it, D. J. Tritton's textbook formula
    small = rate * np.sqrt(1 + 3 * np.cos(tilt) ** 2)
    assert np.abs(found.floquet_multipliers - np.exp(1j * small * found.period)).min() < 1e-6


def test_a_relative_equilibrium_has_no_period(pendulum):
    tilt = 0.6
    rate = np.sqrt(GRAVITY / np.cos(tilt))
    with pytest.raises(ConvergenceError, match=r"relative equilibrium.*steady rates are phi = 3.44|leave the pin out"):
        of.find_orbit(wanted(pendulum, guess=of.Guess([tilt, 0, 0, rate], 1.0), pin=()))


def test_motions_that_are_no_relative_equilibria(pendulum, orbit):
    assert steady(pendulum, orbit.state, orbit.period) == {} and steady(of.chain(2), np.zeros(4), 1.0) == {}
    assert reduction(of.chain(2), replace(orbit, shift={}, state=np.array([0.1, 0.2, 0, 0]))) == ""


# ---- three bodies ------------------------------------------------------------------------------------------

EIGHT = {"period": 6.325913982926211677589, "energy": -1.28714199563185770504}


@pytest.fixture(scope="module")
def eight():
    """The figure eight (A. Chenciner, R. Montgomery 2000; smooth.json), relative in the rotation."""
    first, third = np.array([0.970004356697335, -0.243087531535844]), np.array([-0.932407371441041, -0.864731460921011])
    apart = -2 * first
    angle = np.arctan2(apart[1], apart[0])
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    state = [np.hypot(*apart), angle, 0.0, 0.0, 0.0, 0.0, *(turn @ (1.5 * third))]
    pins = of.pin(energy=EIGHT["energy"], momentum_phi=0.0)
    return of.find_orbit(
        of.Problem(of.systems.turning_three_bodies(), of.Guess(state, 6.3259), pins, relative=("phi",))
    )


def test_the_figure_eight_does_not_turn(eight):
    assert eight.certificate.passed and eight.period == pytest.approx(EIGHT["period"], rel=1e-13)
    assert abs(eight.shift["phi"]) < 1e-12 and eight.stability == "elliptic"
    known = [0.998599982092 + 0.0528968407921j, -0.297596667519 + 0.954691690276j]
    assert all(np.abs(eight.floquet_multipliers - mu).min() < 1e-9 for mu in known)


def _places(state):
    """Positions and velocities (3 x 2 each) of equal bodies about their centre of mass."""
    (r, phi, u, w), (dr, turn, du, dw) = np.split(state, 2)
    basis = np.array([[np.cos(phi), -np.sin(phi)], [np.sin(phi), np.cos(phi)]])
    rotate = np.array([[0.0, -1.0], [1.0, 0.0]])
    here = np.array([[-r / 2, 0.0], [r / 2, 0.0], [u, w]])
    moving = np.array([[-dr / 2, 0.0], [dr / 2, 0.0], [du, dw]]) + turn * here @ rotate.T
    here, moving = here @ basis.T, moving @ basis.T
    return here - here.mean(axis=0), moving - moving.mean(axis=0)


def _pull(_, x):
    places = x[:6].reshape(3, 2)
    gaps = places[None] - places[:, None]
    cubes = (gaps**2).sum(axis=-1) ** 1.5 + np.eye(3)
    return np.concatenate([x[6:], (gaps / cubes[..., None]).sum(axis=1).ravel()])


@pytest.mark.slow
def test_a_turning_eight_in_cartesian_coordinates(eight):
    """The family by angular momentum: after a period the bodies are where they were, turned by the shift (DOP853)."""
    plain = of.FamilySettings(events=False)
    found = of.follow_family(eight, parameter="momentum_phi", until=0.1, points=30, settings=plain)
    turning = found.points[-1]
    assert turning.value == pytest.approx(0.1, rel=1e-14) and turning.shift["phi"] == pytest.approx(
        -1.594135791448, rel=1e-9
    )
    assert of.certify(turning).passed
    places, rates = _places(turning.state)
    start = np.concatenate([places.ravel(), rates.ravel()])
    there = solve_ivp(_pull, (0, turning.period), start, method="DOP853", rtol=3e-14, atol=1e-15).y[:, -1]
    by = turning.shift["phi"]
    turn = np.array([[np.cos(by), -np.sin(by)], [np.sin(by), np.cos(by)]])
    np.testing.assert_allclose(there[:6].reshape(3, 2), places @ turn.T, atol=1e-11)
    np.testing.assert_allclose(there[6:].reshape(3, 2), rates @ turn.T, atol=1e-11)


def test_a_problem_file_is_written_from_a_relative_orbit(orbit, tmp_path):
    """What `page` and others offer for download finds the same orbit again."""
    text = orbit_text(orbit_to_document(orbit))
    (tmp_path / "again.toml").write_text(text)
    problem = of.load_problem(tmp_path / "again.toml")
    assert problem.relative == ("phi",) and problem.count().freedom == 0
    assert of.find_orbit(problem).period == pytest.approx(orbit.period, rel=1e-12)


def test_a_shift_that_is_expected(tmp_path):
    """[expected] names a shift: a wrong number fails the certificate, one that nothing shifts by is refused."""
    text = (PROBLEMS / "spherical-pendulum.toml").read_text()
    path = tmp_path / "wrong.toml"
    path.write_text(text.replace("4.08286507758991", "4.08286507758"))
    assert of.find_orbit(of.load_problem(path)).certificate.failures == ("expected_shift_phi",)
    path.write_text(text.replace("shift = { phi", "shift = { theta"))
    with pytest.raises(InputError, match=r"expected.shift: 'theta' is not in find.relative"):
        of.load_problem(path)


def test_a_relative_orbit_is_not_proved(orbit):
    with pytest.raises(InputError, match=r"shift: phi is found with the orbit"):
        approach(of.systems.spherical_pendulum(), orbit, NONE, None)


@pytest.mark.slow
def test_a_rigid_body_by_its_angles_written_as_text():
    """Euler's top whose angular momentum is vertical: phi goes on by d in a period, and a momentum that is not quite
    vertical has turned by d about the vertical, so that the multipliers are e^(+-i d)."""
    spin = "phidot*sin(theta)*sin(psi)+thetadot*cos(psi)", "phidot*sin(theta)*cos(psi)-thetadot*sin(psi)"
    model = of.equations(
        coordinates=["phi", "theta", "psi"], parameters={"A": 1.0, "B": 2.0, "C": 3.0}, angles=["phi", "theta", "psi"],
        kinetic=f"(A*({spin[0]})**2 + B*({spin[1]})**2 + C*(phidot*cos(theta)+psidot)**2)/2", potential="0",
    )  # fmt: skip
    guess = of.Guess([0.0, 0.4, 0.0, 1.5, 0.0, -0.4605], 6.3)
    orbit = of.find_orbit(of.Problem(model, guess, relative=("phi",), winding=(0, 0, -1)))
    assert orbit.certificate.passed, orbit.certificate.failures
    turned = orbit.shift["phi"]
    expected = np.exp([1j * turned, -1j * turned])
    assert np.sort_complex(orbit.floquet_multipliers) == pytest.approx(np.sort_complex(expected), abs=1e-8)
