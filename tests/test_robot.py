"""Robots from URDF and MJCF: MuJoCo's own mass matrix, bias and motion beside ours; files that are no robots."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError

pytest.importorskip("urdf_parser_py")
mujoco = pytest.importorskip("mujoco")
ARM = Path("problems/robots/iiwa.urdf").resolve()
GRAVITY = 9.80665

TREE = """<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 -9.80665"/>
  <worldbody>
    <body name="trunk" pos="0.1 0.2 0.9">
      <joint name="yaw" type="hinge" axis="0 0 1" damping="0.2" armature="0.03"/>
      <inertial pos="0.05 0.01 -0.1" mass="2" diaginertia="0.02 0.03 0.025" quat="0.9 0.1 0.2 0.3"/>
      <body name="left arm" pos="0.2 0 0.1" quat="0.8 0.2 -0.3 0.4">
        <joint name="left" type="hinge" axis="1 1 0" stiffness="3" springref="0.2"/>
        <inertial pos="0 0.02 -0.3" mass="0.7" diaginertia="0.01 0.012 0.004"/>
        <body name="hand" pos="0 0 -0.5">
          <inertial pos="0.01 0 -0.05" mass="0.2" diaginertia="0.001 0.001 0.0015"/>
        </body>
      </body>
      <body name="piston" pos="-0.2 0.1 0">
        <joint name="slide" type="slide" axis="0 1 2"/>
        <inertial pos="0 0 0.1" mass="0.4" diaginertia="0.002 0.003 0.004"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""


def mujoco_acceleration(one, q, v):
    """M^-1 (forces - bias) by MuJoCo's own recursion, in its order of joints."""
    data = mujoco.MjData(one)
    data.qpos[:], data.qvel[:] = q, v
    mujoco.mj_forward(one, data)
    return data.qacc.copy()


def agree(model, one, seed=3):
    random, order = np.random.default_rng(seed), [one.joint(k).name for k in range(one.njnt)]
    names = model.state_names[: model.degrees_of_freedom]
    place = [order.index(name) for name in names]
    for _ in range(4):
        q, v = random.normal(size=(2, len(names)))
        theirs = mujoco_acceleration(one, q, v)[place]
        ours = model.acceleration(0.0, q[place], v[place], model.parameter_values).full().ravel()
        assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-9 * np.abs(theirs).max())


def test_a_urdf_has_the_accelerations_of_mujoco():
    one = mujoco.MjModel.from_xml_path(str(ARM))
    one.opt.gravity[:] = 0, 0, -GRAVITY
    agree(of.robot(ARM), one)  # the file's damping included


def test_the_leg_of_a_quadruped_has_those_of_mujoco():
    file = ARM.with_name("a1-leg.urdf")
    one = mujoco.MjModel.from_xml_path(str(file))
    one.opt.gravity[:] = 0, 0, -GRAVITY
    one.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT  # which are left out here
    agree(of.robot(file), one)


def test_a_tree_with_rotors_springs_slides_and_welds_has_those_of_mujoco(tmp_path):
    (tmp_path / "tree.xml").write_text(TREE)
    model = of.robot(tmp_path / "tree.xml")
    assert model.state_names[:3] == ("yaw", "left", "slide")
    assert "yaw_rotor" in model.parameter_names and "hand_mass" not in model.parameter_names
    agree(model, mujoco.MjModel.from_xml_string(TREE))
    assert model.system["drawn"]["file"] == "tree.xml" and len(model.system["drawn"]["sha256"]) == 64


def test_locked_joints_are_where_they_are_locked():
    """The arm with three joints at angles is the arm whose equations are held there."""
    angles = {"joint3": 0.4, "joint5": -0.7, "joint7": 1.1}
    few, whole = of.robot(ARM, locked=angles, damping=0.0), of.robot(ARM, damping=0.0)
    random = np.random.default_rng(1)
    moving = [0, 1, 3, 5]
    q, v = np.zeros(7), np.zeros(7)
    q[moving], v[moving] = random.normal(size=(2, 4))
    q[[2, 4, 6]] = list(angles.values())
    for name in ("kinetic", "potential"):

        def value(model, place, rate):
            given = (place, rate) if name == "kinetic" else (place,)  # noqa: B023
            return float(getattr(model, name)(*given, model.parameter_values))  # noqa: B023

        there, zero = value(few, q[moving], v[moving]), value(few, np.zeros(4), np.zeros(4))
        base = np.zeros(7)
        base[[2, 4, 6]] = list(angles.values())
        assert there - zero == pytest.approx(value(whole, q, v) - value(whole, base, np.zeros(7)), rel=1e-12)


def test_a_floating_base_falls_freely(tmp_path):
    free = TREE.replace('<joint name="yaw" type="hinge" axis="0 0 1" damping="0.2" armature="0.03"/>', "<freejoint/>")
    free = free.replace('stiffness="3" springref="0.2"', "")
    (tmp_path / "free.xml").write_text(free)
    link = URDF.format(weight=WEIGHT, kind="continuous", child="b", more="").replace('"a"/>', f'"a">{WEIGHT}</link>', 1)
    (tmp_path / "free.urdf").write_text(link)
    for model in (of.robot(tmp_path / "free.xml"), of.robot(tmp_path / "free.urdf", floating=True)):
        n = model.degrees_of_freedom
        fall = model.acceleration(0.0, np.full(n, 0.1), np.zeros(n), model.parameter_values).full().ravel()
        assert fall == pytest.approx([GRAVITY] + [0] * (n - 1), abs=1e-12)


def test_motors_are_controls_within_the_files_effort():
    model = of.robot(ARM, motors=["joint2", "joint4"])
    assert model.controls == ("joint2_torque", "joint4_torque")
    assert model.limits["joint2_torque"] == (-300.0, 300.0)
    assert len(of.robot(ARM, motors="all").controls) == 7


