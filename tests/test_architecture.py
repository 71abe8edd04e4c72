"""The house: arrows go down only, every library stays in its rooms, nobody takes what is another's own.

Imports are counted wherever they stand: at the top, in functions, for type checking.
"""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "orbitfinder"

# low to high; the rooms of one floor do not import each other
FLOORS = (
    ("errors",), ("_runtime",), ("records",), ("mechanics",), ("integrate",), ("loops",),
    ("continuation",), ("orbits",), ("families",),
    ("mechanisms",), ("problemfile", "proof"), ("exports",), ("control",), ("structures",), ("atlas",),
    ("show",), ("site",), ("studio",), ("reproduce",), ("", "systems", "linkages", "flows", "sections"), ("cli",),
    ("__main__",),
)  # fmt: skip
CORE = 9
"""Floors of the core: what is above the border registers itself"""
LIBRARIES = {
    "casadi": (
        "mechanics",
        "integrate",
        "loops",
        "proof",
        "exports",
        "orbits.shoot",
        "orbits.objectives",
        "mechanisms",
        "control",
        "structures.crossings",
        "cli.casadi_bugs",
    ),
    "click": ("cli",),
    "rich": ("cli",),
    "pydantic": ("records", "problemfile"),
    "matplotlib": ("show", "reproduce"),
    "sqlite3": ("atlas",),
    "jinja2": ("site", "reproduce.runner"),
    "nicegui": ("studio",),
    "anywidget": ("studio.widget",),
    "traitlets": ("studio.widget",),
    "platformdirs": ("integrate.compiled",),
    "pickle": (),
    "cloudpickle": (),
    "dill": (),
    "joblib": (),
}
LATE = ("cli", "__main__")
"""Where imports inside functions are usual, so that --help is quick"""
SYMMETRIES = {"brake", "reflection", "reversal", "brake+reflection"}
SPELLING = ("loops.symmetry", "mechanics.model", "records.family")
"""The only files that spell the name of a symmetry; the last, below symmetries, for families written before 0.2"""


