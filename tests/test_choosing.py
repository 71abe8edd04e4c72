"""The least unstable of separate orbits: the best of all that independent searches find."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.atlas import choose as choosing
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError, InputError, OrbitfinderError
from orbitfinder.loops.ipopt import SolveSettings
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.objectives import rank

DOUBLE = of.chain(2)
GUESS = of.guesses.normal_mode(DOUBLE, 2, 0.9)
EXAMPLES = Path(__file__).parents[1] / "problems" / "examples"


def choice(band=(1.5, 3.0), energy=-10.0, **more):
    settings = {"pin": of.pin(energy=energy), "objective": "min_instability", "bounds": {"period": band}} | more
    return of.Problem(DOUBLE, GUESS, **settings)


@pytest.fixture(scope="module")
def found():
    """All that 20 starts find, least unstable first."""
    return choosing.candidates(choice(), 20, 0)


def test_candidates_are_distinct_and_ordered(found):
    """The guess's own orbit (spectral radius 4.2) is among them, and not the first."""
    assert len(found) >= 3
    assert [one.rank for one in found] == sorted(one.rank for one in found)
    periods = [one.orbit.period for one in found]
    assert len({round(period, 6) for period in periods}) == len(periods)
    own = find_orbit(of.Problem(DOUBLE, GUESS, pin=of.pin(energy=-10.0)))
    places = [k for k, period in enumerate(periods) if abs(period - own.period) < 1e-8]
    assert places and places[0] > 0


def test_the_best_is_certified_and_says_how_it_was_chosen(found):
    """One of the candidates, refined and certified again, with the runner-up in its provenance."""
    orbit = of.least_unstable(choice(), 20, 0)
    assert orbit.certificate.passed
    assert orbit.period == pytest.approx(found[0].orbit.period, rel=1e-9)
    said = orbit.provenance["choice"]
    assert said["orbits"] == len(found) and said["starts"] == 20
    assert said["spectral_radius"] <= said["runner_up"]


def test_the_better_of_two_starts_wins():
    """Ranks go by spectral radius, then by |mu + 1/mu|."""

    class Multipliers:
        def __init__(self, *values):
            self.floquet_multipliers = np.array(values, complex)

    calm, turning = Multipliers(1j, -1j), Multipliers(np.exp(0.1j), np.exp(-0.1j))
    unstable, wild = Multipliers(2.0, 0.5), Multipliers(30.0, 1 / 30)
    assert sorted([wild, turning, unstable, calm], key=rank) == [calm, turning, unstable, wild]
    assert rank(Multipliers()) == (1.0, 0.0)


@pytest.mark.slow
def test_no_independent_search_finds_a_better_one():
    """Close returns of random motions at that energy, solved by find_orbit: nothing beats the shipped answer."""
    problem = of.load_problem(EXAMPLES / "double-least-unstable.toml")
    best = of.least_unstable(problem, 200, 0)
    other = choosing.candidates(problem, 400, 7)
    assert other[0].orbit.period == pytest.approx(best.period, rel=1e-9)
    random, seen = np.random.default_rng(5), []
    for _ in range(5):
        state = np.concatenate([random.uniform(-0.6, 0.6, 2), random.normal(size=2)])
        rest = of.energy(DOUBLE, np.concatenate([state[:2], np.zeros(2)]))
        state[2:] *= np.sqrt((-10.0 - rest) / (of.energy(DOUBLE, state) - rest))
        for one in of.guesses.recurrences(DOUBLE, state, 40.0, 5, 3.0):
            try:
                orbit = find_orbit(
                    of.Problem(DOUBLE, one.guess, pin=of.pin(energy=-10.0)), SolveSettings(with_certificate=False)
                )
            except OrbitfinderError:
                continue
            if 1.5 <= orbit.period <= 3.0:
                seen.append(orbit)
    assert len({round(one.period, 6) for one in seen}) >= 3
    radius, index = rank(best)
    for one in seen:
        assert rank(one)[0] > radius + 1e-4 or rank(one)[1] > index - 1e-6


