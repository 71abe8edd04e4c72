"""XPPAUT's .ode files as equations in text: their common part; what is not understood is named with its line.

Source: B. Ermentrout, Simulating, Analyzing, and Animating Dynamical Systems, SIAM 2002, appendix B.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from orbitfinder.errors import InputError, closest, shortened
from orbitfinder.mechanics.expression import FUNCTIONS
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model, altered
from orbitfinder.records.reading import file_bytes

WORD = re.compile(r"(?<![\w.])[A-Za-z_]\w*")
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
VALUE = re.compile(rf"([A-Za-z_]\w*)\s*=\s*({NUMBER})\s*(?:,|\s|$)\s*")
LISTS = {**dict.fromkeys(("p", "par", "param", "params", "parameter", "parameters"), "parameters"),
         **dict.fromkeys(("n", "num", "number"), "let"), **dict.fromkeys(("i", "init"), "start")}  # fmt: skip
LEFT_OUT = {"a", "aux", "set", "options", "only", "export"}
"""What changes no equation: columns of tables, choices of a window"""
OWN = {"heav": ("heav(u)", "if(u >= 0, 1, 0)"), "ln": ("ln(u)", "log(u)"), "log10": ("log10(u)", "log(u)/log(10)")}
"""XPPAUT's functions that are written out in ours"""
FORMS = {
    r"([A-Za-z_]\w*)\s*'\s*=([^=].*)": "rates", r"d([A-Za-z_]\w*)\s*/\s*dt\s*=([^=].*)": "rates",
    r"([A-Za-z_]\w*)\s*\(\s*0\s*\)\s*=([^=].*)": "start", r"!?\s*([A-Za-z_]\w*)\s*=([^=].*)": "let",
    r"([A-Za-z_]\w*\s*\((?!\s*t\s*[+)])[\sA-Za-z_0-9,]+\))\s*=([^=].*)": "let",
}  # fmt: skip
"""Lines that define something, by how they begin"""


def from_xpp(path: str | Path, period: str | float | None = None) -> Model:
    """The Model of an XPPAUT file, with its initial state as the landmark "init".

    Read are parameters (`par`, `number`), `init`, `x'=`, `dx/dt=`, functions, hidden and derived quantities,
    if()then()else(), heav; `aux`, `set` and `@` change no equation and are left out. Names keep the case of their
    definition. Commands take the file itself in place of a problem file.

    Args:
        path: FILE.ode.
        period: of the explicit dependence on the time, where there is one.

    Returns:
        A Model of equations as text.

    Raises:
        InputError: naming the file, the line, its text and the remedy, for `table`, `global`, `markov`, `wiener`,
            delays, arrays, and whatever else has no meaning here.

    Examples:
        >>> from pathlib import Path
        >>> _ = Path("clock.ode").write_text('''
        ... par a=1, b=1.8
        ... init x=1, y=1.8
        ... x'=a + x^2*y - (b + 1)*x
        ... y'=b*x - x^2*y
        ... done
        ... ''')
        >>> clock = of.from_xpp("clock.ode")
        >>> rest = of.follow_equilibria(clock, clock.landmarks["init"], "b", until=2.5)
        >>> [round(event.parameter, 12) for event in rest.events]
        [2.0]
    """
    document = xpp_document(Path(path), period)
    return altered(build_model(document["system"]), landmarks={"init": tuple(document["simulate"]["state"])})


def xpp_document(path: Path, period: str | float | None = None) -> dict[str, Any]:
    """The problem file that an XPPAUT file stands for: its equations, and where its simulation starts."""
    tables, lines = _tables(path)
    spelled = {_word(name).lower(): _word(name) for key in ("rates", "let", "parameters") for name in tables[key]}
    for name in tables["start"]:
        if spelled.get(name.lower()) not in tables["rates"]:
            raise _fault(
                path, *lines[f"start {name}".lower()], f"no equation gives the rate of {name}; add {name}'=..."
            )
    system: dict[str, Any] = {"kind": "equations"} | ({} if period is None else {"period": period})
    for key in ("let", "rates"):
        said = {name: _translated(text, name, spelled, path, lines) for name, text in tables[key].items()}
        system[key] = {name: text for name, (text, _) in said.items()}
        system["let"] = system.get("let", {}) | dict(pair for _, used in said.values() for pair in used)
    system["parameters"] = {name: float(value) for name, value in tables["parameters"].items()}
    try:
        build_model(system)
    except InputError as error:
        words = [word.lower() for word in re.findall(r"\w+", error.field)[2:]]
        known = next((lines[word] for word in words if word in lines), None)
        raise (InputError(f"{path}: {error}") if known is None else _fault(path, *known, str(error))) from error
    starts = {spelled[name.lower()]: float(value) for name, value in tables["start"].items()}
    state = [starts.get(name, 0.0) for name in tables["rates"]]
    return {
        "system": system,
        "simulate": {"state": state} | {key: float(each) for key, each in tables["total"].items()},
    }


