"""Every kind of record with every command and every public function: an answer, or one sentence.

Never a traceback, an empty site, or success with nothing made. What is dear (following, proving, searching) is cut
where its own work begins, so that what is tried is how a record is read and where it is sent.
"""

import copy
import json
import os
import time
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from test_mutations import edited, garbled, written

import orbitfinder as of
from orbitfinder.atlas.store import Atlas
from orbitfinder.cli.group import cli
from orbitfinder.cli.jobs import orbit_and_model
from orbitfinder.cli.verify import verified
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.mechanics.expression import expression
from orbitfinder.mechanics.scales import units
from orbitfinder.problemfile.write import orbit_text
from orbitfinder.records.family import plain, restored
from orbitfinder.records.orbit import digest, orbit_from_document, orbit_to_document
from orbitfinder.records.registry import VERBS, load_orbit, taken
from orbitfinder.show import html
from orbitfinder.site import gather, text
from orbitfinder.site.build import SiteSettings, build_site
from orbitfinder.structures.manifold import ConnectionEnd
from orbitfinder.studio.session import opened

ROOT = Path(__file__).parents[1]
RESULTS, GALLERY = ROOT / "results", ROOT / "docs" / "gallery" / "orbits"
SHIPPED = {
    "orbit": RESULTS / "orbits" / "triple-1" / "orbit.json",
    "forced": RESULTS / "gallery" / "duffing" / "orbit.json",
    "first-order": RESULTS / "gallery" / "lorenz" / "orbit.json",
    "hybrid": GALLERY / "hybrid-rimless-wheel.json",
    "mechanism": GALLERY / "mechanisms-slider-crank-spring.json",
    "control": GALLERY / "control-maintained-oscillator.json",
    "proof": RESULTS / "proofs" / "triple-7.json",
    "branch-proof": RESULTS / "proofs" / "triple-mode-1" / "branch-proof.json",
    "event-proof": RESULTS / "proofs" / "events" / "duffing-2.json",
    "connection-proof": RESULTS / "proofs" / "connections" / "oterma-l2.json",
    "family": RESULTS / "families" / "henon-heiles-loop" / "family.json",
    "family#": Path(f"{RESULTS / 'families' / 'henon-heiles-loop' / 'family.json'}#3"),
    "atlas": RESULTS / "atlas" / "impact-oscillator.sqlite",
    "atlas#": Path(f"{RESULTS / 'atlas' / 'rossler.sqlite'}#1"),
}
MADE = ("export", "export#", "empty export", "optima", "optima#", "tori", "tori#", "section", "manifold", "connection",
        "controller", "equilibria", "equilibria#", "diagram", "map", "bifurcation", "journal", "text")  # fmt: skip
RESTING = {"equilibria", "equilibria#"}
KINDS = (*SHIPPED, *MADE)
PROOFS = {"branch-proof", "event-proof", "connection-proof"}
ORBITS = {*SHIPPED, "export#", "optima#"} - PROOFS - {"family", "atlas"}
TAKEN = {
    "verify": ORBITS | {"family", "optima", "tori", "tori#", "connection", "controller", "diagram", "map",
                        "bifurcation"} | RESTING,
    "plot": ORBITS | {"family", "atlas", "optima", "tori", "tori#", "section", "manifold", "connection", "controller",
                      "diagram", "map", "bifurcation"} | RESTING,
    "animate": ORBITS,
    "export": ORBITS | {"controller", "family", "optima", "tori", "tori#", "map", "diagram", "bifurcation"} | RESTING,
    "studio": ORBITS | {"family", "atlas"},
    "page": {*KINDS} - PROOFS - {"controller", "diagram", "bifurcation", "journal", "text"},
}  # fmt: skip
"""What a verb answers; of anything else it says in one sentence what takes it"""
PAGES = {"orbit", "forced", "first-order", "hybrid", "mechanism", "control", "proof", "family", "family#", "atlas",
         "atlas#", "export", "export#", "optima", "optima#", "section", "map"} | RESTING  # fmt: skip
"""What a page can be made of, and the studio opens but for exports, sections and equilibria"""


