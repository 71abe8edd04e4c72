"""Poincare sections: crossings located to round-off, none stepped over, at the energy asked for; records, pictures."""

import json
from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.special import ellipk

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.integrate.cvodes import build_flow, sample
from orbitfinder.integrate.dop853 import integrate
from orbitfinder.integrate.equations import accelerations
from orbitfinder.integrate.field import vector_field as second
from orbitfinder.mechanics.model import vector_field
from orbitfinder.show.sections import _limits
from orbitfinder.structures.crossings import FINE, Crossings, Plane
from orbitfinder.structures.frequencies import frequency_table
from orbitfinder.structures.sections import section, surface


def oscillator():
    """x'' = -x."""
    return of.ode(lambda t, x, p: (x.v, -x.x), ("x", "v"))


def crossings(model, unit=1.0):
    return Crossings(vector_field(model), np.full(len(model.state_names), unit))


def passing(model, plane, states, count, **more):
    return crossings(model).passing(plane, np.atleast_2d(states), count, **{"longest": 50.0, **more})


@pytest.mark.parametrize(("direction", "first", "step"), [(1, 1.5, 2.0), (-1, 0.5, 2.0), (0, 0.5, 1.0)])
def test_crossings_of_an_oscillator_are_exact(direction, first, step):
    """cos t passes 0 at pi / 2, falling, and at 3 pi / 2, growing."""
    found = passing(oscillator(), Plane(0, 0.0, direction), [1.0, 0.0], 4)
    np.testing.assert_allclose(found.times[0], np.pi * (first + step * np.arange(4)), rtol=3e-14)
    assert not found.states[0, :, 0].any() and np.abs(np.abs(found.states[0, :, 1]) - 1).max() < 3e-13


def test_backwards_the_same_crossings_come_in_the_other_order():
    """A motion that begins on the plane does not count that; the direction is that of the motion forwards."""
    model = oscillator()
    there = passing(model, Plane(0, 0.0, 1), [1.0, 0.0], 3)
    back = passing(model, Plane(0, 0.0, 1), there.states[0, -1], 2, sense=-1, times=there.times[0, -1])
    np.testing.assert_allclose(back.times[0], there.times[0, 1::-1], rtol=1e-13)


@pytest.mark.parametrize("depth", [1e-3, 1e-6, 1e-9])
def test_a_pair_of_crossings_within_a_step_is_not_stepped_over(depth):
    """The top of cos t is above 1 - depth for 2 acos(1 - depth), down to a ten thousandth of a radian."""
    found = passing(oscillator(), Plane(0, 1.0 - depth, 0), [-1.0, 0.0], 2)
    half = np.arccos(1.0 - depth)
    np.testing.assert_allclose(found.times[0], [np.pi - half, np.pi + half], rtol=0, atol=3e-13 / half)


def test_a_plane_that_is_missed_is_not_crossed():
    assert np.isnan(passing(oscillator(), Plane(0, 1.0 + 1e-9, 0), [-1.0, 0.0], 1).times).all()


def test_many_motions_are_those_of_each_alone():
    """Motions with steps of their own, some of which end in a singularity, do not feel each other."""
    model = of.ode(lambda t, x, p: (x.v, -1 / x.x**2), ("x", "v"))  # falls into 0 in a finite time
    starts = np.array([[1.0, 0.0], [1.0, 1.0], [2.0, 0.5]])
    together = passing(model, Plane(0, 0.5, -1), starts, 1)
    for k, start in enumerate(starts):
        np.testing.assert_array_equal(passing(model, Plane(0, 0.5, -1), start, 1).times[0], together.times[k])
    assert np.isnan(passing(model, Plane(0, 0.5, 1), starts, 1).times).all()  # no motion leaves the singularity


def test_an_angle_is_crossed_every_turn():
    """A pendulum that turns over passes theta = 0 once a turn, at times of an integration by another program."""
    model, start = of.chain(1), np.array([0.5, 9.0])
    found = passing(model, Plane(0, 0.0, 1, 2 * np.pi), start, 3)
    there = integrate(second(accelerations(model)), start, np.append(0.0, found.times[0]))
    np.testing.assert_allclose(there[1:, 0], 2 * np.pi * np.arange(1, 4), rtol=3e-13)
    np.testing.assert_allclose(there[1:], found.states[0], rtol=3e-12)


