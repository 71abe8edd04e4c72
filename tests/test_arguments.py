"""What newcomers get wrong: one sentence each, which names the argument, and no traceback from inside."""

import inspect
import pickle
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder._runtime import arguments
from orbitfinder._runtime.arguments import fits
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError, plural
from orbitfinder.mechanics.model import energy
from orbitfinder.systems import van_der_pol

RESULTS = Path(__file__).parents[1] / "results"
CHAIN = of.chain(2)
STATE = [0.3, 0.4, 0.0, 0.0]
GUESS = of.Guess(STATE, 2.5)
PROBLEM = of.Problem(CHAIN, GUESS)
BAR = of.linkage([0.5, 1.2, 1.0], ground=[0.2, 1.0])
ORBIT = of.Orbit(
    "o", CHAIN.system, np.array(STATE), 2.5, 0.0, 0.0, 0.0, "none", (0, 0), np.ones(2), 0.0, "elliptic", (),
    np.zeros((1, 4)), np.zeros(0), np.zeros((0, 4)), 1e-12,
)  # fmt: skip
Q, V = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
T, U, S = ca.sumsqr(V) / 2, ca.sumsqr(Q) / 2, of.Symbols(Q, V)
MX = ca.MX.sym("q", 2), ca.MX.sym("v", 2)