def connection(orbit):
    """A connection by its entries; whether it is one is not asked here."""
    end = ConnectionEnd(
        orbit.name, orbit.state, orbit.period, 2.0, orbit.state, orbit.state, 1e-6, np.ones(orbit.state.size)
    )
    return of.sections.Connection(
        "c", orbit.system, ("x", "y", "xdot", "ydot"), "x=0", 0, ("y", "ydot"), orbit.energy, orbit.samples[:3],
        np.ones(2), 1, 0.1, 1e-9, end, end, None, orbit.times, orbit.samples,
    )  # fmt: skip


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    """A file of every kind, by kind."""
    folder = tmp_path_factory.mktemp("records")
    loop = load_orbit(RESULTS / "gallery" / "henon-heiles-loop" / "orbit.json")
    tiny, driven = load_orbit(GALLERY / "published-lyapunov-tiny.json"), load_orbit(SHIPPED["control"])
    with Atlas(RESULTS / "atlas" / "rossler.sqlite") as atlas:
        (folder / "export.json").write_text(json.dumps([atlas.document(1), atlas.document(2)]))
    of.save_tori(of.follow_tori(loop, settings=of.TorusSettings(points=1)), folder / "tori.json")
    of.sections.save_section(of.section(loop, seeds=3, returns=4), folder / "section.json")
    grown = of.manifold(tiny, "unstable", plane="y=0", returns=0)
    of.sections.save_manifold(grown, folder / "manifold.json")
    of.sections.save_connection(connection(loop), folder / "connection.json")
    of.save_optima(of.Optima("o", "damping", (driven, driven), np.array([0.2, 0.2]), (0, 0)), folder / "optima.json")
    of.save_controller(of.stabilise(load_orbit(GALLERY / "control-stabilised-triple-1.json")), folder / "held.json")
    resting = of.follow_equilibria(of.systems.brusselator(rate=1.8), [1.0, 1.8], "rate", until=2.4)
    of.save_equilibria(resting, folder / "equilibria.json")
    tree = of.diagram(of.systems.brusselator(rate=1.8), [1.0, 1.8], "rate", 2.2, depth=0)
    of.save_diagram(tree, folder / "diagram.json")
    spring = of.Problem(of.systems.forced_duffing(), of.Guess([0.5, 0.0], 6.0), name="spring")
    of.save_map(of.map_plane(spring, damping=[0.1, 0.2], force=[0.3, 0.31], sample=1), folder / "map.json")
    settled = of.bifurcation(spring, damping=[0.1, 0.2], transient=20, samples=8)
    of.sections.save_bifurcation(settled, folder / "bifurcation.json")
    (folder / "empty.json").write_text("[]")
    (folder / "family.jsonl").write_text('{"format": "orbitfinder/family"}\n')
    (folder / "text.txt").write_text("no record\n")
    names = {"optima": "optima.json", "tori": "tori.json", "section": "section.json", "manifold": "manifold.json",
             "connection": "connection.json", "controller": "held.json", "equilibria": "equilibria.json",
             "equilibria#": "equilibria.json#2", "diagram": "diagram.json", "journal": "family.jsonl",
             "map": "map.json", "bifurcation": "bifurcation.json", "text": "text.txt", "export": "export.json",
             "empty export": "empty.json", "export#": "export.json#0",
             "optima#": "optima.json#1", "tori#": "tori.json#0"}  # fmt: skip
    return SHIPPED | {kind: folder / name for kind, name in names.items()}


CUT = "cut where its own work begins"
DEAR = ("families.folder.follow_family", "families.branches.switch_branch", "structures.manifolds.manifold",
        "structures.connections.connect", "structures.tori.follow_tori", "control.optima.follow_optima",
        "structures.sections.section", "control.feedback.stabilise", "atlas.search.search", "orbits.sweep.sweep",
        "proof.theorem.prove", "proof.theorem.refine", "proof.connections.prove_connection")  # fmt: skip
