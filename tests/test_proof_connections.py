"""Connections proved: Oterma's by published numbers, a slope of the local manifold by its closed form, failures."""

import json
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("flint")

from no_evaluators import printed

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.mechanics.kind import build_model
from orbitfinder.proof import connections
from orbitfinder.proof.balls import arb, arb_mat
from orbitfinder.proof.connections import (
    CODEC,
    LocalManifold,
    apart,
    check_cone,
    cone,
    prove_connection,
    read_connection_proof,
    replayed_connection,
    unproved_claims,
)
from orbitfinder.proof.enclosure import Tube
from orbitfinder.proof.field import make_field
from orbitfinder.proof.theorem import NotProved
from orbitfinder.proof.trajectory import Stability
from orbitfinder.structures.connections import connect
from orbitfinder.structures.manifold import save_connection
from orbitfinder.structures.manifolds import ManifoldSettings

pytestmark = pytest.mark.needs("proof")
ROOT = Path(__file__).parents[1]
RECORDS = ROOT / "results" / "proofs" / "connections"
OTERMA = json.loads((ROOT / "tests/data/oterma.json").read_text())["entries"][0]["values"]
COARSE = ManifoldSettings(spacing=0.1, turning=1.0)


def wells(coupling=0.05):
    """Two wells in x, a spring in y; the orbit x = 0 is a saddle with the multiplier e^pi where nothing couples."""
    return of.hamiltonian(
        lambda x, c: (x.px**2 + x.py**2 - x.x**2) / 2 + x.x**4 / 4 + 2 * x.y**2 + c.coupling * x.x**2 * x.y,
        ("x", "y"), ("px", "py"), {"coupling": coupling},
    )  # fmt: skip


@pytest.fixture(scope="module")
def proved():
    """A homoclinic motion of the wells, and what is proved of it."""
    model = wells()
    saddle = of.find_orbit(of.Problem(model, of.Guess([0, 0, 0, 1.0], np.pi), pin=of.pin(energy=0.5), name="saddle"))
    (motion,) = connect(saddle, plane="y=0", axes=("x", "px"), model=model, most=1, settings=COARSE)
    return motion, prove_connection(motion, model)


@pytest.fixture(scope="module")
def again(proved):
    """The same proved once more from its record."""
    return replayed_connection(proved[1], wells())


def test_a_homoclinic_motion_is_proved_and_replayed(proved, again, tmp_path):
    """The recorded crossing is in the balls, the orbit's own period is pi; the file holds all that is asked for."""
    motion, proof = proved
    assert proof.proved and proof.kind == "homoclinic", proof.reason
    state = np.array([float(ball["value"]) for ball in proof.state])
    assert np.abs(state - motion.states[motion.chosen]).max() < 1e-10
    assert all(ball["radius"] < 1e-15 for ball in proof.state)
    assert abs(Decimal(proof.origin.period["value"]) - Decimal("3.14159265358979323846264338")) < Decimal("1e-18")
    assert float(proof.origin.multipliers[0][0]["value"]) == pytest.approx(motion.origin.multiplier, rel=1e-10)
    assert not unproved_claims(proof, again)
    file = CODEC.save(proof, tmp_path / "connection-1-proof.json")
    assert read_connection_proof(file) == proof


def test_claims_that_are_not_proved_are_named(proved, again):
    """A ball moved by 1e-9 or shrunk to nothing, another kind or contraction, another period or multiplier."""
    record = proved[1]
    for name in ("state", "places", "durations"):
        ball = getattr(record, name)[0]
        for wrong in ({"value": str(Decimal(ball["value"]) + Decimal("1e-9"))}, {"radius": 1e-40}):
            false = replace(record, **{name: ({**ball, **wrong}, *getattr(record, name)[1:])})
            assert [said.partition(":")[0] for said in unproved_claims(false, again)] == [name]
    for words in ({"homoclinic": False}, {"contraction": 1e-12}):
        assert [said.partition(":")[0] for said in unproved_claims(replace(record, **words), again)] == [*words]
    late = {**record.goal.period, "value": "3.2"}
    for false, name in (
        (replace(record, goal=replace(record.goal, period=late)), "goal.period"),
        (replace(record, origin=replace(record.origin, multipliers=((late, late),))), "origin.multipliers"),
    ):
        assert [said.partition(":")[0] for said in unproved_claims(false, again)] == [name]


