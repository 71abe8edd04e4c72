"""The theorem on orbits of every symmetry, planted failures, the record and the commands."""

import json
import re
import sys
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("flint")

import orbitfinder as of
from orbitfinder.atlas.store import Atlas
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.mechanics.model import altered
from orbitfinder.orbits.find import find_orbit
from orbitfinder.problemfile.read import load_problem
from orbitfinder.proof import theorem
from orbitfinder.proof.balls import arb, arb_mat, flint, precision
from orbitfinder.proof.record import contradictions, entry, write_entry
from orbitfinder.proof.theorem import Options, prove, refine, settings_for
from orbitfinder.proof.trajectory import stability
from orbitfinder.records.orbit import digest, save_orbit
from orbitfinder.records.registry import load_orbit

pytestmark = pytest.mark.needs("proof")
ROOT = Path(__file__).parents[1]
REPORT = ("triple-1", "triple-2", "quadruple-1", "quadruple-2")
PROBLEMS = {  # name: (file, symmetry, verdict)
    "pendulum": ("examples/pendulum-2rad.toml", "brake+reflection", "linearly stable"),
    "running": ("examples/pendulum-running.toml", "reversal", "linearly stable"),
    "double": ("examples/double-mode-2.toml", "brake+reflection", "linearly stable"),
    "loop": ("gallery/henon-heiles-loop.toml", "none", "linearly stable"),
    "straight": ("gallery/henon-heiles-straight.toml", "brake", "linearly stable"),
    "coupled": ("gallery/coupled-oscillators.toml", "reflection", "unstable"),
}


@pytest.fixture(scope="module")
def found():
    """Orbits found from their problem files, each when first asked for."""
    known = {}

    def get(name):
        if name not in known:
            known[name] = find_orbit(load_problem(ROOT / "problems" / PROBLEMS[name][0]))
        return known[name]

    return get


@pytest.fixture(scope="module")
def proved(found):
    """What is proved of them, once each."""
    known = {}

    def get(name):
        if name not in known:
            known[name] = prove(found(name))
        return known[name]

    return get


@pytest.mark.parametrize("name", PROBLEMS)
def test_proved_in_every_symmetry(found, proved, name):
    """Existence, minimal period and stability; the record's own numbers lie within the bounds claimed."""
    orbit, proof = found(name), proved(name)
    assert proof.proved, proof.reason
    assert (proof.symmetry, proof.stability.verdict) == PROBLEMS[name][1:]
    assert proof.radius < 1e-9 and proof.contraction < 1 and proof.minimal
    assert abs(float(proof.period.mid()) - orbit.period) < 1e-12
    assert proof.distance < 1e-9 and proof.period_distance < 1e-9
    if proof.unfolding is not None:
        assert proof.unfolding.contains(0)
    for mu in proof.stability.multipliers:
        nearest = np.abs(orbit.floquet_multipliers - complex(float(mu.real.mid()), float(mu.imag.mid()))).min()
        assert nearest < 1e-6


def test_pendulum_period_is_the_elliptic_integral(proved):
    """The proved period of a pendulum meets 4 K / w, computed in balls at the proved amplitude."""
    proof = proved("pendulum")
    with precision(120):
        amplitude = abs(proof.state[0])
        exact = 4 * arb.pi() / 2 / arb(1).agm((amplitude / 2).cos()) / (arb(3) / 2 * arb(49) / 5).sqrt()
        assert proof.period.overlaps(exact) and exact.rad() < 1e-12


def test_full_formulation_agrees_with_the_symmetric_one(found, proved):
    """The same orbit proved with unfolding over the whole period: enclosures of the period meet."""
    orbit = found("double")
    short, whole = proved("double"), prove(orbit, options=Options(symmetry="none"))
    assert whole.proved and whole.symmetry == "none" and whole.unfolding.contains(0)
    assert short.period.overlaps(whole.period)
    assert whole.stability.verdict == short.stability.verdict
    assert all(abs(float(x.mid()) - y) < 1e-12 for x, y in zip(whole.state, orbit.state, strict=True))


def test_another_formulation_of_the_equations_agrees(found, proved):
    """Lagrange's dense equations, another graph, prove the same period."""
    from orbitfinder.mechanisms.chain import chain

    orbit = found("pendulum")
    other = prove(orbit, chain(1, formulation="lagrange"))
    assert other.proved and other.period.overlaps(proved("pendulum").period)