def test_nothing_found_is_said():
    """A band without orbits ends with what was tried and what to change."""
    with pytest.raises(ConvergenceError, match="none of 3 starts.*from 0.1 to 0.2 s.*more starts"):
        of.least_unstable(choice((0.1, 0.2)), 3)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"objective": "nearest"}, "needs objective min_instability"),
        ({"pin": of.pin(theta1=0.3)}, "goes by energy .pin. and period"),
        ({"bounds": {"period": (1.0, 2.0), "theta1": (0.0, 1.0)}}, "leave out other bounds"),
        ({"symmetry": "brake"}, "leave out other bounds, constraints, pins and the symmetry"),
    ],
)
def test_other_problems_are_refused(more, message):
    with pytest.raises(InputError, match=message):
        of.least_unstable(choice(**more), 2)


def test_the_command_prints_what_was_chosen(tmp_path):
    """`run` on a file with a freed length: the value on the line and in the JSON."""
    outcome = CliRunner().invoke(
        cli, ["run", str(EXAMPLES / "triple-length-for-2s.toml"), "--out", str(tmp_path), "--no-figures"]
    )
    assert outcome.exit_code == 0 and "length3 = 0.82225927" in outcome.stdout
    outcome = CliRunner().invoke(
        cli, ["run", str(EXAMPLES / "triple-length-for-2s.toml"), "--out", str(tmp_path), "--no-figures", "--json"]
    )
    (result,) = json.loads(outcome.stdout)["results"]
    assert result["chosen"]["length3"] == pytest.approx(0.82225927751, abs=1e-10)


def test_the_command_says_among_how_many(tmp_path):
    """A choice names the number of orbits and of starts; those are in orbit.json as well."""
    file = tmp_path / "few.toml"
    text = (EXAMPLES / "double-least-unstable.toml").read_text(encoding="utf-8").replace("starts = 100", "starts = 4")
    file.write_text(text.split("[expected]")[0].replace('name = "double-least-unstable"', ""), encoding="utf-8")
    outcome = CliRunner().invoke(cli, ["run", str(file), "--out", str(tmp_path), "--no-figures", "--json"])
    (result,) = json.loads(outcome.stdout)["results"]
    made = json.loads((tmp_path / "few" / "orbit.json").read_text(encoding="utf-8"))["provenance"]["choice"]
    assert made["starts"] == 4
    assert f"certified, the least unstable of {made['orbits']} orbits found from 4 starts" == result["message"]


FIND = '[system]\nkind = "chain"\nlinks = 2\n[guess]\nmode = 2\namplitude = 0.5\n[find]\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('objective = "min_instabilty"', "find.objective"),
        ("bounds = { energy = [2.0, 1.0] }", "bounds.energy: must be [smallest, largest]"),
        ("bounds = { energy = [2.0] }", "bounds.energy: must be"),
        ("bounds = { lenght2 = [0.5, 2.0] }", "find.bounds: unknown quantity 'lenght2'"),
        ("bounds = { length2 = [0.5, 2.0] }", "find.bounds: length2 is not free"),
        ("starts = 0", "find.starts"),
        ("seed = -1", "find.seed"),
        ('objective = "max_amplitude"\npin = { energy = -18.0 }', "find.objective: nothing is left to choose"),
        ('coordinate = "theta1"', "find.coordinate: goes with"),
        ("[expected.parameters]\nlenght = { value = 1.0, tolerance = 1.0 }", "expected.parameters: unknown 'lenght'"),
    ],
)
def test_messages_of_files(text, message, tmp_path):
    """Exit code 2 and a sentence that names the key."""
    file = tmp_path / "p.toml"
    file.write_text(FIND + text + "\n", encoding="utf-8")
    outcome = CliRunner().invoke(cli, ["run", str(file), "--out", str(tmp_path / "out")])
    assert outcome.exit_code == 2 and message in outcome.stderr