COMMANDS = {
    "show": "show FILE", "verify": "verify FILE", "plot": "plot FILE -o OUT",
    "animate": "animate FILE -o OUT --size 64 --fps 1",
    "csv": "export FILE --to csv -o OUT", "json": "export FILE --to json -o OUT",
    "auto": "export FILE --to auto -o OUT", "julia": "export FILE --to julia -o OUT",
    "c": "export FILE --to c -o OUT",
    "page": "page FILE -o OUT --no-verify --atlas-pages 1", "continue": "continue FILE --points 1 -o OUT",
    "prove": "prove FILE --no-record", "refine": "refine FILE --digits 20", "stabilise": "stabilise FILE -o OUT",
    "section": "section FILE -o OUT", "manifold": "manifold FILE -o OUT", "connect": "connect FILE -o OUT",
    "torus": "torus FILE -o OUT", "search": "search FILE --starts 1 --atlas OUT/a.sqlite",
    "sweep": "sweep FILE --parameter energy=1,2 -o OUT", "run": "run FILE -o OUT",
    "simulate": "simulate FILE -o OUT/simulated.csv", "guess": "guess FILE", "atlas list": "atlas list FILE",
    "atlas show": "atlas show FILE 1", "atlas report": "atlas report FILE",
    "atlas export": "atlas export FILE --to json -o OUT/e.json", "atlas merge": "atlas merge FILE --atlas OUT/m.sqlite",
}  # fmt: skip
SAYS = ("show", "verify", "prove", "refine", "guess", "atlas list", "atlas show", "atlas report")
"""Commands whose answer is what they print"""


def told(words, name):
    """What is wrong with how a command ended, "" where nothing is."""
    out = Path(words[words.index("-o") + 1] if "-o" in words else words[-1])
    result = CliRunner().invoke(cli, words)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        return f"{name}: {result.exception!r:.200}"
    last = (result.stderr or result.output).strip().splitlines()[-1:]
    if result.exit_code == 0:
        folder = out if out.is_dir() else out.parent
        made = name in SAYS or any(one.is_file() and one.stat().st_size for one in folder.rglob("*"))
        return "" if made and result.stdout else f"{name}: success, and nothing made"
    if result.exit_code == 1:
        return "" if name == "verify" or CUT in result.output else f"{name}: failed, {last}"
    sentence = result.exit_code == 2 and last and last[0].startswith("Error: ") and len(last[0]) > 40
    return "" if sentence else f"{name}: exit code {result.exit_code}, {last}"


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.slow] * (kind[-1] == "#" and kind != "atlas#")) for kind in KINDS]
)
def test_every_command_answers_or_refuses_in_a_sentence(kind, records, tmp_path, monkeypatch):
    def cut(*_, **__):
        raise ConvergenceError(CUT)

    for name in DEAR:
        if name.rpartition(".")[2] in of.__all__:  # first, or the front door keeps a cut one
            monkeypatch.setattr(of, name.rpartition(".")[2], cut)
        monkeypatch.setattr(f"orbitfinder.{name}", cut)
    wrong = []
    for name, words in COMMANDS.items():
        out = tmp_path / name.replace(" ", "-")
        out.mkdir()
        given = [word.replace("FILE", str(records[kind])).replace("OUT", str(out)) for word in words.split()]
        wrong += filter(None, [told(given, name)])
    assert not wrong


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("journal", "text")])
def test_a_verb_answers_or_says_what_the_record_is_for(kind, records):
    answered = {verb for verb in VERBS if kind in TAKEN[verb]}
    for verb in VERBS:
        if verb in answered:
            assert taken(verb, records[kind])
        else:
            with pytest.raises(InputError, match=f"which `{verb}` does not take; .*; this file is for show") as caught:
                taken(verb, records[kind])
            assert all(verb in str(caught.value).rpartition("for")[2] for verb in answered)


def test_show_says_what_a_system_that_no_file_describes_is_for():
    """It named verify, plot, animate, export and studio, which all refuse such an orbit; a page is made of it."""
    file = GALLERY / "published-freire.json"
    last = CliRunner().invoke(cli, ["show", str(file)]).output.strip().splitlines()[-1].strip()
    assert last.startswith("for show, page; verify, plot, animate, export, studio need its Model")
    for verb in ("verify", "plot"):
        done = CliRunner().invoke(cli, [verb, str(file)])
        assert done.exit_code == 2 and "system.kind: cannot rebuild 'custom'" in done.output
    assert build_site(gather.gather([file]), SiteSettings(verify=False))[1].orbits == 1
    whole = CliRunner().invoke(cli, ["show", str(SHIPPED["orbit"])]).output.strip().splitlines()[-1].strip()
    assert whole == "for show, verify, plot, animate, export, page, studio"