@pytest.mark.parametrize(
    ("name", "component"), [("double", 0), ("loop", 0), ("loop", 3), ("coupled", 1), ("running", 1)]
)
def test_nudged_state_is_not_proved(found, name, component):
    """A state off by 1e-5 in one component: an orbit is near, but the record is not it."""
    orbit = found(name)
    state = orbit.state.copy()
    state[component] += 1e-5
    proof = prove(replace(orbit, state=state))
    assert not proof.proved and proof.reason


def test_state_moved_along_the_orbit_is_proved(found, proved):
    """Any point of the orbit may be recorded."""
    orbit = found("double")
    later = prove(replace(orbit, state=orbit.nodes[3]))
    assert later.proved and later.period.overlaps(proved("double").period)


def test_wrong_period_is_not_proved(found):
    """A period off by 1e-5, and twice the period."""
    orbit = found("straight")
    off = prove(replace(orbit, period=orbit.period + 1e-5))
    assert not off.proved and "period up to" in off.reason
    twice = prove(replace(orbit, period=2 * orbit.period))
    assert not twice.proved
    whole = prove(replace(orbit, period=2 * orbit.period), options=Options(symmetry="none"))
    assert not whole.proved and "T/2" in whole.reason


def test_non_orbit_is_not_proved(found):
    """A random state with a random period, in several formulations."""
    orbit = found("double")
    nothing = replace(orbit, state=np.array([0.7, -1.1, 1.9, 0.4]), period=1.234)
    for symmetry in ("none", "brake", "reversal"):
        proof = prove(nothing, options=Options(symmetry=symmetry))
        assert not proof.proved and proof.reason


def test_equilibrium_is_not_proved(found):
    """Hanging at rest returns after any time; it is no orbit."""
    orbit = found("double")
    rest = replace(orbit, state=np.zeros(4), energy=-19.6)
    for symmetry in ("none", "brake"):
        assert not prove(rest, options=Options(symmetry=symmetry)).proved


def test_wrong_energy_is_not_proved(found):
    """The theorem fixes the recorded energy; the orbit there is another one."""
    orbit = found("double")
    proof = prove(replace(orbit, energy=orbit.energy + 1e-4))
    assert not proof.proved and "not within 1e-09 of the record" in proof.reason


def test_symmetry_that_the_equations_lack_is_not_used(found):
    """Henon-Heiles is not odd: a reflection is refused, with the reason."""
    proof = prove(found("loop"), options=Options(symmetry="reflection"))
    assert not proof.proved and "could not be read off" in proof.reason


def rotation(angle, stretch=1.0):
    c, s = stretch * np.cos(angle), stretch * np.sin(angle)
    return np.array([[c, -s], [s, c]])


@pytest.mark.parametrize(
    ("blocks", "radius", "verdict"),
    [
        ([rotation(1.0), rotation(2.0)], 1e-12, "linearly stable"),
        ([rotation(1.0), rotation(2.0)], 1e-1, "open"),
        ([rotation(1.0), rotation(1.0)], 1e-12, "open"),
        ([rotation(1.0), np.diag([1.001, 1 / 1.001])], 1e-12, "unstable"),
        ([rotation(1.0), np.diag([-1.5, -1 / 1.5])], 1e-9, "unstable"),
        ([rotation(1.0, 1.01), rotation(-1.0, 1 / 1.01)], 1e-12, "unstable"),
        ([rotation(1.0), np.diag([1.0, 1.0])], 1e-12, "open"),
    ],
)
def test_stability_verdicts(blocks, radius, verdict):
    """Known matrices: simple on the circle, blurred, double, real pair, complex quadruple, pair at 1."""
    random = np.random.default_rng(0).normal(size=(4, 4))
    whole = np.block([[blocks[0], np.zeros((2, 2))], [np.zeros((2, 2)), blocks[1]]])
    turned = random @ whole @ np.linalg.inv(random)
    with precision(106):
        matrix = arb_mat(4, 4, [arb(float(x), radius) for x in turned.ravel()])
        assert stability(matrix).verdict == verdict


@pytest.fixture
def saved(found, tmp_path):
    return save_orbit(found("straight"), tmp_path / "straight" / "orbit.json")


