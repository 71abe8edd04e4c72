"""Hostile files of every kind, made from sound ones by a seed, through the readers and commands in watched processes.

`python -m benchmarks.hostile --count 30000` prints how many of each kind were read and refused, and every fault: a
death, a traceback, a warning, a refusal without a remedy, more than 1.5 GB, or later than the limit and 3 s. A fault is
made again by its kind and number: `python -m benchmarks.hostile --kind npz --first 17 --count 1`. Exit code 0: none.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import io
import json
import re
import resource
import select
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
import zipfile
from collections import Counter
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
SAMPLES = ROOT / "tests" / "data" / "hostile"
SEED, LIMIT, LATE, MEMORY = 58, 5.0, 3.0, 1_500_000_000
VERBS = {
    "show": ["show"], "plot": ["plot"], "csv": ["export", "--to", "csv"], "c": ["export", "--to", "c"],
    "julia": ["export", "--to", "julia"], "auto": ["export", "--to", "auto"], "page": ["page"],
    "verify": ["verify"], "prove": ["verify", "--proof"], "animate": ["animate", "--pixels", "64"],
}  # fmt: skip
"""What a record is given to; --out and --limit are added where a verb takes them"""


REMEDY = re.compile(r";|limit|did you mean|\b(musts?|needs?|expected|give|use|try)\b", re.IGNORECASE)
"""What a refusal says besides what is wrong"""


def deep(levels: int = 3000) -> str:
    """JSON nested this deep, as text: `json.dumps` itself could not write it."""
    return "[" * levels + "]" * levels


VALUES = (
    None, True, False, "", "x", "1.0", "\ud800", "a\nb\x1b[2J", -1, 0, 1, 2**31, 2**63, -(10**30), 10**400, 0.0, -1.0,
    1e-320, 1e300, -1e308, float("nan"), float("inf"), [], {}, [[]], [None], {"a": 1}, [1.0, [2.0]],
    [[1.0], [1.0, 2.0]], "x" * 5000, [0.0] * 3000, "DEEP", ["DEEP"], "../../etc/passwd", "none", "brake", "python",
)  # fmt: skip


def containers(document):
    """Every list and table in a document."""
    inside = document.values() if isinstance(document, dict) else document
    yield document
    for one in inside:
        if isinstance(one, (dict, list)):
            yield from containers(one)


def edited(document, random):
    """A document with one to three entries dropped, doubled, renamed, exchanged, or replaced by something else."""
    made = copy.deepcopy(document)
    for _ in range(random.integers(1, 4)):
        places = [one for one in containers(made) if one]
        if not places:
            break
        place = places[random.integers(len(places) if random.random() < 0.7 else min(8, len(places)))]
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        key, value = keys[random.integers(len(keys))], VALUES[random.integers(len(VALUES))]
        act = random.choice(["drop", "value", "value", "value", "double", "other", "scale"])
        if act == "drop":
            del place[key]
        elif act == "double" and isinstance(place, list):
            place.insert(key, copy.deepcopy(place[key]))
        elif act == "double":
            place[f"{key}x"] = place.pop(key)
        elif act == "other":
            place[key] = copy.deepcopy(place[keys[random.integers(len(keys))]])
        elif act == "scale" and isinstance(place[key], float):
            place[key] *= float(random.choice([-1.0, 1e-9, 1 + 1e-9, 2.0, 1e12]))
        else:
            place[key] = copy.deepcopy(value)
    return made


def written(document):
    """JSON text of a mutant, its deep places made deep."""
    return json.dumps(document).replace('"DEEP"', deep()).encode()


def garbled(data, random):
    """Bytes flipped, cut, taken out, doubled, blanked or put in."""
    made = bytearray(data)
    for _ in range(random.integers(1, 6)):
        at, size = int(random.integers(len(made) + 1)), int(random.integers(1, 40))
        act = random.choice(["flip", "flip", "cut", "out", "double", "blank", "in"])
        if act == "flip" and at < len(made):
            made[at] ^= 1 << int(random.integers(8))
        elif act == "cut":
            del made[max(at, len(made) // 8) :]
        elif act == "out":
            del made[at : at + size]
        elif act == "double":
            made[at:at] = made[at : at + size]
        elif act == "blank":
            made[at : at + size] = bytes(len(made[at : at + size]))
        else:
            made[at:at] = random.bytes(size)
    return bytes(made)


WORDS = ("-1", "0", "1e300", "nan", "-inf", "1" * 5000, str(2**63), "true", '""', '"x"', "[]", "[[]]", "{}",
         "{ a = 1 }", "[1.0, 'x']", "1979-05-27", '"\\u0000"', "[" * 3000, "0.5", '"linkage"')  # fmt: skip


def edited_toml(text, random):
    """The lines of a TOML file dropped, doubled, moved, renamed or given other values."""
    lines = text.splitlines()
    for _ in range(random.integers(1, 4)):
        at = int(random.integers(len(lines)))
        key, equals, value = lines[at].partition("=")
        act, word = random.choice(["drop", "double", "move", "rename", "value", "value", "entry"]), random.choice(WORDS)
        if act == "drop" and len(lines) > 1:
            del lines[at]
        elif act == "double":
            lines.insert(at, lines[at])
        elif act == "move":
            lines.insert(int(random.integers(len(lines))), lines.pop(at))
        elif act == "rename" and equals:
            lines[at] = f"{key.strip()}{random.choice(['x', '.a', ' .'])} = {value}"
        elif act == "entry":
            numbers = list(re.finditer(r"-?\d[\d.e+-]*", value))
            if numbers:
                one = numbers[random.integers(len(numbers))]
                lines[at] = f"{key}={value[: one.start()]}{word}{value[one.end() :]}"
        elif equals:
            lines[at] = f"{key}= {word}"
    return "\n".join(lines) + "\n"


NUMBERS = ("-1", "0", "1e308", "-1e308", "nan", "inf", "1e-320", "9" * 30, "9" * 20000, "100000000", "2147483648", "x",
           "", "0x7f", "1.5", "-0", "1 2 3", "\x00", "é")  # fmt: skip


def renumbered(text, random):
    """A text in which some numbers, words or lines are others."""
    for _ in range(random.integers(1, 4)):
        act = random.choice(["number", "number", "number", "word", "line", "swap", "many"])
        found = list(re.finditer(r"\w+" if act == "word" else r"-?\d[\d.eE+-]*", text))
        lines = text.splitlines()
        if act in ("number", "word") and found:
            one = found[random.integers(len(found))]
            text = text[: one.start()] + str(random.choice(NUMBERS)) + text[one.end() :]
        elif act == "line" and len(lines) > 1:
            del lines[random.integers(len(lines))]
            text = "\n".join(lines)
        elif act == "swap" and len(lines) > 1:
            lines.insert(int(random.integers(len(lines))), lines[random.integers(len(lines))])
            text = "\n".join(lines)
        elif act == "many" and lines:
            k = int(random.integers(len(lines)))
            lines[k] = lines[k] * min(int(random.choice([2, 30, 3000])), 1_000_000 // (len(lines[k]) + 1))
            text = "\n".join(lines)
    return text


def renamed_npz(path, random):
    """The arrays of a .npz of which one is missing or another."""
    with np.load(path) as data:
        made = dict(data)
    name = sorted(made)[random.integers(len(made))]
    one = made[name]
    other = (
        lambda: one[:-1], lambda: one[..., None], lambda: one.astype("f4"), lambda: one.astype(complex),
        lambda: one.astype(str), lambda: one * np.nan, lambda: -one, lambda: one[::-1], lambda: np.zeros(0),
        lambda: np.array(3.0), lambda: one.astype(">f8"), lambda: np.full(one.shape, 2**62), lambda: one.astype(bool),
        lambda: np.asfortranarray(one), lambda: one + 1e12, lambda: np.zeros(3, "datetime64[s]"), lambda: None,
        lambda: one * 1e308, lambda: np.full(one.shape, -100_000_000), lambda: np.zeros((3000, 3000)),
        lambda: one.astype(object), lambda: np.array([2**40, 2**40]), lambda: np.resize(one, one.size + 1),
    )[random.integers(23)]  # fmt: skip
    del made[name]
    with (
        contextlib.suppress(TypeError, ValueError, IndexError, np.exceptions.DTypePromotionError),
        np.errstate(all="ignore"),
    ):
        if (new := other()) is not None:
            made[name] = new
    buffer = io.BytesIO()
    (np.savez if random.random() < 0.5 else np.savez_compressed)(buffer, **made)
    return buffer.getvalue()


def bomb(data, random):
    """A .npz, one of whose members says that it is larger than it is, or is."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = sorted(members)[random.integers(len(members))]
    head = np.lib.format.header_data_from_array_1_0(np.zeros(1))
    buffer, size = io.BytesIO(), int(random.choice([10**6, 10**9, 10**12]))
    np.lib.format.write_array_header_1_0(buffer, head | {"shape": (size,)})
    members[name] = buffer.getvalue() + bytes(8 * 10**6 if random.random() < 0.3 else 80)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for each, content in members.items():
            archive.writestr(each, content)
    return out.getvalue()


