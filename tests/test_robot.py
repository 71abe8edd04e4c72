"""Robots from URDF and MJCF: MuJoCo's own mass matrix, bias and motion beside ours; files that are no robots."""

from __future__ import annotations

import codecs
import json
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import Hint, InputError
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanisms import shapes
from orbitfinder.problemfile.write import orbit_text

pytest.importorskip("urdf_parser_py")
mujoco = pytest.importorskip("mujoco")
pytestmark = pytest.mark.needs("robot")
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
        <geom type="box" size="0.1 0.2 0.3" pos="0.05 0 0"/>
        <geom type="sphere" size="9" group="3"/>
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


def agree(model, one, seed=3, within=1e-9):
    random, order = np.random.default_rng(seed), [one.joint(k).name for k in range(one.njnt)]
    names = model.state_names[: model.degrees_of_freedom]
    place = [order.index(name) for name in names]
    for _ in range(4):
        q, v = random.normal(size=(2, len(names)))
        theirs = mujoco_acceleration(one, q, v)[place]
        ours = model.acceleration(0.0, q[place], v[place], model.parameter_values).full().ravel()
        assert ours == pytest.approx(theirs, rel=within, abs=within * np.abs(theirs).max())


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
    assert [*model.system["drawn"]["solids"]] == ["piston"]  # MuJoCo's viewer hides group 3
    assert model.system["drawn"]["solids"]["piston"][:6] == pytest.approx([0, 0, 0.05, 0.3, 0.2, 0.1], abs=1e-9)


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


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_problem_file_and_what_is_recorded(tmp_path):
    problem = of.load_problem("problems/robots/iiwa-mode-7.toml")
    orbit = of.find_orbit(problem)
    of.save_orbit(orbit, tmp_path / "orbit.json")
    document = json.loads((tmp_path / "orbit.json").read_text())
    assert document["system"]["kind"] == "mechanism" and document["system"]["drawn"]["file"] == "iiwa.urdf"
    assert str(ARM.parent) not in json.dumps(document)
    done = CliRunner().invoke(cli, ["verify", str(tmp_path / "orbit.json")])  # from the file alone
    assert done.exit_code == 0, done.output


