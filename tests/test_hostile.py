"""A file is hostile until it is read: what a stranger may have written is refused in a sentence, in time and in memory.

Every kind of file that `benchmarks.hostile` makes is tried by a few seeds here and for a minute in a slow test.
"""

import ast
import io
import json
import re
import shutil
import subprocess
import sys
import time
import tomllib
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import sparse

import orbitfinder as of
from benchmarks import hostile
from orbitfinder._runtime.inert import inert
from orbitfinder.cli.group import cli
from orbitfinder.control.controller import load_controller
from orbitfinder.control.export import c_text, gains_text, python_text
from orbitfinder.errors import Hint, InputError, LimitError
from orbitfinder.exports.auto import constants, equations
from orbitfinder.exports.c99 import c_files
from orbitfinder.exports.feedforward import control_files
from orbitfinder.exports.julia import julia_files
from orbitfinder.exports.source import source_of
from orbitfinder.integrate import compiled
from orbitfinder.mechanisms import robot, shapes, structure
from orbitfinder.problemfile.write import orbit_text
from orbitfinder.problemfile.xpp import from_xpp
from orbitfinder.proof.balls import why_not
from orbitfinder.records.journal import sealed_line
from orbitfinder.records.orbit import orbit_to_document
from orbitfinder.records.reading import npz_members
from orbitfinder.records.registry import load_orbit

ROOT = Path(__file__).parents[1]
SAMPLES = hostile.SAMPLES
EYE = np.eye(2)


def npz(**members):
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **members)
    return buffer.getvalue()


def packed(**others):
    """The arrays of a csr matrix as SciPy saves it, some of them others."""
    return npz(**{"format": np.array(b"csr"), "shape": np.array([2, 2]), "data": np.ones(2),
                  "indices": np.array([0, 1], "i4"), "indptr": np.array([0, 1, 2], "i4")} | others)  # fmt: skip


# ------------------------------------------------------------------------------------------------- matrices


MATRICES = {
    "below": packed(indices=np.array([0, -100_000_000], "i4")),
    "beyond": packed(indices=np.array([0, 2], "i4")),
    "pointers": packed(indptr=np.array([0, 2_000_000_000, 2], "i4")),
    "falling": packed(indptr=np.array([0, 3, 2], "i4")),
    "negative": packed(indptr=np.array([-5, 1, 2], "i4")),
    "columns": packed(format=np.array(b"csc"), indices=np.array([0, 10**8], "i4")),
    "blocks": packed(format=np.array(b"bsr"), data=np.ones((2, 1, 1)), indices=np.array([0, -7], "i4")),
    "block-pointers": packed(format=np.array(b"bsr"), data=np.ones((2, 1, 1)), indptr=np.array([0, 9**9, 2])),
    "coordinates": npz(
        format=np.array(b"coo"), shape=np.array([2, 2]), data=np.ones(2), row=np.array([0, 5]), col=np.array([0, -1])
    ),
    "shape": packed(shape=np.array([-2, 2])),
    "wide": packed(shape=np.array([2, 10**12])),
    "floats": packed(indices=np.array([0.0, np.nan])),
    "form": packed(format=np.array(b"evil")),
    "no-form": packed(format=np.ones((3000, 3000))),
    "no-data": npz(format=np.array(b"csr"), shape=np.array([2, 2])),
    "number": packed(format=np.array(3.0)),
    "objects": npz(a=np.array([{}, {}], object)),
    "several": npz(a=EYE, b=EYE),
    "long": npz(a=np.ones((1, 2))),
}


@pytest.mark.parametrize("name", MATRICES)
def test_compiled_code_gets_no_matrix_of_a_hostile_npz(name, tmp_path):
    """csr with indices [0, -100000000] was a segmentation fault, indices barely outside were read."""
    (tmp_path / "m.npz").write_bytes(MATRICES[name])
    for given in ((tmp_path / "m.npz", EYE), (EYE, tmp_path / "m.npz")):
        with pytest.raises(InputError, match=r"^(mass|stiffness): .*(; give|wanted)"):
            of.structure(given[0], None, given[1])