def _fault(path: Path, number: int, line: str, why: str) -> InputError:
    return InputError(f"{path}: line {number}: {shortened(repr(line))}: {why}")


def _word(name: str) -> str:
    return name.partition("(")[0].strip()


def _logical(path: Path) -> Iterator[tuple[int, str]]:
    """Lines that say something, with their numbers: without comments, continued where they end with a backslash."""
    try:
        rows = file_bytes(path, "XPPAUT file", limit=1_000_000).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text (byte {error.start}); save it as plain text") from error
    begun, first = "", 1
    for number, row in enumerate(rows, start=1):
        first = first if begun else number
        begun += "" if row.lstrip().startswith('"') else row.partition("#")[0].strip()
        if begun.endswith("\\") and number < len(rows):
            begun = begun[:-1]
        elif begun:
            if begun.lower() in ("d", "done"):
                return
            yield first, begun
            begun = ""


def _tables(path: Path) -> tuple[dict[str, dict[str, str]], dict[str, tuple[int, str]]]:
    """Texts and numbers by what they are and by name; the line of each name, in small letters."""
    tables: dict[str, dict[str, str]] = {key: {} for key in ("rates", "let", "parameters", "start", "total")}
    lines: dict[str, tuple[int, str]] = {}
    for number, line in _logical(path):
        for key, name, text in _defined(path, number, line):
            called = f"start {name}".lower() if key == "start" else _word(name).lower()
            if called in lines:
                raise _fault(path, number, line, f"{name} is defined in line {lines[called][0]} too; keep one of them")
            lines[called], tables[key][name] = (number, line), text
    if not tables["rates"]:
        raise InputError(f"{path}: no equations x'=... or dx/dt=...; give an XPPAUT file of differential equations")
    return tables, lines


def _defined(path: Path, number: int, line: str) -> Iterator[tuple[str, str, str]]:
    """(table, name, text) of what a line defines. Raises `InputError` for a line that is not understood."""
    if line.startswith("@"):
        total = re.search(rf"\btotal\s*=\s*({NUMBER})", line, re.IGNORECASE)
        yield from [("total", "duration", total[1])] if total and float(total[1]) > 0 else []
        return
    listed = re.fullmatch(r"([A-Za-z]\w*)\s+(?![=(/'])(.*)", line)
    command = listed[1].lower() if listed else ""
    if listed and command in LISTS:
        values, end = list(VALUE.finditer(listed[2])), 0
        for value in values:
            end = value.end() if value.start() == end else end
        if end < len(listed[2]):
            raise _fault(path, number, line, "give NAME=NUMBER, with commas between; derive others by !NAME=EXPRESSION")
        yield from ((LISTS[command], value[1], value[2]) for value in values)
    elif command not in LEFT_OUT:
        matches = ((key, re.fullmatch(form, line, re.IGNORECASE)) for form, key in FORMS.items())
        key, match = next((pair for pair in matches if pair[1]), ("", None))
        if match is None or (key == "start" and not re.fullmatch(NUMBER, match[2].strip())):
            raise _fault(path, number, line, "is not understood: read are par, number, init, x'=, dx/dt=, f(x)=, a=, "
                         "!a=, aux, x(0)=NUMBER and @; write it by these, or leave it out")  # fmt: skip
        yield key, match[1].strip(), match[2].strip()


def _translated(
    text: str, name: str, spelled: dict[str, str], path: Path, lines: dict[str, tuple[int, str]]
) -> tuple[str, list[tuple[str, str]]]:
    """A right-hand side as our expressions are written, and the definitions of XPPAUT's own functions in it."""
    own = {word.lower(): word for word in WORD.findall(name)[1:]}
    plain = {word: word for word in (*FUNCTIONS, *OWN, "t", "pi", "not")}
    known: dict[str, str] = plain | spelled | own
    used: list[tuple[str, str]] = []

    def word(match: re.Match[str]) -> str:
        if (small := match[0].lower()) not in known:
            raise _fault(path, *lines[_word(name).lower()], f"{match[0]!r} is not understood"
                         f"{closest(small, known)}; define it in the file, or leave it out")  # fmt: skip
        used.extend([OWN[small]] if small in OWN and small not in spelled else [])
        return known[small]

    for between in ("then", "else"):
        text = re.sub(rf"\)\s*{between}\s*\(", ", ", text, flags=re.IGNORECASE)
    text = WORD.sub(word, text)
    return re.sub(r"\|\|?", " or ", re.sub("&&?", " and ", text)), used