@pytest.fixture(scope="module")
def recorded(found, tmp_path_factory):
    """The text of an orbit's file with its proof."""
    file = save_orbit(found("straight"), tmp_path_factory.mktemp("recorded") / "orbit.json")
    run("prove", file)
    return file.read_text()


def widened(ball, factor=1.0, radii=0.0):
    """A recorded ball with another radius, its centre moved by so many radii."""
    ball["value"] = str(Decimal(ball["value"]) + Decimal(radii * ball["radius"]))
    ball["radius"] *= factor


def run(*arguments):
    return CliRunner().invoke(cli, [str(one) for one in arguments])


def test_prove_records_and_verify_replays(saved):
    """The command writes the entry, keeps the digest, and `verify --proof` does it all again."""
    before = json.loads(saved.read_text())
    result = run("prove", saved)
    assert result.exit_code == 0, result.output
    assert "proved in" in result.output and "linearly stable" in result.output
    document = json.loads(saved.read_text())
    entry = document.pop("proof")
    assert document == before and digest(document) == document["record"]
    assert entry["proved"] and entry["box_radius"] < 1e-9 and entry["contraction"] < 1
    assert entry["order"] == 22 and entry["bits"] == 106 and entry["steps"] > 0
    assert abs(float(entry["period"]["value"]) - before["period"]) < 1e-12
    assert len(entry["multipliers"]) == len(before["floquet_multipliers"])
    assert entry["versions"]["python-flint"] == flint.__version__
    again = run("verify", "--proof", "--json", saved)
    assert again.exit_code == 0, again.output
    assert json.loads(again.output)["results"][0]["proof"]["passed"]
    assert load_orbit(saved).name == document["name"]


def test_a_proof_is_not_written_into_another_orbit(proved, saved):
    """As where the file was written anew while its first orbit was proved; the file stays as it is."""
    proof, other = proved("pendulum"), saved.read_text()
    with pytest.raises(InputError, match="changed while it was proved, the proof is not recorded"):
        write_entry(saved, entry(proof))
    assert saved.read_text() == other


@pytest.mark.parametrize(
    ("change", "says"),
    [
        pytest.param(
            lambda e: e["period"].update(value="1.0359", radius=1e-9), "period", marks=pytest.mark.slow
        ),  # what meets the ball and is false, below, is more to ask
        pytest.param(lambda e: e["state"][0].update(radius=float("1e300")), "state", marks=pytest.mark.slow),
        (lambda e: e.update(stability="unstable"), "stability"),
        (lambda e: e.update(box_radius=1e-3), "box_radius"),
        pytest.param(lambda e: e["multipliers"].pop(), "multipliers", marks=pytest.mark.slow),
        pytest.param(lambda e: e["minimal_period"].update(proved=False), "minimal_period", marks=pytest.mark.slow),
        pytest.param(
            lambda e: e["minimal_period"].update(divisors_excluded_up_to=10**6),
            "minimal_period",
            marks=pytest.mark.slow,
        ),
        pytest.param(lambda e: e.update(contraction=1e-30), "contraction", marks=pytest.mark.slow),
        pytest.param(lambda e: e.update(enclosure_radius=1e-60), "enclosure_radius", marks=pytest.mark.slow),
        pytest.param(
            lambda e: e.update(nodes=[[{"value": "9.9", "radius": 1e-9}] * 4] * e["segments"]),
            "nodes",
            marks=pytest.mark.slow,
        ),
        pytest.param(lambda e: e.update(distance=0.0), "distance", marks=pytest.mark.slow),
        pytest.param(lambda e: e.update(period_distance=1e-3), "period_distance", marks=pytest.mark.slow),
        pytest.param(
            lambda e: e.update(unfolding={"value": "1.0", "radius": 1e-9}), "unfolding", marks=pytest.mark.slow
        ),
        (lambda e: e.update(phase=e["phase"] + 0.3), "phase"),
        pytest.param(lambda e: e.update(steps=1), "steps", marks=pytest.mark.slow),
        pytest.param(lambda e: e.update(stability_reason="because"), "stability_reason", marks=pytest.mark.slow),
        (lambda e: widened(e["period"], radii=1.6), "period"),  # meets the one found, and is false
        pytest.param(
            lambda e: widened(e["period"], factor=1e-12), "period", marks=pytest.mark.slow
        ),  # smaller than can be proved
        (lambda e: widened(e["nodes"][1][2], radii=-1.6), "nodes"),
        pytest.param(lambda e: [node.pop() for node in e["nodes"]], "nodes", marks=pytest.mark.slow),
        (lambda e: widened(e["multipliers"][0][1], radii=1.6), "multipliers"),
        (lambda e: e["energy"].update(value=str(Decimal(e["energy"]["value"]) + Decimal("1e-20"))), "energy"),
        pytest.param(lambda e: e["period"].update(value="1e999999999"), "period", marks=pytest.mark.slow),
    ],
)
def test_edited_record_is_rejected(recorded, tmp_path, change, says):
    """A claim edited by hand does not survive the replay."""
    document = json.loads(recorded)
    change(document["proof"])
    saved = tmp_path / "orbit.json"
    saved.write_text(json.dumps(document))
    result = run("verify", "--proof", saved)
    assert result.exit_code == 1
    assert "proof REJECTED" in result.output and says in result.output