@pytest.mark.parametrize("form", ["csr", "csc", "bsr", "coo", "dia"])
def test_scipys_own_files_are_read(form, tmp_path):
    sparse.save_npz(tmp_path / "m.npz", sparse.csr_matrix([[2.0, 1.0], [1.0, 3.0]]).asformat(form))
    model = of.structure(tmp_path / "m.npz", None, EYE)
    assert structure.market(structure._matrix("mass", tmp_path / "m.npz")) == model.system["mass"]


HUGE = 100_000_000
LARGE = {
    "coordinate": f"%%MatrixMarket matrix coordinate real general\n{HUGE} {HUGE} 1\n1 1 1.0",
    "symmetric": f"%%MatrixMarket matrix coordinate real symmetric\n{HUGE} {HUGE} 2\n1 1 1.0\n2 1 1.0",
    "array": f"%%MatrixMarket matrix array real general\n{HUGE} {HUGE}\n1.0",
    "dense": f"%%MatrixMarket matrix array real symmetric\n{HUGE} {HUGE}\n1.0",
    "count": f"%%MatrixMarket matrix coordinate real general\n2 2 {HUGE}\n1 1 1.0",
    "infinite": "%%MatrixMarket matrix coordinate real general\ninf nan 1\n1 1 1.0",
    "negative": "%%MatrixMarket matrix array real general\n-3 -3\n1.0",
}


def peak(work):
    """The most memory that something takes, in bytes."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("name", LARGE)
def test_a_declared_size_is_compared_with_what_is_there(name):
    """74 bytes took 10.9 GB."""

    def read():
        for mass, stiffness in ((LARGE[name], EYE), (EYE, LARGE[name])):
            with pytest.raises(InputError, match=r"^(mass|stiffness): "):
                of.structure(mass, None, stiffness)

    assert peak(read) < 20e6


def test_a_bomb_is_not_expanded(tmp_path):
    """8 MB that stand for 7.9 GB are refused before; here 6 kB for 6 MB."""
    (tmp_path / "m.npz").write_bytes(npz(a=np.zeros(800_000)))

    def read():
        with pytest.raises(ValueError, match="a would expand to 6400128 bytes"):
            npz_members((tmp_path / "m.npz").read_bytes(), (), 5_000_000)

    assert peak(read) < 1e6


def test_a_limit_is_not_taken_for_a_bad_matrix(monkeypatch):
    """It was "is no matrix (stopped after 10 s (limit))"."""

    def late(text):
        raise LimitError("stopped after 10 s (limit)")

    monkeypatch.setattr(structure, "_parsed", late)
    with pytest.raises(LimitError):
        of.structure(LARGE["count"], None, EYE)


# --------------------------------------------------------------------------------------------- other languages


HOSTILE = ("x\nimport os; os.abort()", "*/ int own(void); /*", "a*\\", "??/", "/*", "'''",
           '"""', "\r\x0b\u2028print(1)",
           "coding: utf-7 +AAo-print(1)", "coding=unicode_escape \\x0aprint(1)", "]]>", "$\\frac{$", "=cmd()",
           "end module\n!", "é\ud7ff\u202e", "# =#", "x" * 300, "")  # fmt: skip


def bare(text, name):
    """What is left of a program without its comments."""
    text = re.sub(r"(?s)/\*.*?\*/", "", text) if name.endswith(".c") else text
    mark = {"py": "#", "jl": "#", "f90": "!"}.get(name.rpartition(".")[2], "\0")
    return "\n".join(line.partition(mark)[0].rstrip() for line in text.split("\n"))


