"""Searches of first-order systems: the same orbits as in mechanical form, all of an attractor's, what is refused."""

import json
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

import orbitfinder as of
from orbitfinder.atlas.regions import Attractor, Level, equilibria
from orbitfinder.atlas.search import search
from orbitfinder.atlas.starts import Target, context_of, make_start
from orbitfinder.atlas.store import Atlas
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.loops.symmetry import involutions

ROOT = Path(__file__).parents[1]
LORENZ = {"LR": 1.558652210716, "LLR": 2.305907263940, "LLLR": 3.023583703434, "LLRR": 3.084276775822}
"""periods by words: benchmarks/first_order.py, without orbitfinder; LLR and LLLR have images LRR and LRRR"""


FORCED = {"stiffness": 1.0, "cubic": 1.0, "damping": 0.1, "force": 0.5, "frequency": 1.6}


def henon_heiles():
    """The star potential as Hamilton's equations, with a mirror and a flip."""

    def energy(x, _):
        return (x.px**2 + x.py**2 + x.x**2 + x.y**2) / 2 + x.x**2 * x.y - x.y**3 / 3

    known = {"mirror": (-1, {"x": -1, "py": -1}), "flip": (1, {"x": -1, "px": -1})}
    return of.hamiltonian(energy, ("x", "y"), ("px", "py"), symmetries=known)


def found(model, energy, periods, starts, folder):
    """The orbits that a search in this process finds, each certified again, by period."""
    path = folder / f"{len(model.state_names)}-{model.rates is None}.sqlite"
    search(model, energy, periods, path, starts=starts, workers=0)
    with Atlas(path, model=model) as atlas:
        orbits = [atlas.orbit(row.id) for row in atlas.rows()]
    assert all(of.certify(one, model).passed for one in orbits)
    return sorted(orbits, key=lambda one: one.period)


@pytest.mark.slow
def test_hamiltonian_and_mechanical_search_find_the_same(tmp_path):
    """Hénon-Heiles at E = 1/8: the same periods, actions and multiplicities, but that both senses of a loop count."""
    wanted = found(of.systems.henon_heiles(), 0.125, (3.0, 7.2), 80, tmp_path)
    orbits = found(henon_heiles(), 0.125, (3.0, 7.2), 80, tmp_path)
    assert len(wanted) == 4
    numbers = [(one.period, abs(one.action)) for one in wanted]
    numbers = sorted([*numbers, numbers[0]])  # the loop, run the other way
    assert np.array([(one.period, abs(one.action)) for one in orbits]) == pytest.approx(np.array(numbers), abs=1e-10)
    assert {one.symmetry for one in orbits} == {"mirror", "brake", "brake+flip"}
    assert all(one.energy == pytest.approx(0.125, abs=1e-14) for one in orbits)


def test_lorenz_attractor_is_complete(tmp_path):
    """Every orbit of up to four letters, once each with its image, and no other, from the problem file's command."""
    book = tmp_path / "lorenz.sqlite"
    asked = ["search", str(ROOT / "problems/search/lorenz.toml"), "--starts", "60", "--workers", "0", "--atlas"]
    said = CliRunner().invoke(cli, [*asked, str(book)])
    assert said.exit_code == 0 and "any energy: 60 starts" in said.output, said.output
    with Atlas(book) as atlas:
        orbits = [atlas.orbit(row.id) for row in atlas.rows()]
    periods = sorted([*LORENZ.values(), LORENZ["LLR"], LORENZ["LLLR"]])
    assert sorted(one.period for one in orbits) == pytest.approx(periods, abs=2e-12)
    assert all(of.certify(one).passed and np.isnan(one.energy) for one in orbits)
    assert sorted(one.symmetry for one in orbits) == ["none"] * 4 + ["turn"] * 2
    listed = CliRunner().invoke(cli, ["atlas", "export", str(book), "--to", "json"])
    assert len(json.loads(listed.stdout)) == 6 if listed.stdout.startswith("[") else listed.exit_code == 0


def test_starts_lie_where_they_should():
    """On the level to round-off, in the fixed set of the reversal; on the attractor's box."""
    model, random = henon_heiles(), np.random.default_rng(1)
    level = Level.of(model, 0.125)
    assert np.abs(equilibria(model)).max() == pytest.approx(1.0, abs=1e-9) and len(equilibria(model)) == 4
    assert [of.energy(model, level.drawn(random)) for _ in range(8)] == pytest.approx([0.125] * 8, abs=1e-14)
    mirror = next(one for one in involutions(model) if one.name == "mirror")
    fixed = [level.fixed(mirror, random) for _ in range(4)]
    assert all(x[0] == x[3] == 0 and of.energy(model, x) == pytest.approx(0.125, abs=1e-14) for x in fixed)
    wings = Attractor.of(of.systems.lorenz(), 3.0)
    assert 20 < np.ptp(wings.states[:, 0]) < 45 and wings.states[:, 2].min() > 0


def test_every_start_is_its_number():
    """The same state and period from a context made anew: what resumed and sharded searches rest on."""
    for model, target in ((henon_heiles(), Target(0.125, (3.0, 16.0))), (of.systems.lorenz(), Target(0.0, (0.5, 3.0)))):
        one, other = context_of(model, target), context_of(model, target)
        for index in range(6):
            first, second = make_start(one, 3, index), make_start(other, 3, index)
            assert first.strategy == second.strategy and first.period == second.period
            assert np.array_equal(first.state, second.state)