def matrix(random):
    """Bytes of a .npz with a matrix in one of SciPy's formats, or dense."""
    from scipy import sparse

    buffer, one = io.BytesIO(), sparse.csr_matrix(np.diag([2.0, 3.0, 1.0, 1.0]) + np.eye(4, k=1) + np.eye(4, k=-1))
    form = random.choice(["csr", "csc", "bsr", "coo", "dia", "dense"])
    if form == "dense":
        np.savez(buffer, one.toarray())
    else:
        sparse.save_npz(buffer, one.asformat(str(form)))
    return buffer.getvalue()


STRUCTURE = """name = "s"
[system]
kind = "structure"
mass = "{mass}"
stiffness = "{stiffness}"
[simulate]
state = [0.1, 0.1, 0.1, 0.1, 0.0, 0.0, 0.0, 0.0]
"""
EYE = "%%MatrixMarket matrix coordinate real symmetric\\n4 4 4\\n1 1 1.0\\n2 2 1.0\\n3 3 1.0\\n4 4 1.0\\n"
MARKETS = (
    "%%MatrixMarket matrix coordinate real symmetric\n4 4 5\n1 1 2.0\n2 1 -0.5\n2 2 2.0\n3 3 1.0\n4 4 1.0\n",
    "%%MatrixMarket matrix array real general\n2 2\n2.0\n0.0\n0.0\n2.0\n",
    "%%MatrixMarket matrix coordinate integer general\n2 2 2\n1 1 2\n2 2 2\n",
    "%%MatrixMarket matrix array real symmetric\n2 2\n2.0\n0.0\n2.0\n",
)
ODE = """# a neuron
par I=0,gca=4.4
number vk=-84, vl=-60
!gm=gca/2
minf(v)=.5*(1+tanh((v+1.2)/18))
p b=1.5e-1
init v=-60, w=0.01
aux ica=gca*v
x'=if(v>-20&w<1)then(heav(v))else(-x^2)
dv/dt=I-gca*minf(v)*(v-120)/20-gm*\\
 w*(v-vk)-2*(v-vl)
w'=0.04*(minf(v)-w)/(1+cosh(v/60))+0*vl*b
@ total=150,dt=.1,meth=cvode
done
"""
URDF = """<robot name="arm"><link name="base"/><link name="arm"><inertial><origin xyz="0 0 -0.5" rpy="0 0 0"/>
<mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><mesh filename="part.stl" scale="1 1 1"/></geometry></visual>
<visual><geometry><box size="1 2 3"/></geometry></visual></link><joint name="hinge" type="continuous">
<parent link="base"/><child link="arm"/><axis xyz="0 1 0"/><limit effort="3"/><dynamics damping="0.1"/></joint></robot>
"""
MJCF = """<mujoco model="p"><option gravity="0 0 -9.81"/><worldbody><body name="a" pos="0 0 1">
<joint name="h" type="hinge" axis="0 1 0" damping="0.1"/><geom type="capsule" size="0.05 0.2"/>
<body name="b" pos="0 0 -0.5"><joint name="k" axis="0 1 0"/><geom type="box" size="0.1 0.1 0.2"/></body></body>
</worldbody></mujoco>
"""
CORNERS = ((0, 0, 0), (1, 0, 0), (0, 2, 0), (0, 0, 4))
FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
OBJ = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS) + "f 1/1 3/2/2 2//5\nf 1 2 4\nf -4 -1 -2\nf 2 3 4\n"
STL = "solid w\n" + "".join(
    "facet normal 0 0 1 outer loop\n" + "".join("vertex {} {} {}\n".format(*CORNERS[k]) for k in face) + "endloop\n"
    for face in FACES
)  # fmt: skip
DAE = """<?xml version="1.0" encoding="utf-8"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema">
<asset><unit meter="0.02"/><up_axis>Y_UP</up_axis></asset><library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="a" count="12">0 0 0 1 0 0 0 2 0 0 0 4</float_array></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<polylist count="4"><input semantic="NORMAL" source="#s" offset="1"/>
<input semantic="VERTEX" source="#v" offset="0"/><vcount>3 3 3 3</vcount>
<p>0 7 2 7 1 7 0 7 1 7 3 7 0 7 3 7 2 7 1 7 2 7 3 7</p></polylist></mesh>
</geometry></library_geometries><library_nodes><node id="n0"><instance_geometry url="#g"/></node>
<node id="n1"><instance_node url="#n0"/><instance_node url="#n0"/></node></library_nodes><library_visual_scenes>
<visual_scene id="scene"><node><translate>0 0 0</translate><rotate>1 0 0 90</rotate><scale>0.5 0.5 0.5</scale>
<instance_node url="#n1"/></node></visual_scene></library_visual_scenes></COLLADA>
"""
AUTO = """   1   1   9   1   2   1   3   4  5   1   1  11
  0.0 1.0 0.0 0.0
  0.5 -1.0 0.0 0.0
  1.0 1.0 0.0 0.0
  0 0 0
  1 2 3 4 5 6 7 8 9 10 6.28
"""
LAW = '<math xmlns="http://www.w3.org/1998/Math/MathML"><apply><times/><ci>k</ci><ci>A</ci></apply></math>'
SBML = (
    f"""<sbml xmlns="http://www.sbml.org/sbml/level3/version2/core" level="3" version="2"><model id="m">
<listOfCompartments><compartment id="c" size="1.5" constant="true"/></listOfCompartments><listOfSpecies>
<species id="A" compartment="c" initialAmount="2" hasOnlySubstanceUnits="false" boundaryCondition="false"
constant="false"/></listOfSpecies><listOfParameters><parameter id="k" value="3e-1" constant="true"/>
<parameter id="q" value="1" constant="false"/></listOfParameters>
<listOfInitialAssignments><initialAssignment symbol="q">{LAW}</initialAssignment></listOfInitialAssignments>
<listOfRules><rateRule variable="q">{LAW}</rateRule></listOfRules>
<listOfReactions><reaction id="r" reversible="false"><listOfReactants><speciesReference species="A" constant="true"
stoichiometry="1"/></listOfReactants><kineticLaw>{LAW}</kineticLaw></reaction></listOfReactions></model></sbml>
""",
    f"""<sbml xmlns="http://www.sbml.org/sbml/level2/version4" level="2" version="4"><model id="m"><listOfCompartments>
<compartment id="c" size="2"/></listOfCompartments><listOfSpecies><species id="A" compartment="c"
initialConcentration="3"/></listOfSpecies><listOfReactions><reaction id="r"><listOfProducts><speciesReference
species="A"/></listOfProducts><kineticLaw>{LAW}<listOfParameters><parameter id="k" value="0.5"/>
</listOfParameters></kineticLaw></reaction></listOfReactions></model></sbml>
""",
)
TEXTS = {"mtx": MARKETS, "ode": (ODE,), "xml": (URDF, MJCF), "stl": (STL,), "obj": (OBJ,), "dae": (DAE,),
         "auto": (AUTO,), "sbml": SBML}  # fmt: skip
