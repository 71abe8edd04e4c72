"""Proofs of equilibria, folds and Hopf points: closed forms, the road's digits, rounded numbers, failures."""

import subprocess
import sys
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
from orbitfinder.problemfile.read import load_problem_file
from orbitfinder.proof.balls import arb, precision
from orbitfinder.proof.equilibria import CODEC, prove_equilibria, replay_equilibria
from orbitfinder.proof.program import derived, program
from orbitfinder.proof.series import BALLS

pytestmark = pytest.mark.needs("proof")
ROOT = Path(__file__).parents[1]


def wing(speed=8.0, damping=0.18):
    """The wing section of road.json, its constants parameters, which are the decimals that they are written as."""
    given = {
        "U": speed, "m": 12.387, "r": 0.0333, "i": 0.065, "c": 27.43, "k": 2844.4, "d": damping, "s": 2.82, "s3": 100.0,
        "b": 0.135, "rho": 1.225, "cl": 6.28, "near": 1.1, "lever": 0.1,
    }  # fmt: skip

    def field(t, x, p):
        h, a, hd, ad = (x[k] for k in range(4))
        lift = p.rho * p.U**2 * p.b * p.cl * (a + hd / p.U + p.near * p.b * ad / p.U)
        first, second = -lift - p.c * hd - p.k * h, -p.lever * p.b * lift - p.d * ad - p.s * a - p.s3 * a**3
        det = p.m * p.i - (p.m * p.r) ** 2
        return [hd, ad, (p.i * first - p.m * p.r * second) / det, (p.m * second - p.m * p.r * first) / det]

    return of.ode(field, ["h", "a", "hd", "ad"], parameters=given)


def lorenz():
    """C+ of Lorenz' equations, beta 8/3 exactly."""
    return of.ode(
        lambda t, x, p: [10 * (x[1] - x[0]), x[0] * (p[0] - x[2]) - x[1], x[0] * x[1] - 8 * x[2] / 3],
        ["x", "y", "z"], parameters={"rho": 20.0},
    )  # fmt: skip


def nerve():
    """FitzHugh and Nagumo's."""
    return load_problem_file(ROOT / "problems/equations/fitzhugh-nagumo.toml").model


def holds(ball, decimal):
    """Whether a recorded ball, without its margin, contains a decimal of the reference."""
    with precision(200):
        return bool(arb(ball["value"], ball["radius"] / 2).overlaps(arb(decimal)))


ROAD = {
    "brusselator": (lambda: of.systems.brusselator(rate=1.8), [1.0, 1.8], "rate", 2.4,
                    [("2", "1", "-0.5")]),
    "nerve": (nerve, [-1.2, -0.62], "I", 2.0, [
        ("0.33128133745474581144439560374831367", "0.27550680572356102869484374034619492",
         "0.97197108198899900511157075171"),
        ("1.4187186625452541885556043962516863", "0.27550680572356102869484374034619492",
         "0.97197108198899900511157075171")]),
    "lorenz": (lorenz, [7.0, 7.0, 19.0], "rho", 28.0, [
        ("24.736842105263157894736842105263158", "9.6245300637157563534496734518571812",
         "0.000265518972583671428839541472451")]),
    "wing": (wing, np.zeros(4), "U", 20.0, [
        ("12.10749991814706530442840438449869", "13.229134778258633121348706548112397",
         "0.0627673555465144360166674816447")]),
}  # fmt: skip
"""Model, state, parameter, until, of each Hopf point parameter, frequency, first Lyapunov coefficient (road.json)"""


@pytest.fixture(scope="module")
def flutter():
    """The wing's equilibria and what is proved of them."""
    model = wing()
    equilibria = of.follow_equilibria(model, np.zeros(4), "U", until=20.0)
    return model, equilibria, prove_equilibria(equilibria, model)


