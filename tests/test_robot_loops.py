"""Loops of MuJoCo models, and ball and free joints by quaternions: accelerations beside MuJoCo's mass matrix, bias and
Jacobians with rigid loops, and certified orbits beside other forms and closed ones."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipk

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.families.minimal import minimal_problem
from orbitfinder.mechanics.constrained import constraint_rows
from orbitfinder.mechanics.kind import build_model

mujoco = pytest.importorskip("mujoco")
pytestmark = pytest.mark.needs("robot")
DOWN = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
G = 9.8
FORM = """<mujoco><compiler angle="radian"/><option gravity="0 0 -{gravity}"/><worldbody>{bodies}</worldbody>
<equality>{loops}</equality></mujoco>"""


def text(bodies, loops="", gravity=G):
    return FORM.format(bodies=bodies, loops=loops, gravity=gravity)


def read(folder, written, **options):
    (folder / "machine.xml").write_text(written)
    return of.robot(folder / "machine.xml", **options), mujoco.MjModel.from_xml_string(written)


def product(a, b):
    """Of two quaternions, w first."""
    return np.concatenate([[a[0] * b[0] - a[1:] @ b[1:]], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])])


class Mapped:
    """Where the coordinates of a model by quaternions are in MuJoCo's, by the joints' child bodies."""

    def __init__(self, one):
        self.one, self.data = one, mujoco.MjData(one)
        mujoco.mj_kinematics(one, self.data)
        self.turns = [DOWN @ self.data.xmat[k].reshape(3, 3) for k in range(one.nbody)]
        self.origins = self.data.xpos.copy()

    def put(self, q, v):
        """Coordinates and rates by name into MuJoCo's data."""
        for k in range(self.one.njnt):
            joint, body = self.one.joint(k), self.one.jnt_bodyid[k]
            name, place, dof = joint.name, joint.qposadr[0], joint.dofadr[0]
            if name in q:
                self.data.qpos[place], self.data.qvel[dof] = q[name], v[name]
                continue
            first, turn = 1, self.turns[body]
            if self.one.jnt_type[k] == mujoco.mjtJoint.mjJNT_FREE:
                slides = [[each[f"{name}{i}"] for i in (1, 2, 3)] for each in (q, v)]
                self.data.qpos[place : place + 3] = self.origins[body] + DOWN.T @ slides[0]
                self.data.qvel[dof : dof + 3] = DOWN.T @ slides[1]
                first, place, dof = 4, place + 3, dof + 3
            c, rate = (np.array([each[f"{name}{first + i}"] for i in range(4)]) for each in (q, v))
            own = np.append(c[0], turn.T @ c[1:])
            if first == 4:  # MuJoCo's is that of the body in the world
                own = product(np.roll(Rotation.from_matrix(DOWN.T @ turn).as_quat(), 1), own)
            self.data.qpos[place : place + 4] = own
            self.data.qvel[dof : dof + 3] = turn.T @ (2 * product(c * [1, -1, -1, -1], rate)[1:])
        mujoco.mj_forward(self.one, self.data)

    def accelerations(self, names, q, v, given):
        """Of MuJoCo's (nv), as those of coordinates by name."""
        found = {}
        for k in range(self.one.njnt):
            joint, turn = self.one.joint(k), self.turns[self.one.jnt_bodyid[k]]
            name, dof = joint.name, joint.dofadr[0]
            if name in q:
                found[name] = given[dof]
                continue
            first = 1
            if self.one.jnt_type[k] == mujoco.mjtJoint.mjJNT_FREE:
                found |= {f"{name}{i + 1}": each for i, each in enumerate(DOWN @ given[dof : dof + 3])}
                first, dof = 4, dof + 3
            c, rate = (np.array([each[f"{name}{first + i}"] for i in range(4)]) for each in (q, v))
            spin = product(c * [1, -1, -1, -1], 2 * rate)
            turned = np.append(0.0, turn @ given[dof : dof + 3])
            wanted = (product(rate, np.append(0.0, spin[1:])) + product(c, turned)) / 2
            found |= {f"{name}{first + i}": each for i, each in enumerate(wanted)}
        return np.array([found[name] for name in names])


