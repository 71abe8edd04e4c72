"""Proofs of driven orbits: a linear oscillator's closed form, what the graph says of a drive, planted failures."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("flint")

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.proof.balls import arb, decimal, precision
from orbitfinder.proof.field import make_field, programs
from orbitfinder.proof.theorem import prove
from orbitfinder.records.orbit import read_document
from orbitfinder.records.reading import write_json

pytestmark = pytest.mark.needs("proof")
ROOT = Path(__file__).parents[1]
DUFFING = str(ROOT / "problems/gallery/forced-duffing-upper.toml")


def linear(rate=lambda t, p: ca.cos(p.w * t), given=None):
    """x'' + c x' + x = F(t)."""

    def field(t, x, p):
        return [x.v, rate(t, p) - x.x - p.c * x.v]

    values = {"c": 0.4, "w": 0.8} | (given or {})
    return of.ode(field, ("x", "v"), values, forcing_period=lambda p: 2 * np.pi / p.w)


def response(model, times=1):
    """The response to cos w t as an orbit of so many periods of the drive, by the closed form."""
    c, w = model.parameter_values
    z = 1 / complex(1 - w**2, c * w)
    state, period = np.array([z.real, -w * z.imag]), 2 * np.pi / w
    orbit = of.find_orbit(of.Problem(model, of.Guess(state, period)))
    return replace(orbit, period=times * period, state=state)


@pytest.fixture(scope="module")
def proved():
    """A model, its orbit and the proof of it."""
    model = linear()
    orbit = response(model)
    return model, orbit, prove(orbit, model)


def test_a_linear_response_is_enclosed(proved):
    """x + i v = closed form in exact numbers, the multipliers those of the decay over a period."""
    _, _, proof = proved
    assert proof.proved and proof.minimal, proof.reason
    with precision(160):
        c, w = decimal(0.4), decimal(0.8)
        size = (1 - w**2) ** 2 + (c * w) ** 2
        exact = [(1 - w**2) / size, w * c * w / size]
        assert all(ball.contains(value) and ball.rad() < 1e-14 for ball, value in zip(proof.state, exact, strict=True))
        assert proof.period.overlaps(2 * arb.pi() / w) and len(proof.state) == 2
        decay = (-c * 2 * arb.pi() / w / 2).exp()
        assert all(abs(mu).overlaps(decay) for mu in proof.stability.multipliers)
    assert proof.stability.verdict == "asymptotically stable"


def test_a_multiple_of_the_drives_period_is_not_minimal(proved):
    """Three periods of an orbit of one, and a record that is not the orbit; a square of a cosine, which repeats twice
    as fast as the cosine."""
    model, orbit, _ = proved
    assert "state at T/3 could not be told" in prove(response(model, 3), model).reason
    square = linear(lambda t, p: 2 * ca.cos(p.w * t / 2) ** 2 - 1)
    assert "state at T/2 could not be told" in prove(response(model, 2), square).reason
    assert "not within 1e-09 of the record" in prove(replace(orbit, state=orbit.state + 1e-8), model).reason


def test_stability_of_hamiltonian_drives_is_proved_on_the_circle():
    """An undamped oscillator: both multipliers simple and on the circle; with a little damping nothing is said."""
    model = of.systems.forced_duffing(cubic=0.2, damping=0.0, force=0.3, frequency=1.7)
    orbit = of.find_orbit(of.Problem(model, of.Guess([-0.2, 0.0], 2 * np.pi / 1.7)))
    proof = prove(orbit, model)
    assert proof.stability.verdict == "linearly stable" and len(proof.stability.multipliers) == 2, proof.reason
    assert make_field(model).symplectic
    assert not make_field(of.systems.forced_duffing(damping=1e-9)).symplectic and not make_field(linear()).symplectic


