"""Proofs of first-order orbits: Hamilton's against Lagrange's equations, dissipative ones, what is refused."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import quad

pytest.importorskip("flint")

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.mechanics.model import altered
from orbitfinder.problemfile.read import load_problem
from orbitfinder.proof.balls import arb, precision
from orbitfinder.proof.field import programs
from orbitfinder.proof.theorem import Options, prove, refine, settings_for

pytestmark = pytest.mark.needs("proof")
ROOT = Path(__file__).parents[1]
LORENZ = "1.5586522107161747275678702092126960705284805489972439358895215783190198756258880854355851082660142374"
"""period for beta = 8/3: D. Viswanath, Physica D 190 (2004) 115-128"""


def henon_heiles(**parts):
    """The star potential as Hamilton's equations, with one of its mirrors."""

    def energy(x, _):
        return (x.px**2 + x.py**2 + x.x**2 + x.y**2) / 2 + x.x**2 * x.y - x.y**3 / 3

    mirror = {"mirror": (-1, {"x": -1, "py": -1})}
    return of.hamiltonian(energy, ("x", "y"), ("px", "py"), **{"symmetries": mirror, **parts})


def lorenz():
    """Lorenz' equations with 8/3 exactly: 3 z' = 3 x y - 8 z."""

    def field(_, x, p):
        return [10 * (x.y - x.x), x.x * (28 - x.z) - x.y, x.x * x.y - 8 * x.z / 3]

    return of.ode(field, ("x", "y", "z"), symmetries={"turn": (1, {"x": -1, "y": -1})})


@pytest.fixture(scope="module")
def loop():
    """An orbit found in mechanical form, and the same numbers as an orbit of Hamilton's equations."""
    mechanical = of.find_orbit(load_problem(ROOT / "problems/gallery/henon-heiles-loop.toml"))
    model, guess = henon_heiles(), of.Guess(mechanical.state, mechanical.period)
    found = of.find_orbit(of.Problem(model, guess, of.pin(energy=mechanical.energy)))
    assert found.symmetry == "mirror" and found.period == pytest.approx(mechanical.period, abs=1e-13)
    return mechanical, model, replace(found, energy=mechanical.energy, state=mechanical.state)


@pytest.fixture(scope="module")
def butterfly():
    """The shortest orbit round both wings."""
    model = lorenz()
    return model, of.find_orbit(of.Problem(model, of.Guess([-13.7636, -19.5788, 27.0], 1.5587)))


def test_one_orbit_in_both_forms(loop):
    """The enclosures of period and state meet, and those of the multipliers; the mirror gives the same period."""
    mechanical, model, orbit = loop
    one, other = prove(mechanical), prove(orbit, model, Options(symmetry="none"))
    assert one.proved and other.proved, (one.reason, other.reason)
    assert one.period.overlaps(other.period) and float(other.period.rad()) < 1e-17
    assert all(a.overlaps(b) for a, b in zip(one.state, other.state, strict=True))
    pairs = zip(one.stability.multipliers, other.stability.multipliers, strict=True)
    assert other.stability.verdict == "linearly stable" and all(a.overlaps(b) for a, b in pairs)
    assert other.unfolding.contains(0) and other.minimal and other.divisors == one.divisors
    half = prove(orbit, model)
    assert half.proved and half.symmetry == "mirror" and half.unfolding is None and half.period.overlaps(one.period)


def test_restricted_three_bodies_in_both_forms():
    """A Lyapunov orbit from Lagrange's and from Hamilton's equations, in the mirror of six components."""
    ratio, state, period = 0.01215057, [0.8232, 0.0, 0.0, 0.1270], 2.7437
    planar = of.systems.restricted_three_body(ratio=ratio)
    problem = of.Problem(planar, of.Guess(state, period), of.pin(x=state[0]), symmetry="mirror")
    one = of.find_orbit(problem)
    model, x = of.systems.restricted_three_body_canonical(ratio=ratio), one.state
    canonical = [x[0], x[1], 0.0, x[2] - x[1], x[3] + x[0], 0.0]
    guess = of.Guess(canonical, one.period)
    other = of.find_orbit(of.Problem(model, guess, of.pin(energy=one.energy), symmetry="mirror"))
    first, second = prove(one), prove(replace(other, energy=one.energy), model)
    assert first.proved and second.proved, (first.reason, second.reason)
    assert second.symmetry == "mirror" and second.stability.verdict == "unstable"
    assert first.period.overlaps(second.period)


def test_lorenz_orbit_is_proved(butterfly):
    """The published hundred digits of the period lie in the enclosure, whole and by half; 60 digits are enclosed."""
    model, orbit = butterfly
    for symmetry in ("none", "turn"):
        proof = prove(orbit, model, Options(symmetry=symmetry))
        assert proof.proved and proof.symmetry == symmetry, proof.reason
        assert proof.energy is None and proof.unfolding is None and proof.stability.verdict == "unstable"
        assert proof.period.overlaps(arb(LORENZ)) and float(proof.period.rad()) < 1e-17
        assert any(mu.real.overlaps(arb("4.712947273424", "1e-11")) for mu in proof.stability.multipliers)
    found = refine(orbit, settings_for(60), 60, model)
    with precision(found.settings.bits):
        assert found.enclosed and abs(found.period - arb(LORENZ)) < arb("1e-59"), found.period.str(70)