@pytest.mark.parametrize("name", ROAD)
def test_the_hopf_points_of_the_road_are_proved(name, flutter):
    """The 30 digits of parameter, frequency and coefficient lie in the enclosures; every point is proved too."""
    make, state, parameter, until, wanted = ROAD[name]
    model, equilibria, proof = flutter if name == "wing" else (make(), None, None)
    if proof is None:
        equilibria = of.follow_equilibria(model, state, parameter, until=until)
        proof = prove_equilibria(equilibria, model)
    assert proof.proved and [part.event for part in proof.parts].count("hopf") == len(wanted)
    for part, (value, frequency, coefficient) in zip(
        (p for p in proof.parts if p.event == "hopf"), wanted, strict=True
    ):
        assert holds(part.value, value) and holds(part.known["frequency"], frequency)
        assert holds(part.known["lyapunov"], coefficient) and float(part.known["lyapunov"]["radius"]) < 1e-27
        assert part.criticality == ("subcritical" if float(coefficient) > 0 else "supercritical")
    verdicts = {"stable": "asymptotically stable", "unstable": "unstable"}
    for part, point in zip(proof.parts, equilibria.points, strict=False):
        assert part.stability == verdicts[point.stability] and part.radius >= 1e-3
    crossing = float(proof.parts[-1].known["crossing"]["value"])
    at = [point.value for point in equilibria.points]
    rates = [point.eigenvalues.real.max() for point in equilibria.points]
    k = int(np.searchsorted(at, float(proof.parts[-1].value["value"])))
    assert crossing == pytest.approx((rates[k] - rates[k - 1]) / (at[k] - at[k - 1]), rel=0.5)  # a chord across it


def test_a_cubics_folds_are_proved():
    """x = +-1 / sqrt 3, r = -+2 / sqrt 27, in the box by exact numbers; the points between have 1 - 3 x^2."""
    cubic = of.ode(lambda t, x, p: [p[0] + x[0] - x[0] ** 3], ["x"], parameters={"r": -1.0})
    proof = prove_equilibria(of.follow_equilibria(cubic, [-1.3], "r", until=1.0), cubic)
    folds = [part for part in proof.parts if part.event == "fold"]
    assert proof.proved and len(folds) == 2
    with precision(200):
        for part, sign in zip(folds, (1, -1), strict=True):
            exact = sign * 2 / arb(27).sqrt(), -sign / arb(3).sqrt()
            for ball, value in zip((part.value, part.state[0]), exact, strict=True):
                assert arb(ball["value"], ball["radius"] / 2).contains(value)


def test_rest_of_a_conservative_system():
    """A pendulum hangs stably by its energy and stands unstably; pi is no decimal and is enclosed."""
    q, v, p = (ca.SX.sym(name, 1) for name in "qvp")
    model = of.lagrange(v**2 / 2, -p * ca.cos(q), of.Symbols(q, v, p, ("g",), (9.8,)), names=("q",), angles=[True])
    for state, verdict in (([0.0, 0.0], "stable"), ([np.pi, 0.0], "unstable")):
        proof = prove_equilibria(of.follow_equilibria(model, state, "g", until=10.0), model)
        assert proof.proved and {part.stability for part in proof.parts} == {verdict}
    with precision(200):
        ball = proof.parts[0].state[0]
        assert arb(ball["value"], ball["radius"] / 2).contains(arb.pi())


def test_numbers_are_not_rounded_where_they_are_derived():
    """CasADi's slope of v^3 / 3 is 0.333... rounded times 3 v^2; `derived` has v^2."""
    v = ca.SX.sym("v")
    with precision(106):
        for function, wanted in ((v**3 / 3, arb(1)), (ca.sin(v / 7), (arb(1) / 7).cos() / 7)):
            exact = derived("slope", [v], function, lambda f: [ca.jacobian(f, v)])
            rounded = program(ca.Function("slope", [v], [ca.jacobian(function, v)]))
            here, there = (code.run([[arb(1)]], BALLS)[0][0] for code in (exact, rounded))
            assert here.overlaps(wanted) and here.rad() < 1e-30 and not there.overlaps(wanted)


def test_what_is_false_is_not_proved(flutter):
    """A state or a parameter that is off, a fold that is none, a Hopf point whose eigenvalues do not cross."""
    model, equilibria, _ = flutter
    event = equilibria.events[0]
    for wrong in (replace(event, parameter=event.parameter + 1e-6), replace(event, kind="fold")):
        part = prove_equilibria(replace(equilibria, events=(wrong,)), model).parts[-1]
        assert not part.proved and ("not within 1e-09" in part.reason or "no box into itself" in part.reason)
    moved = replace(equilibria.points[0], state=equilibria.points[0].state + 1e-6)
    assert "not within" in prove_equilibria(replace(equilibria, points=(moved,)), model).parts[0].reason
    still = of.ode(lambda t, x, p: [x[1], -x[0] + p[0] ** 2 * x[1]], ["x", "y"], parameters={"r": 0.5})
    touching = replace(
        equilibria, parameter="r", points=(),
        events=(replace(event, state=np.zeros(2), parameter=0.0, frequency=1.0),),
    )  # fmt: skip
    reason = prove_equilibria(touching, still).parts[0].reason
    assert "no box into itself" in reason or "could be 0" in reason