def test_records_of_other_motions_are_rejected(proved):
    """A constant changed by 1e-3, the motion, the orbit, the energy or the local manifold another."""
    record = proved[1]
    moved = (record.centre[0], record.centre[1] + 1e-6, *record.centre[2:])
    origin, goal = record.origin, record.goal
    shifted = replace(origin, centre=(origin.centre[0] + 1e-6, *origin.centre[1:]))
    changes = [
        ({"centre": moved}, "map the box"), ({"energy": record.energy + 1e-6}, "box"), ({"level": 1e-6}, "map the box"),
        ({"origin": shifted}, "orbit's box"), ({"turns": (1, 0, 0, 0)}, "no angle"),
        ({"origin": replace(origin, slope=origin.slope / 100)}, "no cone"),
        ({"origin": replace(origin, reach=1e-3)}, "return|energy|cone"),
        ({"goal": replace(goal, lap=-goal.lap)}, "lap"),
        ({"origin": replace(origin, reach=origin.reach / 100)}, "beyond the part"),
        ({"origin": replace(origin, reach=1.1 * abs(record.centre[0]))}, "beyond the part"),  # the box, not its zero
        ({"origin": replace(origin, frame=(origin.frame[1], origin.frame[0], origin.frame[2]))}, "no cone"),
        ({"origin": replace(origin, frame=((1.0, 1.0, 0.0, 0.0), *origin.frame[1:]))}, "not in the plane"),
        ({"origin": replace(origin, lap=1.01 * origin.lap)}, "at another time"),
        ({"goal": replace(goal, radius=goal.radius / 2)}, "different ones"),
    ]  # fmt: skip
    for change, reason in changes:
        fresh = replayed_connection(replace(record, **change), wells())
        assert not fresh.proved and any(word in fresh.reason for word in reason.split("|")), (change, fresh.reason)
    assert not replayed_connection(record, wells(0.05 * 1.001)).proved
    names = (*record.state_names[1:], record.state_names[0])
    for change in ({"centre": record.centre[:-1]}, {"turns": ()}, {"component": 4}, {"state_names": names}):
        with pytest.raises(InputError, match="does not fit the system; prove the connection again"):
            replayed_connection(replace(record, **change), wells())


def test_the_cone_of_a_saddle_is_the_closed_form():
    """P = (2 x, y / 2 + x^2) on |x| <= r: the unstable manifold is y = 4 x^2 / 7, its slope 8 r / 7 within the cone."""
    reach = 2.0**-10
    slopes = arb_mat([[arb(2), arb(0)], [arb(0, 2 * reach), arb(0.5)]])
    shape = LocalManifold([arb(0), arb(0)], [[arb(1), arb(0)], [arb(0), arb(1)]], None, reach, cone(slopes))
    check_cone(slopes, shape)
    assert 8 * reach / 7 < shape.slope < 3 * reach
    for x in (-reach, 0.3 * reach, reach):
        assert shape.at(arb(x))[1].contains(4 * arb(x) ** 2 / 7)
        assert shape.tangent()[1].contains(8 * arb(x) / 7)
    for false in (replace(shape, slope=reach), replace(shape, slope=0.5), replace(shape, slope=0.0)):
        with pytest.raises(NotProved, match="no cone"):
            check_cone(slopes, false)
    with pytest.raises(NotProved, match="no cone"):
        check_cone(arb_mat([[0.9, 0], [0, 0.5]]), replace(shape, slope=1e-3))