@pytest.mark.parametrize(("first", "second", "gradient"), [
    (lambda q: q[1] / 3, lambda q: q[0] / 3, True),
    (lambda q: q[1] / 3, lambda q: q[0] * (1 / 3), False),  # a double, which CasADi's slope of q / 3 is too
    (lambda q: 2 * q[0] * q[1], lambda q: q[0] ** 2, True),
])  # fmt: skip
def test_forces_are_a_gradient_without_rounding(first, second, gradient):
    """1 / 3 is no double: forces q2 / 3 and q1 times the double next to it have no potential."""
    t, w = ca.SX.sym("t"), 1.3
    q, v, p = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("p", 1)
    symbols = of.Symbols(q, v, p, ("w",), (w,), t, 2 * ca.pi / p)
    forces = ca.vertcat(first(q) + ca.cos(p * t), second(q))
    model = of.lagrange(ca.sumsqr(v) / 2, 2 * ca.sumsqr(q), symbols, forces=forces)
    assert make_field(model).symplectic is gradient


@pytest.mark.parametrize(("factor", "rate"), [
    (1, lambda t, p: ca.cos(p.w * t)),
    (2, lambda t, p: ca.sin(2 * p.w * t) * ca.cos(4 * (p.w * t) + p.c)),
    (0.5, lambda t, p: ca.cos(t * p.w / 2 - 0.3) + ca.exp(ca.sin(-(1.5 * t) * p.w))),
    (None, lambda t, p: ca.cos(p.w * t) + ca.cos(t)),
    (None, lambda t, p: ca.cos(p.w * t) + 1e-12 * t),
    (None, lambda t, p: ca.cos(p.w * t**2)),
    (None, lambda t, p: ca.exp(p.w * t)),
    (None, lambda t, p: p.c),
])  # fmt: skip
def test_a_drives_period_is_read_off_the_graph(factor, rate):
    """The common frequency of all sines and cosines of time, or a refusal."""
    model = linear(rate)
    if factor is None:
        with pytest.raises(InputError, match="when its drive repeats cannot be read off"):
            programs(model)
        return
    field = make_field(model)
    assert field.frequency.contains(decimal(0.8) * decimal(factor)) and field.frequency.rad() < 1e-14
    turn, t, x = 2 * np.pi / 0.8 / factor, np.linspace(0.0, 3.0, 7), [0.3, -0.2]
    values = [[float(model.rates(at + s, x, model.parameter_values)[1]) for at in t] for s in (0.0, turn, turn / 2)]
    assert np.allclose(values[0], values[1], atol=1e-13) and not np.allclose(values[0], values[2], atol=1e-3)


def test_commands_prove_a_driven_orbit_and_reject_a_doctored_record(tmp_path):
    """`prove`, `verify --proof`; a multiplier, a node, the damping changed; families and symmetries refused."""
    run = CliRunner().invoke
    assert run(cli, ["run", DUFFING, "--no-figures", "--out", str(tmp_path)]).exit_code == 0
    file = tmp_path / "forced-duffing-upper" / "orbit.json"
    said = run(cli, ["prove", str(file)])
    assert said.exit_code == 0 and "asymptotically stable" in said.output, said.output
    again = run(cli, ["verify", "--proof", str(file)])
    assert again.exit_code == 0 and "proof replayed" in again.output, again.output
    document = read_document(file)
    false = {**document, "proof": dict(document["proof"])}
    for change in ("multipliers", "state"):
        first = document["proof"][change][0]
        ball = first[0] if change == "multipliers" else first
        moved = {**ball, "value": str(float(ball["value"]) + 1e-6)}
        entry = [moved, *first[1:]] if change == "multipliers" else moved
        false["proof"][change] = [entry, *document["proof"][change][1:]]
    other = tmp_path / "other.json"
    write_json(other, false)
    rejected = run(cli, ["verify", "--proof", str(other)])
    assert rejected.exit_code == 1, rejected.output
    assert "multipliers: recorded" in rejected.output and "state: recorded" in rejected.output
    asked = run(cli, ["prove", str(file), "--symmetry", "reflection", "--no-record"])
    assert asked.exit_code == 2 and "driven systems are proved without any" in asked.output
    orbit = of.load_orbit(file)
    system = {**orbit.system, "arguments": {**orbit.system["arguments"], "damping": 0.2 * 1.001}}
    assert not prove(replace(orbit, system=system)).proved