def test_a_forced_system_is_seen_once_a_period():
    model = of.systems.forced_duffing()
    period = float(model.forcing_period(model.parameter_values))
    done = list[tuple[int, int]]()
    made = section(model, seeds=3, returns=4, progress=lambda *counts: done.append(counts))
    assert done == sorted(done) and done[0][0] < done[-1][0] and set(done[-1]) == {12} == {whole for _, whole in done}
    first = made.starts[0]
    wanted = sample(build_flow(model), first, 4 * period, 5)[1:]
    np.testing.assert_allclose(made.states[made.seeds == 0], wanted, atol=3e-8)
    assert np.isnan(made.energy) and made.plane.startswith("t = k P")


@pytest.fixture(scope="module")
def henon_heiles():
    return section(of.systems.henon_heiles(), 0.125, plane="x=0", axes=("y", "ydot"), seeds=24, returns=120)


def test_returns_have_the_energy_and_lie_on_the_plane(henon_heiles):
    """All returns of all motions, which begin at the energy to round-off."""
    made, model = henon_heiles, of.systems.henon_heiles()
    level = [of.energy(model, state) for state in (*made.starts, *made.states[::50])]
    assert np.abs(np.array(level[:24]) - 0.125).max() < 1e-14 and np.abs(np.array(level) - 0.125).max() < 1e-8
    assert made.returns == 24 * 120 and not made.states[:, 0].any() and (made.states[:, 2] > 0).all()
    low, high = made.points.min(axis=0), made.points.max(axis=0)
    assert low[0] > -0.5 and high[0] < 0.7 and np.abs(made.points[:, 1]).max() < 0.5  # all over what the energy allows
    assert high[0] - low[0] > 1.0 and high[1] - low[1] > 0.9


def test_chaos_and_order_are_told_apart(henon_heiles):
    """At 1/8 Henon and Heiles found islands in a sea; at 1/100 every motion is regular."""
    made = henon_heiles
    assert 4 <= made.regular.sum() <= 20
    assert (made.kinds == "chaotic").sum() >= 3 and made.told
    means = np.array([made.megno(k)[-1] for k in range(24)])
    assert means[made.regular].max() < 2.5 < 3.5 < means[made.kinds == "chaotic"].min()
    calm = section(of.systems.henon_heiles(), 0.01, plane="x=0", seeds=6, returns=60)
    assert calm.regular.all()


def test_laws_of_growth_are_told_apart_and_what_is_neither_is_undecided(henon_heiles):
    """As n, <Y> = 2; as exp(n / 4), n / 8; between them neither; few returns and old files say nothing."""
    n = np.arange(1, 121.0)
    laws = [np.log(n), n / 4, 0.55 * np.sqrt(n), 0 * n]
    made = replace(henon_heiles, growth=np.concatenate([laws[k % 4] for k in range(24)]))
    assert list(made.kinds[:4]) == ["regular", "chaotic", "undecided", "regular"]
    assert made.megno(0)[-1] == pytest.approx(2.0, abs=0.02) and made.megno(1)[-1] == pytest.approx(15, rel=0.03)
    few = section(of.systems.henon_heiles(), 0.01, plane="x=0", seeds=2, returns=10)
    old = replace(made, growth=np.full(24, 3.0))
    assert set(few.kinds) == {"undecided"} == set(old.kinds) and few.told and not old.told


