"""Manifolds of orbits against exact ones and published numbers; connections, and what must not be taken for one."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import brentq

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.structures import connections
from orbitfinder.structures.connections import (
    ReturnChain,
    certified_connection,
    certify_connection,
    connect,
    described,
    solved,
)
from orbitfinder.structures.manifold import free_file
from orbitfinder.structures.manifolds import ManifoldSettings, local_manifold, manifold, surface_of

LEVEL = 0.1
SEEN = {"plane": "y=0", "axes": ("x", "px")}
OTERMA = json.loads((Path(__file__).parent / "data" / "oterma.json").read_text())["entries"][0]["values"]
OTERMA = {name: float(OTERMA[name]) for name in ("L1_x", "L1_T", "L1_multiplier", "homoclinic_L1_interior_x")}
MU = 0.0009537
ENERGY = -(3.03 - MU * (1 - MU)) / 2
PLANE = {"plane": "y=0", "axes": ("x", "xdot")}


def wells(coupling):
    """Two wells in x, a spring in y. Without coupling the manifolds of the orbit x = 0 are px^2 = x^2 - x^4 / 2."""
    return of.hamiltonian(
        lambda x, c: (x.px**2 + x.py**2 - x.x**2) / 2 + x.x**4 / 4 + 2 * x.y**2 + c.coupling * x.x**2 * x.y,
        ("x", "y"), ("px", "py"), {"coupling": coupling},
    )  # fmt: skip


def over_the_saddle(coupling):
    guess = of.Guess([0, 0, 0, np.sqrt(2 * LEVEL)], np.pi)
    return of.find_orbit(of.Problem(wells(coupling), guess, pin=of.pin(energy=LEVEL), name="saddle"))


@pytest.fixture(scope="module")
def saddle():
    return over_the_saddle(0.0)


@pytest.fixture(scope="module")
def coupled():
    return over_the_saddle(0.05)


@pytest.fixture(scope="module")
def homoclinic(coupled):
    (found,) = connect(coupled, **SEEN, model=wells(0.05), most=1)
    return found


def lyapunov(x, period, sign, name):
    """A Lyapunov orbit of the Sun and Jupiter at Oterma's Jacobi constant, from two digits of each number."""
    model = of.systems.restricted_three_body(MU)
    ends = (0.0, 0.5 * sign)
    speed = brentq(lambda v: of.energy(model, np.array([x, 0, 0, v])) - ENERGY, min(ends), max(ends))
    guess = of.Guess([x, 0, 0, speed], period)
    return of.find_orbit(of.Problem(model, guess, pin=of.pin(energy=ENERGY), symmetry="mirror", name=name))


@pytest.fixture(scope="module")
def first():
    return lyapunov(0.921, 3.08, 1, "L1")


@pytest.mark.parametrize("which", ["unstable", "stable"])
def test_the_manifold_is_the_exact_one(saddle, which):
    """All points satisfy px^2 = x^2 - x^4 / 2, the multiplier is e^pi, and both sides are grown."""
    found = manifold(saddle, which, **SEEN, returns=1, model=wells(0.0), settings=ManifoldSettings(spacing=0.03))
    x, p = found.states[:, 0], found.states[:, 2]
    assert np.abs(p**2 - x**2 + x**4 / 2).max() < 1e-9
    assert found.multiplier == pytest.approx(np.exp(np.pi) ** (1 if which == "unstable" else -1), rel=1e-11)
    assert x.max() > 1.41 and x.min() < -1.41 and np.abs(found.states[:, 1]).max() < 1e-20
    slope = found.direction[2] / found.direction[0]
    assert slope == pytest.approx(1.0 if which == "unstable" else -1.0, abs=1e-12)
    assert max(np.linalg.norm(np.diff(curve[:, [0, 2]], axis=0), axis=1).max() for curve in found.curves) < 0.15


def test_published_numbers_of_oterma(first):
    """Orbit, multiplier, slopes on the section: the reference of another program, to 1e-8 and better."""
    assert first.state[0] == pytest.approx(OTERMA["L1_x"], abs=1e-12)
    assert first.period == pytest.approx(OTERMA["L1_T"], abs=1e-11)
    found = surface_of(first, None, direction=1, **PLANE)
    for which, sign in (("unstable", 1), ("stable", -1)):
        base = local_manifold(first, found, which)
        assert base.multiplier**sign == pytest.approx(OTERMA["L1_multiplier"], abs=1e-8)
        assert base.direction[2] / base.direction[0] == pytest.approx(sign * 2.5733012193647, abs=1e-11)


def chain_near(origin, goal, places, counts):
    """A guess of a connection from displacements known to a few digits."""
    forth = connections._returned(origin, places[0], counts[0])
    back = connections._returned(goal, places[1], counts[1])
    return ReturnChain(origin, goal, np.vstack([forth, back[-2::-1]]), places, counts[0])


