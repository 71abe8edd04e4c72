"""Where equilibria come from and what leaves them: all of a box, normal modes; judged by Hamilton's equations."""

import json
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from conftest import verified

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError


def lorenz(rho):
    """sigma 10, beta 8/3."""
    return of.ode(
        lambda t, x, p: [10 * (x[1] - x[0]), x[0] * (p[0] - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]],
        ["x", "y", "z"], parameters={"rho": rho},
    )  # fmt: skip


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_all_of_a_box(unit):
    """Lorenz's three; sin(2 x) = 0.3 y, cos y = 0.2 x against a grid of starts, in units of the first component."""
    found = of.find_equilibria(lorenz(20.0), {"x": (-20, 20), "y": (-20, 20), "z": (0, 40)})
    root = (8 / 3 * 19) ** 0.5
    assert np.allclose([rest.state for rest in found], [[-root, -root, 19], [0, 0, 0], [root, root, 19]], atol=1e-12)
    assert all(rest.certified and rest.value == 20.0 for rest in found) and found[1].stability == "unstable"

    def waves(t, x, p):
        u = x[0] / unit
        return [unit * (ca.sin(2 * u) - p[0] * x[1]), ca.cos(x[1]) - 0.2 * u]

    model = of.ode(waves, ["x", "y"], parameters={"r": 0.3})
    found = of.find_equilibria(model, {"x": (-6 * unit, 6 * unit), "y": (-6, 6)})
    grid = np.array(np.meshgrid(np.linspace(-6, 6, 241), np.linspace(-6, 6, 241))).reshape(2, -1)
    for _ in range(60):
        x, y = grid
        rows = np.array([np.sin(2 * x) - 0.3 * y, np.cos(y) - 0.2 * x])
        a, b, c, d = 2 * np.cos(2 * x), -0.3, -0.2, -np.sin(y)
        with np.errstate(all="ignore"):
            grid = grid - np.array([d * rows[0] - b * rows[1], a * rows[1] - c * rows[0]]) / (a * d - b * c)
    inside = np.all(np.abs(grid) <= 6, axis=0) & np.all(np.abs(rows) < 1e-9, axis=0)
    distinct = np.unique(np.round(grid[:, inside], 6) + 0.0, axis=1)
    assert len(found) == distinct.shape[1] > 9
    assert np.allclose(sorted(rest.state[0] / unit for rest in found), np.sort(distinct[0]), atol=1e-6)
    assert all(rest.certified for rest in found)


def test_boxes_of_mechanics():
    """Every link of a chain hangs or stands; a symmetry's direction stays at the middle; bars under constraints."""
    chain, cart, dae = of.chain(3), of.systems.pendulum_on_cart(), of.chain_dae(2)
    found = of.find_equilibria(chain, dict.fromkeys(chain.state_names[:3], (-1.0, 4.0)))
    assert np.allclose([rest.state[:3] for rest in found], np.pi * np.array(list(np.ndindex(2, 2, 2))), atol=1e-12)
    assert [rest.stability for rest in found] == ["neutral"] + ["unstable"] * 7
    found = of.find_equilibria(cart, {"y": (-1.0, 4.0), "theta": (-1.0, 4.0)}, "gravity")
    assert np.allclose([rest.state[:2] for rest in found], [[1.5, 0.0], [1.5, np.pi]], atol=1e-12)
    box = {"x1": (0, 1), "y1": (-1, 1), "theta1": (-1, 1), "x2": (0, 2), "y2": (-1, 1), "theta2": (-1, 1)}
    (hanging,) = of.find_equilibria(dae, box, starts=5)
    assert hanging.stability == "neutral" and hanging.certified


def test_hamiltons_equations_judge_mechanics():
    """A wrong acceleration of a chain, whose energies are right, is seen; so is a wrong eigenvalue."""
    chain = of.chain(2)
    found = of.follow_equilibria(chain, np.zeros(4), "mass2", points=3)
    assert verified(found, chain).passed and all(point.certified for point in found.points)
    wrong = replace(found.points[0], eigenvalues=found.points[0].eigenvalues * (1 + 1e-5))
    assert verified(replace(found, points=(wrong, *found.points[1:])), chain).failures == ("eigenvalues",)
    sizes = {"t": 1, "q": 2, "v": 2, "p": len(chain.parameter_names)}
    t, q, v, p = (ca.SX.sym(name, size) for name, size in sizes.items())
    softer = ca.Function("softer", [t, q, v, p], [chain.acceleration(t, q, v, p) * (1 + 1e-4)])
    bent = of.follow_equilibria(replace(chain, acceleration=softer), np.zeros(4), "mass2", points=3)
    assert not any(point.certified for point in bent.points) and verified(bent, chain).failures == ("eigenvalues",)


def restricted():
    """L4 of Sun and Jupiter, nearly: both modes are stable."""
    model = of.systems.restricted_three_body(ratio=0.001)
    return model, [0.499, 3**0.5 / 2, 0.0, 0.0]


def wells():
    """Frequencies 2 and sqrt(2), as a first-order system."""

    def energy(x, p):
        return x[2] ** 2 / 2 + p[0] * x[0] ** 2 / 2 + x[0] ** 4 + x[3] ** 2 + x[1] ** 2 / 2

    return of.hamiltonian(energy, ["q1", "q2"], ["p1", "p2"], parameters={"k": 4.0}), [0.0] * 4