READERS = ("toml", "npz", *TEXTS)


def samples():
    """The sound records: by kind, the file of each."""
    return {path.stem: path for path in sorted(SAMPLES.glob("*.*")) if path.suffix in (".json", ".sqlite", ".jsonl")}


def kinds():
    """All kinds of mutants."""
    return (*READERS, *samples())


def mutant(kind, number, folder):
    """A hostile file of a kind and what is done with it: ("call", name, path) or ("command", words)."""
    random = np.random.default_rng([SEED, *kind.encode(), number])
    as_bytes = random.random() < 0.25
    if kind == "toml":
        files = sorted((ROOT / "problems" / "gallery").glob("*.toml"))
        data, path = files[random.integers(len(files))].read_bytes(), folder / "problem.toml"
        path.write_bytes(garbled(data, random) if as_bytes else edited_toml(data.decode(), random).encode())
        return "call", kind, path
    if kind in ("npz", "mtx"):
        path, first = folder / f"m.{kind}", random.random() < 0.5
        if kind == "npz":
            path.write_bytes(data := matrix(random))
            act = random.random()
            path.write_bytes(garbled(data, random) if as_bytes else bomb(data, random) if act < 0.3
                             else renamed_npz(path, random))  # fmt: skip
        else:
            text = MARKETS[random.integers(len(MARKETS))]
            path.write_bytes(garbled(text.encode(), random) if as_bytes else renumbered(text, random).encode())
        files = f"m.{kind}", EYE
        mass, stiffness = files if first else files[::-1]
        (folder / "problem.toml").write_text(STRUCTURE.format(mass=mass, stiffness=stiffness))
        return "call", "toml", folder / "problem.toml"
    if kind in TEXTS:
        text = TEXTS[kind][random.integers(len(TEXTS[kind]))]
        path = folder / {"auto": "s.x", "xml": "r.urdf"}.get(kind, f"part.{kind}")
        path.write_bytes(garbled(text.encode(), random) if as_bytes else renumbered(text, random).encode())
        if kind == "dae" and random.random() < 0.2:
            more = "".join(f'<node id="n{k + 1}"><instance_node url="#n{k}"/><instance_node url="#n{k}"/></node>'
                           for k in range(1, int(random.integers(2, 40))))  # fmt: skip
            last = more.count("<node") + 1
            text = DAE.replace("</library_nodes>", f"{more}</library_nodes>").replace(
                'url="#n1"/></node></visual', f'url="#n{last}"/></node></visual'
            )
            path.write_text(text)
        return "call", kind, path
    return "command", kind, _record(kind, samples()[kind], folder, random, as_bytes)