def wedge(folder):
    """Files of half a box of sides 1, 2, 4 in its corner, in every format, and what they hold."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 4], [1, 0, 4], [0, 2, 4]], float)
    faces = np.array([[0, 2, 1], [3, 4, 5], [0, 1, 4], [0, 4, 3], [0, 3, 5], [0, 5, 2], [1, 2, 5], [1, 5, 4]])
    records = np.zeros(len(faces), [("normal", "<f4", 3), ("at", "<f4", (3, 3)), ("more", "<u2")])
    records["at"] = corners[faces]
    head = b"solid, or so it says".ljust(80) + (8).to_bytes(4, "little")
    (folder / "binary.stl").write_bytes(head + records.tobytes())
    loops = ["facet normal 0 0 0 outer loop", *("vertex {} {} {}",) * 3, "endloop endfacet"]
    text = "\n".join("\n".join(loops).format(*at.ravel()) for at in corners[faces])
    (folder / "looks" / "meshes").mkdir(parents=True)
    (folder / "looks" / "meshes" / "text.STL").write_text(f"solid w\n{text}\nendsolid w\n")
    vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in corners)
    (folder / "w.obj").write_text(
        f"# wedge\n{vertices}f 1 3 2\nf 4 5 6\nf 1/1 2/2/2 5//5 4\nf -6 -3 -1 -4\nf 2 3 6 5\n"
    )
    numbers = " ".join(map(str, (corners[:, [0, 2, 1]] * [50, 50, -50]).ravel()))  # y up, 2 cm, half as large
    polygons = [(0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (0, 3, 5, 2), (1, 2, 5, 4)]
    indices, counts = " ".join(f"{k} 7" for at in polygons for k in at), " ".join(str(len(at)) for at in polygons)
    (
        folder / "w.dae"
    ).write_text(f"""<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema">
    <asset><unit meter="0.02"/><up_axis>Y_UP</up_axis></asset><library_geometries><geometry id="g"><mesh>
    <source id="s"><float_array id="a" count="18">{numbers}</float_array></source>
    <vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
    <polylist count="5"><input semantic="NORMAL" source="#s" offset="1"/>
    <input semantic="VERTEX" source="#v" offset="0"/><vcount>{counts}</vcount><p>{indices}</p></polylist></mesh>
    </geometry></library_geometries><library_visual_scenes>
    <visual_scene id="scene"><node><translate>0 0 0</translate><scale>0.5 0.5 0.5</scale><node><matrix>2 0 0 0 0 2 0 0
    0 0 2 0 0 0 0 1</matrix><instance_geometry url="#g"/></node></node></visual_scene></library_visual_scenes>
    </COLLADA>""")
    return corners, faces


def test_links_look_as_their_files_say(tmp_path):
    """One link for each format, at its origin, turned and scaled; what is lost is said, and that link is a line."""
    corners, faces = wedge(tmp_path)
    meshes = [
        "../binary.stl",
        "package://looks/meshes/text.STL",
        "package://arm/w.obj",
        "file://" + str(tmp_path / "w.dae"),
        "lost.stl",
    ]
    links = [
        f"<link name='l{k}'>{WEIGHT}<visual><origin xyz='0.5 0 0' rpy='0 0 1.5707963267948966'/><geometry>"
        f"<mesh filename='{mesh}' scale='0.1 0.1 -0.1'/></geometry></visual></link>"
        for k, mesh in enumerate(meshes)
    ]
    joints = [
        f"<joint name='j{k}' type='continuous'><parent link='l{k - 1}'/><child link='l{k}'/></joint>"
        for k in range(len(meshes))
    ]
    base = "<link name='l-1'><visual><geometry><cylinder radius='0.2' length='0.6'/></geometry></visual></link>"
    (tmp_path / "robots").mkdir()
    file = tmp_path / "robots" / "arm.urdf"
    file.write_text(f"<robot name='arm'>{base}{''.join(links + joints)}</robot>")
    with pytest.warns(Hint, match=r"arm.urdf: of link 'l4' the mesh lost.stl is not there"):
        model = of.robot(file)
    solids = model.system["drawn"]["solids"]
    assert [*solids] == ["ground", "l0", "l1", "l2", "l3"]
    assert solids["ground"][:6] == pytest.approx([0, 0, 0, 0.3, 0.2, 0.2])
    x, y, z = (0.1 * corners * [1, 1, -1]).T
    wanted = np.stack([-z, x, 0.5 - y], axis=1)  # turned by a right angle about z, then x down
    for name in ("l0", "l1", "l2", "l3"):
        at, seen = shapes.undescribed(solids[name])
        at = np.array(solids[name][:3]) + at * solids[name][3:6]
        assert len(at) == 6 and np.abs(at[:, None] - wanted).max(axis=2).min(axis=0).max() < 1e-5
        assert len(seen) == len(faces) and volume(at, seen) == pytest.approx(0.004, rel=1e-3)  # its outside is outside
    guess = {
        "name": "arm",
        "system": model.system,
        "state": [0.1] * 10,
        "period": 1.0,
        "energy": None,
        "provenance": {},
    }
    (tmp_path / "again.toml").write_text(orbit_text(guess, expected=False))
    again = of.load_problem(tmp_path / "again.toml").model  # as the studio's searches do
    assert again.system["drawn"] == model.system["drawn"] and again.strokes == model.strokes
    wrong = {**solids, "l0": [*solids["l0"][:7], "AAAA"]}
    with pytest.raises(InputError, match="drawn.solids.l0: is no solid of a body in space"):
        build_model({**model.system, "drawn": {"solids": wrong}})
    kinds = [kind for kind, _ in model.strokes]
    assert kinds.count("solid") == 5 and kinds.count("bone") == 4 and kinds.count("rod") == 1
    for broken in (b"", b"solid\nvertex 1 2\n", b"vertex 1 2 x"):
        file.with_name("lost.stl").write_bytes(broken)
        with pytest.warns(Hint, match=r"of link 'l4' lost.stl: cannot be read as STL"):
            of.robot(file, locked=["j0", "j1", "j2", "j3"])


def volume(corners, faces):
    a, b, c = (corners[faces[:, k]] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6)


def test_a_fine_mesh_keeps_its_shape_with_few_triangles():
    """A torus of 80,000 triangles: its volume, its outside and every corner on it."""
    around, about = np.meshgrid(*(2 * np.pi * np.arange(k) / k for k in (400, 100)), indexing="ij")
    radius = 1 + 0.3 * np.cos(about)
    corners = np.stack([radius * np.cos(around), radius * np.sin(around), 0.3 * np.sin(about)], axis=2).reshape(-1, 3)
    here = np.arange(40000).reshape(400, 100)
    right, up, both = np.roll(here, -1, 0), np.roll(here, -1, 1), np.roll(here, (-1, -1), (0, 1))
    faces = np.vstack([np.stack(part, axis=2).reshape(-1, 3) for part in ((here, right, both), (here, both, up))])
    (entry,) = shapes.described({"ring": (corners, faces)}).values()
    at, few = shapes.undescribed(entry)
    at = np.array(entry[:3]) + at * entry[3:6]
    assert 2000 < len(few) <= shapes.MOST and volume(at, few) == pytest.approx(volume(corners, faces), rel=0.02)
    assert np.abs(np.hypot(np.hypot(at[:, 0], at[:, 1]) - 1, at[:, 2]) - 0.3).max() < 0.02


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
        (URDF.format(weight=WEIGHT, kind="continuous", child="b", more="<dynamics damping='1' friction='0.3'/>"), {},
         "file: joint 'j' has the friction 0.3, whose force jumps"),
        (URDF.format(weight=WEIGHT, kind="continuous", child="b", more="<mimic joint='k'/>"), {},
         "file: joint 'j' mimics 'k', which is not there"),
        (URDF.format(weight=WEIGHT, kind="continuous", child="b", more="<mimic joint='j'/>"), {},
         "file: joint 'j' mimics 'j', which mimics; name one that moves by itself"),
        (URDF.format(weight=WEIGHT, kind="continuous", child="b", more="").replace("<joint", "<link name='b'/><joint"),
         {}, "file: two links are named 'b'; rename one"),
        (URDF.format(weight=WEIGHT, kind="continuous", child="b", more=""), {"gravity": [0.0, 9.8]},
         "gravity: [0.0, 9.8]; give m/s^2 along"),
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


@pytest.mark.parametrize(
    "option",
    [
        '<option gravity="1 -2 3"/>', "", '<option gravity="0 0 0"/>',
        '<option><flag gravity="disable"/></option>', '<option><flag spring="disable" damper="disable"/></option>',
    ],
)  # fmt: skip
def test_gravity_and_flags_of_mjcf_are_its_own(tmp_path, option):
    """Size, direction, MuJoCo's own 9.81 where nothing is said, and what a flag turns off."""
    text = TREE.replace('<option gravity="0 0 -9.80665"/>', option)
    (tmp_path / "tree.xml").write_text(text)
    agree(of.robot(tmp_path / "tree.xml"), mujoco.MjModel.from_xml_string(text), within=1e-12)