@pytest.mark.parametrize("kind", KINDS)
def test_a_page_and_the_studio_have_something_to_show_or_say_what_they_take(kind, records):
    if kind in PAGES:
        site, summary = build_site(gather.gather([records[kind]]), SiteSettings(atlas_pages=1, verify=False))
        assert sum(vars(summary).values()) > summary.size
        assert len(site.pages) > 1
    else:
        with pytest.raises(InputError) as caught:
            gather.gather([records[kind]])
        assert "\n" not in str(caught.value) and len(str(caught.value)) > 40
    if kind in PAGES - {"export", "optima", "section", "map"} - RESTING:
        assert opened(records[kind]).state.size
    else:
        with pytest.raises(InputError):
            opened(records[kind])


LOADERS = (of.load_orbit, of.load_family, of.load_optima, of.load_tori, of.load_controller, of.sections.load_section,
           of.sections.load_manifold, of.sections.load_connection, of.load_equilibria, of.load_diagram,
           of.load_map, of.sections.load_bifurcation)  # fmt: skip


def test_every_reader_takes_its_own_files_and_refuses_the_others(records):
    read = {}
    for kind, file in records.items():
        for load in LOADERS:
            try:
                read[kind] = load(file)
            except InputError as error:
                assert "\n" not in str(error) and len(str(error)) > 30
    files = {
        "branch-proof",
        "event-proof",
        "connection-proof",
        "atlas",
        "export",
        "empty export",
        "tori#",
        "equilibria#",
        "journal",
        "text",
    }
    assert set(KINDS) - set(read) == files


@pytest.mark.parametrize("kind", ["optima", "tori", "section", "manifold", "connection", "controller", "equilibria"])
def test_damaged_records_are_read_or_refused_in_a_sentence(kind, records, tmp_path):
    load, path = next(one for one in LOADERS if one.__name__ == f"load_{kind}"), tmp_path / "record.json"
    data, beside, read = records[kind].read_bytes(), records[kind].with_suffix(".npz"), 0
    if beside.exists():
        path.with_suffix(".npz").write_bytes(beside.read_bytes())
    for number in range(60):
        random = np.random.default_rng([number, 30])
        as_bytes = random.random() < 0.3
        path.write_bytes(garbled(data, random) if as_bytes else written(edited(json.loads(data), random)))
        try:
            read += bool(repr(load(path)))
        except InputError as error:
            assert "\n" not in str(error) and str(tmp_path) in str(error)
    assert 0 < read < 30


GIVEN = {
    "certify": (), "stabilise": (), "section": (), "torus": (), "connect": (), "follow_family": (), "prove": (),
    "follow_tori": (), "manifold": ("unstable",), "follow_optima": ("damping", 0.3), "switch_branch": (0,),
    "follow_curve": (0, ("a", "b")), "basin": (), "recovery": (), "frequency_map": (), "export_orbit": ("csv", "OUT"),
    "save_orbit": ("OUT/o.json",), "save_optima": ("OUT/o.json",), "save_tori": ("OUT/t.json",),
    "save_controller": ("OUT/c.json",), "save_figures": ("OUT",), "export_controller": ("OUT",),
    "Refiner": (), "find_orbit": (), "sweep": ({"a": [1.0]},), "search": ("OUT/a.sqlite",),
}  # fmt: skip
OWN = {
    "orbit": ("certify", "stabilise", "section", "torus", "connect", "follow_family", "prove", "follow_tori",
              "manifold", "export_orbit", "save_orbit", "save_figures", "frequency_map", "sweep", "search"),
    "family": ("switch_branch", "follow_curve", "save_figures"), "equilibria": ("switch_branch",),
    "optima": ("save_optima",), "tori": ("save_tori",),
    "controller": ("basin", "recovery", "save_controller", "export_controller"),
}  # fmt: skip
"""What takes which record; tried where the commands are"""


@pytest.mark.parametrize(
    "kind", ["orbit", "family", "optima", "tori", "section", "manifold", "connection", "controller", "equilibria"]
)
def test_public_functions_refuse_records_that_they_do_not_take(kind, records, tmp_path):
    load = next(one for one in LOADERS if one.__name__ == f"load_{kind}")
    record, wrong = load(records[kind]), []
    for name, rest in GIVEN.items():
        if name in OWN.get(kind, ()):
            continue
        more = [one.replace("OUT", str(tmp_path)) if isinstance(one, str) else one for one in rest]
        try:
            getattr(of, name)(record, *more)
        except InputError as error:
            wrong += [f"{name}: {error}"] if "\n" in str(error) else []
        except Exception as error:
            wrong.append(f"{name}: {error!r:.150}")
        else:
            wrong.append(f"{name}: took a {kind}")
    assert not wrong