def test_published_homoclinic_point(first, tmp_path):
    """x = -0.616041515588730 on the section, its mirror image, from a start with three digits."""
    found = surface_of(first, None, direction=-1, **PLANE)
    base = [local_manifold(first, found, which) for which in ("unstable", "stable")]
    guess = brentq(lambda s: connections._returned(base[0], s, 3)[-1, 2], -1.25e-7, -1.05e-7, xtol=1e-10)
    made = solved(chain_near(*base, (round(guess, 10), -round(guess, 10)), (3, 3)))
    known = certified_connection(described(made, "Oterma"), found.model)
    assert known.certificate.passed and known.kind == "homoclinic"
    assert known.state[0] == pytest.approx(OTERMA["homoclinic_L1_interior_x"], abs=1e-12)
    assert abs(known.state[2]) < 1e-12 and known.error < 1e-10 and known.angle > 0.05
    file = of.sections.save_connection(known, tmp_path / "connection.json")
    done = CliRunner().invoke(cli, ["verify", str(file)])
    assert done.exit_code == 0 and "(Oterma): certified" in done.output, done.output
    moved = known.states + 1e-6 * (np.arange(len(known.states)) == 2)[:, None]
    of.sections.save_connection(replace(known, states=moved), file)
    done = CliRunner().invoke(cli, ["verify", str(file)])
    assert done.exit_code == 1 and "REJECTED by" in done.output, done.output


@pytest.mark.slow
def test_published_heteroclinic_connection(first):
    """Wilczak and Zgliczynski's orbit from L1 to L2, found from the orbits alone and followed in energy."""
    second = lyapunov(1.082, 3.31, -1, "L2")
    assert second.state[0] == pytest.approx(1.081929486841799903, abs=1e-12)
    published = (0.967306682018305608, 0.003703230165036550462)
    (found,) = connect(first, second, direction=-1, near=published, most=1, **PLANE)
    assert found.certificate.passed and found.kind == "heteroclinic"
    np.testing.assert_allclose(found.state[[0, 2]], published, rtol=0, atol=1e-8)
    (known,) = connect(first, direction=-1, near=(-0.616, 0.0), most=1, **PLANE)
    assert known.state[0] == pytest.approx(OTERMA["homoclinic_L1_interior_x"], abs=1e-12)
    along = of.sections.follow_connection(found, first, [ENERGY + 2e-5, ENERGY + 4e-5], second)
    assert len(along) == 2 and all(one.certificate.passed for one in along)
    steps = [along[0].state[0] - found.state[0], along[1].state[0] - along[0].state[0]]
    assert 0 < steps[0] < steps[1] < 2 * steps[0]


def test_the_error_of_the_displacement_is_of_second_order(first):
    found = surface_of(first, None, direction=1, **PLANE)
    base = local_manifold(first, found, "unstable")
    errors = [base.error(place) for place in (4e-3, 2e-3, 1e-3)]
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 4.0, rtol=0.02)
    place, error, half = base.displacement(1e-9)
    assert error <= 1.5e-9 and 3.9 < error / half < 4.1 and base.error(10 * place) > 50 * error
    wrong = replace(base, direction=base.direction + 1e-3 * base.extents * np.array([0, 0, 1.0, 0]))
    with pytest.raises(ConvergenceError, match="not of second order"):
        wrong.displacement(1e-9)


def test_a_connection_is_found_certified_saved_and_certified_again(homoclinic, tmp_path, monkeypatch):
    known = homoclinic
    assert known.certificate.passed and known.error < 1e-11 and 0.01 < known.angle < 1.57
    ends = known.samples[[0, -1]]
    assert np.abs(ends[:, [0, 2]]).max() < 1e-2  # from the orbit, and back to it
    level = [of.energy(wells(0.05), state) for state in known.samples]
    assert np.ptp(level) < 1e-12
    again = of.sections.load_connection(of.sections.save_connection(known, tmp_path / "connection.json"))
    assert again.certificate.passed and again.kind == "homoclinic" and again.error == known.error
    np.testing.assert_array_equal(again.states, known.states)
    assert certify_connection(again, wells(0.05)).passed
    monkeypatch.setattr("orbitfinder.show.sections.save_png", lambda figure, path: figure)
    (axes,) = of.sections.draw_section(None, tmp_path / "x.png", connections=[again], model=wells(0.05)).axes
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()  # no crossing is outside, nor is round-off magnified
    assert ((again.states[:, [0, 2]] > [left, low]) & (again.states[:, [0, 2]] < [right, high])).all()
    assert right - left > 1e-3 and high - low > 1e-3
    said = CliRunner().invoke(
        cli, ["verify", str(tmp_path / "connection.json")]
    )  # wells are no file's: so far it comes
    assert said.exit_code == 2 and "cannot rebuild 'custom'" in said.output