def test_gravity_that_is_given_replaces_the_files(tmp_path):
    (tmp_path / "tree.xml").write_text(TREE)
    one = mujoco.MjModel.from_xml_string(TREE)
    for given, theirs in ((3.0, (0, 0, -3)), ([1.0, 2.0, 3.0], (1, 2, 3))):
        one.opt.gravity[:] = theirs
        agree(of.robot(tmp_path / "tree.xml", gravity=given), one, within=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('damping="0.2"', 'frictionloss="0.2"', "file: joint 'yaw' has the friction 0.2, whose force jumps"),
        ('type="hinge" axis="0 0 1" damping="0.2"', 'type="ball" damping="0.2"', "file: the spherical joint 'yaw' has"),
        ('damping="0.2"', 'damping="0.2 0.1"', "file: dampingpoly of dof 'yaw' acts in MuJoCo"),
        ('stiffness="3"', 'stiffness="3 1"', "file: stiffnesspoly of jnt 'left' acts in MuJoCo"),
        ("<option ", '<option density="1.2" ', "file: density (drag of a fluid) acts in MuJoCo and is not known here"),
        ('<body name="hand"', '<body name="hand" gravcomp="1"', "file: gravcomp of body 'hand' acts in MuJoCo"),
        ("</worldbody>", '</worldbody><equality><joint joint1="slide" joint2="left" polycoef="0 1 1 0 0"/></equality>',
         "file: equality 0 (mjEQ_JOINT) acts in MuJoCo"),
        ("</worldbody>", '</worldbody><equality><connect body1="hand" body2="piston" anchor="0 0 0"/>'
         '<connect name="pin" body1="trunk" anchor="0.1 0 0"/></equality>',
         "joints: over-constrained, joint 'equality0' between 'left_arm' and 'piston', joint 'pin' between 'trunk'"),
        ("</worldbody>", '</worldbody><tendon><fixed stiffness="2"><joint joint="yaw" coef="1"/></fixed></tendon>',
         "file: stiffness of tendon 0 acts in MuJoCo"),
        ('name="hand"', 'name="left.arm"', "file: two bodies are named 'left_arm'; rename one"),
        ("</worldbody>", "</worldbody><bodies/>", "file: tree.xml is no MJCF that can be read (XML Error: Schema"),
    ],
)  # fmt: skip
def test_what_acts_in_mjcf_and_is_not_known_is_named(tmp_path, old, new, said):
    assert old in TREE
    (tmp_path / "tree.xml").write_text(TREE.replace(old, new))
    with pytest.raises(InputError) as caught:
        of.robot(tmp_path / "tree.xml")
    assert str(caught.value).startswith(said) and "\n" not in str(caught.value)