def every_record(each=1):
    """The document of every orbit that is shipped, of atlases each so many-th, and where it is from."""
    for file in [*sorted(RESULTS.rglob("*.json")), *sorted(GALLERY.glob("*.json"))]:
        document = json.loads(file.read_bytes())
        if isinstance(document, dict) and document.get("format") == "orbitfinder/orbit":
            yield document, file.name
    for file in sorted((RESULTS / "atlas").glob("*.sqlite")):
        with Atlas(file) as atlas:
            yield from ((document, file.name) for document in islice(atlas.documents(), None, None, each))


PURE = {
    "there and back": lambda document, orbit: orbit_to_document(orbit),
    "problem file": lambda document, orbit: orbit_text(document),
    "facts": lambda document, orbit: html.numbers(orbit),
    "label": lambda document, orbit: (repr(orbit), text.mechanism(document["system"])),
    "units": lambda document, orbit: units(document["system"]),
    "page": lambda document, orbit: gather._orbit(document, "here"),
    "circle": lambda document, orbit: html.circle(orbit),
    "certificate": lambda document, orbit: html.certificate_html(orbit.certificate),
}


@pytest.mark.parametrize(("each", "least"), [(25, 150), pytest.param(1, 3400, marks=pytest.mark.slow)])
def test_every_shipped_record_passes_every_pure_function(each, least):
    began, count, wrong = time.perf_counter(), 0, []
    for document, where in every_record(each):
        count, orbit = count + 1, orbit_from_document(document)
        for name, function in PURE.items():
            try:
                function(document, orbit)
            except Exception as error:  # of a shipped record not even a sentence
                wrong.append(f"{name} of {where}: {error!r:.100}")
    print(f"{count} records, {time.perf_counter() - began:.1f} s")
    assert not wrong and count > least


@pytest.mark.slow
def test_systems_of_every_kind_are_written_for_other_programs(tmp_path):
    seen = set()
    for document, where in every_record():
        system = document["system"]
        if (key := (system["kind"], system.get("function"), document["symmetry"])) in seen or len(seen) > 15:
            continue
        seen.add(key)
        try:
            assert of.export_orbit(orbit_from_document(document), "c", tmp_path), where
        except InputError as error:
            assert "\n" not in str(error)


CONTROL = GALLERY / "control-maintained-oscillator.json"


@pytest.mark.parametrize(
    "change, entry",
    [({"only": {"cost": 1.0}}, "control.names"), ({"costate": [[1.0], [1.0, 2.0]]}, "control.costate"),
     ({"costate": [1.0]}, "control.costate"), ({"multipliers": [1.0]}, "control.multipliers"),
     ({"multipliers": {"phase 0": "x"}}, "control.multipliers.phase 0"), ({"intervals": 10**9}, "control.intervals"),
     ({"coefficients": [[1.0]]}, "control.coefficients"), ({"coefficients": [[1e300] * 7]}, "control.coefficients"),
     ({"normals": [[0.0]]}, "control.normals"), ({"names": ["force\x1b"]}, "control.shape or names"),
     ({"limits": {"force": [1.0]}}, "control.limits.force"), ({"arcs": 3}, "control.shares"),
     ({"points": 0}, "control.points")],
)  # fmt: skip
def test_what_a_controlled_orbit_says_of_its_control_is_read_by_its_types_and_shapes(change, entry, tmp_path):
    document = json.loads(CONTROL.read_text())
    document["control"] = change.get("only") or copy.deepcopy(document["control"]) | change
    document["record"] = digest(document)
    file = tmp_path / "orbit.json"
    file.write_text(json.dumps(document))
    for use in (orbit_and_model, lambda file: verified(file, False)):
        with pytest.raises(InputError, match=f"{entry}.*run the problem again"):
            use(file)


