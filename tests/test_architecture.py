"""The house: imports go down only, CasADi stays on the lower floors, rooms stay short."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "orbitfinder"
LONGEST_FILE, LONGEST_FUNCTION = 400, 60

# low to high; modules of one floor may import each other
FLOORS = (
    ("version", "errors", "quiet", "suggest", "interrupt", "limit", "display", "onethread", "jsontext", "processes",
     "locks", "streams", "arguments", "reading"),
    ("mechanics", "systems"),
    ("flow", "dae_flow", "reference", "buffered", "runge_kutta", "compiled", "taylor", "defects"),
    ("periodic",),
    ("families",),
    ("atlas",),
    ("proof",),
    ("show",),
    ("exports",),
    ("page",),
    ("report", "validation"),
    (
        "schema", "schemadoc", "schemasystem", "schemafaults", "problemfile", "trajectory", "startpoint", "template",
        "simulation", "startlinkage", "choosing", "proposing",
    ),
    (
        "console", "runner", "pictures", "following", "searching", "cataloguing", "guessing", "proving", "paging",
        "exporting", "doctor", "completion", "clioptions", "cli", "__main__",
    ),
)
SOLVING = (
    "conditions",
    "shooting",
    "solve",
    "polish",
    "measure",
    "certify",
    "guesses",
    "preparation",
    "dae_orbit",
    "dae_segments",
    "evidence",
    "hamilton",
    "balanced_start",
    "dae_evidence",
    "tangent",
    "linkage_guesses",
    "quarter",
    "long_chain",
    "closing",
    "marches",
    "freedom",
    "instability",
    "nlp",
    "objectives",
    "second_variation",
)
CASADI = (
    "onethread",
    "mechanics",
    "systems",
    "flow",
    "dae_flow",
    "reference",
    "buffered",
    "runge_kutta",
    "compiled",
    "taylor",
    "defects",
    "families.propagate",
    "families.lanes",
    "atlas.march",
    "proof",
    "exports",
    "validation.literature",
    *(f"periodic.{name}" for name in SOLVING),
)
MODULES = sorted(PACKAGE.rglob("*.py"))


def dotted(path: Path) -> str:
    """`periodic.solve` for orbitfinder/periodic/solve.py; a package has its own name."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """(line, full dotted name) of every import, wherever in the file it stands."""
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}:{node.lineno}: relative import; write orbitfinder.…"
            yield from ((node.lineno, f"{node.module}.{alias.name}") for alias in node.names)


def floor(module: str) -> int:
    """The floor that a module of the package lives on."""
    room = module.split(".")[0]
    found = [level for level, rooms in enumerate(FLOORS) if room in rooms]
    assert found, f"orbitfinder/{room} is on no floor; add it to FLOORS"
    return found[0]


def inside(module: str, rooms: tuple[str, ...]) -> bool:
    return any(module == room or module.startswith(f"{room}.") for room in rooms)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: dotted(path) or "orbitfinder")
def test_imports_go_down_only(path):
    """A module imports its own floor or lower ones; the package's front door may name them all."""
    here = dotted(path)
    if not here:
        pytest.skip("orbitfinder/__init__.py exports from every floor")
    upward = [
        f"line {line}: {name}"
        for line, name in imports(path)
        if name.startswith("orbitfinder.") and floor(name.removeprefix("orbitfinder.")) > floor(here)
    ]
    assert not upward


@pytest.mark.parametrize("path", MODULES, ids=lambda path: dotted(path) or "orbitfinder")
def test_casadi_stays_on_the_lower_floors(path):
    """Above mechanics, flow and the solving half of periodic there is only NumPy."""
    found = [line for line, name in imports(path) if name.split(".")[0] == "casadi"]
    assert not found or inside(dotted(path), CASADI)


def executed_imports(path: Path) -> set[str]:
    """Modules of the package that are imported while `path` itself is imported."""
    known = {dotted(module) for module in MODULES} - {""}
    found = set()
    for node in tree(path).body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("orbitfinder"):
            home = node.module.removeprefix("orbitfinder").removeprefix(".")
            found |= {home, *(f"{home}.{alias.name}".removeprefix(".") for alias in node.names)} & known
    return found - {dotted(path)}


def test_no_import_cycles():
    """The modules can be put in an order in which each needs only earlier ones to be imported."""
    needs = {dotted(path): executed_imports(path) for path in MODULES if dotted(path)}
    while ready := {module for module, wanted in needs.items() if not wanted & needs.keys()}:
        needs = {module: wanted for module, wanted in needs.items() if module not in ready}
    assert not needs, f"import cycle among {sorted(needs)}"


@pytest.mark.parametrize("path", MODULES, ids=lambda path: dotted(path) or "orbitfinder")
def test_library_does_not_print_or_pickle(path):
    """Results go through return values, logging and the command line; files are JSON and npz."""
    printed = [
        node.lineno
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
    ]
    unsafe = ("pickle", "cloudpickle", "dill", "joblib")
    pickled = [line for line, name in imports(path) if name.split(".")[0] in unsafe]
    assert not printed and not pickled


@pytest.mark.parametrize("path", MODULES, ids=lambda path: dotted(path) or "orbitfinder")
def test_rooms_are_short(path):
    """No file and no function longer than the house rule."""
    lines = path.read_text(encoding="utf-8").count("\n")
    long = [
        f"{node.name}: {node.end_lineno - node.lineno + 1} lines"
        for node in ast.walk(tree(path))
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
        and node.end_lineno - node.lineno + 1 > LONGEST_FUNCTION
    ]
    assert lines <= LONGEST_FILE and not long


@pytest.mark.parametrize("path", MODULES, ids=lambda path: dotted(path) or "orbitfinder")
def test_no_bare_except(path):
    """Every handler names what it handles."""
    assert not [node.lineno for node in ast.walk(tree(path)) if isinstance(node, ast.ExceptHandler) and not node.type]