MISTAKES = {
    "chain of a list": (lambda: of.chain([1.0, 2.0]), "links"),
    "chain of text": (lambda: of.chain("3"), "links"),
    "chain None": (lambda: of.chain(None), "links"),
    "chain mass text": (lambda: of.chain(2, mass="heavy"), "mass"),
    "chain gravity None": (lambda: of.chain(2, gravity=None), "gravity"),
    "energy short": (lambda: of.energy(of.chain(3), [0.1, 0.2]), "state"),
    "energy long": (lambda: of.energy(CHAIN, [0.1] * 8), "state"),
    "energy swapped": (lambda: of.energy(STATE, CHAIN), "model"),
    "energy text": (lambda: of.energy(CHAIN, "abc"), "state"),
    "energies vector": (lambda: of.energies(CHAIN, STATE), "states"),
    "positions 8": (lambda: of.positions(CHAIN, np.zeros((3, 8))), "states"),
    "positions which": (lambda: of.positions(CHAIN, [STATE], "joints"), "which"),
    "positions vector": (lambda: of.positions(CHAIN, STATE), "states"),
    "guess neg": (lambda: of.Guess(STATE, -1), "guess.period"),
    "guess period text": (lambda: of.Guess(STATE, "2"), "guess.period"),
    "guess period none": (lambda: of.Guess(STATE, None), "guess.period"),
    "guess state text": (lambda: of.Guess("here", 2.0), "guess.state"),
    "guess state none": (lambda: of.Guess(None, 2.0), "guess.state"),
    "problem list guess": (lambda: of.Problem(CHAIN, STATE), "guess"),
    "problem list model": (lambda: of.Problem([1, 2], GUESS), "model"),
    "problem pin dict": (lambda: of.Problem(CHAIN, GUESS, {"energy": -10}), "pin"),
    "problem pin one": (lambda: of.Problem(CHAIN, GUESS, pin=of.pin(energy=-10.0)[0]), "pin"),
    "pin positional": (lambda: of.pin(-10.0), "pin"),
    "pin text": (lambda: of.pin(energy="low"), "energy"),
    "pin none": (lambda: of.pin(energy=None), "energy"),
    "problem winding float": (lambda: of.Problem(CHAIN, GUESS, winding=(0.5, 0)), "winding"),
    "problem free str": (lambda: of.Problem(CHAIN, GUESS, free="mass1"), "free"),
    "problem bounds list": (lambda: of.Problem(CHAIN, GUESS, bounds=[1, 2]), "bounds"),
    "problem constraints fn": (lambda: of.Problem(CHAIN, GUESS, constraints=(lambda v: v.period,)), "constraints"),
    "problem constraints one": (
        lambda: of.Problem(CHAIN, GUESS, constraints=of.Constraint(lambda v: v.period)),
        "constraints",
    ),
    "problem tol text": (lambda: of.Problem(CHAIN, GUESS, tolerance="tight"), "tolerance"),
    "problem expected": (lambda: of.Problem(CHAIN, GUESS, expected={"period": 2.5}), "expected"),
    "problem objective": (lambda: of.Problem(CHAIN, GUESS, objective=3), "objective"),
    "constraint expr": (lambda: of.Constraint(3.0), "expression"),
    "find model": (lambda: of.find_orbit(CHAIN), "problem"),
    "find path": (lambda: of.find_orbit("problem.toml"), "problem"),
    "find orbit": (lambda: of.find_orbit(ORBIT), "problem"),
    "find settings": (lambda: of.find_orbit(PROBLEM, {"max_iterations": 5}), "settings"),
    "find progress": (lambda: of.find_orbit(PROBLEM, progress=True), "progress"),
    "certify problem": (lambda: of.certify(PROBLEM), "orbit"),
    "certify model str": (lambda: of.certify(ORBIT, "chain"), "model"),
    "save_orbit swapped": (lambda: of.save_orbit("o.json", ORBIT), "orbit"),
    "load none": (lambda: of.load_orbit(None), "path"),
    "load_problem int": (lambda: of.load_problem(3), "path"),
    "export swapped": (lambda: of.export_orbit("csv", ORBIT, "nowhere"), "orbit"),
    "figures none": (lambda: of.save_figures(None, "nowhere"), "orbit"),
    "clip": (lambda: of.orbit_clip("orbit.json"), "orbit"),
    "save_animation orbit": (lambda: of.save_animation(ORBIT, "x.gif"), "clip"),
    "modes text": (lambda: of.guesses.normal_mode(CHAIN, "1", 0.1), "mode"),
    "mode 1.5": (lambda: of.guesses.normal_mode(CHAIN, 1.5, 0.1), "mode"),
    "mode of list": (lambda: of.guesses.normal_mode([1, 2], 1, 0.1), "model"),
    "modes eq": (lambda: of.guesses.normal_modes(CHAIN, [0.0]), "equilibrium"),
    "modes eq scalar": (lambda: of.guesses.normal_modes(CHAIN, 0.0), "equilibrium"),
    "mode sum scalar": (lambda: of.guesses.normal_mode_sum(CHAIN, 1, 0.1), "modes"),
    "recurrences dur none": (lambda: of.guesses.recurrences(CHAIN, STATE, None), "duration"),
    "refiner model": (lambda: of.Refiner(CHAIN), "problem"),
    "atlas none": (lambda: of.Atlas(None), "path"),
    "search energies text": (
        lambda: of.search(CHAIN, "low", (1.0, 3.0), "nowhere.sqlite", starts=0, workers=0),
        "energies",
    ),
    "search periods scalar": (lambda: of.search(CHAIN, -10.0, 3.0, "nowhere.sqlite", starts=0, workers=0), "periods"),
    "search starts text": (
        lambda: of.search(CHAIN, -10.0, (1.0, 2.0), "nowhere.sqlite", starts="many", workers=0),
        "starts",
    ),
    "follow family parameter": (lambda: of.follow_family(ORBIT, 3), "parameter"),
    "follow family until": (lambda: of.follow_family(ORBIT, until="high"), "until"),
    "follow family at": (lambda: of.follow_family(ORBIT, at=3.0), "at"),
    "follow family settings": (lambda: of.follow_family(ORBIT, settings={"points": 5}), "settings"),
    "follow family model": (lambda: of.follow_family(ORBIT, model="chain"), "model"),
    "follow family word": (lambda: of.follow_family(ORBIT, untill=-30.0), "follow_family"),
    "switch orbit": (lambda: of.switch_branch(ORBIT, 1), "family"),
    "switch event": (lambda: of.switch_branch("family.json", "first"), "event"),
    "load_family none": (lambda: of.load_family(None), "path"),
    "simulate swapped": (lambda: of.simulate(STATE, CHAIN, 1.0), "model"),
    "simulate short": (lambda: of.simulate(CHAIN, [0.1], 1.0), "state"),
    "simulate backwards": (lambda: of.simulate(CHAIN, STATE, -1.0), "duration"),
    "simulate samples": (lambda: of.simulate(CHAIN, STATE, 1.0, "many"), "samples"),
    "prove problem": (lambda: of.prove(PROBLEM), "orbit"),
    "linkage baumgarte": (lambda: of.linkage([0.5, 1.2, 1.0], baumgarte=10.0), "baumgarte"),
    "assemble chain": (lambda: of.linkages.assemble(CHAIN, {"theta1": 0.3}), "model"),
    "assemble list": (lambda: of.linkages.assemble(BAR, [0.3]), "known"),
    "linkage_state chain": (lambda: of.linkages.linkage_state(CHAIN, [0.1, 0.2]), "model"),
    "linkage_rates list": (
        lambda: of.linkages.linkage_rates(BAR, of.linkages.assemble(BAR, {"theta1": 0.3}), [1.0]),
        "known",
    ),
    "joint_forces": (lambda: of.linkages.joint_forces(BAR, [0.1]), "state"),
    "linkage_modes eq": (lambda: of.linkages.linkage_modes(BAR, [0.1]), "equilibrium"),
    "linkage_equilibrium short": (lambda: of.linkages.linkage_equilibrium(BAR, [0.1]), "equilibrium"),
    "simulate_dae chain": (lambda: of.linkages.simulate_dae(CHAIN, STATE, 1.0), "model"),
    "minimal_states": (lambda: of.linkages.minimal_states(BAR, [0.1]), "states"),
    "minimal_linkage": (lambda: of.linkages.minimal_linkage(BAR, 1), "independent"),
    "build_flow": (lambda: of.flows.build_flow(BAR.system), "model"),
    "end_state model": (lambda: of.flows.end_state(CHAIN, STATE, 1.0), "flow"),
    "end_state short": (lambda: of.flows.end_state(of.flows.build_flow(CHAIN), [0.1], 1.0), "state"),
    "sample count": (lambda: of.flows.sample(of.flows.build_flow(CHAIN), STATE, 1.0, 1), "count"),
    "sample short": (lambda: of.flows.sample(of.flows.build_flow(CHAIN), [0.1], 1.0, 10), "state"),
    "transition short": (lambda: of.flows.transition(of.flows.build_flow(CHAIN), [0.1], 1.0), "state"),
    "lagrange MX": (lambda: of.lagrange(ca.sumsqr(MX[1]) / 2, ca.sumsqr(MX[0]) / 2, of.Symbols(*MX)), "coordinates"),
    "constrained MX": (
        lambda: of.constrained(ca.sumsqr(MX[1]) / 2, ca.sumsqr(MX[0]) / 2, MX[0][0], of.Symbols(*MX)),
        "coordinates",
    ),
    "lagrange tuple": (lambda: of.lagrange(T, U, (Q, V)), "symbols"),
    "lagrange none": (lambda: of.lagrange(T, None, S), "potential"),
    "lagrange text": (lambda: of.lagrange("v**2/2", U, S), "kinetic"),
    "lagrange function": (lambda: of.lagrange(lambda q, v: v, U, S), "kinetic"),
    "lagrange names short": (lambda: of.lagrange(T, U, S, names=["x"]), "names"),
    "lagrange names long": (lambda: of.lagrange(T, U, S, names=["x", "y", "z"]), "names"),
    "lagrange names dup": (lambda: of.lagrange(T, U, S, names=["x", "x"]), "names"),
    "lagrange names dot": (lambda: of.lagrange(T, U, S, names=["x", "xdot"]), "names"),
    "lagrange names energy": (lambda: of.lagrange(T, U, S, names=["energy", "x"]), "names"),
    "lagrange names str": (lambda: of.lagrange(T, U, S, names="xy"), "names"),
    "lagrange angles short": (lambda: of.lagrange(T, U, S, angles=[True]), "angles"),
    "lagrange angles bool": (lambda: of.lagrange(T, U, S, angles=True), "angles"),
    "constrained names": (lambda: of.constrained(T, U, ca.sumsqr(Q) - 1, S, names=["x"]), "names"),
    "constrained angles": (lambda: of.constrained(T, U, ca.sumsqr(Q) - 1, S, angles=[True]), "angles"),
    "lagrange points shape": (lambda: of.lagrange(T, U, S, points=ca.SX(4, 2)), "points"),
    "symbols parameter names": (
        lambda: of.lagrange(T, U, of.Symbols(Q, V, ca.SX.sym("k"))),
        "parameter_names, parameter_values",
    ),
    "symbols numbers": (lambda: of.Symbols([1, 2], [3, 4]), "coordinates"),
    "symbols list of SX": (lambda: of.lagrange(T, U, of.Symbols([Q[0], Q[1]], [V[0], V[1]])), "coordinates"),
    "invariants names": (lambda: of.lagrange(T, U, S, invariants=["energy"]), "invariants"),
    "least": (lambda: of.least_unstable(PROBLEM, starts="many"), "starts"),
    "settings": (lambda: of.SolveSettings(max_iterations="many"), "max_iterations"),
    "integrator": (
        lambda: of.flows.build_flow(CHAIN, settings=of.flows.IntegratorSettings(relative_tolerance=-1)),
        "relative_tolerance, absolute_tolerance, max_steps",
    ),
    "baumgarte text": (lambda: of.Baumgarte("a", 1), "alpha"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_newcomers_mistake_is_one_sentence_about_the_argument(mistake):
    """`energy` of half a state was a number, `positions` of 8 a picture; most others gave an AttributeError."""
    wrong, argument = MISTAKES[mistake]
    with pytest.raises(InputError) as caught:
        wrong()
    message = str(caught.value)
    assert message.startswith(f"{argument}: ") and len(message) < 400 and "\n" not in message


def test_public_functions_stay_what_they_are():
    """Checked ones keep their signature and can be pickled; what the house itself calls is not checked."""
    assert pickle.loads(pickle.dumps(of.certify)) is of.certify
    assert inspect.signature(of.energy) == inspect.signature(energy) and of.energy is not energy
    assert of.energy(CHAIN, tuple(STATE)) == of.energy(CHAIN, ca.DM(STATE)) == energy(CHAIN, np.array(STATE))


def test_a_guess_and_its_turns_may_be_those_of_the_links():
    theta = of.linkages.assemble(BAR, {"theta1": 0.3})
    state = of.linkages.linkage_state(BAR, theta)
    problem = of.Problem(BAR, of.Guess(np.concatenate([theta, np.zeros(3)]), 1.0), winding=(1, 0, -1))
    assert np.array_equal(problem.guess.state, state) and problem.winding == (0, 0, 1, 0, 0, 0, 0, 0, -1)
    again = of.Problem(BAR, of.Guess(state, 1.0), winding=problem.winding)
    assert np.array_equal(again.guess.state, state) and again.winding == problem.winding


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("int | Event", "a whole number or an Event"), ("Atlas", "an Atlas"), ("Unfolding", "an Unfolding"),
        ("UniformMesh", "a UniformMesh"), ("Model", "a Model"),
    ],
)  # fmt: skip
def test_articles_are_those_of_english(monkeypatch, kind, words):
    monkeypatch.setitem(arguments.MADE_BY, kind.split()[-1], "make one")
    with pytest.raises(InputError, match=f"^event: expected {words}, got 'first'; "):
        arguments.check("event", kind, "first")