def dotted(path: Path) -> str:
    """`orbits.find` for orbitfinder/orbits/find.py; a package has its own name."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def modules() -> dict[str, ast.Module]:
    """Every module of the package by its name; read when a test asks, as every process of a run collects this file."""
    return {dotted(path): ast.parse(path.read_text(encoding="utf-8")) for path in sorted(PACKAGE.rglob("*.py"))}


@cache
def nodes(module: str) -> tuple[ast.AST, ...]:
    """Every node of a module; to walk them all takes a second, and most tests here do."""
    return tuple(ast.walk(modules()[module]))


@cache
def imports(module: str) -> list[tuple[str, str]]:
    """(what it is imported from, the name), wherever in the file the import stands."""
    found = []
    for node in nodes(module):
        if isinstance(node, ast.Import):
            found += [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}:{node.lineno}: relative import; write orbitfinder.…"
            found += [(node.module or "", alias.name) for alias in node.names]
    return found


@cache
def needs(module: str) -> set[str]:
    """The modules of the package that a module imports."""
    found = set()
    for source, name in imports(module):
        if source.split(".")[0] == "orbitfinder":
            home = source.removeprefix("orbitfinder").removeprefix(".")
            whole = f"{home}.{name}".removeprefix(".")
            found.add(whole if whole in modules() else home)
    return found - {module}


def floor(module: str) -> int:
    room = module.split(".")[0]
    found = [level for level, rooms in enumerate(FLOORS) if room in rooms]
    assert found, f"orbitfinder/{room} is on no floor; add it to FLOORS"
    return found[0]


def inside(module: str, rooms: tuple[str, ...]) -> bool:
    return any(module == room or module.startswith(f"{room}.") for room in rooms)


def test_arrows_go_down_only():
    """A module imports its own room and lower floors."""
    upward = [
        f"{module} -> {needed}"
        for module in modules()
        for needed in needs(module)
        if module and needed
        if floor(needed) > floor(module)
        or (floor(needed) == floor(module) and needed.split(".")[0] != module.split(".")[0])
    ]
    assert not upward


def test_the_core_is_closed():
    """What stands above the border registers itself: nothing below it imports or names it."""
    assert not [
        f"{module} -> {needed}"
        for module in modules()
        if module and floor(module) < CORE
        for needed in needs(module)
        if needed and floor(needed) >= CORE
    ]
    rooms = "|".join(room for rooms in FLOORS[CORE:] for room in rooms if room)
    named = re.compile(rf'"(?:{rooms})\.[a-z_.]+:[a-z_]+"')
    assert not [
        module for module in modules()
        if module and floor(module) < CORE and named.search(ast.unparse(modules()[module]).replace("'", '"'))
    ]  # fmt: skip


def circles(graph: dict[str, set[str]]) -> Iterator[tuple[str, ...]]:
    """Modules of which each needs the next, the last the first; one after the other is cut out."""
    left = {module: set(needed) for module, needed in graph.items()}
    while True:
        try:
            list(TopologicalSorter(left).static_order())
        except CycleError as error:
            members = error.args[1]
            yield tuple(sorted(set(members)))
            left[members[1]].discard(members[0])
        else:
            return


def test_no_import_circles():
    """The modules can be put in an order in which each needs only earlier ones."""
    assert not list(circles({module: needs(module) for module in modules() if module}))


@pytest.mark.parametrize("library", LIBRARIES)
def test_libraries_stay_in_their_rooms(library):
    found = {module for module in modules() if any(source.split(".")[0] == library for source, _ in imports(module))}
    assert not [module for module in found if not inside(module, LIBRARIES[library])]


def test_nobody_takes_what_is_anothers_own():
    """Names that begin with an underscore stay at home, and only front doors export what they import."""
    private = [
        f"{module}: {source}.{name}"
        for module in modules()
        for source, name in imports(module)
        if source.startswith("orbitfinder") and name.startswith("_") and name not in ("_runtime", "__version__")
    ]
    again = [
        f"{module}: {alias.name} as {alias.asname}"
        for module in modules()
        for node in nodes(module)
        if module and isinstance(node, ast.ImportFrom)
        for alias in node.names
        if alias.asname == alias.name
    ]
    assert not private and not again, again


def test_symmetries_are_spelled_in_two_files():
    spelled = defaultdict(set)
    for module in modules():
        for node in nodes(module):
            if isinstance(node, ast.Constant) and node.value in SYMMETRIES:
                spelled[module].add(node.value)
    assert set(spelled) == set(SPELLING)


def test_the_library_does_not_print_and_names_what_it_handles():
    """Results go through return values and the command line; no handler takes everything unnamed."""
    wrong = [
        f"{module}:{node.lineno}"
        for module in modules()
        for node in nodes(module)
        if (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print")
        or (isinstance(node, ast.ExceptHandler) and not node.type)
    ]
    assert not wrong


def test_the_top_of_the_house_can_be_seen_at_once():
    assert len([path for path in PACKAGE.iterdir() if path.name != "__pycache__"]) <= 29


def code_lines(node):
    """The lines of a function without its docstring: tables of parameters may be long."""
    said = node.body[0] if ast.get_docstring(node) else None
    return node.end_lineno - node.lineno + 1 - (said.end_lineno - said.lineno + 1 if said else 0)


def test_functions_are_short():
    long = [
        f"{module}.{node.name}: {code_lines(node)} lines"
        for module in modules()
        for node in nodes(module)
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) and code_lines(node) > 60
    ]
    assert not long


def test_kinds_of_systems_are_asked_in_one_file():
    """What is special to a kind stands in its entry of `mechanics.kind.KINDS`."""
    kinds, asked = {"chain", "linkage", "mechanism", "robot", "python"}, set()
    for module in modules():
        for node in (one for one in nodes(module) if isinstance(one, ast.Compare)):
            named = {one.value for one in ast.walk(node) if isinstance(one, ast.Constant)}
            if named & kinds and "kind" in ast.unparse(node):
                asked.add(module)
    assert not asked


def test_every_kind_of_event_has_a_check():
    """What the code may call an event is checked by its definition, and drawn."""
    from orbitfinder.continuation.tests import index_levels
    from orbitfinder.families.entries import KINDS
    from orbitfinder.show.diagram import LOOKS

    made = {kind for root in (1, 2) for _, kind, *_ in index_levels(root, 6)}
    for module in modules():
        for node in nodes(module) if module.startswith("families") else ():
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("Test", "Margin"):
                made |= {one.value for one in ast.walk(node.args[0]) if isinstance(one, ast.Constant)}
    assert len(made) > 8 and made <= set(KINDS), made - set(KINDS)
    assert set(LOOKS) == set(KINDS)


SOLVERS = {"solve", "dgesv", "lstsq", "pinv", "splu", "spsolve", "least_norm", "least_squares"}
"""What a step of Newton's method is solved with"""
ITERATIONS = {
    "mechanics.newton": "the one: whole, chord and halved steps, closures, equilibria",
    "loops.continued": "families' corrector, with a border whose derivatives are measured on the way",
    "integrate.collocation": "the stages of all steps at once, whose derivatives come with the last solve",
    "atlas.solver": "many side by side, judged by the natural level, each of which may be given up at every evaluation",
    "mechanisms.closing": "the minimal form's steps: an expression graph, whose number of steps is fixed",
    "mechanisms.pose": "a hand pulls to the least distance, which is no zero",
    "structures.sections": "many states at once, each of which may fail alone",
    "orbits.product": "no Newton: directions of a periodic Schur form, block by block",
    "structures.frequencies": "no Newton: lines of a spectrum, taken off one after the other",
    "control.riccati": "no Newton: the doubling of a Riccati equation",
    "control.stationary": "no Newton: constraints that are met or let go",
    "orbits.harmonics": "no Newton: a kernel by inverse iteration",
    "orbits.hill": "no Newton: more exponents about a shift, until they reach as far as a bound asks",
    "orbits.implicit": "the stages of a step, which end at round-off in extents of the motion; the fastest mode",
}
"""Files outside proof/ in which something is solved again and again, and why `mechanics.newton` does not do it"""