def test_the_local_manifold_keeps_the_energy():
    """That of the orbit, 1/2, along a direction that leaves it: u makes up for that."""
    law, reach = make_field(wells(0.0)), 0.05
    point, frame = [arb(0), arb(0), arb(0), arb(1)], [[1, 0, 1, 0.2], [1, 0, -1, 0], [0, 0, 0, 1]]
    shape = LocalManifold(point, [list(map(arb, row)) for row in frame], None, reach)
    shape = replace(shape, gradient=law.energy([*shape.box(), arb(0), arb(1)])[1])
    for x in (0.01, 0.05):
        state = shape.at(arb(x))
        level = law.energy([*state, arb(0), arb(1)])[0]
        assert level.contains(0.5) and level.rad() < 0.15 * x  # without u it is off by x / 5


def test_what_cannot_be_proved_is_refused(proved, tmp_path):
    """Driven systems, more coordinates, a record that is not of the motion proved, files and options of other kinds."""
    motion, _ = proved
    with pytest.raises(InputError, match="of a driven system"):
        prove_connection(replace(motion, component=-1), wells())
    with pytest.raises(InputError, match="its states have 6 components"):
        prove_connection(motion, of.systems.restricted_three_body(0.01, spatial=True))
    away = replace(motion, states=motion.states + 1e-6 * (np.arange(len(motion.states)) == motion.chosen)[:, None])
    assert "a connection exists, but its crossing is" in prove_connection(away, wells()).reason
    flat = replace(motion, states=motion.states + 0.01)
    assert "no connection near" in prove_connection(flat, wells()).reason
    file = save_connection(motion, tmp_path / "connection-1.json")
    for options, said in ((["--event", "1"], "--event: is for orbits"), (["--order", "3"], "order: must be")):
        done = CliRunner().invoke(cli, ["prove", str(file), *options])
        assert done.exit_code == 2 and said in done.output, done.output
    done = CliRunner().invoke(cli, ["prove", str(file), str(ROOT / "results/orbits/triple-1/orbit.json")])
    assert done.exit_code == 2 and "prove them by a command each" in done.output


def test_what_the_theorem_asks_for_besides(proved, monkeypatch):
    """Multipliers on both sides of the unit circle, a return in time, a push along the energy that is never none."""
    with monkeypatch.context() as patched:
        inside = Stability("asymptotically stable", "", [arb(0.5), arb(0.25)])
        patched.setattr(connections, "stability", lambda *_: inside)
        assert "on either side" in replayed_connection(proved[1], wells()).reason
    record = read_connection_proof(RECORDS / "oterma-l2.json")
    run = connections._ConnectionProof(record, build_model(dict(record.system)), print)
    early = replace(record.origin, slack=0.1 * record.origin.slack)
    with pytest.raises(NotProved, match="return to the plane could not be enclosed"):
        run.manifold(early, run.enclosed_orbit(early))
    path = run.enclosed_orbit(early)
    other = replace(path, box=[path.box[0] + 2 * arb.pi(), *path.box[1:]])
    assert apart(path, other, (False, False)) and not apart(path, other, (True, False))
    tube = Tube(0.0, 0.5, [[arb(1)]] * 4, [arb(0)] * 4, [arb(0), arb(1)])
    run.check_push([[tube]])
    monkeypatch.setattr(connections, "positive_definite", lambda _: False)
    with pytest.raises(NotProved, match="positive definite along the motion"):
        run.check_push([[tube]])


def test_damaged_records_are_refused(proved, tmp_path):
    """A number that is none or too large; that no energy is conserved is no damage."""
    file = CODEC.save(replace(proved[1], energy=float("nan")), tmp_path / "connection-1-proof.json")
    assert np.isnan(read_connection_proof(file).energy)
    for change in ({"radius": 0.0}, {"before": 0}, {"centre": (float("inf"),) * len(proved[1].centre)}):
        damaged = replace(proved[1], **change)
        file = tmp_path / "connection-1-proof.json"
        if np.isfinite(damaged.centre).all():
            CODEC.save(damaged, file)
        else:
            file.write_text(json.dumps(CODEC.document(proved[1])).replace(str(proved[1].centre[3]), "1e400"))
        with pytest.raises(InputError, match="no usable numbers|malformed|not a number|damaged"):
            read_connection_proof(file)