def _record(kind, sample, folder, random, as_bytes):
    """The words of a command about a record that was damaged, its .npz or itself."""
    path = folder / (f"family{sample.suffix}" if sample.suffix == ".jsonl" else f"{kind}{sample.suffix}")
    shutil.copy(sample, path)
    beside, npz = path.with_suffix(".npz"), sample.with_suffix(".npz")
    if npz.exists():
        shutil.copy(npz, beside)
    for folder_beside in SAMPLES.glob("equilibria*/") if kind == "diagram" else ():
        shutil.copytree(folder_beside, folder / folder_beside.name)
    data = sample.read_bytes()
    if npz.exists() and random.random() < 0.3:
        content = npz.read_bytes()
        act = random.random()
        beside.write_bytes(garbled(content, random) if as_bytes else bomb(content, random) if act < 0.1
                           else renamed_npz(npz, random))  # fmt: skip
        if (kind == "family") and random.random() < 0.8:
            bare = json.loads(data)
            path.write_text(json.dumps({key: value for key, value in bare.items() if key not in ("record", "dense")}))
    elif sample.suffix == ".sqlite" or as_bytes:
        path.write_bytes(garbled(data, random))
    else:
        document = edited(json.loads(data), random)
        for digest in ("record", "dense") if isinstance(document, dict) and random.random() < 0.85 else ():
            document.pop(digest, None)
        path.write_bytes(written(document))
    verb = str(random.choice(_fitting(kind) if random.random() < 0.9 else list(VERBS)))
    words = [*VERBS[verb], str(path)]
    if verb not in ("show", "verify", "prove"):
        words += ["--out", str(folder / ("out.gif" if verb == "animate" else "out"))]
    return words if verb == "show" else [*words, "--limit", f"{LIMIT:g}"]