def calls(nodes):
    """The names that are called in some nodes: `solve` of np.linalg.solve(...)."""
    made = [node.func for one in nodes for node in ast.walk(one) if isinstance(node, ast.Call)]
    return {getattr(function, "attr", getattr(function, "id", "")) for function in made}


def iterates(node):
    """Whether a node is a loop that counts, or goes on until something holds."""
    counted = isinstance(node, ast.For) and isinstance(node.iter, ast.Call) and calls([node.iter]) == {"range"}
    return counted or isinstance(node, ast.While)


def test_newton_is_written_once():
    """A loop that solves linear equations, or calls a function of its file that does, is there or has a reason."""
    found = set()
    for module in (module for module in modules() if not module.startswith("proof")):
        functions = [node for node in nodes(module) if isinstance(node, ast.FunctionDef)]
        solving = SOLVERS | {one.name for one in functions if calls(one.body) & SOLVERS}
        loops = [node for node in nodes(module) if iterates(node)]
        found |= {module for loop in loops if calls(loop.body) & solving}
    assert found == set(ITERATIONS)


BRACKETS = {
    "continuation.follow": "the one: where something vanishes within a step of what is followed",
    "integrate.automaton": "the events of a motion",
    "atlas.starts": "where a ray meets an energy",
    "atlas.regions": "where a ray meets an energy",
    "mechanisms.library": "the collinear points of the restricted problem",
}
HALVED = {
    "continuation.follow": "the one: steps of what is followed",
    "atlas.solver": "the valley of a nearly degenerate orbit, which is left on either side",
    "loops.polish": "pieces of a motion that is integrated",
}


def test_brackets_are_closed_and_steps_halved_in_one_place():
    """Of what is followed; whatever else does so has its reason."""
    brackets, halved = set(), set()
    for module in modules():
        for node in nodes(module):
            if isinstance(node, ast.Call) and calls([node]) & {"brentq", "bisect", "toms748", "root_scalar"}:
                brackets.add(module)
            value = node.value if isinstance(node, ast.AugAssign) else None
            if isinstance(value, ast.Constant) and (type(node.op), value.value) in ((ast.Div, 2), (ast.Mult, 0.5)):
                halved.add(module)
    assert brackets == set(BRACKETS) and halved == set(HALVED)