def moved(known, k, by):
    states = known.states.copy()
    states[k] += by
    return replace(known, states=states)


@pytest.mark.parametrize(
    ("plant", "failing"),
    [
        (lambda c: moved(c, c.chosen, [1e-6, 0, 0, 0]), "gap"),  # a near miss
        (lambda c: moved(c, 0, [0, 0, 1e-6, 0]), "gap"),
        (lambda c: moved(c, -1, [1e-5, 0, 1e-5, 0]), "local"),  # it ends beside the stable manifold
        (lambda c: replace(c, origin=replace(c.origin, place=-c.origin.place)), "local"),
        (lambda c: replace(c, origin=replace(c.origin, point=np.add(c.origin.point, [1e-3, 0, 0, 0]))), "orbits"),
        (lambda c: replace(c, durations=c.durations * (1 + 1e-6)), "section"),
        (lambda c: replace(c, durations=c.durations * np.nan), "finite"),
    ],
)  # fmt: skip
def test_a_near_miss_is_no_connection(homoclinic, plant, failing):
    """What is 1e-6 off, at the point, at its start or at its end, is rejected, by name."""
    certificate = certify_connection(plant(homoclinic), wells(0.05))
    assert not certificate.passed and failing in certificate.failures


def test_an_orbit_of_another_energy_is_rejected(homoclinic, coupled):
    other = coupled.state * [1, 1, 1, 1 + 1e-6]
    tampered = replace(homoclinic, goal=replace(homoclinic.goal, state=other))
    assert "energy" in certify_connection(tampered, wells(0.05)).failures


def test_manifolds_that_coincide_do_not_cross(saddle, monkeypatch):
    """Without coupling they are one curve: no transversal point is claimed, whatever round-off makes of them."""
    tried, true = list[object](), connections.solved
    monkeypatch.setattr(connections, "TRIED", 3)
    monkeypatch.setattr(connections, "solved", lambda guess: tried.append(guess) or true(guess))
    settings = ManifoldSettings(spacing=0.2, turning=2.0)
    assert not connect(saddle, **SEEN, model=wells(0.0), most=5, settings=settings)
    assert len(tried) == 3  # however many are asked for


def test_a_connection_is_followed_in_energy(homoclinic, coupled):
    (found,) = of.sections.follow_connection(homoclinic, coupled, [LEVEL + 1e-3], model=wells(0.05))
    assert found.certificate.passed and found.energy == pytest.approx(LEVEL + 1e-3, abs=1e-12)
    assert 1e-6 < abs(found.state[0] - homoclinic.state[0]) < 1e-2


def test_connections_of_another_search_take_other_files(homoclinic, tmp_path):
    """They were numbered from 1 at each search, over those of the one before."""
    other = replace(homoclinic, states=homoclinic.states * 1.001)
    near = replace(homoclinic, states=homoclinic.states * (1 + 1e-13))
    names = []
    for each in (homoclinic, other, near, replace(homoclinic, plane="q=0")):
        names.append(free_file(tmp_path, each).name)
        of.sections.save_connection(each, tmp_path / names[-1])
    assert names == [f"connection-{k}.json" for k in (1, 2, 1, 3)]


@pytest.mark.slow
def test_it_goes_on_where_it_was_cut(homoclinic, coupled, tmp_path, monkeypatch):
    """The same file, bit for bit, and what the journal has is not solved again; nor is where it ends."""
    asked, right = [], connections._at_level
    levels = [LEVEL + 1e-3, LEVEL + 2e-3, LEVEL + 4e-3]

    def counted(known, refiners, level):
        asked.append(level)
        if level > LEVEL + 3e-3:
            raise ConvergenceError("planted")
        return right(known, refiners, level)

    def along(count=2):
        asked.clear()
        return of.sections.follow_connection(homoclinic, coupled, levels[:count], model=wells(0.05), out=tmp_path)

    monkeypatch.setattr(connections, "_at_level", counted)
    whole, journal = along(), tmp_path / homoclinic.name / "connection.jsonl"
    written = journal.read_bytes()
    assert len(whole) == 2 and asked == levels[:2] and len(written.splitlines()) == 3
    journal.write_bytes(written[:-100])
    again = along()
    assert asked == levels[1:2] and journal.read_bytes() == written
    for one, other in zip(whole, again, strict=True):
        files = [of.sections.save_connection(each, tmp_path / "c.json").read_bytes() for each in (one, other)]
        assert files[0] == files[1] and np.array_equal(one.samples, other.samples)
    assert len(along(3)) == 2 and asked[0] == levels[2] and journal.read_bytes().startswith(written)
    assert len(along(3)) == 2 and not asked
    with pytest.raises(InputError, match="orbit: of another system"):
        of.sections.follow_connection(replace(homoclinic, system={}), coupled, levels, model=wells(0.05))