def _fitting(kind):
    """The verbs that a kind of record answers."""
    from orbitfinder.records.registry import kinds as registry

    record = registry().get("orbit" if kind == "proof" else kind)
    asked = {"csv": "export", "c": "export", "julia": "export", "auto": "export", "prove": "verify"}
    return [verb for verb in VERBS if verb == "show" or getattr(record, asked.get(verb, verb), "")]


def done(what, kind, given):
    """What a mutant is given to. Raises whatever comes of it."""
    import orbitfinder as of
    from orbitfinder.mechanisms import shapes
    from orbitfinder.problemfile.read import load_problem_file

    calls = {"toml": load_problem_file, "ode": of.from_xpp, "xml": of.robot, "auto": of.from_auto,
             "sbml": of.from_sbml, **dict.fromkeys(("stl", "obj", "dae"), shapes.read)}  # fmt: skip
    if what == "call":
        with of.limited(LIMIT):
            calls[kind](given)
        return 0, ""
    from click.testing import CliRunner

    from orbitfinder.cli.group import cli

    result = CliRunner().invoke(cli, given)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


def tried(what):
    """How a mutant ended: "read", "refused", or what is wrong."""
    from orbitfinder.errors import Hint, OrbitfinderError

    said = ""
    try:
        with warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always")
            code, output = done(*what)
        strange = [one for one in seen if not issubclass(one.category, Hint)]
        if strange:
            one = strange[0]
            return f"warning: {one.category.__name__}: {one.message} {Path(one.filename).name}:{one.lineno}"
        if code not in (0, 1, 2):
            return f"exit code {code}"
        said = output.partition("Error: ")[2] if code == 2 else ""
        if code != 2:
            return "read"
    except OrbitfinderError as error:
        said = str(error)
    except Exception as error:  # this is what is looked for
        trace = error.__traceback__
        while trace.tb_next:
            trace = trace.tb_next
        where = f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}"
        return f"traceback: {error!r:.150} at {where}; {what[2][0] if what[0] == 'command' else what[1]}"
    if not REMEDY.search(said):
        return f"no remedy: {said[:200]!r}"
    return "refused"