@pytest.mark.parametrize(
    ("count", "noun", "said"),
    [(1, "orbit", "1 orbit"), (0, "event", "0 events"), (2, "family", "2 families"), (3, "atlas", "3 atlases")],
)
def test_counts_are_said_in_english(count, noun, said):
    assert plural(count, noun) == said


ORBIT_FILE = str(RESULTS / "orbits" / "triple-1" / "orbit.json")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["refine", ORBIT_FILE, "--digits", "0"], "--digits: must be from 1 to"),
        (["refine", ORBIT_FILE, "--bits", "10"], "--bits: 50 digits need at least"),
        (["atlas", "list", str(RESULTS / "atlas" / "triple.sqlite"), "--symmetry", "odd"], "--symmetry: unknown"),
        (["page", ORBIT_FILE, "-o", str(RESULTS)], "--out: "),
    ],
)
def test_a_command_names_the_option_that_was_given(words, said):
    """One message, raised where it is found, about an argument: the command says which option that was."""
    assert CliRunner().invoke(cli, words).stderr.startswith(f"Error: {said}")


def test_python_names_the_argument():
    from orbitfinder.proof.theorem import settings_for

    with pytest.raises(InputError, match="^digits: must be from 1 to"):
        settings_for(0)


def test_what_a_file_says_is_not_an_option(tmp_path):
    """`symmetry` of an orbit.json stays `symmetry` where --symmetry was given too."""
    wrong = tmp_path / "orbit.json"
    wrong.write_text(Path(ORBIT_FILE).read_text().replace('"brake"', "7"))
    said = CliRunner().invoke(cli, ["prove", str(wrong), "--symmetry", "brake"]).stderr
    named = f"Error: {wrong}: malformed entry (symmetry: expected text, got 7)"
    assert said.startswith((named, "Error: proofs need python-flint"))


def test_annotations_are_read_as_they_are_written():
    assert fits("float | Sequence[float]", 1) and fits("float | Sequence[float]", np.arange(3))
    assert fits("int", np.int64(3)) and not fits("int", True) and not fits("int", 3.0)
    assert fits("tuple[int, ...] | None", None) and fits("tuple[int, ...] | None", [1, 0])
    assert fits("Mapping[str, tuple[float, float]]", {"a": [0, 1]}) and not fits("Mapping[str, float]", {1: 2.0})
    assert fits("Model | None", van_der_pol()) and not fits("Model | None", PROBLEM)
    assert fits("WhoKnows[int]", object())