def test_checks_are_judged_in_one_file():
    """A number is held against what is allowed there, in one of its three senses."""
    called = {module for module, tree in modules().items() if "Check" in calls([tree])}
    assert called == {"records.certificate"}


def test_what_guards_a_quotient_is_said_once():
    """`nonzero`, `size_of` and `relative` say what a size of 0 is; nobody writes a number of his own for it."""
    written = {
        module
        for module in modules()
        for node in nodes(module)
        if isinstance(node, ast.Constant) and isinstance(node.value, float) and 0 < node.value < 1e-200
    }
    assert written == {"_runtime.sizes"}


ASKED = {
    "mechanics.kind": "the registry of systems",
    "problemfile.schema": "which table of a file belongs to a system's kind",
    "mechanisms.mechanism": "the table of joints",
    "mechanisms.linkage": "named in a message",
    "mechanisms.structure": "the table of elements",
    "records.family": "a fold of the period in files of 0.1, which is a turn",
}
KIND = re.compile(r"\[\"kind\"\]|\.get\(\"kind\"\)|\w\.kind [!=]=|\bkind [!=]= \"")


def texts():
    return {module: (PACKAGE / f"{module.replace('.', '/')}.py") for module in modules() if module}


def read(path):
    return (path if path.exists() else path.with_suffix("") / "__init__.py").read_text(encoding="utf-8")


def test_kinds_are_asked_by_registries():
    """Of systems, events, ends, records: what is special to a kind stands in its entry."""
    told = {"structures.section": "NumPy's kind of numbers"}
    assert {module for module, path in texts().items() if KIND.search(read(path))} <= {*ASKED, *told}


def test_a_class_has_its_name_alone():
    names = [node.name for tree in modules().values() for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    assert not {name for name in names if names.count(name) > 1}


def test_things_are_called_what_they_are():
    """`one` and `found` only where nothing better says it; whether a system is hybrid is asked of the Model."""
    whole = "\n".join(read(path) for path in texts().values())
    assert len(re.findall(r"\b(?:one|found)\b", whole)) <= 2000
    assert len(re.findall(r"\bmodel\.hybrid\b", whole)) <= 40


def test_numbers_belong_to_settings():
    """Capitals at the top of files."""
    named = [
        node
        for tree in modules().values()
        for node in tree.body
        for target in (node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)])
        if isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(target, ast.Name) and target.id.isupper()
    ]
    assert len(named) <= 650


HANDED_ON = {"integrate.dop853", "_runtime.tasks", "_runtime.guard"}
"""Files that keep what was raised and raise it again: beyond SciPy, from a future; and a thread that raises no limit"""


def names_in(node):
    """The names that something is made of."""
    return {each.id for each in ast.walk(node) if isinstance(each, ast.Name)} if node else set()


def test_no_wide_handler_takes_a_time_limit():
    """`except Exception` comes behind the limit's own handler, or raises again: it said "is no matrix (stopped)"."""
    wrong = []
    for module in modules():
        for node in nodes(module):
            passed, handlers = set(), node.handlers if isinstance(node, ast.Try) else ()
            for handler in handlers:
                names = names_in(handler.type)
                wide = names & {"Exception", "BaseException"} or ("OrbitfinderError" in names and not handler.name)
                again = any(isinstance(each, ast.Raise) and not each.exc for each in ast.walk(handler))
                if wide and not again and not passed & {"LimitError", "OrbitfinderError"}:
                    wrong.append((module, handler.lineno))
                passed |= names
            if isinstance(node, ast.Call) and "suppress" in ast.unparse(node.func):
                wrong += [
                    (module, node.lineno) for each in node.args if names_in(each) & {"Exception", "BaseException"}
                ]
    assert {module for module, _ in wrong} <= HANDED_ON, wrong