def rigid(one, data):
    """MuJoCo's accelerations (nv) where what it connects or welds is rigid: M a + h = J^T l, J a + Jdot v = 0."""
    mass, rows, bias = np.zeros((one.nv, one.nv)), [], []
    mujoco.mj_fullM(one, data, mass)
    for k in range(one.neq):
        first, weld = one.eq_data[k], one.eq_type[k] == mujoco.mjtEq.mjEQ_WELD
        parts = []
        for end, which in enumerate((one.eq_obj1id[k], one.eq_obj2id[k])):
            if one.eq_objtype[k] == mujoco.mjtObj.mjOBJ_SITE:
                body, at = one.site_bodyid[which], data.site_xpos[which].copy()
            else:
                anchor = first[3 * (end ^ weld) : 3 * (end ^ weld) + 3]
                body, at = which, data.xpos[which] + data.xmat[which].reshape(3, 3) @ anchor
            now, later = np.zeros((2, 3, one.nv)), np.zeros((2, 3, one.nv))
            mujoco.mj_jac(one, data, now[0], now[1], at, body)
            mujoco.mj_jacDot(one, data, later[0], later[1], at, body)
            parts.append((now, later, at))
        assert np.abs(parts[0][2] - parts[1][2]).max() < 1e-11  # the loop is closed there too
        for kind in range(1 + (weld and first[10] > 0)):
            rows.append(parts[0][0][kind] - parts[1][0][kind])
            bias.append((parts[0][1][kind] - parts[1][1][kind]) @ data.qvel)
    jacobian, turning = np.vstack(rows), np.concatenate(bias)
    assert np.abs(jacobian @ data.qvel).max() < 1e-11
    free = np.linalg.solve(mass, data.qfrc_passive - data.qfrc_bias)
    push = np.linalg.lstsq(jacobian @ np.linalg.solve(mass, jacobian.T), -turning - jacobian @ free, rcond=1e-11)[0]
    return free + np.linalg.solve(mass, jacobian.T @ push)


def agree(model, one, size=0.4, count=3, seed=0):
    """At random consistent states."""
    random, mapped, names = np.random.default_rng(seed), Mapped(one), model.coordinates
    values, pose = model.parameter_values, model.system.get("pose", {})
    for _ in range(count):
        place = np.array([pose.get(name, 0.0) for name in names]) + size * random.normal(size=len(names))
        state = of.linkages.mechanism_state(model, near=place)
        q, rate = np.split(state, 2)
        jacobian = model.constraint.jacobian(q, values).full()
        rate = random.normal(size=q.size)
        v = rate - np.linalg.pinv(jacobian) @ (jacobian @ rate)
        named = [dict(zip(names, each, strict=True)) for each in (q, v)]
        mapped.put(*named)
        theirs = rigid(one, mapped.data) if one.neq else mapped.data.qacc
        wanted = mapped.accelerations(names, *named, theirs)
        ours = model.acceleration(0.0, q, v, values).full().ravel()
        assert ours == pytest.approx(wanted, rel=1e-9, abs=1e-9 * np.abs(wanted).max())


WEIGHT = (
    '<inertial pos="0.05 0.02 -0.2" mass="{0}" diaginertia="0.02 0.03 0.025" quat="0.9 0.1 0.2 0.3"/>'
    '<site name="s{0}" pos="0.1 0 -0.2" euler="0.3 0.1 0.7"/>'
)


def chain(axes):
    """A serial chain with turned bodies, j1 to jn of bodies b1 to bn."""
    head = "".join(
        f'<body name="b{k}" pos="0.05 {0.1 * (-1) ** k} {-0.4 * (k > 1)}" quat="0.9 {0.1 * k} -0.2 0.1">'
        f'<joint name="j{k}" type="hinge" axis="{axis}" pos="0.01 0 0.02"/>{WEIGHT.format(k)}'
        for k, axis in enumerate(axes, 1)
    )
    return head + "</body>" * len(axes)