def rotor(cubic, more=()):
    """x' = p x - y + cubic x |x|^2, y' alike: a Hopf point at 0, z' = i z + 2 cubic z |z|^2 along q of length 1, so
    that l1 = 2 cubic; `more` oscillators beside it."""

    def field(t, x, p):
        grown = cubic * (x[0] ** 2 + x[1] ** 2)
        own = [p[0] * x[0] - x[1] + grown * x[0], x[0] + p[0] * x[1] + grown * x[1]]
        return own + [rate for k, w in enumerate(more) for rate in (w * x[3 + 2 * k], -w * x[2 + 2 * k])]

    return of.ode(field, [f"x{k}" for k in range(2 + 2 * len(more))], parameters={"p": 0.25})


@pytest.mark.parametrize(("cubic", "more", "said"), [
    (-1.0, (), ""), (0.0, (), "first Lyapunov coefficient could be 0"), (-1.0, (2.5,), "another eigenvalue"),
])  # fmt: skip
def test_what_hopfs_theorem_asks_for_besides(flutter, cubic, more, said):
    """A coefficient that is not 0, and no other pair on the axis."""
    event = replace(flutter[1].events[0], state=np.zeros(2 + 2 * len(more)), parameter=0.0, frequency=1.0)
    part = prove_equilibria(replace(flutter[1], parameter="p", points=(), events=(event,)), rotor(cubic, more)).parts[0]
    assert part.proved is not bool(said) and said in part.reason
    if not said:
        with precision(200):
            ball = part.known["lyapunov"]
            assert arb(ball["value"], ball["radius"]).contains(2 * cubic)


def test_rest_that_no_energy_holds_is_open(flutter):
    """Two oscillators, one of negative energy: eigenvalues on the axis, no definite energy."""
    for sign, verdict in ((1, "stable"), (-1, "open")):
        model = of.hamiltonian(
            lambda x, p, sign=sign: (x.a**2 + x.pa**2) / 2 + sign * p.w * (x.b**2 + x.pb**2) / 2,
            ("a", "b"), ("pa", "pb"), parameters={"w": 1.7},
        )  # fmt: skip
        point = replace(flutter[1].points[0], state=np.zeros(4), value=1.7)
        part = prove_equilibria(replace(flutter[1], parameter="w", points=(point,), events=()), model).parts[0]
        assert part.proved and part.stability == verdict


def test_other_equations_and_doctored_records_are_rejected(flutter):
    """One constant by 1e-3; every field of the record."""
    model, _, proof = flutter
    assert replay_equilibria(proof, model)[1] == []
    faults = replay_equilibria(proof, wing(damping=0.18 * 1.001))[1]
    assert any(fault.startswith("hopf 0") for fault in faults)
    part = proof.parts[-1]
    shifted = {"value": str(float(part.value["value"]) + 1e-9), "radius": part.value["radius"]}
    lyapunov = part.known | {"lyapunov": part.known["lyapunov"] | {"value": "-0.0627"}}
    for changes in (
        {"criticality": "supercritical"}, {"radius": 0.1}, {"contraction": 1e-3}, {"value": shifted}, {"index": 7},
        {"known": lyapunov},
        {"eigenvalues": part.eigenvalues[::-1][:3]}, {"state": part.state[:3]}, {"event": "fold"},
        {"vector": (1.0,)}, {"known": None}, {"state": ({"value": "x", "radius": 1.0},) * 4},
    ):  # fmt: skip
        assert replay_equilibria(replace(proof, parts=(replace(part, **changes),)), model)[1], changes
    first = replace(proof.parts[0], stability="unstable")
    assert "stability" in replay_equilibria(replace(proof, parts=(first,)), model)[1][0]