PLANAR = """<mujoco><compiler angle="radian"/><option gravity="0 0 -9.81" density="{density}"/><worldbody>
<body name="torso" pos="0 0 1.2" quat="0.9 0.1 0.2 0.3">
  <joint name="rootx" type="slide" axis="1 0 0" armature="0.1"/>
  <joint name="rootz" type="slide" axis="0 0 1" ref="1.2"/>
  <joint name="rooty" type="hinge" axis="0 1 0" pos="0.1 0.2 -0.1" damping="0.2" stiffness="2" springref="0.3"
    ref="0.1" frictionloss="{loss}"/>
  <geom type="capsule" fromto="0 0 -0.2 0 0 0.3" size="0.07"/>
  <body name="leg" pos="0.1 0 -0.2">
    <joint name="knee" type="hinge" axis="0 1 0" pos="0 0 0.05"/><joint name="roll" type="hinge" axis="1 0 0"/>
    <geom type="capsule" fromto="0 0 0 0 0.1 -0.4" size="0.05"/>
    <body name="foot" pos="0 0.1 -0.4"><joint name="ankle" type="hinge" axis="0 1 0" pos="-0.05 0 0"/>
      <geom type="box" size="0.1 0.05 0.02" pos="0.05 0 -0.02"/></body>
  </body></body></worldbody></mujoco>"""


def test_several_joints_of_a_body_off_its_origin_and_counted_from_ref(tmp_path):
    """The idiom of every planar walker; ours are 0 as drawn, MuJoCo's is its ref there."""
    text = PLANAR.format(density=0, loss=0)
    (tmp_path / "walker.xml").write_text(text)
    model, one = of.robot(tmp_path / "walker.xml"), mujoco.MjModel.from_xml_string(text)
    names = [one.joint(k).name for k in range(one.njnt)]
    place = [names.index(name) for name in model.state_names[:6]]
    for q, v in np.random.default_rng(5).normal(size=(4, 2, 6)):
        theirs = mujoco_acceleration(one, one.qpos0 + q, v)[place]
        ours = model.acceleration(0.0, q[place], v[place], model.parameter_values).full().ravel()
        assert ours == pytest.approx(theirs, rel=1e-10, abs=1e-10 * np.abs(theirs).max())
    assert [name for name in model.parameter_names if name.endswith("mass")] == ["torso_mass", "leg_mass", "foot_mass"]


def test_what_is_to_be_ignored_is_in_the_record(tmp_path):
    """Dry friction, a fluid, a tendon and a weld, each refused by name, and left out where that is said."""
    text = PLANAR.format(density=1.2, loss=0.2).replace(
        "</worldbody>",
        """</worldbody>
      <tendon><fixed stiffness="2"><joint joint="knee" coef="1"/></fixed></tendon>
      <equality><weld body1="foot" body2="torso"/></equality>""",
    )
    (tmp_path / "walker.xml").write_text(text)
    everything = ["fluid", "tendons", "equalities", "friction"]
    for k in (0, 3):
        with pytest.raises(InputError, match="acts in MuJoCo and is not known|whose force jumps"):
            of.robot(tmp_path / "walker.xml", ignore=everything[:k])
    model = of.robot(tmp_path / "walker.xml", ignore=everything)
    (tmp_path / "plain.xml").write_text(PLANAR.format(density=0, loss=0))
    plain = of.robot(tmp_path / "plain.xml")
    assert model.system["drawn"]["ignored"] == sorted(everything) and "ignored" not in plain.system["drawn"]
    q, v = np.random.default_rng(6).normal(size=(2, 6))
    assert np.array_equal(*(one.acceleration(0, q, v, one.parameter_values).full() for one in (model, plain)))
    with pytest.raises(InputError, match="ignore: unknown 'frictions', did you mean 'friction'"):
        of.robot(tmp_path / "walker.xml", ignore=["frictions"])