SEVEN = chain(["1 0 0", "0 1 0.2", "0 0 1", "1 1 0", "0 1 1", "1 0 -1", "0.3 1 0"])


@pytest.mark.parametrize(
    ("loop", "rows"),
    [
        ('<connect name="pin" body1="b7" body2="b2" anchor="0.1 0.2 -0.3"/>', 3),
        ('<connect name="pin" body1="b6" anchor="0 0 -0.3"/>', 3),
        ('<connect name="pin" site1="s7" site2="s1"/>', 3),
        ('<weld name="pin" body1="b1" body2="b7" anchor="0.2 0.1 0" torquescale="2"/>', 6),
        ('<weld name="pin" body1="b7" relpose="0.1 0 0.5 0.9 0.3 0.2 0.1" torquescale="0"/>', 3),
        ('<weld name="pin" site1="s2" site2="s7" torquescale="0"/>', 3),
    ],
)
def test_what_is_connected_or_welded_has_the_accelerations_of_mujoco_with_rigid_loops(tmp_path, loop, rows):
    """Bodies and sites, with the world and with each other, as the file draws them or apart from it."""
    model, one = read(tmp_path, text(SEVEN, loop))
    assert len(model.constraint.force_names) == rows and model.degrees_of_freedom == 7
    agree(model, one, 0.3)


def test_a_weld_of_sites_turns_as_they_are(tmp_path):
    """Sites that coincide in a pose other than that of the file: their axes too, wherever the loop goes."""
    one, place = mujoco.MjModel.from_xml_string(text(SEVEN)), np.random.default_rng(4).normal(size=7) / 2
    data = mujoco.MjData(one)
    data.qpos[:] = place
    mujoco.mj_kinematics(one, data)
    (first, here), (last, there) = (
        (each.xpos, each.xmat.reshape(3, 3)) for each in (data.site("s2"), data.body("b7"))
    )  # fmt: skip
    at, turn = there.T @ (first - last), np.roll(Rotation.from_matrix(there.T @ here).as_quat(), 1)
    site = '<site name="s7" pos="{} {} {}" quat="{} {} {} {}"/>'.format(*at, *turn)
    moved = SEVEN.replace('<site name="s7" pos="0.1 0 -0.2" euler="0.3 0.1 0.7"/>', site)
    pose = {f"j{k}": each for k, each in enumerate(place, 1)}
    model, one = read(tmp_path, text(moved, '<weld name="pin" site1="s2" site2="s7"/>'), pose=pose)
    assert of.linkages.mechanism_state(model)[:7] == pytest.approx(place, abs=1e-9)
    agree(model, one, 0.05)
    state = of.linkages.mechanism_state(model, {"j1": place[0] + 0.05})
    mapped = Mapped(one)
    mapped.put(*(dict(zip(model.coordinates, each, strict=True)) for each in np.split(state, 2)))
    first, second = (mapped.data.site(name) for name in ("s2", "s7"))
    assert first.xmat == pytest.approx(second.xmat, abs=1e-10) and np.abs(state[:7] - place).max() > 0.04


TWO = f"""
<body name="rod" pos="0.1 0.2 0.3" quat="0.9 0.1 0.2 0.3"><joint name="hip" type="ball" pos="0.02 0.03 0.1"/>
  {WEIGHT.format(1)}<body name="shin" pos="0 0.1 -1" quat="0.7 0.2 0.2 -0.1">
  <joint name="knee" type="hinge" axis="1 0.3 0" damping="0.1" stiffness="2"/>{WEIGHT.format(2)}</body></body>
<body name="box" pos="1 0 0.5" quat="0.5 -0.4 0.2 0.7"><freejoint name="loose"/>{WEIGHT.format(3)}
  <body name="arm" pos="0 0.1 0.2" quat="0.7 0.2 0.2 -0.1"><joint name="shoulder" type="ball" pos="0 .1 .2"/>
  {WEIGHT.format(4)}</body></body>"""