def test_a_ball_recorded_without_margin_is_proved_by_a_smaller_one(saved):
    """As other round-off and 0.2 leave it: no wider than what is found here, beside it, and true."""
    run("prove", saved)
    document = json.loads(saved.read_text())
    for ball in (document["proof"]["period"], document["proof"]["multipliers"][0][1], document["proof"]["nodes"][1][0]):
        widened(ball, factor=0.5, radii=0.1)
    document["proof"]["multipliers"].reverse()
    saved.write_text(json.dumps(document))
    result = run("verify", "--proof", saved)
    assert result.exit_code == 0, result.output


def test_radii_are_recorded_twice_as_wide_as_found(proved):
    proof = proved("straight")
    for name in ("period", "energy"):
        wide, narrow = (entry(proof, margin)[name] for margin in (2.0, 1.0))
        assert wide == entry(proof)[name] and wide == narrow | {"radius": 2 * narrow["radius"]}


def test_numbers_in_words_are_compared(proved):
    """A multiplier in the reason of a verdict, with fewer digits and with others."""
    recorded, fresh = (entry(proved("coupled"), margin) for margin in (2.0, 1.0))
    for number, wrong in (("[2.3 +/- 9]", []), ("9.9", ["stability_reason"])):
        said = re.sub(r"[\d.]+(?= is off)|\[[^]]*\]", number, recorded["stability_reason"])
        assert number in said and [*contradictions(recorded | {"stability_reason": said}, fresh)] == wrong


def test_refined_digits_are_of_an_orbit(found, monkeypatch):
    """Where the unfolding need not push along the motion, what is enclosed could have one that is not 0."""
    monkeypatch.setattr(theorem, "positive_mass", lambda _: False)
    refined = refine(found("loop"), settings_for(12), 12)
    assert not refined.enclosed and "positive definite" in refined.reason