def test_a_ball_joint_falls_as_mujocos(tmp_path):
    """At angles 0, where the rates of angles are those of the turn."""
    text = TREE.replace('type="hinge" axis="0 0 1" damping="0.2" armature="0.03"', 'type="ball"')
    (tmp_path / "ball.xml").write_text(text)
    model, one = of.robot(tmp_path / "ball.xml"), mujoco.MjModel.from_xml_string(text)
    q, v = np.array([0, 0, 0, 0.3, 0.1]), np.array([0, 0, 0, 0.5, -0.4])
    data = mujoco.MjData(one)
    data.qpos[4:], data.qvel[3:] = q[3:], v[3:]
    mujoco.mj_forward(one, data)
    ours = model.acceleration(0.0, q, v, model.parameter_values).full().ravel()
    x, y, z = data.qacc[:3]  # ours point down, right and towards us
    assert ours == pytest.approx([-z, y, x, *data.qacc[3:]], rel=1e-10)


def test_links_without_mass_between_others_and_any_name(tmp_path):
    """A universal joint as two hinges; names that CasADi would not take, and a file that its parser would not."""
    link = "<link name='{0}'>{1}</link>"
    hinge = "<joint name='{0}' type='continuous'><parent link='{1}'/><child link='{2}'/><axis xyz='{3}'/></joint>"
    weight = WEIGHT.replace("<mass", "<origin xyz='0.1 0 -0.5'/><mass")
    (tmp_path / "two.urdf").write_text("<robot>" + "".join([
        link.format("a", ""), link.format("between", ""), link.format("b", weight), "<transmission name='t'/>",
        hinge.format("_x::__1", "a", "between", "1 0 0"), hinge.format("r__phi", "between", "b", "0 1 0"),
        "<material name='m'><texture/></material></robot>",
    ]))  # fmt: skip
    model = of.robot(tmp_path / "two.urdf")
    assert model.state_names[:2] == ("_x____1", "r__phi") and "between_mass" not in model.parameter_names
    spin = of.robot(tmp_path / "two.urdf", gravity=0.0)
    rest = model.acceleration(0, [0, 0], [0, 0], model.parameter_values).full().ravel()
    assert rest == pytest.approx([0, 0.1 * GRAVITY / (1 + 0.5**2 + 0.1**2)], abs=1e-12)
    text = of.equations(kinetic="rdot^2/2 + r^2*r__phidot^2/2", potential="r^2/2", coordinates=["r", "r__phi"])
    for cyclic, name in ((spin, "_x____1"), (text, "r__phi")):
        assert f"momentum_{name}" in [one.name for one in cyclic.invariants]


def test_a_damping_that_is_given_stands_for_friction(tmp_path):
    (tmp_path / "tree.xml").write_text(TREE.replace('damping="0.2"', 'frictionloss="0.2"'))
    assert "yaw_damper_damping" not in of.robot(tmp_path / "tree.xml", damping={"yaw": 0.0}).parameter_names
    (tmp_path / "tree.xml").write_text(
        TREE.replace('damping="0.2"', 'frictionloss="0.2"').replace(
            "<option ", "<option><flag frictionloss='disable'/></option><option "
        )
    )
    assert of.robot(tmp_path / "tree.xml").degrees_of_freedom == 3


GRIPPER = """<robot name="gripper"><link name="base"/>
<link name="hand"><inertial><origin xyz="0.1 0 -0.3"/><mass value="1.5"/>
<inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="0" iyz="0"/></inertial></link>
<link name="left"><inertial><origin xyz="0 0.02 -0.1"/><mass value="0.2"/>
<inertia ixx="0.002" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="right"><inertial><origin xyz="0.01 -0.02 -0.1"/><mass value="0.3"/>
<inertia ixx="0.001" iyy="0.002" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="wrist" type="continuous"><parent link="base"/><child link="hand"/><axis xyz="0 1 0"/></joint>
<joint name="left_finger" type="revolute"><parent link="hand"/><child link="left"/><origin xyz="0 0.05 -0.5"/>
<axis xyz="1 0 0"/><limit lower="-0.4" upper="0.5" effort="2" velocity="1"/><dynamics damping="0.3"/></joint>
<joint name="right_finger" type="revolute"><parent link="hand"/><child link="right"/><origin xyz="0 -0.05 -0.5"/>
<axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="2" velocity="1"/>
<dynamics damping="0.1"/>{mimic}</joint></robot>"""
MIMIC = '<mimic joint="left_finger" multiplier="-0.7" offset="0.2"/>'


