"""kill -9 at random times of what is followed: the same command ends as if it had not been, and repeats nothing."""

import json
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from orbitfinder.records.journal import read_lines

ROOT = Path(__file__).parents[1]
OTERMA = "orbits/oterma-l1/orbit.json"
RUNS = {
    "torus": (
        ["torus", str(ROOT / "results/gallery/henon-heiles-loop/orbit.json"), "--until", "0.2926242", "--no-figures"],
        "tori/henon-heiles-loop-tori/tori.json",
    ),
    "family": (
        ["continue", str(ROOT / "problems/gallery/van-der-pol.toml"), "--parameter", "damping", "--points", "40"],
        "families/van-der-pol/family.json",
    ),
    "curve": (
        ["continue", "families/forced-duffing-lower/family.json", "--curve", "0", "--parameters", "force,frequency",
         "--points", "40", "--no-figures"],
        "families/forced-duffing-lower-0-force-frequency/family.json",
        ["continue", str(ROOT / "problems/gallery/forced-duffing-lower.toml"), "--parameter", "frequency", "--until",
         "1.0", "--points", "40", "--no-figures"],
    ),
    "connection": (
        ["connect", OTERMA, "--follow", "connections/oterma-l1/connection-1.json",
         "--at", ",".join(f"-1.514{k}" for k in range(50, 34, -2))],
        "connections/oterma-l1-1/connection.jsonl",
        ["run", str(ROOT / "problems/gallery/oterma-l1.toml"), "--no-figures"],
        ["connect", OTERMA, "--plane", "y=0", "--axes", "x,xdot", "--direction", "falling", "--near", "-0.616,0",
         "--most", "1"],
    ),
    "sweep": (
        ["sweep", str(ROOT / "problems/gallery/spring-pendulum-swing.toml"), "--parameter", "stiffness=28:33:30"],
        "sweeps/spring-pendulum-swing/sweep.json",
    ),
    "workers": (
        ["sweep", str(ROOT / "problems/gallery/spring-pendulum-swing.toml"), "--parameter", "stiffness=28:33:30",
         "--workers", "2"],
        "sweeps/spring-pendulum-swing/sweep.json",
    ),
    "section": (
        ["section", str(ROOT / "problems/examples/double-mode-2.toml"), "--energy", "-14", "--plane", "theta1=0",
         "--seeds", "4", "--returns", "60"],
        "sections/double-mode-2/section.json",
    ),
    "stabilise": (
        ["stabilise", str(ROOT / "results/orbits/triple-1/orbit.json"), "--motors", "1", "--disturbances", "2",
         "--sizes", "0.03", "--periods", "20", "--noise", "0.001"],
        "controllers/triple-1/controller.json",
    ),
    "optima": (
        ["continue", str(ROOT / "problems/control/maintained-oscillator.toml"), "--parameter", "damping", "--until",
         "0.3", "--no-figures"],
        "families/maintained-oscillator/optima.json",
    ),
}  # fmt: skip
"""The command of each kind, the file that it makes, and commands that come before"""
QUICK = {"sweep": ("stiffness=28:33:30", "stiffness=28:33:12"), "torus": ("", "")}
"""Those that are killed once in the ordinary run, and what is shorter there; all are in the slow one, whole"""


def started(words, folder):
    """The command, in its folder."""
    line = [sys.executable, "-m", "orbitfinder", *words]
    return subprocess.Popen(line, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def lines(path):
    """How many lines of a journal are whole."""
    return len(read_lines(path, path.name)[0]) if path.exists() and path.stat().st_size else 0


def made(folder, file):
    """What the files say that come with one, but for the time that it took and the digest of that."""

    def told(value):
        if isinstance(value, dict):
            return {key: told(one) for key, one in value.items() if key not in ("wall_time", "record")}
        return [told(one) for one in value] if isinstance(value, list) else value

    if file.endswith(".jsonl"):
        return told(list(map(json.loads, (folder / file).read_text().splitlines())))
    home = (folder / file).parent
    documents = {one.relative_to(home): told(json.loads(one.read_text())) for one in home.rglob("*.json")}
    for one in home.rglob("*.npz"):
        with np.load(one) as arrays:
            documents[one.relative_to(home)] = {name: arrays[name].tobytes() for name in arrays}
    return documents


@pytest.mark.parametrize("kind", QUICK)
def test_killed_once(kind, tmp_path):
    """As soon as the journal has a few lines."""
    whole, short = QUICK[kind]
    words, *rest = RUNS[kind]
    killed(([short if word == whole else word for word in words], *rest), tmp_path, kills=1, seed=0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", RUNS)
def test_killed_eight_times(kind, tmp_path):
    """Whenever it comes: while it starts, while it computes, while it writes."""
    killed(RUNS[kind], tmp_path, kills=8, seed=1)


def killed(run, tmp_path, kills, seed):
    words, file, *before = run
    calm, rough = tmp_path / "calm", tmp_path / "rough"
    calm.mkdir()
    for first in before:
        assert started(first, calm).wait() in (0, 1)  # its event may stand at no certified orbit
    shutil.copytree(calm, rough)
    began = time.monotonic()
    assert started(words, calm).wait() == 0
    longest, rng = time.monotonic() - began, random.Random(seed)
    journal = (rough / file).with_suffix(".jsonl")
    seen = 0
    for turn in range(kills):
        process = started(words, rough)
        if turn == 0:
            while lines(journal) < 4 and process.poll() is None:
                time.sleep(0.01)
        else:
            time.sleep(rng.uniform(0.2, 1.0) * longest)
        process.kill()
        process.wait()
        assert lines(journal) >= seen, "a line was lost"
        seen = lines(journal)
    assert seen >= 4
    before = b"".join(line for line in journal.read_bytes().splitlines(keepends=True) if line.endswith(b"\n"))
    assert started(words, rough).wait() == 0
    assert journal.read_bytes().startswith(before), "what was known was computed again"
    assert made(rough, file) == made(calm, file)