def test_growth_of_a_deviation_is_that_of_a_neighbour(henon_heiles):
    """What two motions 1e-7 apart part by within a few returns, by another program."""
    model, first = of.systems.henon_heiles(), int(np.flatnonzero(henon_heiles.regular)[0])
    mine = henon_heiles.seeds == first
    cut = surface(model, "x=0", ("y", "ydot"), levels={"energy": 0.125})
    start = henon_heiles.starts[first]
    rates = cut.motions.rates(np.zeros(1), start[None])[0] / cut.units
    both = start + np.outer([1.0, -1.0], 1e-6 * cut.units * (0.5 - rates * 0.5 / rates[0]))
    ends = cut.passing(both, 5, tolerance=FINE).states
    parted = np.linalg.norm((ends[0] - ends[1]) / cut.units, axis=1) / 2e-6
    np.testing.assert_allclose(henon_heiles.growth[mine][:5], np.log(parted), atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("returns", [300, 1000])
def test_the_double_pendulum_at_minus_14(returns):
    """35 of the 40 motions lie on curves and island chains at both lengths, the other five in the sea."""
    made = section(of.load_problem("problems/examples/double-mode-2.toml"), -14, plane="theta1=0", returns=returns)
    assert [int((made.kinds == kind).sum()) for kind in ("regular", "chaotic", "undecided")] == [35, 5, 0]


@pytest.mark.slow
def test_henon_heiles_and_what_it_is_the_beginning_of():
    """At 1/12 nearly all is regular, at 1/6 nearly all chaotic (Henon and Heiles 1964); Toda's lattice, of which it is
    the third-order part, is integrable at any energy (Henon 1974)."""
    asked = {"plane": "x=0", "axes": ("y", "ydot"), "seeds": 30, "returns": 300}
    calm, wild = (section(of.systems.henon_heiles(), energy, **asked) for energy in (1 / 12, 1 / 6 - 1e-9))
    assert calm.regular.sum() >= 29 and (wild.kinds == "chaotic").sum() >= 26
    toda = of.hamiltonian(
        lambda x, c: (x.p**2 + x.r**2) / 2 - 1 / 8
        + (ca.exp(2 * x.x + 12**0.5 * x.y) + ca.exp(2 * x.x - 12**0.5 * x.y) + ca.exp(-4 * x.x)) / 24,
        ("x", "y"), ("p", "r"),
    )  # fmt: skip
    assert section(toda, 1.0, plane="y=0", axes=("x", "p"), seeds=30, returns=300).regular.all()


def test_a_section_of_the_rates_of_a_first_order_system():
    """Lorenz's attractor on z = 27: no energy, transients left out, and the mirror (x, y) -> (-x, -y) seen."""
    made = section(of.systems.lorenz(), plane="z=27", axes=("x", "y"), direction=-1, seeds=4, returns=60)
    assert made.returns == 4 * 40 and np.isnan(made.energy) and (made.states[:, 2] == 27).all()
    assert made.points[:, 0].min() < -2 and made.points[:, 0].max() > 2


def test_a_hybrid_system_is_seen_after_its_own_events():
    """A ball that loses half its speed on a table at rest: every return is at height 0, half as fast as the last."""
    model = of.systems.bouncing_ball(amplitude=0.0, frequency=1.0, gravity=10.0, restitution=0.5)
    height, speed = model.state_names[:2]
    done = list[tuple[int, int]]()
    made = section(model, seeds=2, returns=3, ranges={height: (1.0, 1.1), speed: (0.0, 0.1)},
                   progress=lambda *counts: done.append(counts))  # fmt: skip
    assert done == [(3, 6), (6, 6)]
    speeds = np.abs(made.states[made.seeds == 0][:, 1])
    np.testing.assert_allclose(speeds[1:] / speeds[:-1], 0.5, rtol=1e-8)


@pytest.fixture(scope="module")
def swing():
    """A stable orbit of the double pendulum: its second mode, small."""
    model = of.chain(2)
    guess = of.guesses.normal_mode(model, 2, 0.05)
    return of.find_orbit(of.Problem(model, guess, pin=of.pin(energy=of.energy(model, guess.state)), name="swing"))


def test_an_orbit_is_drawn_where_it_crosses(swing, tmp_path):
    """Its crossing is its own: a motion from there comes back to it after the period."""
    from orbitfinder.structures.sections import level_of, pierced

    model = of.chain(2)
    found = surface(model, "theta1=0", levels=level_of(model, swing.energy, None))
    crossing = pierced(found, swing)
    assert len(crossing.states) == 1
    again = found.passing(crossing.states, 1, tolerance=FINE)
    np.testing.assert_allclose(again.states[0, 0], crossing.states[0], atol=1e-11)
    np.testing.assert_allclose(again.times[0, 0], swing.period, rtol=1e-11)
    made = section(swing, plane="theta1=0", seeds=6, returns=40)
    assert made.energy == swing.energy
    picture = of.sections.draw_section(made, tmp_path / "section.png", orbits=[swing])
    assert picture.stat().st_size > 20_000


def test_sections_are_saved_and_loaded(henon_heiles, tmp_path):
    path = of.sections.save_section(henon_heiles, tmp_path / "section.json")
    again = of.sections.load_section(path)
    for name in ("states", "times", "seeds", "starts", "growth"):
        np.testing.assert_array_equal(getattr(again, name), getattr(henon_heiles, name))
    assert again.plane == henon_heiles.plane and again.axes == henon_heiles.axes and again.energy == 0.125
    path.write_text(path.read_text().replace("orbitfinder/section", "orbitfinder/other"))
    with pytest.raises(InputError, match="format: expected 'orbitfinder/section'.*got 'orbitfinder/other'"):
        of.sections.load_section(path)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"plane": "z=0"}, "plane: unknown component 'z'"),
        ({"plane": "x"}, "is no plane; give a component and a number"),
        ({"plane": "x=up"}, "is no plane"),
        ({"plane": "x=0", "axes": ("x", "ydot")}, "the same all over its own plane"),
        ({"plane": "x=0", "axes": ("y",)}, "need two different components"),
        ({"plane": "x=0", "axes": ("y", "yd")}, "did you mean 'ydot'"),
        ({"plane": "x=0", "direction": 2}, "direction: must be 1"),
        ({"plane": "x=0", "seeds": 0}, "seeds: must be between"),
        ({"plane": "x=0", "returns": 0}, "returns: must be between"),
        ({"plane": "x=0", "ranges": {"z": (0, 1)}}, "ranges: 'z' is no axis"),
        ({"plane": "x=0", "ranges": {"y": (1, 0)}}, "two growing numbers"),
        ({"plane": "x=0", "energy": None}, "energy: missing"),
        ({"plane": "x=0", "energy": float("nan")}, "energy: must be finite"),
        pytest.param(
            {"plane": "x=0", "energy": 5.0},
            "ranges: missing; motions of this energy are not bounded",
            marks=pytest.mark.slow,
        ),
        ({"plane": "x=3", "energy": 0.1, "ranges": {"y": (-0.1, 0.1), "ydot": (5, 6)}}, "no motion of this energy"),
    ],
)
def test_what_is_wrong_is_named(asked, said):
    with pytest.raises(InputError, match=said):
        section(of.systems.henon_heiles(), **{"energy": 0.1, "seeds": 2, "returns": 2, **asked})