def test_a_joint_that_mimics_another_follows_it(tmp_path):
    """Gauss: with q = B y + c the accelerations are those of B^T M B y'' = B^T (M q'')_free, M and q'' by MuJoCo."""
    (tmp_path / "free.urdf").write_text(GRIPPER.format(mimic=""))
    (tmp_path / "gripper.urdf").write_text(GRIPPER.format(mimic=MIMIC))
    model = of.robot(tmp_path / "gripper.urdf")
    assert model.state_names[:2] == ("wrist", "left_finger") and "right_finger_ratio" in model.parameter_names
    one = mujoco.MjModel.from_xml_path(str(tmp_path / "free.urdf"))
    one.opt.gravity[:], one.jnt_limited[:] = (0, 0, -GRAVITY), 0
    lead, random, data = np.array([[1, 0], [0, 1], [0, -0.7]]), np.random.default_rng(2), mujoco.MjData(one)
    for _ in range(4):
        y, rate = random.normal(size=(2, 2))
        data.qpos[:], data.qvel[:] = lead @ y + [0, 0, 0.2], lead @ rate
        mujoco.mj_forward(one, data)
        mass = np.zeros((3, 3))
        mujoco.mj_fullM(one, mass, data.qM) if hasattr(data, "qM") else mujoco.mj_fullM(one, data, mass)
        wanted = np.linalg.solve(lead.T @ mass @ lead, lead.T @ mass @ data.qacc)
        ours = model.acceleration(0.0, y, rate, model.parameter_values).full().ravel()
        assert ours == pytest.approx(wanted, rel=1e-12, abs=1e-12 * np.abs(wanted).max())


def test_a_joint_that_mimics_one_that_is_locked_is_locked_where_that_holds_it(tmp_path):
    (tmp_path / "free.urdf").write_text(GRIPPER.format(mimic=""))
    (tmp_path / "gripper.urdf").write_text(GRIPPER.format(mimic=MIMIC))
    one = of.robot(tmp_path / "gripper.urdf", locked={"left_finger": 0.3})
    other = of.robot(tmp_path / "free.urdf", locked={"left_finger": 0.3, "right_finger": 0.2 - 0.7 * 0.3})
    assert one.system["bodies"] == other.system["bodies"] and one.system["joints"] == other.system["joints"]


def test_an_equality_of_two_joints_of_mjcf_is_one_that_mimics(tmp_path):
    said = '<equality><joint joint1="slide" joint2="left" polycoef="0.1 0.4 0 0 0"/></equality></mujoco>'
    (tmp_path / "tree.xml").write_text(TREE.replace("</mujoco>", said))
    model = of.robot(tmp_path / "tree.xml")
    assert model.state_names[:2] == ("yaw", "left") and model.degrees_of_freedom == 2
    assert model.system["joints"]["slide"]["mimics"] == ["left", 0.4, 0.1]


def test_an_orbit_of_a_robot_that_mimics_is_found_and_certified_and_its_stops_are_said(tmp_path):
    """A mode of the gripper, damping taken out; swung wider than its finger goes, which is said."""
    (tmp_path / "gripper.urdf").write_text(GRIPPER.format(mimic=MIMIC))
    model = of.robot(tmp_path / "gripper.urdf", damping=0.0, stiffness={"left_finger": 2.0})
    assert model.system["joints"]["left_finger"]["range"] == [-0.4, 0.5]
    small = of.find_orbit(of.Problem(model, of.guesses.normal_mode(model, 2, 0.05)))
    assert small.certificate.passed, small.certificate.failures
    with pytest.warns(of.errors.Hint, match=r"joints.left_finger.range: the orbit goes from .* where no stop acts"):
        of.find_orbit(of.Problem(model, of.guesses.normal_mode(model, 2, 0.7)))