def test_a_tube_leaves_the_orbit_and_keeps_its_energy(saddle, tmp_path):
    found = manifold(saddle, **SEEN, tube=4.0, side=1, model=wells(0.0), settings=ManifoldSettings(spacing=0.05))
    x, p = found.states[:, 0], found.states[:, 2]
    assert found.kind == "tube" and np.abs(p**2 - x**2 + x**4 / 2).max() < 1e-8
    starts = np.array([curve[0] for curve in found.curves])
    assert (starts[:, 0] > 0).all() and np.ptp(starts[:, 1]) > 0.4  # on one side, all around the orbit
    picture = of.sections.draw_manifolds([found], tmp_path / "tube.png", orbits=[saddle], model=wells(0.0))
    assert picture.stat().st_size > 20_000
    again = of.sections.load_manifold(of.sections.save_manifold(found, tmp_path / "tube.json"))
    np.testing.assert_array_equal(again.states, found.states)
    assert again.multiplier == found.multiplier and len(again.curves) == len(found.curves)
    assert (tmp_path / "tube.csv").read_text().startswith("curve,return,time,displacement,x,y,px,py\n0,-1,0.0,")
    with pytest.raises(InputError, match="is a tube"):
        of.sections.draw_section(None, tmp_path / "x.png", manifolds=[found], model=wells(0.0))


def test_orbits_without_a_manifold_say_why(saddle, first):
    model = of.chain(2)
    guess = of.guesses.normal_mode(model, 1, 0.05)
    stable = of.find_orbit(of.Problem(model, guess, pin=of.pin(energy=of.energy(model, guess.state))))
    with pytest.raises(InputError, match="no unstable manifold, no multiplier is off the unit circle"):
        manifold(stable, plane="theta1=0")
    with pytest.raises(InputError, match="which: must be unstable or stable"):
        manifold(saddle, "both", **SEEN, model=wells(0.0))
    with pytest.raises(InputError, match="1 multiplier that grow"):
        manifold(saddle, number=1, **SEEN, model=wells(0.0))
    with pytest.raises(InputError, match="does not cross"):
        manifold(first, plane="y=2", axes=("x", "xdot"))
    with pytest.raises(InputError, match="side: must be"):
        manifold(saddle, side=3, **SEEN, model=wells(0.0))
    with pytest.raises(InputError, match="other: its energy"):
        connect(saddle, replace(saddle, state=saddle.state * 1.1), **SEEN, model=wells(0.0))
    with pytest.raises(InputError, match="hybrid"):
        manifold(replace(saddle, system={}), model=of.systems.simplest_walker())
    with pytest.raises(InputError, match="constraints are not grown"):
        manifold(saddle, model=of.chain_dae(2))


def test_a_complex_multiplier_has_no_single_direction():
    """A quartet of multipliers off the unit circle and off the real axis."""
    from orbitfinder.structures.manifolds import _eigenpair

    turn = 1.5 * np.array([[0.6, -0.8], [0.8, 0.6]])
    matrix = np.block([[turn, np.zeros((2, 2))], [np.zeros((2, 2)), np.linalg.inv(turn).T]])
    forced = of.ode(lambda t, x, p: (x.a, x.b, x.c, x.d), list("abcd"), forcing_period=1.0)
    with pytest.raises(InputError, match="is complex, its manifold winds"):
        _eigenpair(forced, np.zeros(4), np.zeros(4), matrix, "unstable", 0)


def test_the_commands_grow_connect_and_draw(first, tmp_path):
    """manifold writes JSON, npz, csv and a picture; what cannot be grown is exit code 2 and a sentence."""
    file = of.save_orbit(first, tmp_path / "L1" / "orbit.json")
    asked = [
        "manifold",
        file,
        "--which",
        "unstable",
        "--plane",
        "y=0",
        "--returns",
        "0",
        "-o",
        tmp_path / "m",
        "--json",
    ]
    done = CliRunner().invoke(cli, list(map(str, asked)))
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert told["manifolds"][0]["multiplier"] == pytest.approx(OTERMA["L1_multiplier"], abs=1e-8)
    assert all(Path(one).exists() for one in told["written"]) and len(told["written"]) == 2
    bad = CliRunner().invoke(cli, ["manifold", str(file), "--plane", "q=0", "-o", str(tmp_path)])
    assert bad.exit_code == 2 and "--plane: unknown component 'q'" in bad.output
    bad = CliRunner().invoke(cli, ["connect", str(file), "--near", "1", "--plane", "y=0", "-o", str(tmp_path)])
    assert bad.exit_code == 2 and "--near: need two numbers" in bad.output
    bad = CliRunner().invoke(cli, ["connect", str(file), "--at", "-1.5", "-o", str(tmp_path)])
    assert bad.exit_code == 2 and "--at: goes with --follow" in bad.output
