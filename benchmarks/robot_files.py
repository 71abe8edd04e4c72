"""Robots in files of others: which are read, and their accelerations beside MuJoCo's.

Every MJCF and URDF file below the folders given, with friction, fluid, tendons and equalities ignored. MJCF is compared
with `mujoco` at four seeded states, with contact, limits, actuators and what is ignored switched off: hinges and slides
number by number, the accelerations of ball and free joints, which have other coordinates here, by their norm.

    python benchmarks/robot_files.py NAME=FOLDER ...      writes results/validation/robot_files.md

The page is of the packages gymnasium 1.4.0 (gymnasium/envs), dm_control 1.0.50 (dm_control/suite) and
example-robot-data 6.0.0.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import numpy as np
from machine import processor, versions

import orbitfinder as of
from orbitfinder.errors import OrbitfinderError

PAGE = Path(__file__).parents[1] / "results" / "validation" / "robot_files.md"
IGNORED = ("friction", "fluid", "tendons", "equalities")
OFF = ("CONTACT", "LIMIT", "FRICTIONLOSS", "EQUALITY", "ACTUATION")


def beside_mujoco(model: of.Model, path: Path) -> float:
    """The largest difference of accelerations over the largest acceleration."""
    import mujoco  # of the extra [robot]; --help needs none

    turning = int(mujoco.mjtJoint.mjJNT_BALL), int(mujoco.mjtJoint.mjJNT_FREE)
    one, random, worst = mujoco.MjModel.from_xml_path(str(path)), np.random.default_rng(1), 0.0
    for name in OFF:
        one.opt.disableflags |= getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}")
    one.opt.density = one.opt.viscosity = 0.0
    one.tendon_stiffness[:], one.tendon_damping[:] = 0.0, 0.0
    data, names = mujoco.MjData(one), list(model.state_names[: model.degrees_of_freedom])
    plain = [k for k in range(one.njnt) if one.jnt_type[k] not in turning]
    here, there = [names.index(one.joint(k).name) for k in plain], one.jnt_dofadr[plain]
    rest = [np.setdiff1d(np.arange(size), own) for size, own in ((len(names), here), (one.nv, there))]
    for _ in range(4):
        mujoco.mj_resetData(one, data)
        q, v, values = np.zeros(len(names)), np.zeros(len(names)), random.uniform(-0.5, 0.5, (2, len(plain)))
        q[here], v[here] = values
        data.qpos[one.jnt_qposadr[plain]] += values[0]
        data.qvel[there] = values[1]
        mujoco.mj_forward(one, data)
        ours = model.acceleration(0.0, q, v, model.parameter_values).full().ravel()
        off = [*(ours[here] - data.qacc[there]), np.linalg.norm(ours[rest[0]]) - np.linalg.norm(data.qacc[rest[1]])]
        worst = max(worst, float(np.abs(off).max() / np.abs(data.qacc).max()))
    return worst


def main() -> None:
    """Read all, write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("packages", nargs="+", metavar="NAME=FOLDER")
    table, counts = list[str](), dict[str, list[int]]()
    for given in parser.parse_args().packages:
        name, folder = given.split("=", 1)
        for path in sorted(file for file in Path(folder).rglob("*") if file.suffix in (".xml", ".urdf")):
            if path.suffix == ".xml" and "<worldbody" not in path.read_text(encoding="utf-8"):
                continue  # what others include
            try:
                model = of.robot(path, ignore=IGNORED)
                off = f"{beside_mujoco(model, path):.1e}" if path.suffix == ".xml" else ""
                row = f"{model.degrees_of_freedom} | {off} |"
            except OrbitfinderError as error:
                row = f" | {re.sub(r'[|`]', '', str(error))[:160]} |"
            counts.setdefault(name, []).append(row[0] != " ")
            table.append(f"| {name} | {path.name} | {row}")
            print(table[-1], flush=True)
    read = [f"| {name} | {sum(each)} of {len(each)} |" for name, each in counts.items()]
    head = ["# Robots in files of others", "", "By `benchmarks/robot_files.py`, which says what is compared and how.",
            f"{processor()}, {versions('mujoco')}.", ""]  # fmt: skip
    columns = "| package | file | coordinates | accelerations beside MuJoCo's, or why it is not read |"
    lines = [*head, "| package | read |", "|---|---|", *read, "", columns, "|---|---|---|---|", *table]
    PAGE.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