def test_ball_and_free_joints_by_quaternions_have_the_accelerations_of_mujoco(tmp_path):
    """Attitudes of any kind: half a turn away too, where three angles have their pole."""
    model, one = read(tmp_path, text(TWO), quaternions=True)
    assert model.constraint.force_names == ("hip_s", "loose_s", "shoulder_s")
    assert model.coordinates[:5] == ("hip1", "hip2", "hip3", "hip4", "loose1")
    agree(model, one, 2.0, 5)


def test_loops_over_ball_joints_have_the_accelerations_of_mujoco(tmp_path):
    """A linkage in space of a ball between two hinges, closed by a point; and a body that floats on two of them."""
    loop = '<connect name="pin" body1="shin" body2="arm" anchor="0.1 0 -0.2"/>'
    model, one = read(tmp_path, text(TWO, loop), quaternions=True)
    assert model.constraint.force_names == ("hip_s", "loose_s", "shoulder_s", "pin_i", "pin_j", "pin_k")
    agree(model, one, 0.3)


def bar(name, joint, com, inside="", at="0 0 0"):
    """Across x, of 1 kg and 0.1 kg m^2."""
    hinge = f'<joint name="{joint}" type="hinge" axis="1 0 0"/>' if joint else "<freejoint/>"
    weight = f'<inertial pos="{com}" mass="1" diaginertia="0.1 0.1 0.1"/>'
    return f'<body name="{name}" pos="{at}">{hinge}{weight}{inside}</body>'


ROCKER = bar("rocker", "c", "0 0 0.5", at="0 1.2 0")
COUPLER = bar("coupler", "b", "0 0.6 0", ROCKER, "0 0 -1")
FOUR = bar("crank", "a", "0 0 -0.5", COUPLER)
PIN = '<connect name="pin" body1="rocker" anchor="0 0 1"/>'


def test_redundant_rows_of_a_planar_loop_may_be_dropped_however_it_floats(tmp_path):
    """The row across the plane repeats others in the axes of a body, but in the world's at a single attitude."""
    free = FOUR.replace('<joint name="a" type="hinge" axis="1 0 0"/>', '<freejoint name="a"/>').replace(
        '<inertial pos="0 0 -0.5"', '<body name="base" pos="0 1.2 0">'
        '<joint name="d" type="hinge" axis="1 0 0"/><inertial pos="0 0 -0.5" mass="2" diaginertia="0.2 0.1 0.1"/>'
        "</body>"
        '<inertial pos="0 0 -0.5"', 1)  # fmt: skip
    model, one = read(tmp_path, text(free, PIN.replace("anchor", 'body2="base" anchor')), quaternions=True)
    assert len(model.constraint.force_names) == 3 and model.degrees_of_freedom == 10
    agree(model, one, 1.0, 5)


def ground_hinge(folder, loops, extra=""):
    model, _ = read(folder, text(FOUR.replace(ROCKER, bar("rocker", "c", "0 0 0.5", extra, "0 1.2 0")), loops))
    state = of.linkages.mechanism_state(model, {"a": 0.4})
    energy = of.energy(model, state)
    guess = of.Guess(state, 1.03 * of.linkages.first_return(model, state))
    return of.find_orbit(of.Problem(model, guess, of.pin(energy=energy)))


@pytest.mark.slow
def test_a_chain_that_is_connected_or_welded_is_the_four_bar_linkage(tmp_path):
    """The same machine thrice: closed by a point, by a weld of a further link, and as the package's own linkage."""
    connected = ground_hinge(tmp_path, PIN)
    link = '<body name="stub" pos="0 0 1"><joint name="d" type="hinge" axis="1 0 0"/></body>'
    welded = ground_hinge(tmp_path, '<weld name="pin" body1="stub"/>', link.replace(
        "</body>", '<inertial pos="0 0 0" mass="0.5" diaginertia="0.1 0.1 0.1"/></body>'))  # fmt: skip
    linkage = of.linkage([1.0, 1.2, 1.0], ground=(0.0, 1.2), mass=1.0, inertia=0.1, gravity=G)
    state = of.linkages.linkage_state(linkage, of.linkages.assemble(linkage, {"theta1": 0.4}, guess=[0.4, 1.6, 3.5]))
    own = of.find_orbit(of.Problem(
        linkage, of.Guess(state, 1.01 * connected.period), of.pin(energy=of.energy(linkage, state))))  # fmt: skip
    for orbit in (connected, welded, own):
        assert orbit.certificate.passed, orbit.certificate.failures
    assert connected.period == pytest.approx(own.period, rel=1e-9)
    assert welded.period == pytest.approx(own.period, rel=1e-9)