@pytest.mark.parametrize(
    "name, change, said",
    [("states", lambda one: one[:, :-1], "states"), ("times", lambda one: one[:-1], "states: shape"),
     ("seeds", lambda one: one + 99, "seeds"), ("seeds", lambda one: one.astype(float), "seeds"),
     ("seeds", lambda one: -one - 1, "seeds"), ("starts", lambda one: one[..., None], "starts: shape"),
     ("growth", lambda one: one[:1], "growth: shape"), ("growth", lambda one: one[:0], "growth: shape"),
     ("times", lambda one: np.array(3.0), "states: shape"), ("growth", lambda one: one + np.nan, "growth holds"),
     ("states", lambda one: one + np.inf, "states holds")],
)  # fmt: skip
def test_a_section_is_read_by_the_shapes_of_its_arrays(name, change, said, records, tmp_path):
    section = of.sections.load_section(records["section"])
    endless = replace(section, growth=section.growth + np.inf)  # that of a hybrid system, where it is not known
    saved = of.sections.save_section(endless, tmp_path / "section.json")
    assert np.isinf(of.sections.load_section(saved).growth).all()
    of.sections.save_section(replace(section, **{name: change(getattr(section, name))}), saved)
    with pytest.raises(InputError, match=f"{said}.*make the section again"):
        gather.gather([saved])


def test_samples_without_a_dimension_are_damaged(tmp_path):
    document = json.loads(SHIPPED["forced"].read_text())
    (tmp_path / "orbit.json").write_text(json.dumps(document))
    np.savez(tmp_path / "orbit.npz", times=np.array(3.0), samples=np.zeros(2))
    with pytest.raises(InputError, match="damaged"):
        load_orbit(tmp_path / "orbit.json")


def test_a_page_imports_a_module_only_where_it_is_trusted(tmp_path):
    (tmp_path / "mine.py").write_text(
        "import orbitfinder as of\n\n\ndef made(stiffness=1.0, **more):\n    return of.systems.duffing(**more)\n"
    )
    document = json.loads(SHIPPED["forced"].read_text())
    own = {"kind": "python", "module": "mine", "function": "made", "arguments": document["system"]["arguments"]}
    document["system"] = own
    document["record"] = digest(document)
    (tmp_path / "orbit.json").write_text(json.dumps(document))
    for trust in (False, True):
        site, _ = build_site(gather.gather([tmp_path / "orbit.json"], trust=trust), SiteSettings(verify=True))
        page = next(one.html for one in site.pages if one.path.startswith("orbits/"))
        assert ("add --trust" in page) != trust and ("Recomputed from the numbers" in page) == trust


def test_energies_that_are_null_come_back_as_null():
    document = Atlas(RESULTS / "atlas" / "rossler.sqlite").document(1)
    assert document["energy"] is None and np.isnan(orbit_from_document(document).energy)
    assert "energy" not in orbit_text(document) and orbit_to_document(orbit_from_document(document))["energy"] is None
    family = of.load_family(SHIPPED["family"])
    unknown = replace(family.points[0], energy=float("nan"))
    entry = plain(unknown)
    assert entry["energy"] is None and np.isnan(restored(type(unknown), entry).energy)


@pytest.mark.parametrize(
    "text, said",
    [("10**400", "10**400"), ("1/0", "1/0"), ("force*(-8)**0.5", "(-8)**0.5"), ("1e999*force", "1e999"),
     ("exp(1000)", "exp(1000)"), ("log(0)", "log(0)"), ("force + 1" + "0" * 400, "1000")],
)  # fmt: skip
def test_numbers_in_expressions_are_real_and_finite(text, said):
    with pytest.raises(InputError, match=r"^control\.cost: .* is no finite real number; ") as caught:
        expression(text, {"force": 1.0}, "control.cost")
    assert said in str(caught.value)
    with pytest.raises(InputError, match="unknown name 'forse'"):
        expression("forse/1", {"force": 1.0}, "control.cost")


@pytest.mark.parametrize("at", ["0.25", '"always"', '"mean"'])
@pytest.mark.parametrize("task", ["1", "0*force", "atan2(0, 0)"])
def test_a_task_that_no_motion_changes_is_refused(task, at, tmp_path):
    problem = (ROOT / "problems" / "control" / "pick-and-place.toml").read_text()
    file = tmp_path / "p.toml"
    file.write_text(f'{problem}\n[[control.task]]\nexpression = "{task}"\nat = {at}\nhighest = 3.0\n')
    result = CliRunner().invoke(cli, ["run", str(file), "-o", str(tmp_path)])
    assert result.exit_code == 2 and "is the same for every motion" in result.output


def test_a_robot_is_no_device_and_no_pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe.urdf")
    for file in (tmp_path / "pipe.urdf", Path("/dev/zero")):
        with pytest.raises(InputError, match="file: .*not a regular file; give a URDF or MJCF file"):
            of.robot(file)