def test_recorded_connections_hold_the_published_numbers():
    """Of the Sun and Jupiter at Oterma's energy: to L2 and back, to L1 and back (140 bits), from L1 to L2."""
    first, second, chain = (read_connection_proof(RECORDS / f"oterma-{name}.json") for name in ("l1", "l2", "l1-l2"))
    assert [record.kind for record in (first, second, chain)] == ["homoclinic", "homoclinic", "heteroclinic"]
    assert first.proved and second.proved and chain.proved
    given = ((first.state[0], "homoclinic_L1_interior_x"), (first.origin.period, "L1_T"),
             (first.origin.multipliers[0][0], "L1_multiplier"), (chain.origin.period, "L1_T"))  # fmt: skip
    for ball, name in given:
        assert abs(Decimal(ball["value"]) - Decimal(OTERMA[name])) <= Decimal(ball["radius"]) < Decimal("1e-7"), name
    published = (0.967306682018305608, 0.003703230165036550462)  # centres of proved boxes, within 1e-10
    for ball, value in zip((chain.state[0], chain.state[2]), published, strict=True):
        assert float(ball["value"]) == pytest.approx(value, abs=2e-10)


REPLAY = """
import sys
from no_evaluators import forbid
from orbitfinder.proof.connections import read_connection_proof, replayed_connection, unproved_claims
forbid()
record = read_connection_proof(sys.argv[1])
again = replayed_connection(record)
print(again.kind, again.reason, unproved_claims(record, again))
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["l1", "l2", "l1-l2"])
def test_shipped_connections_are_replayed_in_another_process_without_evaluators(name):
    """Their records alone; the same with the ratio of masses changed by 1e-3 fails."""
    file = RECORDS / f"oterma-{name}.json"
    said = printed(REPLAY, file)
    assert said.strip().endswith("clinic  []"), said
    record = read_connection_proof(file)
    other = {**record.system, "arguments": {"ratio": 0.0009537 * 1.001}}
    assert not replayed_connection(replace(record, system=other)).proved


@pytest.mark.slow
def test_a_motion_without_an_energy_and_with_whole_turns(tmp_path):
    """Holmes' oscillator with the phase of its drive as a third component: its tangle, seven turns and more."""
    force, damping = 0.2, 0.1

    def field(_, x, p):
        return [x.v, x.x - x.x**3 - p.damping * x.v + p.force * ca.cos(x.theta), 1]

    model = of.ode(field, ("x", "v", "theta"), {"damping": damping, "force": force}, angles=("theta",))
    guess = of.Guess([-0.1, 0.0, 0.0], 2 * np.pi)
    saddle = of.find_orbit(of.Problem(model, guess, winding=(0, 0, 1), name="saddle"))
    (motion,) = connect(saddle, plane="theta=0", axes=("x", "v"), model=model, most=1)
    proof = prove_connection(motion, model)
    assert proof.proved and proof.turns[2] >= 7 and proof.origin.turns == (0, 0, 1), proof.reason
    mu = [float(pair[0]["value"]) for pair in proof.origin.multipliers]
    assert mu[0] * mu[1] == pytest.approx(np.exp(-2 * np.pi * damping), rel=1e-12)  # Liouville
    record = read_connection_proof(CODEC.save(proof, tmp_path / "connection-1-proof.json"))  # without an energy
    assert not unproved_claims(record, replayed_connection(record, model))
    goal, later = record.goal, 4 * np.pi * (np.arange(len(record.goal.centre)) % 3 == 2)
    anchor = (*goal.anchor[:2], goal.anchor[2] + 4 * np.pi)
    turned = replace(goal, centre=tuple((goal.centre + later).tolist()), anchor=anchor)
    false = replace(record, goal=turned, turns=(0, 0, proof.turns[2] - 2))
    assert "different ones could not be shown" in replayed_connection(false, model).reason
    assert not replayed_connection(replace(proof, turns=(0, 0, proof.turns[2] + 1)), model).proved