ROD = """<body name="rod"><joint name="hip" type="ball"/>
<inertial pos="0 0 -0.5" mass="1.3" diaginertia="0.1 0.1 0.05"/></body>"""
PULL, ABOUT = 1.3 * G * 0.5, 0.1 + 1.3 * 0.25
"""Of the rod: N m at right angles, kg m^2 across it about the joint"""


def closed(model, state, period):
    return of.find_orbit(of.Problem(model, of.Guess(state, period), of.pin(energy=of.energy(model, state))))


@pytest.mark.slow
def test_a_spherical_pendulum_by_a_ball_joint_swings_and_circles_as_in_closed_form(tmp_path):
    """Through more than a right angle, 4 K(k) / w; and on a cone, where the whole body turns with the bob and its
    quaternion is back after two turns."""
    model, _ = read(tmp_path, text(ROD), quaternions=True)
    kept = [each.name for each in model.invariants]
    assert kept == ["energy", "angular_momentum_hip1_hip2", "angular_momentum_hip3_hip4"]
    swing = of.linkages.mechanism_state(model, {"hip4": np.sin(1.0)})  # 2 rad about z
    period = 4 * ellipk(np.sin(1.0) ** 2) / np.sqrt(PULL / ABOUT)
    orbit = closed(model, swing, 1.01 * period)
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.period == pytest.approx(period, rel=1e-11)
    tilt = 0.7
    rate = np.sqrt(PULL / ((ABOUT - 0.05) * np.cos(tilt)))
    c = np.array([np.cos(tilt / 2), 0, 0, np.sin(tilt / 2)])
    cone = np.concatenate([c, product(np.array([0, rate, 0, 0]), c) / 2])
    orbit = closed(model, cone, 1.01 * 4 * np.pi / rate)
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.period == pytest.approx(4 * np.pi / rate, rel=1e-11)
    rod = {"mass": 1.3, "inertia": [0.05, 0.1, 0.1], "com": [0.5, 0.0, 0.0]}
    hip = {"kind": "spherical", "between": ["ground", "rod"], "axes": "xzx"}
    angles = of.mechanism({"rod": rod}, {"hip": hip}, dimension=3, gravity=[G, 0, 0], pose={"hip2": tilt})
    state = [0, tilt, 0, rate, 0, 0]
    turn = of.find_orbit(of.Problem(
        angles, of.Guess(state, 2 * np.pi / rate), of.pin(energy=of.energy(angles, state)), winding=(1, 0, 0)
    ))  # fmt: skip
    assert turn.certificate.passed, turn.certificate.failures
    assert np.sort(orbit.floquet_multipliers) == pytest.approx(np.sort(turn.floquet_multipliers**2), abs=1e-8)


def tumbling(moments, turns):
    """Energy and period for |L| = 1 of Euler's motion about the axis of the largest of three moments in which the body
    turns about L `turns` times meanwhile; Landau and Lifshitz, Mechanics, section 37."""
    a, b, c = moments

    def motion(energy):
        rate = np.sqrt((c - b) * (1 - 2 * energy * a) / (a * b * c))
        return rate, (b - a) * (2 * energy * c - 1) / ((c - b) * (1 - 2 * energy * a))

    def turned(energy):
        rate, m = motion(energy)
        first, second = (np.sqrt((2 * energy * c - 1) / (each * (c - each))) for each in (a, b))

        def precession(t):
            sn, cn, *_ = ellipj(rate * t, m)
            x, y = first * cn, second * sn
            return (a * x**2 + b * y**2) / ((a * x) ** 2 + (b * y) ** 2)

        return 4 * quad(precession, 0, ellipk(m) / rate, epsabs=1e-13, epsrel=1e-13)[0]

    low, high = 1 / (2 * c), 1 / (2 * b)
    ends = low + 1e-3 * (high - low), high - 1e-3 * (high - low)
    energy = brentq(lambda given: turned(given) - 2 * np.pi * turns, *ends, xtol=1e-15)
    rate, m = motion(energy)
    return energy, 4 * ellipk(m) / rate