@pytest.mark.parametrize("name", ["rossler", "van-der-pol", "brusselator"])
def test_limit_cycles_are_proved(name):
    """Multipliers inside the unit circle are proved to be; the largest is the orbit's."""
    orbit = of.find_orbit(load_problem(ROOT / f"problems/gallery/{name}.toml"))
    proof = prove(orbit)
    assert proof.proved, proof.reason
    wanted = "unstable" if orbit.stability == "unstable" else "asymptotically stable"
    assert proof.stability.verdict == wanted and proof.energy is None
    largest = max(float(abs(mu).mid()) for mu in proof.stability.multipliers)
    assert largest == pytest.approx(float(np.abs(orbit.floquet_multipliers).max()), abs=1e-9)
    assert abs(float(proof.period.mid()) - orbit.period) < 1e-12


@pytest.mark.parametrize("spoiled", ["state", "period", "twice", "energy", "equilibrium", "symmetry"])
def test_what_is_no_orbit_of_hamiltons_equations_is_not_proved(loop, spoiled):
    """A nudge of 1e-5, twice the period, another energy, rest, a mirror that the equations lack."""
    _, model, orbit = loop
    change = {
        "state": {"state": orbit.state + 1e-5 * np.eye(4)[3]}, "period": {"period": orbit.period + 1e-5},
        "twice": {"period": 2 * orbit.period}, "energy": {"energy": orbit.energy + 1e-4},
        "equilibrium": {"state": np.zeros(4), "energy": 0.0}, "symmetry": {},
    }[spoiled]  # fmt: skip
    asked = Options(symmetry="reflection" if spoiled == "symmetry" else "none")
    proof = prove(replace(orbit, **change), model, asked)
    assert not proof.proved and proof.reason
    if spoiled == "symmetry":
        assert "could not be read off" in proof.reason


@pytest.mark.parametrize("spoiled", ["state", "period", "twice", "equilibrium"])
def test_what_is_no_orbit_of_lorenz_is_not_proved(butterfly, spoiled):
    """A nudge of 1e-5 in z, a period off by 1e-5, twice the period, the fixed point."""
    model, orbit = butterfly
    c = np.sqrt(8 / 3 * 27)
    change = {
        "state": {"state": orbit.state + 1e-5 * np.eye(3)[2]}, "period": {"period": orbit.period + 1e-5},
        "twice": {"period": 2 * orbit.period}, "equilibrium": {"state": np.array([c, c, 27.0])},
    }[spoiled]  # fmt: skip
    proof = prove(replace(orbit, **change), model, Options(symmetry="none"))
    assert not proof.proved and proof.reason


def test_what_is_elsewhere_after_a_period_is_not_proved(butterfly):
    """A mass that falls, its place a length, comes back to another: the unfolding would stop it. A phase that goes half
    round in a half period goes round in another time, where its pace is not that of the other half."""
    orbit, period = butterfly[1], 2 * np.pi / (2 + 5e-7)
    falling = of.hamiltonian(lambda x, _: x.p**2 / 2 - 1e-3 * x.x, ("x",), ("p",))
    given = {"period": period, "energy": 2.0, "winding": (1, 0)}
    proof = prove(replace(orbit, state=np.array([0.0, 2.0]), **given), falling, Options(symmetry="none"))
    assert not proof.proved and "what is no angle" in proof.reason

    def field(_, x, p):
        grown = 1 - x.y**2 - x.z**2
        return [1 + 0.5 * ca.cos(x.phi), x.y * grown - p.pace * x.z, x.z * grown + p.pace * x.y]

    half, _ = quad(lambda phi: 1 / (1 + 0.5 * np.cos(phi)), 0.3, 0.3 + np.pi, epsabs=1e-15)
    turn = {"turn": (1, {"y": -1, "z": -1})}
    model = of.ode(field, ("phi", "y", "z"), {"pace": np.pi / half}, angles=("phi",), symmetries=turn)
    given = {"state": np.array([0.3, 1.0, 0.0]), "period": 2 * half, "winding": (1, 0, 0)}
    proof = prove(replace(orbit, **given), model, Options(symmetry="turn"))
    assert not proof.proved and "under half turns" in proof.reason


def test_a_false_hamiltonian_is_refused(loop):
    """Rates that are nearly those of the energy; integrals that are only declared; clocks."""
    _, model, orbit = loop
    t, x, p = ca.SX.sym("t"), ca.SX.sym("x", 4), ca.SX.sym("p", 0)
    leaking = ca.Function("rates", [t, x, p], [model.rates(t, x, p) - 1e-12 * x])
    with pytest.raises(InputError, match="not Hamilton's of its energy"):
        prove(orbit, altered(model, rates=leaking))
    with pytest.raises(InputError, match="conserves energy is declared"):
        prove(orbit, altered(model, hamiltonian=False))
    with pytest.raises(InputError, match="when its drive repeats cannot be read off"):
        prove(orbit, altered(model, forcing_period=ca.Function("T", [p], [1.0])))
    with pytest.raises(InputError, match="of systems with events only orbits are proved"):
        programs(of.systems.simplest_walker())


def test_commands_prove_and_replay_without_energy(tmp_path):
    """`prove` writes null for the energy, says nothing of one, and `verify --proof` does it again."""
    orbit = of.find_orbit(load_problem(ROOT / "problems/gallery/lorenz.toml"))
    file = str(of.save_orbit(orbit, tmp_path / "orbit.json"))
    said = CliRunner().invoke(cli, ["prove", file])
    assert said.exit_code == 0 and "exactly one turn orbit within" in said.output, said.output
    assert of.load_orbit(file).proof["energy"] is None
    again = CliRunner().invoke(cli, ["verify", "--proof", file])
    assert again.exit_code == 0 and "proof replayed" in again.output, again.output
    digits = CliRunner().invoke(cli, ["refine", file, "--digits", "30"])
    assert digits.exit_code == 0 and "30 digits, enclosed" in digits.output