MODES = [
    ("chain", lambda: (of.chain(2), [0.0] * 4), "mass2"),
    ("three body", restricted, "ratio"),
    ("first order", wells, "k"),
]


@pytest.mark.parametrize("start, parameter", [case[1:] for case in MODES], ids=[case[0] for case in MODES])
def test_normal_modes_leave_an_undamped_equilibrium(start, parameter):
    """By the verb of Hopf points: periods near 2 pi / omega, slowest first, and closed."""
    model, state = start()
    found = of.follow_equilibria(model, state, parameter, points=2)
    frequencies = np.sort([value.imag for value in found.points[-1].eigenvalues if value.imag > 0])
    for mode, omega in enumerate(frequencies, 1):
        branch = of.switch_branch(found, "end", mode, model=model)
        assert branch.name == f"equilibria-end-{mode}" and branch.described()["kind_of_event"] == "mode"
        forward = of.FamilySettings(directions="forward", events=False)
        family = of.follow_family(branch, points=3, settings=forward, model=model)
        assert family.points[0].period == pytest.approx(2 * np.pi / omega, rel=2e-3)
        # As well as growth A lets any orbit close, by the turns of the fastest mode, in each of which round-off adds
        turned = family.points[0].period * frequencies[-1] / (2 * np.pi)
        assert family.points[0].closure < 1e-12 * turned * family.points[0].scale
    with pytest.raises(InputError, match=f"branch: 3 asked for, {frequencies.size} modes oscillate at the start"):
        of.switch_branch(found, "start", 3, model=model)


def test_no_modes_with_friction_and_messages_of_boxes():
    """Field, value, remedy."""
    found = of.follow_equilibria(of.systems.brusselator(rate=1.8), [1.0, 1.8], "rate", points=2)
    with pytest.raises(InputError, match="event: no energy is kept, so that nothing leaves the equilibrium at"):
        of.switch_branch(found, "start")
    model = lorenz(20.0)
    whole = {"x": (-20, 20), "y": (-20, 20), "z": (0, 40)}
    for box, more, message in (
        (whole | {"w": (0, 1)}, {}, "box: unknown 'w'.*; this system has x, y, z"),
        (whole | {"x": (1, 1)}, {}, r"box: x from \(1, 1\); give a number and a larger one"),
        (whole | {"x": (1,)}, {}, r"box: x from \(1,\); give a number and a larger one"),
        ({"x": (0, 1)}, {}, "box: y, z missing; say from where to where"),
        (whole, {"starts": 0}, "starts: must be at least 1, got 0"),
        (whole, {"parameter": "rh"}, "parameter: unknown 'rh'.* did you mean 'rho'"),
    ):
        with pytest.raises(InputError, match=message):
            of.find_equilibria(model, box, **more)
    with pytest.raises(InputError, match="model: depends on time, so that it has no equilibria"):
        of.find_equilibria(of.systems.forced_duffing(), {})


def test_the_command_follows_every_curve_of_a_box(tmp_path):
    """Lorenz's three, in files of their own; modes by --switch start; sentences for what is no box."""
    file = tmp_path / "own.toml"
    file.write_text('system = { kind = "python", function = "lorenz", arguments = { rho = 20.0 } }\n'
                    "search = { period = [1.0, 9.0] }\n")  # fmt: skip
    words = ["equilibria", str(file), "--parameter", "rho", "--until", "28", "-o", str(tmp_path / "out")]
    box = ["--box", "x=-20:20", "--box", "y=-20:20", "--box", "z=0:40"]
    done = CliRunner().invoke(cli, [*words, *box])
    assert done.exit_code == 0, done.output
    assert "3 equilibria were met in the box at rho = 20, which proves no completeness" in done.output
    done = CliRunner().invoke(cli, [*words, *box, "--json"])
    assert [result["name"] for result in json.loads(done.stdout)["results"]] == ["own", "own-2", "own-3"]
    for name in ("own", "own-2", "own-3"):
        assert of.load_equilibria(tmp_path / "out" / name / "equilibria.json").ends[-1].kind == "target"
    for given, message in (("x=-20", "--box: 'x=-20' is not NAME=LOW:HIGH"), ("x=0:1", "--box: y, z missing")):
        done = CliRunner().invoke(cli, [*words, "--box", given])
        assert done.exit_code == 2 and message in done.stderr
    far = ["--box", "x=30:31", "--box", "y=-31:-30", "--box", "z=90:91"]
    done = CliRunner().invoke(cli, [*words, *far])
    assert done.exit_code != 0 and "no equilibrium was met in the box; give a larger one" in done.stderr
    file.write_text('system = { kind = "chain", links = 2 }\nsimulate = { state = [0.0, 0.0, 0.0, 0.0] }\n')
    words = ["equilibria", str(file), "--parameter", "mass2", "--points", "2", "-o", str(tmp_path / "out")]
    assert CliRunner().invoke(cli, [*words, "--name", "hung"]).exit_code == 0
    words = ["continue", str(tmp_path / "out" / "hung" / "equilibria.json"), "--switch", "start", "--branch", "2"]
    more = ["--direction", "forward", "--points", "3", "--no-figures", "-o", str(tmp_path / "families")]
    assert CliRunner().invoke(cli, [*words, *more]).exit_code == 0
    family = of.load_family(tmp_path / "families" / "hung-start-2" / "family.json")
    assert family.source["event"] == "start" and family.source["branch"] == 2