@pytest.mark.slow
@pytest.mark.parametrize("at", ["0 0 0", "0.1 0.2 -0.3"])
def test_a_free_body_tumbles_in_elliptic_functions(tmp_path, at):
    """Without gravity, in the motion in which it turns thrice about its angular momentum in a period of its rates."""
    a, b, c = moments = 1.0, 2.0, 2.6
    box = f'<body name="box"><freejoint name="f"/><inertial pos="{at}" mass="1" diaginertia="{a} {b} {c}"/></body>'
    model, _ = read(tmp_path, text(box, gravity=0), quaternions=True)
    assert len(model.invariants) == 7 and model.invariants[0].name == "energy"
    energy, period = tumbling(moments, 3)
    spin = np.sqrt([(2 * energy * c - 1) / (a * (c - a)), 0, (1 - 2 * energy * a) / (c * (c - a))])
    w, com = DOWN @ spin, DOWN @ np.array(at.split(), float)
    start = np.concatenate([np.zeros(3), [1, 0, 0, 0], -np.cross(w, com), [0], w / 2])
    assert of.energy(model, start) == pytest.approx(energy, rel=1e-14)
    orbit = closed(model, start, 1.003 * period)
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.period == pytest.approx(period, rel=1e-11)
    assert of.energy(model, orbit.state) == pytest.approx(energy, rel=1e-12)


@pytest.mark.slow
def test_a_problem_file_by_quaternions_is_solved_and_its_record_verified_without_the_robots_file(tmp_path):
    (tmp_path / "rod.xml").write_text(text(ROD))
    (tmp_path / "swing.toml").write_text(
        'name = "swing"\n[system]\nkind = "robot"\nfile = "rod.xml"\nquaternions = true\n[guess]\n'
        f"state = [{np.cos(0.5)}, 0, 0, {np.sin(0.5)}, 0, 0, 0, 0]\nperiod = 1.85\n"
        f"[find]\npin = {{ energy = {-PULL * np.cos(1.0)} }}\n"
    )
    problem = of.load_problem(tmp_path / "swing.toml")
    orbit = of.find_orbit(problem)
    assert orbit.period == pytest.approx(4 * ellipk(np.sin(0.5) ** 2) / np.sqrt(PULL / ABOUT), rel=1e-11)
    of.save_orbit(orbit, tmp_path / "orbit.json")
    (tmp_path / "rod.xml").unlink()
    done = CliRunner().invoke(cli, ["verify", str(tmp_path / "orbit.json")])
    assert done.exit_code == 0, done.output


def test_a_record_has_the_whole_machine_and_equalities_may_be_ignored(tmp_path):
    model, _ = read(tmp_path, text(FOUR, PIN))
    again = build_model(json.loads(json.dumps(model.system)))
    q, v = np.split(of.linkages.mechanism_state(model, {"a": 0.3}, {"adot": 1.0}), 2)
    ours, theirs = (each.acceleration(0, q, v, each.parameter_values).full() for each in (model, again))
    assert np.array_equal(ours, theirs) and again.constraint.force_names == ("pin_i", "pin_j")
    tree = of.robot(tmp_path / "machine.xml", ignore=["equalities"])
    assert tree.constraint is None and "redundant" not in tree.system


HUNG = {
    "bodies": {"rod": {"mass": 1.3, "inertia": [0.05, 0.1, 0.12], "com": [0.5, 0.1, 0.0]}},
    "joints": {"hip": {"kind": "spherical", "between": ["ground", "rod"], "at": [[0, 0, 0.1], [0.1, 0, 0]],
                       "axes": "quaternion"}},
    "dimension": 3, "gravity": [G, 0.0, 0.0],
}  # fmt: skip