def test_what_cannot_be_searched_is_said(tmp_path):
    """Energies where there are none, or none where there are, levels never met, motions that run away, clocks."""
    book = tmp_path / "atlas.sqlite"

    def asked(model, energy=None):
        of.search(model, energy, (1.0, 4.0), book, starts=1, workers=0)

    for model in (of.systems.lorenz(), of.systems.forced_duffing(**FORCED)):
        with pytest.raises(InputError, match="energy: this system conserves none; leave it out"):
            asked(model, 1.0)
    with pytest.raises(InputError, match="energy: missing"):
        asked(henon_heiles())
    with pytest.raises(InputError, match="no state of energy -1 is found"):
        asked(of.hamiltonian(lambda x, _: x.p**2 + x.q**2, ("q",), ("p",)), -1.0)
    with pytest.raises(InputError, match="no motion from a random state stays bounded"):
        asked(of.ode(lambda t, x, p: [x.x, x.y], ("x", "y")))
    forced = of.ode(lambda t, x, p: [x.y, -x.x + ca.cos(t)], ("x", "y"), forcing_period=2 * np.pi)
    with pytest.raises(
        InputError, match="search.period: no multiple of the forcing's period, 6.28319 s, is from 1 to 4"
    ):
        asked(forced)


def strobed(x, damping=0.1):
    """The state a forcing period later, by SciPy."""

    def field(t, y):
        return [y[1], 0.5 * np.cos(1.6 * t) - damping * y[1] - y[0] - y[0] ** 3]

    return solve_ivp(field, (0.0, 2 * np.pi / 1.6), x, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]


def test_all_responses_of_a_forced_oscillator(tmp_path):
    """Upper, lower, the unstable one between, as SciPy has the fixed points; resumed, nothing twice."""
    model, beat = of.systems.forced_duffing(**FORCED), 2 * np.pi / 1.6
    orbits = found(model, None, (0.9 * beat, 3.1 * beat), 36, tmp_path)
    fixed = {tuple(np.round(fsolve(lambda x: strobed(x) - x, one.state), 8)) for one in orbits}
    assert len(orbits) == len(fixed) == 3
    for one in orbits:
        assert one.period == pytest.approx(beat, rel=1e-14) and np.abs(strobed(one.state) - one.state).max() < 1e-9
    assert [one.stability for one in orbits].count("unstable") == 1
    assert len(found(model, None, (0.9 * beat, 3.1 * beat), 48, tmp_path)) == 3


def test_a_grid_of_parameters_is_searched_into_a_single_atlas(tmp_path):
    """Orbits carry their damping, alike in period they are not taken for each other; shards of the grid join to it."""
    model, beat, damping = of.systems.forced_duffing(**FORCED), 2 * np.pi / 1.6, [0.1, 0.2]
    asked = {"starts": 6, "workers": 0, "parameters": {"damping": damping}}
    whole, *parts = (tmp_path / f"{name}.sqlite" for name in ("whole", "1", "2"))
    done = of.search(model, None, (0.9 * beat, 1.1 * beat), whole, **asked)
    assert [tally.parameters for _, tally in done.tallies] == [{"damping": value} for value in damping]
    assert {each.parameters for each in done.summary.strata} == {'{"damping":0.1}', '{"damping":0.2}'}
    said = "\n".join(done.summary.remarks)
    assert (
        "symmetry at damping = 0.1 were sought by 6 starts" in said
        and "in no estimate: orbits away from what motions" in said
    )
    with of.Atlas(whole) as atlas:
        for row in atlas.rows():
            orbit, value = atlas.orbit(row.id), json.loads(row.parameters)["damping"]
            assert orbit.certificate.passed and of.certify(orbit).passed and f"damping{value:g}" in orbit.name
            assert np.abs(strobed(orbit.state, value) - orbit.state).max() < 1e-9
            atlas.forget()
            assert atlas.look_up(atlas.signature(row.id)) == row.id
            assert atlas.look_up(replace(atlas.signature(row.id), parameters="")) is None
        held = {value: sum(value in row.parameters for row in atlas.rows()) for value in ("0.1", "0.2")}
    assert min(held.values()) >= 1
    for k, part in enumerate(parts):
        of.search(model, None, (0.9 * beat, 1.1 * beat), part, shard=(k + 1, 2), **asked)
    assert of.merge_atlases(parts, tmp_path / "both.sqlite").orbits == sum(held.values())
    again = of.search(model, None, (0.9 * beat, 1.1 * beat), whole, **asked)
    assert [tally.done for _, tally in again.tallies] == [0, 0]
    with pytest.raises(InputError, match="parameters: unknown 'dampng', did you mean 'damping'"):
        of.search(model, None, (3.0, 5.0), whole, parameters={"dampng": 0.1})
    with pytest.raises(InputError, match="parameters.damping: must be different finite numbers"):
        of.search(model, None, (3.0, 5.0), whole, parameters={"damping": [0.1, 0.1]})
