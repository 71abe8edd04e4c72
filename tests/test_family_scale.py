"""Families in the scale of their motion: switching, small orbits, units, and ends that are what they say."""

import json

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import brentq

from orbitfinder.cli.group import cli
from orbitfinder.families.branches import branches
from orbitfinder.families.folder import follow_family
from orbitfinder.families.point import FamilySettings
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.orbits.find import find_orbit
from orbitfinder.records.family import load_family
from orbitfinder.records.orbit import save_orbit

SYSTEM = '''
import casadi as ca
import orbitfinder as of


def three_body(mu=0.04):
    """The spatial restricted three-body problem in its rotating frame."""
    q, v = ca.SX.sym("q", 3), ca.SX.sym("v", 3)
    x, y, z = q[0], q[1], q[2]
    kinetic = ((v[0] - y) ** 2 + (v[1] + x) ** 2 + v[2] ** 2) / 2
    potential = -(1 - mu) / ca.sqrt((x + mu) ** 2 + y**2 + z**2) - mu / ca.sqrt((x - 1 + mu) ** 2 + y**2 + z**2)
    system = {"kind": "python", "module": "restricted", "function": "three_body", "arguments": {"mu": mu}}
    return of.lagrange(kinetic, potential, of.Symbols(q, v), names=["x", "y", "z"], system=system)
'''
HALO = 3.32914982648407, 2 * 1.300183082193319815123
"""Jacobi constant and period of Howell's first L1 halo orbit at mu = 0.04 (140-bit Taylor integration)."""


@pytest.fixture(scope="module")
def three_body(tmp_path_factory):
    """The model, its small Lyapunov orbit about L1 in an orbit.json beside the module, and the folder."""
    folder = tmp_path_factory.mktemp("restricted")
    (folder / "restricted.py").write_text(SYSTEM, encoding="utf-8")
    names: dict = {}
    exec(SYSTEM, names)
    model, mu = names["three_body"](), 0.04
    near = brentq(lambda x: x - (1 - mu) / (x + mu) ** 2 + mu / (1 - mu - x) ** 2, 0.5, 0.9)
    pull = (1 - mu) / (near + mu) ** 3 + mu / (1 - mu - near) ** 3
    rate = np.sqrt((2 - pull + np.sqrt(9 * pull**2 - 8 * pull)) / 2)
    ratio = (rate**2 + 1 + 2 * pull) / (2 * rate)
    start = [near + 3e-4, 0.0, 0.0, 0.0, -ratio * rate * 3e-4, 0.0]
    problem = Problem(model, Guess(start, 2 * np.pi / rate), pin(x=start[0]), name="lyapunov")
    save_orbit(find_orbit(problem), folder / "orbit.json")
    return model, folder


def lyapunov(three_body, out, points=25):
    """The planar family from an orbit of size 6e-4 on."""
    model, folder = three_body
    settings = FamilySettings(directions="forward")
    return follow_family(folder / "orbit.json", points=points, out=out, settings=settings, model=model)


def test_halo_orbits_are_switched_to(three_body, tmp_path):
    """The Lyapunov family's first branch point leads to the halo family, once; Howell's orbit is on it."""
    family = lyapunov(three_body, tmp_path)
    assert family.events[0].kind == "branch_point" and family.events[0].certified in (True, False)
    (halo,) = branches(tmp_path / "lyapunov" / "family.json", 0, model=three_body[0])
    settings = FamilySettings(directions="away")
    energy, period = -HALO[0] / 2, HALO[1]
    found = follow_family(halo, at=(energy,), points=40, out=tmp_path, settings=settings)
    (asked,) = (one for one in found.points if one.role == "at")
    assert asked.certified and abs(asked.period - period) < 1e-11 * period
    assert len(found.points) > 10 and max(abs(one.state[2]) for one in found.points) > 0.02


def test_halo_orbits_by_command(three_body, tmp_path, monkeypatch):
    """The same by `continue` twice, from files and a module that is trusted."""
    monkeypatch.chdir(three_body[1])
    options = ("--trust", "--no-figures", "--out", str(tmp_path))
    planar = CliRunner().invoke(cli, ["continue", "orbit.json", "--points", "25", "--direction", "forward", *options])
    assert planar.exit_code == 0 and "closed orbits, " in planar.output, planar.output
    file = str(tmp_path / "lyapunov" / "family.json")
    options += ("--points", "8", "--at", str(-HALO[0] / 2))
    halo = CliRunner().invoke(cli, ["continue", file, "--switch", "0", *options])
    assert halo.exit_code == 0, halo.output
    found = load_family(tmp_path / "lyapunov-0-1" / "family.json")
    assert len(found.points) >= 8 and found.source["event"] == 0
    counts = json.loads((tmp_path / "lyapunov-0-1" / "family.json").read_text())["points"]
    assert sum(one["certified"] for one in counts) >= 2  # both ends


@pytest.mark.slow
def test_approach_to_a_primary_is_no_homoclinic_orbit(three_body, tmp_path):
    """The Lyapunov family goes on from its tiny start; wherever it stops, not at a saddle that it is nowhere near."""
    family = lyapunov(three_body, tmp_path, points=150)
    assert len(family.points) > 60 and family.ends[-1].kind in ("point limit", "singularity", "step underflow")


def springs(unit):
    """Two masses between walls, one of them on a hardening spring (Kerschen's), in lengths of so many metres."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    stretched = (q[0] ** 2 + (q[0] - q[1]) ** 2 + q[1] ** 2) / 2
    return lagrange(ca.sumsqr(v) / 2, stretched + q[0] ** 4 / (8 / unit**2), Symbols(q, v), names=["x1", "x2"])


def backbone(unit, points, out, certify=True):
    """The in-phase family of the springs from an amplitude of 0.1 m."""
    size = 0.1 / unit
    guess = Guess([size, size, 0.0, 0.0], 2 * np.pi)
    problem = Problem(springs(unit), guess, pin(energy=0.01 / unit**2), "brake+reflection", name="backbone")
    return follow_family(
        problem, points=points, out=out, settings=FamilySettings(directions="forward", certify=certify)
    )


@pytest.mark.slow
def test_units_do_not_change_a_family(tmp_path):
    """Told in millimetres the same orbits, events and steps come out."""
    metres, small = (backbone(unit, 40, tmp_path / name, certify=False) for unit, name in ((1.0, "m"), (1e-3, "mm")))
    assert np.allclose(metres.values("energy") * 1e6, small.values("energy"), rtol=1e-6)
    assert [one.kind for one in metres.events] == [one.kind for one in small.events]
    assert np.allclose([e.energy * 1e6 for e in metres.events], [e.energy for e in small.events], rtol=1e-6)


@pytest.mark.slow
def test_family_passes_a_fold_beside_a_branch_point(tmp_path):
    """At 285.158991 the family folds just before it crosses one of a third of its period, and goes on.

    The other folds are those of the tongue of ratio 5 and of the backbone beyond (G. Kerschen et al., MSSP 23 (2009)).
    """
    family = backbone(1.0, 240, tmp_path)
    folds = [one.energy for one in family.events if (one.kind, one.detail) == ("fold", "energy")]
    expected = [4680.5462928, 285.1589908, 2105.4660208, 1786.3850840, 107345.2741786]
    assert np.allclose(folds[:5], expected, rtol=1e-8) and "merged" not in {end.kind for end in family.ends}