def test_a_joint_told_from_its_second_body_has_the_conjugate_quaternion():
    model = of.mechanism(**HUNG)
    hip = HUNG["joints"]["hip"]
    turned = {"between": hip["between"][::-1], "at": hip["at"][::-1]}
    back = of.mechanism(**HUNG | {"joints": {"hip": hip | turned}})
    other = np.array([1, -1, -1, -1])
    for c, rate in np.random.default_rng(2).normal(size=(3, 2, 4)):
        c = c / np.linalg.norm(c)
        rate = rate - c * (c @ rate)
        ours = model.acceleration(0, c, rate, model.parameter_values).full().ravel()
        theirs = back.acceleration(0, c * other, rate * other, back.parameter_values).full().ravel()
        assert theirs * other == pytest.approx(ours, rel=1e-11)


def test_what_is_conserved_is_so_on_the_constraint():
    """Turning about gravity, of a body without symmetry; that about its own axis too, of a body of revolution."""
    model = of.mechanism(**HUNG)
    assert [each.name for each in model.invariants] == ["energy", "angular_momentum"]
    rod = HUNG["bodies"]["rod"] | {"inertia": [0.05, 0.1, 0.1], "com": [0.5, 0.0, 0.0]}
    top = of.mechanism(**HUNG | {"bodies": {"rod": rod}})
    assert len(top.invariants) == 3
    for each in (model, top):
        p, random = each.parameter_values, np.random.default_rng(3)
        c, rate = random.normal(size=(2, 4))
        c = c / np.linalg.norm(c)
        rate = rate - c * (c @ rate)
        later = each.acceleration(0, c, rate, p).full().ravel()
        for kept in each.invariants:
            ahead, behind = (float(kept.value(c + h * rate, rate + h * later, p)) for h in (1e-5, -1e-5))
            assert abs(ahead - behind) < 2e-9 * max(abs(float(kept.value(c, rate, p))), 1.0)
            if kept.generator is not None:  # keeps the constraint and its rate
                along = kept.generator(c, rate, p).full().ravel()
                assert np.abs(constraint_rows(each)(np.append(c, rate)).full() @ along).max() < 1e-13


@pytest.mark.parametrize(
    ("at", "kept"), [([0.8, 0.0, 0.0], ["energy", "angular_momentum"]), ([0.8, 0.3, 0.0], ["energy"])]
)
def test_a_loop_that_holds_the_turning_takes_its_momentum(at, kept):
    """A rod from a point on the vertical through the ball joint, and from beside it."""
    tie = {"kind": "rod", "between": ["ground", "rod"], "at": [at, [0.9, 0.4, 0.0]], "length": 0.5}
    hip = HUNG["joints"]["hip"] | {"at": [[0, 0, 0], [0.1, 0, 0]]}
    model = of.mechanism(**HUNG | {"joints": {"hip": hip, "tie": tie}})
    assert [each.name for each in model.invariants] == kept


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"springs": {"k": {"joint": "hip1", "stiffness": 1.0}}}, "springs.k.joint: 'hip1' is no coordinate; use"),
        ({"motors": {"m": {"joint": "hip2"}}}, "motors.m.joint: 'hip2' is no coordinate"),
        ({"bodies": {"rod": {"mass": 1.0, "com": [0.6, 0, 0]}}},
         "joints.hip: coordinate hip2 moves no mass: body 'rod' turns about its own centre of mass without inertia"),
        ({"joints": {"hip": {"kind": "universal", "between": ["ground", "rod"], "axes": "quaternion"}}},
         "joints.hip.axes: need 2 directions, or letters such as 'xyz', got 'quaternion'"),
        ({"joints": {"hip": {"kind": "connect", "between": ["ground", "rod"]}}},
         "bodies.rod: hangs in the air, no joint leads from the ground to it (its joints: hip)"),
    ],
)  # fmt: skip
def test_what_a_quaternion_or_a_loop_is_not_is_said(change, said):
    with pytest.raises(InputError) as caught:
        of.mechanism(**HUNG | change)
    assert str(caught.value).startswith(said)