@pytest.fixture(scope="module")
def hardening():
    """q'' = -q - q^3, q an angle by its name alone."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    model = of.lagrange(v**2 / 2, q**2 / 2 + q**4 / 4, of.Symbols(q, v), names=["q"], angles=[True])
    return model, find_orbit(of.Problem(model, of.Guess([1.0, 0.0], 4.8), of.pin(energy=0.75)))


def test_a_whole_turn_away_is_elsewhere_where_equations_are_not_the_same_there(hardening):
    model, orbit = hardening
    proof = prove(orbit, model, Options(symmetry="brake"))
    assert proof.proved, proof.reason
    begun = np.array([[float(x.mid()) for x in node] for node in proof.nodes]), float(proof.period.mid())
    asked = Options(symmetry="brake", segments=len(begun[0]), begun=begun)
    away = prove(replace(orbit, state=np.add(orbit.state, [2 * np.pi, 0.0])), model, asked)
    assert not away.proved and "not within 1e-09 of the record" in away.reason


def test_what_leaks_is_not_made_up_for(hardening):
    """Damping that the Model does not know of, just what the unfolding takes back."""
    model, orbit = hardening
    t, q, v, p = ca.SX.sym("t"), ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("p", 0)
    damped = ca.Function("acceleration", [t, q, v, p], [-q - q**3 - 1e-6 * v])
    proof = prove(orbit, altered(model, acceleration=damped), Options(symmetry="none"))
    assert not proof.proved and "does not conserve it" in proof.reason


def test_the_horizon_starts_at_the_recorded_one_of_two_instants(found, proved):
    """Equal but for round-off, which chooses another on another machine."""
    orbit = found("straight")
    one = proved("straight")
    other = prove(orbit, options=Options(phase=(one.phase + 0.5) % 1.0))
    assert other.proved and abs(abs(other.phase - one.phase) - 0.5) < 1e-6
    assert prove(orbit, options=Options(phase=one.phase)).phase == one.phase


def test_a_mirror_that_nobody_declared_is_proved_by_the_name_that_the_atlas_gives_it():
    """Of two oscillators y -> -y and x -> -x are mirrors; recognised, they have names, and these are known again."""
    with Atlas(ROOT / "results" / "atlas" / "coupled-oscillators.sqlite") as atlas:
        row = min((one for one in atlas.rows() if one.symmetry == "mirror-y+reflection"), key=lambda one: one.period)
        orbit = atlas.orbit(row.id)
    assert prove(orbit).symmetry == "mirror-y+reflection"
    refined = refine(orbit, settings_for(20), 20)
    assert refined.enclosed and refined.symmetry == "mirror-y+reflection"


def test_record_of_a_nudged_state_is_rejected(saved):
    """The proof recorded for one state does not hold for another."""
    run("prove", saved)
    document = json.loads(saved.read_text())
    document["state"][0] += 1e-5
    saved.write_text(json.dumps(document))
    result = run("verify", "--proof", saved)
    assert result.exit_code == 1 and "not within" in result.output


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d.pop("proof"), "prove the orbit first"),
        (lambda d: d["proof"].update(theorem=99), "prove it again"),
        (lambda d: d["proof"].update(order="many"), "malformed entry"),
        (lambda d: d["proof"].update(order=10**6), "order: must be from 10 to 120"),
        (lambda d: d["proof"].update(order=4), "order: must be from 10 to 120"),
        (lambda d: d["proof"].update(segments=1000), "segments: must be from 1 to 100"),
        (lambda d: d["proof"].update(segments=0), "segments: must be from 1 to 100"),
        (lambda d: d["proof"].update(box_radius=1e-300), "need not hold the orbit"),
        (lambda d: d["proof"].update(contraction="x"), "contraction: expected a finite number"),
        (lambda d: d["proof"].update(symmetry="odd"), "symmetry: unknown 'odd'"),
    ],
)
def test_unusable_record_is_bad_input(saved, change, says):
    """No entry, another theorem, nonsense: exit code 2 with the remedy."""
    run("prove", saved)
    document = json.loads(saved.read_text())
    change(document)
    saved.write_text(json.dumps(document))
    result = run("verify", "--proof", saved)
    assert result.exit_code == 2 and says in result.output and "Traceback" not in result.output


def test_not_proved_is_exit_code_one(saved):
    """The command says "not proved" and why, leaves the file alone, and prints JSON when asked."""
    document = json.loads(saved.read_text())
    document["period"] += 1e-5
    saved.write_text(json.dumps(document))
    before = saved.read_bytes()
    result = run("prove", saved)
    assert result.exit_code == 1 and "not proved: an orbit exists, but not within" in result.output
    listed = CliRunner().invoke(cli, ["prove", "--json", str(saved)])
    assert listed.exit_code == 1 and not json.loads(listed.stdout)["passed"]
    assert saved.read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--order", "2"], "order: must be from 10"), (["--bits", "10"], "bits: must be from 64"),
        (["--tolerance", "1"], "tolerance: must be from 1e-40"), (["--segments", "0"], "segments: must be from 1"),
        (["--symmetry", "odd"], "'odd' is not one of"),
    ],
)  # fmt: skip
def test_bad_options(saved, arguments, says):
    """Each option out of range is named."""
    result = run("prove", *arguments, saved)
    assert result.exit_code == 2 and says in result.output


def test_unprovable_systems_are_bad_input(found, tmp_path):
    """A symmetry that no linkage is proved with: exit code 2 and the reason."""
    result = run("prove", ROOT / "results/gallery/four-bar-rocking/orbit.json", "--no-record", "--symmetry", "reversal")
    assert result.exit_code == 2 and "it is brake or none in proofs" in result.output
    missing = run("prove", tmp_path / "nothing.json")
    assert missing.exit_code == 2 and "no such file" in missing.output


OLD = SimpleNamespace(arb_poly=object, __version__="0.7.1")


@pytest.mark.parametrize(("module", "is_"), [(None, "not installed"), (OLD, "0.7.1, older than 0.8")])
def test_missing_python_flint_names_the_extra(saved, monkeypatch, module, is_):
    """Without python-flint, or with one that is too old, both commands say what to install."""
    for own in [name for name in sys.modules if name.startswith("orbitfinder.proof.")]:
        home, _, name = own.rpartition(".")
        monkeypatch.delattr(sys.modules[home], name)  # which comes back with the module itself, or two would be about
        monkeypatch.delitem(sys.modules, own)
    monkeypatch.setitem(sys.modules, "flint", module)
    for command in ("prove", "refine"):
        result = run(command, saved)
        assert result.exit_code == 2 and "orbitfinder[proof]" in result.output and is_ in result.output


def test_refine_agrees_with_the_elliptic_integral(found):
    """Forty digits of a pendulum's period, enclosed, against 4 K / w in balls."""
    orbit = found("pendulum")
    refined = refine(orbit, settings_for(40), 40)
    assert refined.enclosed, refined.reason
    with precision(250):
        energy = refined.energy  # = -4.9 cos(amplitude)
        amplitude = (-energy * 10 / 49).acos()
        exact = 4 * arb.pi() / 2 / arb(1).agm((amplitude / 2).cos()) / (arb(3) / 2 * arb(49) / 5).sqrt()
        assert refined.period.overlaps(exact)
        assert abs(refined.period - exact) < arb(10) ** -40