def test_contraction_number_and_units_of_a_recorded_proof_are_covered(tmp_path):
    """A contraction above 1 or below the one found, the number of another point or event, another unit."""
    cubic = of.ode(lambda t, x, p: [p[0] + x[0] - x[0] ** 3], ["x"], parameters={"r": -1.0}, units={"time": "ms"})
    along = of.follow_equilibria(cubic, [-1.3], "r", until=1.0)
    proof = prove_equilibria(replace(along, points=along.points[:2]), cubic)
    assert replay_equilibria(proof, cubic)[1] == [] and proof.events == ("fold", "fold")
    assert replay_equilibria(replace(proof, events=()), cubic)[1] == []  # of an older file
    for k, changes, said in (
        (1, {"contraction": 1.34}, "contraction"), (1, {"contraction": 1.0}, "contraction"),
        (1, {"contraction": 0.6 * proof.parts[1].contraction}, "contraction"),
        (-1, {"contraction": 0.9 * proof.parts[-1].contraction}, "contraction"),
        (1, {"index": 4}, "index"), (-1, {"index": 0}, "index"), (-1, {"index": 2}, "index"),
    ):  # fmt: skip
        parts = list(proof.parts)
        parts[k] = replace(parts[k], **changes)
        wrong = replay_equilibria(replace(proof, parts=tuple(parts)), cubic)[1]
        assert wrong and said in wrong[-1], (changes, wrong)
    wider = replace(proof.parts[1], contraction=0.5 * (1 + proof.parts[1].contraction))
    parts = (proof.parts[0], wider, *proof.parts[2:])
    assert replay_equilibria(replace(proof, parts=parts), cubic)[1] == []
    file = CODEC.save(proof, tmp_path / "equilibria-proof.json")
    assert CODEC.load(file).parts == proof.parts
    text = file.read_text()
    for old, new in (('"ms"', '"msx"'), ('"index": 1', '"index": 2'), ('"wall_time": ', '"wall_time": 1')):
        assert old in text
        file.write_text(text.replace(old, new))
        with pytest.raises(InputError, match="record: its digest is another"):
            CODEC.load(file)


def test_what_cannot_be_proved_is_refused():
    """Driven systems, curves in two parameters."""
    driven = of.systems.forced_pendulum()
    model = of.systems.brusselator(rate=1.8)
    equilibria = of.follow_equilibria(model, [1.0, 1.8], "rate", until=2.4)
    with pytest.raises(InputError, match="smooth autonomous systems"):
        prove_equilibria(replace(equilibria, parameter=driven.parameter_names[0]), driven)
    with pytest.raises(InputError, match="curves in two parameters"):
        prove_equilibria(replace(equilibria, curve={"test": "hopf"}), model)


REPLAY = """
import casadi as ca
from orbitfinder.proof.equilibria import CODEC, replay_equilibria
from orbitfinder.proof.theorem import provable_system
from orbitfinder.integrate.evaluate import Buffered
recorded = CODEC.load("equilibria-proof.json")
model, called = provable_system(recorded.system), ca.Function.__call__
def symbolic(self, *given, **named):
    flat = [x for part in given for x in (part if isinstance(part, (list, tuple)) else [part])]
    if not any(isinstance(x, (ca.SX, ca.MX)) for x in flat):
        raise AssertionError("CasADi evaluated numbers")
    return called(self, *given, **named)
def never(*_):
    raise AssertionError("NumPy evaluated the rates")
ca.Function.__call__ = symbolic
Buffered.__call__ = never
again, wrong = replay_equilibria(recorded, model)
print(len(again.parts), wrong)
"""


def test_the_command_proves_and_another_process_replays(tmp_path, monkeypatch):
    """prove, verify --proof and show; the replay evaluates balls alone."""
    monkeypatch.chdir(tmp_path)
    run = CliRunner().invoke
    model = load_problem_file(ROOT / "problems/equations/brusselator.toml").model
    of.save_equilibria(of.follow_equilibria(model, [1.0, 1.8], "b", until=2.2), "equilibria.json")
    said = run(cli, ["prove", "equilibria.json"])
    assert (
        said.exit_code == 0
        and "hopf 0: supercritical proved" in said.output
        and "b 2.00000000000000000 +/- 4e-30" in said.output
    )
    assert "proof replayed" in run(cli, ["verify", "--proof", "equilibria-proof.json"]).output
    assert "Hopf points" in run(cli, ["show", "equilibria-proof.json"]).output
    replayed = subprocess.run([sys.executable, "-c", REPLAY], capture_output=True, text=True, check=False)
    assert replayed.stdout.strip().endswith("[]"), replayed.stderr
    proof = CODEC.load(Path("equilibria-proof.json"))
    spoilt = (*proof.parts[:-1], replace(proof.parts[-1], criticality="subcritical"))
    CODEC.save(replace(proof, parts=spoilt), "equilibria-proof.json")
    rejected = run(cli, ["verify", "--proof", "equilibria-proof.json"])
    assert rejected.exit_code == 1 and "REJECTED: hopf 0: criticality" in rejected.output
    for options, words in ((["--from", "1"], "--from: is for"), (["x.json"], "by a command each")):
        refused = run(cli, ["prove", "equilibria.json", *options])
        assert refused.exit_code == 2 and words in refused.output