@pytest.mark.parametrize(
    ("bodies", "loops", "said"),
    [
        (FOUR.replace("<body name=\"rocker\"", '<site name="here" pos="0 9 0"/><body name="rocker"')
         + '<site name="there" pos="0 0 3"/>', '<connect name="pin" site1="here" site2="there"/>',
         "joints: the loop stays open at joint 'pin' between 'coupler' and 'ground'"),
        (FOUR, PIN + '<connect name="too" body1="coupler" anchor="0 0.6 0"/>',
         "joints: over-constrained, joint 'pin' between 'rocker' and 'ground', joint 'too' between 'coupler' and"),
        (FOUR, PIN + '<joint joint1="c" joint2="a"/>', "joints.c.mimics: need [joint, ratio, offset] of a"),
        (FOUR, PIN.replace('"pin"', '"a"'), "file: two joints are named 'a'; rename one"),
        (bar("crank", "a", "0 0 -0.5", bar("coupler", "b", "0 0 -0.5", bar("rocker", "c", "0 0 -0.5", at="0 0 -1"),
                                           "0 0 -1")), '<connect name="pin" body1="rocker" anchor="0 0 -1"/>',
         "pose: singular at a = 0, b = 0, c = 0: the equations of joint 'pin' between 'rocker' and 'ground' depend"),
    ],
)  # fmt: skip
def test_loops_that_do_not_close_or_leave_no_freedom_are_said(tmp_path, bodies, loops, said):
    with pytest.raises(InputError) as caught:
        read(tmp_path, text(bodies, loops))
    assert str(caught.value).startswith(said) and "\n" not in str(caught.value)


@pytest.mark.slow
def test_families_by_quaternions_are_followed_in_three_components_where_the_fourth_says_its_sign():
    """A swing's keeps w away from 0 and has its momenta; on a cone each component passes 0, which is named."""
    rod = HUNG["bodies"]["rod"] | {"inertia": [0.05, 0.1, 0.1], "com": [0.5, 0.0, 0.0]}
    hip = {key: value for key, value in HUNG["joints"]["hip"].items() if key != "at"}
    model = of.mechanism(**HUNG | {"bodies": {"rod": rod}, "joints": {"hip": hip}})
    state = of.linkages.mechanism_state(model, {"hip4": np.sin(0.5)})
    orbit = closed(model, state, 1.74)
    small = minimal_problem(of.Problem(model, of.Guess(orbit.state, orbit.period)))
    assert small.model.coordinates == ("hip2", "hip3", "hip4")
    assert [each.name for each in small.model.invariants] == [each.name for each in model.invariants]
    q, v = np.array([0.1, 0.2, 0.3]), np.array([0.5, -0.4, 0.7])
    whole = np.array([np.sqrt(1 - q @ q), *q]), np.array([-(q @ v) / np.sqrt(1 - q @ q), *v])
    for ours, theirs in zip(small.model.invariants, model.invariants, strict=True):
        value = float(theirs.value(*whole, model.parameter_values))
        assert float(ours.value(q, v, small.model.parameter_values)) == pytest.approx(value, rel=1e-12)
    family = of.follow_family(orbit, settings=of.FamilySettings(points=3))
    assert sum(point.certified for point in family.points) >= 2
    for point in family.points:  # 4 K(k) / w, by the energy at rest
        height = -point.energy / PULL
        exact = 4 * ellipk((1 - height) / 2) / np.sqrt(PULL / ABOUT)
        assert point.period == pytest.approx(exact, rel=1e-10)
    tilt, rate = 0.7, np.sqrt(PULL / ((ABOUT - 0.05) * np.cos(0.7)))
    c = np.array([np.cos(tilt / 2), 0, 0, np.sin(tilt / 2)])
    cone = np.concatenate([c, product(np.array([0, rate, 0, 0]), c) / 2])
    with pytest.raises(InputError, match="whichever coordinates are taken as independent"):
        minimal_problem(of.Problem(model, of.Guess(cone, 4 * np.pi / rate)))