def test_systems_without_a_section_or_an_energy_say_so():
    with pytest.raises(InputError, match="conserves none"):
        section(of.systems.lorenz(), 1.0, plane="z=27")
    with pytest.raises(InputError, match="leave the plane out"):
        section(of.systems.forced_duffing(), plane="x=0")
    with pytest.raises(InputError, match="under constraints"):
        section(of.chain_dae(2), -10.0)


@pytest.mark.slow
def test_the_command_draws_and_tells(tmp_path):
    """From a problem file, with the numbers as JSON; a bad plane is exit code 2."""
    file = "problems/examples/double-mode-2.toml"
    few = ["--seeds", "5", "--returns", "20", "-o", tmp_path]
    asked = ["section", file, "--energy", "-14", "--plane", "theta1=0", *few]
    done = CliRunner().invoke(cli, [*map(str, asked), "--frequencies", "100", "--json"])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert len(told["diffusion"]) == 5 and (tmp_path / "double-mode-2" / "frequencies.csv").exists()
    assert told["returns"] == 100 and told["energy"] == -14 and (tmp_path / "double-mode-2" / "section.png").exists()
    bad = CliRunner().invoke(cli, [*map(str, asked[:5]), "theta9=0"])
    assert bad.exit_code == 2 and "--plane: unknown component 'theta9', did you mean" in bad.output
    bad = CliRunner().invoke(cli, [*map(str, asked), "--range", "theta2"])
    assert bad.exit_code == 2 and "names no range" in bad.output


def test_a_field_with_parameters_of_matrices_is_stepped_too():
    """Long expressions are called and not written out: the same crossings."""
    x = ca.MX.sym("x", 2)
    field = ca.Function("f", [ca.MX.sym("t"), x, ca.MX.sym("s", 0), ca.MX.sym("p", 0)], [ca.vertcat(x[1], -x[0])])
    found = Crossings(field, np.ones(2)).passing(Plane(0, 0.0, 1), np.array([[1.0, 0.0]]), 1, longest=50.0)
    assert found.times[0, 0] == pytest.approx(1.5 * np.pi, rel=1e-13)


def test_frequencies_of_two_pendulums_are_exact(tmp_path):
    """Uncoupled, swinging and going round: pi w / 2 K(sin(a/2)) and pi v / 2 K(2 w / v), in both halves."""
    model = of.hamiltonian(
        lambda x, c: (x.p**2 + x.r**2) / 2 - ca.cos(x.a) - 2 * ca.cos(x.b), ("a", "b"), ("p", "r"), angles=("a", "b")
    )
    starts = [[0.5, 1.0, 0, 0], [1.5, 0.3, 0, 0], [0, 0.4, 2.5, 0]]
    found = of.frequency_map(model, starts, 300.0)

    def swinging(w, a):
        return np.pi * w / (2 * ellipk(np.sin(a / 2) ** 2))

    first = [swinging(1, 0.5), swinging(1, 1.5), np.pi * 2.5 / (2 * ellipk((2 / 2.5) ** 2))]
    second = [swinging(2**0.5, one[1]) for one in starts]
    for half in (found.frequencies, found.later):
        np.testing.assert_allclose(half, np.column_stack([first, second]), rtol=0, atol=1e-9)
    assert found.diffusion.max() < 1e-9
    rows = frequency_table(found, model).splitlines()
    assert rows[0] == "a,b,p,r,w1,w2,w1_later,w2_later,diffusion" and len(rows) == 4
    assert of.sections.draw_frequencies(found, model, tmp_path / "map.png").stat().st_size > 10_000
    with pytest.raises(InputError, match="axes: unknown component 'q'"):
        of.sections.draw_frequencies(found, model, tmp_path / "map.png", axes=("q", "a"))