def written(controller, name):
    """Each program of a controller by its file's name."""
    texts = {"law.c": c_text, "law.py": python_text, "law.csv": gains_text}
    return {file: text(controller, ("x", "y")) for file, text in texts.items() if file == name}


@pytest.fixture(scope="module")
def controller():
    made = load_controller(SAMPLES / "controller.json")
    keep = slice(None, None, max(1, (len(made.states) - 1) // 8))
    small = {name: getattr(made, name)[keep] for name in ("states", "inputs", "gains")}
    return replace(made, **small)


@pytest.mark.parametrize("file", ["law.c", "law.py"])
def test_programs_of_a_controller_hold_no_code_of_its_words(file, controller):
    """A newline in `event` ran code when the exported Python was run; `*/` put a function into the exported C."""
    plain = written(controller, file)[file]
    for text in HOSTILE:
        many = written(replace(controller, name=text or "x", actuators=(text,), title=text), file)[file]
        if file.endswith(".c"):
            word = re.search(r"(\w+)_states =", many)[1]
            assert re.sub(rf"\b{word}_", "W_", bare(many, file)) == re.sub(r"\btriple_1_", "W_", bare(plain, file))
        else:
            (old, _, _), (head, _, table) = plain.partition("\nTABLE = "), many.partition("\nTABLE = ")
            assert bare(head, file) == bare(old, file)
            table, _, end = table.replace("inf", "1e999").partition("\n}\n")
            assert ast.literal_eval(table + "}")["actuators"] == (text,) and end == plain.partition("\n}\n")[2]
        assert all(line.isascii() for line in many.splitlines()[:6])


@pytest.mark.parametrize("text", ["x\nimport os", "*/", "a,b", "a b"])
def test_a_controller_with_such_words_is_not_read(text, controller, tmp_path):
    document = json.loads((SAMPLES / "controller.json").read_text())
    fields = {"actuators": [text], "limits": {}}, {"event": "x\ny"}
    for change in fields:
        (tmp_path / "controller.json").write_text(json.dumps(document | change))
        with pytest.raises(InputError, match=r"actuators, event: '.*' is not a name.*; stabilise the orbit again"):
            load_controller(tmp_path / "controller.json")


@pytest.fixture(scope="module")
def cycle():
    return load_orbit(SAMPLES / "orbit.json")


def auto_texts(source):
    return {"a.f90": equations(source), "c.a": constants(source)}


@pytest.mark.parametrize("files", [c_files, julia_files, auto_texts])
def test_programs_of_an_orbit_hold_no_code_of_its_words(files, cycle, monkeypatch):
    monkeypatch.setattr("orbitfinder.exports.auto.ROWS", 3)
    source = source_of(cycle)
    plain = files(source)
    for text in HOSTILE:
        one = replace(cycle, title=text, source=text)
        for (name, old), new in zip(plain.items(), files(replace(source, orbit=one)).values(), strict=True):
            assert bare(new, name) == bare(old, name)


def test_controls_in_time_hold_no_code_of_their_words(cycle):
    entry = {"names": ["u"], "shape": "zero-order", "intervals": 2, "harmonics": 0, "coefficients": [[1.0, 2.0]],
             "arcs": 0, "shares": {}}  # fmt: skip
    plain = control_files(replace(cycle, name="w", control=entry), None)
    for text in HOSTILE:
        made = control_files(replace(cycle, name="w", title=text, control=entry | {"names": [text]}), None)
        assert {name: bare(each, name) for name, each in made.items()} == {
            name: bare(each, name) for name, each in plain.items()}  # fmt: skip


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc) on the path")
def test_strict_compilers_take_a_title_with_the_beginning_of_a_comment(cycle, tmp_path):
    for text in ("/* see */ //", "??/", "a \\"):
        for name, code in c_files(source_of(replace(cycle, title=text))).items():
            (tmp_path / name).write_text(code)
            strict = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-fsyntax-only")
            subprocess.run(["cc", *strict, tmp_path / name], check=True)


def test_an_exported_program_says_how_it_is_used(cycle, controller, tmp_path):
    """Without its argument it was an IndexError."""
    entry = {"names": ["u"], "shape": "zero-order", "intervals": 2, "harmonics": 0, "coefficients": [[1.0, 2.0]],
             "arcs": 0, "shares": {}}  # fmt: skip
    (text,) = (t for n, t in control_files(replace(cycle, name="w", control=entry), None).items() if n.endswith("py"))
    (tmp_path / "w.py").write_text(text)
    for given in ([], ["x"], ["1", "2"]):
        made = subprocess.run([sys.executable, tmp_path / "w.py", *given], capture_output=True, text=True, check=False)
        assert made.returncode == 1 and made.stderr.startswith("usage: ") and "Traceback" not in made.stderr
    assert (
        subprocess.run([sys.executable, tmp_path / "w.py", "0.1"], capture_output=True, check=True).stdout == b"1.0\n"
    )


def test_toml_and_html_give_texts_back(cycle):
    from html import unescape

    for text in HOSTILE:
        assert unescape(inert(text)) == text and not set(inert(text)) & set("<>\"'")
        assert tomllib.loads(f"a = {inert(text, 'toml')}\n{inert(text, 'toml')} = 1")["a"] == text
        assert not set(inert(text, "comment")) - set(map(chr, range(32, 127))) | set("\\") & set(inert(text, "comment"))
        document = orbit_to_document(replace(cycle, title=text, system=cycle.system | {"let": {"q": "x"}}))
        made = tomllib.loads(orbit_text(document))
        assert made.get("title", "") == "".join(letter if letter.isprintable() else " " for letter in text)[:300]


# -------------------------------------------------------------------------------------------------- meshes, robots


MESHES = {
    "obj": [("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n", "int too big|int too large"),
            ("v 0 0\nf 1 1 1\n", "reshape"),
            ("v 0 0 0\nf 1 2 3\n", "1 corners and 1 triangles, with corner 3"),
            ("v 0 0 1e308\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not a finite number below")],
    "stl": [("vertex 1 2 x", "could not convert"), ("", "0 corners and 0 triangles"), ("vertex 1 2 3", "reshape")],
    "dae": [(hostile.DAE.replace("utf-8", "klingon-8"), "unknown encoding"),
            (hostile.DAE.replace('"VERTEX"', '"WERTEX"'), "no 'VERTEX' in it"),
            (hostile.DAE.replace('"POSITION"', '"X"'), "no 'POSITION' in it"),
            (hostile.DAE.replace('url="#n1"', 'url="#n9"'), "no 'n9' in it"),
            (hostile.DAE.replace("0 7 2 7", "0 7 1e300 7"), "invalid literal"),
            (hostile.DAE.replace('url="#n0"', 'url="#n1"'), "instances stand for more than|recursion")],
}  # fmt: skip


@pytest.mark.parametrize("ending", MESHES)
def test_a_bad_mesh_is_refused_with_what_is_wrong_in_it(ending, tmp_path):
    for text, why in MESHES[ending]:
        (tmp_path / f"m.{ending}").write_text(text)
        with pytest.raises(InputError, match=rf"m.{ending}: cannot be read as {ending.upper()} \(.*({why}).*export it"):
            shapes.read(tmp_path / f"m.{ending}")


@pytest.mark.parametrize("times", [18, 40])
def test_instances_of_instances_are_counted(times, tmp_path):
    """Doubled 18 times it took 21 s, 26 times had no end."""
    more = "".join(f'<node id="m{k}"><instance_node url="#m{k - 1}"/><instance_node url="#m{k - 1}"/></node>'
                   for k in range(1, times))  # fmt: skip
    text = hostile.DAE.replace('id="n1"', 'id="m0"').replace("</library_nodes>", more + "</library_nodes>")
    (tmp_path / "m.dae").write_text(text.replace('"#n1"', f'"#m{times - 1}"'))
    with pytest.raises(InputError, match="its instances stand for more than 2000000"), of.limited(20.0):
        monkey = shapes.MOST_ELEMENTS
        try:
            shapes.MOST_ELEMENTS = 20_000  # the same sooner
            shapes.read(tmp_path / "m.dae")
        except InputError as error:
            raise InputError(str(error).replace("20000 ", "2000000 ")) from None
        finally:
            shapes.MOST_ELEMENTS = monkey


def test_meshes_stay_in_the_robots_tree(tmp_path):
    """../meshes is what ROS does; what lies elsewhere is refused by name."""
    own = tmp_path / "home" / "arm"
    (own / "urdf").mkdir(parents=True)
    (own / "meshes").mkdir()
    (own / "package.xml").touch()
    for place in (own / "meshes" / "m.obj", own / "urdf" / "m.obj", tmp_path / "s.obj", tmp_path / "home" / "s.obj"):
        place.write_text(hostile.OBJ)
    for name in ("../meshes/m.obj", "m.obj", "package://arm/meshes/m.obj", f"file://{own / 'urdf' / 'm.obj'}"):
        assert robot._beside(own / "urdf", name).name == "m.obj"
    outside = ("../../s.obj", "../../../s.obj", str(tmp_path / "s.obj"), f"file://{tmp_path / 's.obj'}",
               "package://arm/../s.obj", "package://home/s.obj", "package://../s.obj")  # fmt: skip
    for name in outside:
        with pytest.raises(InputError, match=rf"{re.escape(name)} lies outside the robot's folder arm; put it"):
            robot._beside(own / "urdf", name)
    with pytest.raises(InputError, match="x.obj is not there"):
        robot._beside(own / "urdf", "x.obj")


def test_what_mujoco_would_read_stays_in_the_robots_tree(tmp_path):
    own = tmp_path / "home" / "arm"
    own.mkdir(parents=True)
    (tmp_path / "m.obj").write_text(hostile.OBJ)
    (own / "more.xml").write_text("<mujoco><asset><mesh file='../../m.obj'/></asset></mujoco>")
    for text in ("<asset><mesh file='../../m.obj'/></asset>", f"<asset><mesh file='{tmp_path / 'm.obj'}'/></asset>",
                 "<compiler meshdir='../..'/><asset><mesh file='m.obj'/></asset>",
                 "<include file='more.xml'/>"):  # fmt: skip
        (own / "r.xml").write_text(f"<mujoco>{text}</mujoco>")
        with pytest.raises(InputError, match=r"r.xml: m.obj lies outside the robot's folder home; put it inside"):
            robot._check_files(own / "r.xml")
    (own / "r.xml").write_text(hostile.MJCF)
    robot._check_files(own / "r.xml")


# ---------------------------------------------------------------------------------------------------------- XPPAUT


VALUES = {
    "2^3^2": 64.0, "2**3**2": 64.0, "-x^2": -4.0, "(-x)^2": 4.0, "x>1+5": 6.0, "1+(x>1)": 2.0, "x^2^y": 64.0,
    "1|0+0": 1.0, "x>1&y>1": 1.0, "3*x>1": 3.0, "-x>1": -1.0, "2-3-4": -5.0, "8/4/2": 1.0, "not(x>1)*3": 0.0,
    "if(x>1)then(5)else(6)*2": 10.0, "max(1,2^3^2)": 64.0, "x==2+1": 2.0, "1e-1^2": 0.01, "2*not(x>3)": 2.0,
}  # fmt: skip
"""At x = 2, y = 3; after XPPAUT's parser: all operators from the left, comparisons as tight as powers"""


@pytest.mark.parametrize("text", VALUES)
def test_operators_bind_as_xppauts_do(text, tmp_path):
    (tmp_path / "a.ode").write_text(f"x'={text}\ny'=0*x\n")
    model = from_xpp(tmp_path / "a.ode")
    assert float(model.rates(0, [2.0, 3.0], [])[0]) == pytest.approx(VALUES[text], rel=1e-15)


@pytest.mark.parametrize(
    "line, why",
    [("export {x,y,a} {xp,yp}", "another program gives these"), ("#include more.ode", "is not followed"),
     ("@ meth=discrete,total=3", "makes a map"), ("@ METH = volterra", "makes a map"), ("z'=x*)", "no expression"),
     ("z'=2(x)", "no expression"), (f"z'={'(' * 5000}x", "nested too deeply"), ("z'=" + "x+" * 12000 + "x", "letters")],
)  # fmt: skip
def test_nothing_that_changes_the_rates_is_left_out(line, why, tmp_path):
    """`export` was dropped, and what another program fills in was read as 0."""
    (tmp_path / "a.ode").write_text(f"xp=0\n{line}\nx'=-x\ndone\n")
    with pytest.raises(InputError, match=r"a.ode: line 2: .*; ") as error:
        from_xpp(tmp_path / "a.ode")
    assert why in str(error.value)


@pytest.mark.parametrize(
    "text", ["1" * 20_000, "1." + "0" * 20_000 + "x", ".5" * 9000, "1e" + "9" * 19_000, "1,b=" * 4000]
)
def test_long_numbers_take_no_long_time(text, tmp_path):
    """`par a=` and 20,000 digits took 50 s, in which no limit could stop it."""
    (tmp_path / "a.ode").write_text(f"par a={text}\nx'=-a*x\n")
    began = time.process_time()
    with pytest.raises((InputError, Hint)) as error:  # XPPAUT reads .5 of .5.5.5
        from_xpp(tmp_path / "a.ode")
    assert time.process_time() - began < 0.5 and len(str(error.value)) < 500


# ------------------------------------------------------------------------------------- environment, proofs, records


@pytest.mark.parametrize("value", ["'x", '"', "\\", "'"])
def test_a_compiler_that_is_no_command_is_none(value, monkeypatch):
    """CC="'x" was a traceback in `run` and `doctor`."""
    monkeypatch.setenv("CC", value)
    there, why = compiled.available()
    assert not there and why.startswith("CC: ") and "quote it as a shell does, or unset CC" in why


@pytest.mark.slow
def test_processors_are_a_number(tmp_path):
    line = [sys.executable, "-c", "import orbitfinder.integrate.parallel"]
    made = subprocess.run(line, env={"ORBITFINDER_PROCESSORS": "abc", "PYTHONPATH": str(ROOT)}, capture_output=True,
                          text=True, check=False)  # fmt: skip
    assert "ORBITFINDER_PROCESSORS: must be a whole number, got 'abc'; set one, or unset it" in made.stderr


@pytest.mark.needs("proof")
@pytest.mark.parametrize("option", [["--scheduler", "tcp://x:1"], ["--workers", "2"], ["--event", "0"]])
def test_proofs_of_equilibria_say_what_they_do_not_take(option, tmp_path):
    shutil.copy(SAMPLES / "equilibria.json", tmp_path)
    made = CliRunner().invoke(cli, ["prove", str(tmp_path / "equilibria.json"), *option])
    assert made.exit_code == 2 and f"{option[0]}: is for orbits and families" in made.stderr


@pytest.mark.needs("proof")
def test_arbs_words_are_not_ours():
    from flint import arb_mat

    with pytest.raises(ZeroDivisionError) as error:
        arb_mat(2, 2, [0, 0, 0, 0]).solve(arb_mat(2, 1, [1, 1]))
    assert why_not(error.value).startswith("a divisor may be 0") and why_not(InputError("a: b")) == "a: b"


EDITS = {
    ("orbit", "show"): {"floquet_multipliers": [[]]},
    ("sweep", "csv"): {"rows.0.mu": []},
    ("equilibria", "show"): {"events.0.state": [], "points.0.state.0": 1e308, "events.0.parameter": 1e308,
                             "curve": {"parameters": 3.0}},
    ("equilibria", "csv"): {"events.0.state.0": None, "curve": {"parameters": ["a", "b"]}},
    ("family", "show"): {"curve.cycles": None, "curve.method": [], "curve.watch": 3.0, "curve.test": 1.0,
                         "points.3.free": {}},
    ("family", "csv"): {"curve.test": {"parameters": 3.0}, "curve.free": 1.0},
    ("tori", "show"): {"parameter": "x", "tori.0.curve.0.0": 1e308, "held": {"y": 1.0}},
    ("phase-response", "plot"): {"winding": [0, 0, 0]},
    ("diagram", "plot"): {"coordinate": "orbitfinder/diagram"},
    ("manifold", "plot"): {"which": "../../etc/passwd", "axes": ["x", "q"],
                           "state_names": ["y", "x", "z", "px", "py", "pz"]},
    ("map", "show"): {"parameters": ["w"], "curve.cycles": 0},
    ("connection-proof", "show"): {"origin.frame.0": [1.0]},
    ("controller", "csv"): {"multipliers": [], "actuators": ["a b"]},
}  # fmt: skip


@pytest.mark.parametrize("kind, verb", EDITS)
def test_an_edited_record_is_refused_by_name(kind, verb, tmp_path):
    for place, value in EDITS[kind, verb].items():
        document = json.loads((SAMPLES / f"{kind}.json").read_text())
        document.pop("record", None), document.pop("dense", None)
        *outer, last = [int(word) if word.isdigit() else word for word in place.split(".")]
        at = document
        for key in outer:
            at = at[key]
        at[last] = value
        path = tmp_path / f"{kind}.json"
        path.write_text(json.dumps(document))
        if (SAMPLES / f"{kind}.npz").exists():
            shutil.copy(SAMPLES / f"{kind}.npz", tmp_path)
        for folder in SAMPLES.glob("equilibria*/") if kind == "diagram" else ():
            shutil.copytree(folder, tmp_path / folder.name)
        made = hostile.done(
            "command", kind, [*hostile.VERBS[verb], str(path), *["--out", str(tmp_path / "o")] * (verb != "show")]
        )
        name = [word for word in place.split(".") if not word.isdigit()][-1]
        assert made[0] == 2 and name in made[1] and ";" in made[1], (place, made)


@pytest.mark.parametrize(("kind", "change"), [
    ("bifurcation", {"repeats": np.array([[99999999], [0]])}), ("bifurcation", {"values": np.array([[0.3], [0.4]])}),
    ("map", {"sample": np.array([[1.0, 0.0, 1.0]])}), ("map", {"mesh": np.array([0.0, 1.0])}),
    ("section", {"starts": np.array(1.0)}),
])  # fmt: skip
def test_dense_numbers_are_of_their_kind_and_size(kind, change, tmp_path):
    document = json.loads((SAMPLES / f"{kind}.json").read_text())
    document.pop("record", None), document.pop("dense", None)
    (tmp_path / f"{kind}.json").write_text(json.dumps(document))
    with np.load(SAMPLES / f"{kind}.npz") as data:
        (tmp_path / f"{kind}.npz").write_bytes(npz(**dict(data) | change))
    made = hostile.done("command", kind, ["show" if kind == "section" else "verify", str(tmp_path / f"{kind}.json")])
    assert made[0] == 2 and next(iter(change)) in made[1] and ";" in made[1], made


def test_whole_numbers_are_numbers(tmp_path):
    """States that another program wrote as integers, of a system without angles, are drawn."""
    document = json.loads((SAMPLES / "manifold.json").read_text())
    document.pop("record", None), document.pop("dense", None)
    (tmp_path / "manifold.json").write_text(json.dumps(document))
    with np.load(SAMPLES / "manifold.npz") as data:
        states = np.arange(data["states"].size).reshape(data["states"].shape)
        (tmp_path / "manifold.npz").write_bytes(npz(**dict(data) | {"states": states}))
    made = hostile.done("command", "manifold", ["plot", str(tmp_path / "manifold.json"), "--out", str(tmp_path / "o")])
    assert made[0] == 0 and "manifold-" in made[1], made


def test_dense_numbers_have_finite_squares(tmp_path):
    for name in ("orbit", "map", "section"):
        shutil.copy(SAMPLES / f"{name}.json", tmp_path)
        with np.load(SAMPLES / f"{name}.npz") as data:
            members = dict(data)
        key = {"orbit": "samples", "map": "nodes", "section": "states"}[name]
        (tmp_path / f"{name}.npz").write_bytes(npz(**members | {key: np.full_like(members[key], 1e308)}))
        made = hostile.done("command", name, ["plot", str(tmp_path / f"{name}.json"), "--out", str(tmp_path / "o")])
        assert made[0] == 2 and f"{key} holds a number that is not finite, or beyond 1e+150" in made[1]


LINES = ({"curve": 3.0}, {"segments": 10**9}, {"segments": "x"}, {"mesh": "1:AAAA"}, {"mesh": 3}, {"vector": "x"},
         {"vector": "1:"}, {"round": "x"}, {"pixels": 5}, {"pixels": "0:"}, {"pixels": "3:AAAA"})  # fmt: skip


@pytest.mark.parametrize("change", LINES, ids=str)
def test_a_maps_journal_is_read_as_a_strangers(change):
    """Lines with their digests made anew."""
    from orbitfinder.families.mapping import _read
    from orbitfinder.records.journal import packed

    first = {"curve": {}, "segments": 2, "mesh": packed(np.zeros((3, 1))), "vector": packed(np.zeros((9, 1)))}
    other = {"round": 0, "task": 0, "pixels": packed(np.zeros((1, 9)))}
    line = first if change.keys() <= first.keys() else other
    assert sealed_line(line | change) and _read(line)
    with pytest.raises(ValueError, match=next(iter(change))) if "segments" in change else pytest.raises(ValueError):
        _read(line | change)


def test_pixels_lie_in_their_map():
    from orbitfinder.families.pixels import PixelBlock

    block, row = PixelBlock.empty((2, 3), 4, 2), np.zeros((1, 10))
    block.fill(row)
    for column, value in ((0, -1), (0, 2), (1, 3), (2, 99), (3, 16), (0, np.nan), (1, 1e300)):
        bad = row.copy()
        bad[0, column] = value
        with pytest.raises(ValueError, match="a pixel outside 2 x 3"):
            block.fill(bad)


# ------------------------------------------------------------------------------------------------------------ fuzz


QUICK = dict.fromkeys(hostile.kinds(), 3) | dict.fromkeys(("xml", "tori", "export"), 1)
SLOW, PROOF = pytest.mark.slow, pytest.mark.needs("proof")


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[SLOW] * (kind == "xml") + [PROOF] * ("proof" in kind)) for kind in QUICK]
)
def test_a_few_hostile_files(kind, tmp_path):
    """Of every kind, in this process; a number makes the same file again."""
    for number in range(QUICK[kind]):
        (tmp_path / str(number)).mkdir()
        assert hostile.tried(hostile.mutant(kind, number, tmp_path / str(number))) in ("read", "refused"), number


@pytest.mark.slow
def test_a_minute_of_hostile_files():
    """In watched processes: no death, no traceback, no warning, at most 1.5 GB, no later than the limit and 3 s."""
    ends, faults = hostile.fuzz(hostile.kinds(), 10_000, 10**6, budget=60.0)
    assert not faults and sum(sum(counts.values()) for counts in ends.values()) > 60