def test_a_mode_of_the_compliant_arm_closes_in_mujoco():
    """A certified orbit, replayed by MuJoCo's Runge-Kutta: what it misses falls with the fourth power of its step."""
    springs = {f"joint{k}": c for k, c in enumerate((1000.0, 1000.0, 500.0, 500.0, 200.0, 100.0, 50.0), 1)}
    model = of.robot(ARM, damping=0.0, stiffness=springs)
    orbit = of.find_orbit(of.Problem(model, of.guesses.normal_mode(model, 7, 0.2)))
    assert orbit.certificate.passed, orbit.certificate.failures
    one = mujoco.MjModel.from_xml_path(str(ARM))
    one.opt.gravity[:], one.opt.integrator = (0, 0, -GRAVITY), mujoco.mjtIntegrator.mjINT_RK4
    one.jnt_stiffness[:], one.dof_damping[:], one.jnt_limited[:] = list(springs.values()), 0.0, 0
    missed = []
    for steps in (100, 200):
        data = mujoco.MjData(one)
        data.qpos[:], data.qvel[:] = orbit.state[:7], orbit.state[7:]
        one.opt.timestep = orbit.period / steps
        for _ in range(steps):
            mujoco.mj_step(one, data)
        missed.append(np.abs(np.concatenate([data.qpos, data.qvel * orbit.period]) - np.concatenate(
            [orbit.state[:7], orbit.state[7:] * orbit.period])).max())  # fmt: skip
    assert missed[0] < 1e-4 and missed[1] < missed[0] / 8


def test_the_problem_file_and_what_is_recorded(tmp_path):
    problem = of.load_problem("problems/robots/iiwa-mode-7.toml")
    orbit = of.find_orbit(problem)
    of.save_orbit(orbit, tmp_path / "orbit.json")
    document = json.loads((tmp_path / "orbit.json").read_text())
    assert document["system"]["kind"] == "mechanism" and document["system"]["drawn"]["file"] == "iiwa.urdf"
    assert str(ARM.parent) not in json.dumps(document)
    done = CliRunner().invoke(cli, ["verify", str(tmp_path / "orbit.json")])  # from the file alone
    assert done.exit_code == 0, done.output


URDF = """<robot name="r"><link name="a"/><link name="b">{weight}</link>
<joint name="j" type="{kind}"><parent link="a"/><child link="{child}"/>{more}</joint></robot>"""
WEIGHT = "<inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial>"


@pytest.mark.parametrize(
    "text, options, said",
    [
        ("nonsense", {}, "file: bad.urdf is no robot; give a URDF"),
        ("<robot name='r'><link", {}, "file: bad.urdf is no URDF that can be read"),
        (URDF.format(weight=WEIGHT, kind="planar", child="b", more=""), {}, "file: joint 'j' is planar; known are"),
        (URDF.format(weight="", kind="continuous", child="b", more=""), {},
         "file: link 'b' moves with joint 'j' and has no mass; give it one, or lock the joint"),
        (URDF.format(weight=WEIGHT, kind="continuous", child="b", more=""), {"locked": ["k"]},
         "locked: no moving joint 'k'; they are j"),
        (URDF.format(weight=WEIGHT, kind="continuous", child="b", more=""), {"locked": ["j"]},
         "locked: no joint is left to move; unlock one"),
        (URDF.format(weight=WEIGHT, kind="continuous", child="b", more=""), {"stiffness": {"j": -1.0}},
         "stiffness: of joint 'j' must not be negative, got -1"),
        (URDF.format(weight=WEIGHT, kind="continuous", child="b", more=""), {"motors": "jj"},
         "motors: no moving joint 'jj'"),
        (URDF.format(weight=WEIGHT, kind="continuous", child="b", more="").replace('"b"', '"a b"')
         .replace('"a"', '"a.b"'), {},
         "file: links 'a.b' and 'a b' are both 'a_b' where names are letters, digits and _; rename one"),
        (URDF.format(weight=WEIGHT.replace("'1'", "'nan'", 1), kind="continuous", child="b", more=""), {},
         "file: link 'b' has a mass, place or inertia that is no finite number; correct it"),
        (URDF.format(weight=WEIGHT.replace("'1'", "'-1'", 1), kind="continuous", child="b", more=""), {},
         "file: link 'b' has the mass -1 kg; give one that is not negative"),
        (URDF.format(weight=WEIGHT, kind="continuous", child="b", more="<origin xyz='0 0 inf'/>"), {},
         "file: joint 'j' has an origin, axis, damping or effort that is no finite number; correct it"),
        (URDF.format(weight=WEIGHT, kind="continuous", child="b", more=""), {"values": {"b_mass": -2.0}},
         "bodies.b.mass: must be positive, got -2.0"),
        ("<!DOCTYPE r [<!ENTITY a '" + "a" * 999 + "'>" + "".join(
            f"<!ENTITY {two} '{f'&{one};' * 50}'>" for one, two in zip("abcde", "bcdef", strict=True)
        ) + "]><robot name='r'>&f;</robot>", {}, "file: bad.urdf is no URDF that can be read (XMLSyntaxError: "),
    ],
)  # fmt: skip
def test_bad_files(tmp_path, text, options, said):
    (tmp_path / "bad.urdf").write_text(text)
    with pytest.raises(InputError) as caught:
        of.robot(tmp_path / "bad.urdf", **options)
    assert str(caught.value).startswith(said) and "\n" not in str(caught.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match=r"file: .*gone.urdf: no such file; check the path"):
        of.robot(tmp_path / "gone.urdf")