@pytest.mark.slow
def test_chaos_diffuses_and_what_leaves_has_no_frequencies(henon_heiles):
    """At 1/8 the frequencies of chaotic motions change a hundred times more than those of the calmest islands."""
    model, made = of.systems.henon_heiles(), henon_heiles
    chosen = np.concatenate([np.flatnonzero(made.regular)[:3], np.flatnonzero(~made.regular)[:3]])
    starts = np.vstack([made.starts[chosen], [0.0, 1.2, 0.0, 0.5]])  # the last leaves
    found = of.frequency_map(model, starts, 500.0)
    assert found.diffusion[3:6].min() > 1e-4 and found.diffusion[:3].min() < 0.01 * found.diffusion[3:6].min()
    assert np.isnan(found.frequencies[6]).all() and np.isnan(found.diffusion[6])


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (([[0.1, 0.1, 0, 0]], -1.0), "duration: must be positive, got -1.0"),
        (([[0.1, 0.1, 0, 0]], 50.0), "duration: 50 is too short, half of it is .* turns of one of the motions; give"),
        (([[0.0, 1.2, 0.0, 0.5]], 500.0), "starts: all motions leave"),
        (([[0.1, 0.1]], 500.0), "states: shape"),
    ],
)
def test_frequencies_that_cannot_be_had_say_why(asked, said):
    with pytest.raises(InputError, match=said):
        of.frequency_map(of.systems.henon_heiles(), *asked)


def test_systems_without_frequencies_say_so():
    with pytest.raises(InputError, match="take the minimal model of this one"):
        of.frequency_map(of.chain_dae(2), np.zeros((1, 8)), 100.0)
    with pytest.raises(InputError, match="hybrid systems jump"):
        of.frequency_map(of.systems.bouncing_ball(), np.zeros((1, 2)), 100.0)


def test_a_section_has_a_page_of_its_own(swing, tmp_path):
    """Points, motions that a click shows, the orbit among them; a record of another plane is refused."""
    from orbitfinder.site.build import SiteSettings, build_site
    from orbitfinder.site.gather import gather
    from orbitfinder.site.section import section_data

    made = section(swing, plane="theta1=0", seeds=4, returns=12)
    files = [of.sections.save_section(made, tmp_path / "section.json"), of.save_orbit(swing, tmp_path / "orbit.json")]
    found = gather(files)
    data = section_data(found.sections[0], found)
    assert [one["kind"] for one in data["items"][-1:]] == ["orbit"] and len(data["items"]) == 5
    assert data["axes"] == ["θ<sub>2</sub> (rad)", "rate of θ<sub>2</sub> (rad/s)"]
    np.testing.assert_allclose(data["items"][1]["x"], made.points[made.seeds == 1][:, 0], rtol=1e-5)
    assert all(one["motion"]["count"] == 480 for one in data["items"])
    site, _ = build_site(found, SiteSettings("sections", verify=False))
    page = next(text.decode() for name, text in site.files.items() if name.startswith("sections/"))
    assert "4 motions" in page and "theta1 = 0, growing" in page and "assets/section.js" in page
    assert 'href="sections/' in site.files["index.html"].decode()
    done = CliRunner().invoke(cli, ["page", *map(str, files), "-o", str(tmp_path / "site")])
    assert done.exit_code == 0, done.output
    assert list((tmp_path / "site" / "sections").glob("*.html"))


@pytest.mark.parametrize("place", [0.0, 3.0, 1e17, -1e300])
def test_a_single_place_has_room_around_it(place):
    """Limits that are equal to round-off were a warning of Matplotlib's: a unit is none beside 1e17."""
    axes, points = plt.figure().add_subplot(), np.array([place, 0.0])
    _limits(axes, of.chain(1), ("theta1dot", "theta1"), None, [SimpleNamespace(reach=lambda _: (points, points))], [])
    low, high = axes.get_xlim()
    assert low < place < high
    plt.close(axes.figure)