def work():
    """In a process: the mutants that are asked for, a line each, answered by a line each."""
    answers = sys.stdout
    sys.stdout = sys.stderr
    with contextlib.suppress(ValueError):
        resource.setrlimit(resource.RLIMIT_AS, (8_000_000_000, 8_000_000_000))
    import matplotlib.figure  # noqa: F401  what a limit interrupts while it is imported stays half imported

    import orbitfinder.cli.group  # noqa: F401
    from orbitfinder._runtime.guard import guarded

    for line in sys.stdin:
        kind, number = line.split()
        with tempfile.TemporaryDirectory() as folder, guarded(says=False):  # as a command is
            what = mutant(kind, int(number), Path(folder))
            began = time.perf_counter()
            end = tried(what)
            seconds = time.perf_counter() - began
        peak = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        answers.write(json.dumps([end, seconds, peak]) + "\n")
        answers.flush()


class Watched:
    """A process that works, and is watched."""

    def __init__(self):
        self.process = None

    def __call__(self, kind, number):
        """How a mutant ended, and after how many seconds."""
        if self.process is None:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "benchmarks.hostile", "--work"], cwd=ROOT, stdin=subprocess.PIPE, text=True,
                stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            )  # fmt: skip
            self.process.stdin.write("toml 0\n")  # what is imported at first belongs to no mutant
            self.process.stdin.flush()
            self.process.stdout.readline()
        self.process.stdin.write(f"{kind} {number}\n")
        self.process.stdin.flush()
        if not select.select([self.process.stdout], [], [], 60.0)[0]:
            self.close()
            return "no answer within 60 s", 60.0
        line = self.process.stdout.readline()
        if not line:
            code = self.process.wait()
            self.close()
            if code == 1:  # how `guard` ends a command that does not hear its deadline
                return "refused", LIMIT
            return f"death: exit code {code}", 0.0
        end, seconds, peak = json.loads(line)
        if peak > MEMORY:
            self.close()
            return f"memory: {peak / 1e9:.1f} GB ({end})", seconds
        if seconds > LIMIT + LATE:
            return f"late: {seconds:.1f} s ({end})", seconds
        return end, seconds

    def close(self):
        """End the process."""
        if self.process is not None:
            self.process.kill()
            self.process.communicate()  # ends and closes the pipes
            self.process = None


def fuzz(chosen, first, count, budget=np.inf, say=print):
    """Mutants in turn of each kind, within a budget (s): counts of ends by kind, and the faults."""
    began, ends, faults, watched = time.perf_counter(), {kind: Counter() for kind in chosen}, [], Watched()
    try:
        for number in range(first, first + -(-count // len(chosen))):
            for kind in chosen:
                if time.perf_counter() - began > budget:
                    return ends, faults
                end, _ = watched(kind, number)
                if end not in ("read", "refused"):
                    faults.append(f"{kind} {number}: {end}")
                    say(faults[-1])
                ends[kind][end if end in ("read", "refused") else "fault"] += 1
    finally:
        watched.close()
    return ends, faults


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--work", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--count", type=int, default=30_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kind", action="append", choices=kinds())
    parser.add_argument("--budget", type=float, default=np.inf, help="s after which no more are begun")
    options = parser.parse_args()
    if options.work:
        work()
        return
    ends, faults = fuzz(options.kind or kinds(), options.first, options.count, options.budget)
    for kind, counts in ends.items():
        print(f"{kind:18}" + "".join(f"{word} {counts[word]:6}  " for word in ("read", "refused", "fault")))
    print(f"{sum(sum(counts.values()) for counts in ends.values())} mutants, {len(faults)} faults")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