def test_refine_is_stable_under_order_and_precision(found):
    """Another order and precision give the same digits."""
    orbit = found("pendulum")
    one, two = (refine(orbit, settings_for(30, order, bits), 30) for order, bits in ((None, None), (60, 300)))
    with precision(300):
        assert one.enclosed and two.enclosed and one.period.overlaps(two.period)


def test_refine_command(saved):
    """Text and JSON of the command; without enclosing, nothing is claimed."""
    text = run("refine", saved, "--digits", "25")
    assert text.exit_code == 0 and "25 digits, enclosed" in text.output and "period" in text.output
    assert re.search(r"^  y +[\d.]+ \+/- [\d.]+e-\d+$", text.output, re.MULTILINE), "a name and how far it is known"
    found = CliRunner().invoke(cli, ["refine", str(saved), "--digits", "25", "--json", "--no-enclose"])
    document = json.loads(found.stdout)
    assert not document["enclosed"] and abs(float(document["period"]["value"]) - load_orbit(saved).period) < 1e-12
    for arguments, says in (
        (["--digits", "0"], "--digits: must be from 1"),
        (["--digits", "40", "--bits", "100"], "--bits: 40 digits need"),
        (["--order", "1"], "--order: must be from 4"),
    ):  # fmt: skip
        wrong = run("refine", saved, *arguments)
        assert wrong.exit_code == 2 and says in wrong.output


def test_settings_are_checked():
    """Too many digits are refused."""
    with pytest.raises(InputError, match="digits: must be from 1 to 250"):
        settings_for(1000)


@pytest.mark.slow
@pytest.mark.parametrize("name", REPORT)
def test_report_orbits_are_proved(name):
    """Each of the report's orbits, with its stability: triples unstable, quadruples linearly stable."""
    orbit = load_orbit(ROOT / "results" / "orbits" / name / "orbit.json")
    proof = prove(orbit)
    assert proof.proved, proof.reason
    assert proof.radius < 1e-9 and proof.minimal and proof.distance < 1e-9
    assert proof.stability.verdict == ("unstable" if name.startswith("triple") else "linearly stable")
    nudged = orbit.state.copy()
    nudged[0] += 1e-5
    assert not prove(replace(orbit, state=nudged)).proved
    assert not prove(replace(orbit, period=orbit.period + 1e-5)).proved


@pytest.mark.slow
@pytest.mark.parametrize(("order", "bits"), [(None, None), (76, 280)])
def test_fifty_digits_of_triple_1(order, bits):
    """The period to 50 digits, enclosed, is the same at another order and precision."""
    orbit = load_orbit(ROOT / "results" / "orbits" / "triple-1" / "orbit.json")
    refined = refine(orbit, settings_for(50, order, bits), 50)
    assert refined.enclosed, refined.reason
    with precision(300):
        digits = arb("1.65533898831464074470778910946168024901583045990775")
        assert abs(refined.period - digits) < 2 * arb(10) ** -50