@pytest.mark.parametrize("text", [
    "<mujoco><size nkey='2000000000'/><worldbody><body><joint/><geom size='1'/></body></worldbody></mujoco>",
    "<mujoco><worldbody><replicate count='100000000' euler='0 0 1'><body><joint/><geom size='1'/></body></replicate>"
    "</worldbody></mujoco>",
    pytest.param(
        "<mujoco><worldbody><replicate count='3000' euler='0 0 1'><body><joint/><geom size='1'/></body></replicate>"
        "</worldbody></mujoco>", marks=pytest.mark.slow,
    ),
])  # fmt: skip
def test_a_small_file_that_asks_for_very_much_is_refused_in_time(tmp_path, monkeypatch, text):
    monkeypatch.setattr("orbitfinder.mechanisms.robot.SECONDS", 4.0 if "'3000'" in text else 2.0)
    (tmp_path / "huge.xml").write_text(text)
    began = time.monotonic()
    with pytest.raises(InputError, match=r"file: (huge.xml was not read within|3001 bodies)"):
        of.robot(tmp_path / "huge.xml")
    assert time.monotonic() - began < 20.0


def test_a_large_file_is_refused(tmp_path):
    """By its bytes before it is read, by its bodies before a mechanism is made of them."""
    text = URDF.format(weight=WEIGHT, kind="continuous", child="b", more="")
    (tmp_path / "large.urdf").write_text(text + " " * 4_000_000)
    with pytest.raises(InputError, match=r"file: .*large.urdf: 40\d+ bytes are too large .* the limit is 4000000"):
        of.robot(tmp_path / "large.urdf")
    more = (f"<link name='x{k}'/><joint name='y{k}' type='fixed'><parent link='b'/><child link='x{k}'/></joint>"
            for k in range(999))  # fmt: skip
    (tmp_path / "large.urdf").write_text(text.replace("</robot>", "".join(more) + "</robot>"))
    with pytest.raises(InputError, match="file: 1001 bodies, 1000 can be read; give a part of the robot"):
        of.robot(tmp_path / "large.urdf")


def test_a_limit_of_time_ends_the_reading(tmp_path):
    (tmp_path / "huge.xml").write_text("<mujoco><worldbody><replicate count='100000000' euler='0 0 1'><body><joint/>"
                                       "<geom size='1'/></body></replicate></worldbody></mujoco>")  # fmt: skip
    began = time.monotonic()
    with pytest.raises(of.errors.LimitError, match="stopped after 2 s"), of.limited(2.0):
        of.robot(tmp_path / "huge.xml")
    assert time.monotonic() - began < 15.0


def test_nothing_is_written_where_one_works(tmp_path, monkeypatch):
    """MuJoCo writes its warnings into MUJOCO_LOG.TXT in the current folder, which is not the caller's."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("orbitfinder.mechanisms.robot.SECONDS", 2.0)
    Path("tree.xml").write_text(TREE.replace('pos="0 0 -0.5">', 'pos="0 0 -0.5"><geom type="mesh" mesh="gone"/>'))
    with pytest.raises(InputError):
        of.robot("tree.xml")
    Path("tree.xml").write_text("<mujoco><size nkey='2000000000'/><worldbody/></mujoco>")
    with pytest.raises(InputError):
        of.robot("tree.xml")
    assert [one.name for one in tmp_path.iterdir()] == ["tree.xml"]


def test_comments_of_any_length_and_other_encodings(tmp_path):
    text = ARM.read_text(encoding="utf-8")
    _, body = text.split("?>", 1) if text.startswith("<?xml") else ("", text)
    long = f"<?xml version='1.0'?><!-- {'of no use ' * 1000} -->{body}"
    (tmp_path / "long.urdf").write_text(long)
    (tmp_path / "wide.urdf").write_bytes(long.replace("'1.0'", "'1.0' encoding='UTF-16'").encode("utf-16"))
    for name in ("long.urdf", "wide.urdf"):
        assert of.robot(tmp_path / name).parameter_names == of.robot(ARM).parameter_names
    (tmp_path / "wide.xml").write_bytes(TREE.encode("utf-16"))
    assert (tmp_path / "wide.xml").read_bytes()[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    with pytest.raises(InputError, match=r"file: wide.xml is UTF-16, which MuJoCo does not read; save it as UTF-8"):
        of.robot(tmp_path / "wide.xml")
    (tmp_path / "long.xml").write_text(f"<!-- {'of no use ' * 1000} -->{TREE}")
    assert of.robot(tmp_path / "long.xml").degrees_of_freedom == 3
