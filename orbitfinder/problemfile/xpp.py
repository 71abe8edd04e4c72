"""XPPAUT's .ode files as equations in text: their common part; what is not understood is named with its line.

Source: B. Ermentrout, Simulating, Analyzing, and Animating Dynamical Systems, SIAM 2002, appendix B.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from orbitfinder.errors import InputError, shortened
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model, altered
from orbitfinder.records.reading import Entries, file_bytes

WORD, NUMBER = re.compile(r"(?<![\w.])[A-Za-z_]\w*"), r"[+-]?(?:\d++\.?\d*+|\.\d++)(?:[eE][+-]?\d++)?"
VALUE = rf"([A-Za-z_]\w*) ?= ?({NUMBER})(?: ?, ?| |$)"
LISTS, LEFT_OUT = (
    {**dict.fromkeys(("p", "par", "param", "params", "parameter", "parameters"), "parameters"),
     **dict.fromkeys(("n", "num", "number"), "let"), **dict.fromkeys(("i", "init"), "start")},
    {"a", "aux", "set", "options", "only"},
)  # fmt: skip
"""What changes no equation: columns of tables, values to choose from later, choices of a window"""
LONGEST, PRIORITIES = 20_000, {**dict.fromkeys(("+", "-", "|", "||"), 4), **dict.fromkeys(("*", "/", "&", "&&"), 6),
              **dict.fromkeys(("^", "**", ">", "<", "==", ">=", "<=", "!="), 7)}  # fmt: skip
"""Letters of a line with those that it goes on in; how tightly operators bind, all from the left; a minus and a not
before something bind as a product does"""
OWN = {"heav": ("heav(u)", "if(u >= 0, 1, 0)"), "ln": ("ln(u)", "log(u)"), "log10": ("log10(u)", "log(u)/log(10)"),
       "not": ("not_(u)", "if(u, 0, 1)")}  # fmt: skip
"""XPPAUT's functions that are written out in ours"""
FORMS = {
    r"([A-Za-z_]\w*) ?' ?=([^=].*)": "rates", r"d([A-Za-z_]\w*) ?/ ?dt ?=([^=].*)": "rates",
    rf"([A-Za-z_]\w*) ?\( ?0 ?\) ?= ?({NUMBER})": "start", r"!? ?([A-Za-z_]\w*) ?=([^=].*)": "let",
    r"([A-Za-z_]\w* ?\((?! ?t ?[+)]) ?[A-Za-z_][ \w,]*\)) ?=([^=].*)": "let",
}  # fmt: skip
"""Lines that define something"""


@dataclass(frozen=True)
class _Entry:
    """What a line defines: a text or number in a table of the system, or where its simulation starts and ends."""

    table: str
    name: str
    text: str
    number: int
    where: str

    @property
    def word(self) -> str:
        """Its name alone, in small letters: XPPAUT does not tell them from capitals."""
        return self.name.partition("(")[0].strip().lower()


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


def xpp_document(path: Path, period: str | float | None = None) -> Entries:
    """The problem file that an XPPAUT file stands for: its equations, and where its simulation starts."""
    seen: dict[tuple[str, str], _Entry] = {}
    for entry in _entries(path):
        key = (entry.table if entry.table in ("start", "total") else "", entry.word)
        if key in seen:
            raise InputError(f"{entry.where}: {entry.name} is defined in line {seen[key].number} too; keep one of them")
        seen[key] = entry
    tables = {key: [entry for entry in seen.values() if entry.table == key] for key in ("rates", "let", "parameters")}
    if not tables["rates"]:
        raise InputError(f"{path}: no equations x'=... or dx/dt=...; give an XPPAUT file of differential equations")
    spelled = {entry.word: entry.name.partition("(")[0].strip() for each in tables.values() for entry in each}
    system: Entries = {
        "kind": "equations", "find_invariants": True,
        "parameters": {entry.name: float(entry.text) for entry in tables["parameters"]},
        **{key: {entry.name: _translated(entry, spelled) for entry in tables[key]} for key in ("rates", "let")},
    }  # fmt: skip
    used = {word.lower() for key in ("rates", "let") for entry in tables[key] for word in WORD.findall(entry.text)}
    system["let"] |= {head: text for word, (head, text) in OWN.items() if word in used and word not in spelled}
    system |= {} if period is None else {"period": period}
    try:
        build_model(system)
    except InputError as error:
        named = [seen["", word.lower()] for word in re.findall(r"\w+", error.field)[2:3] if ("", word.lower()) in seen]
        raise InputError(f"{named[0].where if named else path}: {error}") from error
    starts = {word: entry for (table, word), entry in seen.items() if table == "start"}
    for word in starts.keys() - {entry.word for entry in tables["rates"]}:
        raise InputError(f"{starts[word].where}: nothing gives the rate of {word}; add {word}'=...")
    state = [float(starts[entry.word].text) if entry.word in starts else 0.0 for entry in tables["rates"]]
    total = {"duration": float(seen["total", "duration"].text)} if ("total", "duration") in seen else {}
    return {"system": system, "simulate": {"state": state, **total}}


def _logical(path: Path) -> Iterator[tuple[int, str]]:
    """Lines that say something, with their numbers: without comments, continued where they end with a backslash."""
    try:
        rows = file_bytes(path, "XPPAUT file", limit=1_000_000).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text (byte {error.start}); save it as plain text") from error
    begun, first = "", 1
    for number, row in enumerate(rows, start=1):
        first = first if begun else number
        where, row = f"{path}: line {number}: {shortened(repr(row))}", row.lstrip()
        if row.lower().startswith("#include"):
            raise InputError(f"{where}: is not followed; write what is in that file in its place")
        begun += "" if row.startswith('"') else row.partition("#")[0].strip()
        if len(begun) > LONGEST:
            raise InputError(f"{where}: a line of {len(begun)} letters, at most {LONGEST} are read; write several")
        if begun.endswith("\\") and number < len(rows):
            begun = begun[:-1]
        elif begun.lower() in ("d", "done"):
            return
        elif begun:
            yield first, " ".join(begun.split())
            begun = ""


def _entries(path: Path) -> Iterator[_Entry]:
    """What the lines define, in their order. Raises `InputError` for a line that is not understood."""
    for number, line in _logical(path):
        where, defined = f"{path}: line {number}: {shortened(repr(line))}", _defined(line)
        if re.match(r"export\b(?! ?[=(/'])", line, re.IGNORECASE):
            raise InputError(f"{where}: another program gives these their values; write them as equations, name=...")
        if line.startswith("@") and (method := re.search(r"\bmeth\w* ?= ?([dv]\w*)", line, re.IGNORECASE)):
            raise InputError(f"{where}: {method[1]} makes a map or an integral equation of these lines; only "
                             "differential equations are read")  # fmt: skip
        if defined is None:
            raise InputError(f"{where}: is not understood; read are par a=1, number a=1, init x=1, x(0)=1, x'=, "
                             "dx/dt=, f(x)=, a=, !a=, aux and @; write it by these, or leave it out")  # fmt: skip
        yield from (_Entry(table, name.strip(), text.strip(), number, where) for table, name, text in defined)


def _defined(line: str) -> list[tuple[str, str, str]] | None:
    """(table, name, text) of what a line defines, None where it is not understood."""
    if line.startswith("@"):
        total = re.search(rf"\btotal ?= ?({NUMBER})", line, re.IGNORECASE)
        return [("total", "duration", total[1])] if total and float(total[1]) > 0 else []
    listed = re.fullmatch(r"([A-Za-z]\w*) (?![=(/'])(.*)", line)
    command = listed[1].lower() if listed else ""
    if listed and command in LISTS:
        whole = re.fullmatch(f"(?:{VALUE})+", listed[2])
        return [(LISTS[command], name, text) for name, text in re.findall(VALUE, listed[2])] if whole else None
    matches = ((table, re.fullmatch(form, line, re.IGNORECASE)) for form, table in FORMS.items())
    defined = [(table, match[1], match[2]) for table, match in matches if match]
    return [] if command in LEFT_OUT else defined or None


def _translated(entry: _Entry, spelled: Mapping[str, str]) -> str:
    """A right-hand side as our expressions are written. Raises `InputError`."""
    known = {"not": "not_", **spelled, **{word.lower(): word for word in WORD.findall(entry.name)[1:]}}
    text = re.sub(r"\) ?(?:then|else) ?\(", ", ", entry.text, flags=re.IGNORECASE)
    try:
        text = _bracketed(text)
    except (ValueError, RecursionError) as error:
        why = "nested too deeply" if isinstance(error, RecursionError) else error
        raise InputError(f"{entry.where}: {shortened(repr(entry.text))} is no expression ({why}); write it by numbers, "
                         "names, + - * / ^, comparisons, &, |, brackets and functions") from error  # fmt: skip
    return WORD.sub(lambda match: known.get(match[0].lower(), match[0].lower()), text)


def _bracketed(text: str) -> str:
    """An expression with brackets where XPPAUT reads it otherwise: operators from the left, comparisons as tight as
    powers, `&` as a product and `|` as a sum. Raises `ValueError`. Source: `alg_to_rpn` of its parserslow.c."""
    sign = r"\*\*|[=<>!]=|&&|\|\||\S"
    tokens = [match[0] for match in re.finditer(rf"{NUMBER[5:]}|[A-Za-z_]\w*|{sign}", text)][::-1]

    def listed() -> str:
        """What stands in brackets, with them."""
        inside = [part(0)]
        while tokens and tokens[-1] == ",":
            tokens.pop()
            inside.append(part(0))
        if not tokens or tokens.pop() != ")":
            raise ValueError("a bracket is not closed")
        return f"({','.join(inside)})"

    def part(least: int) -> str:
        """Up to the next operator that does not bind more tightly."""
        token = tokens.pop() if tokens else ""
        left, power = token, False
        if token in ("-", "+"):
            left += part(6)
        elif token.lower() == "not":
            left = f"not({part(6)})"
        elif token == "(":
            left = listed()
        elif not re.match(r"[\w.]", token):
            raise ValueError(f"{token!r} where a number or a name belongs" if token else "it ends too early")
        elif tokens and tokens[-1] == "(" and token[:1].isidentifier():
            tokens.pop()
            left += listed()
        while tokens and PRIORITIES.get(tokens[-1], 0) > least:
            sign = tokens.pop()
            right = part(PRIORITIES[sign])
            if sign in ("+", "-", "*", "/"):
                left, power = f"{left}{sign}{right}", False
            elif sign in ("^", "**"):
                left, power = f"({left})^{right}" if power else f"{left}^{right}", True
            else:
                word = {"&": " and ", "|": " or "}.get(sign[0], sign)
                left, power = f"({left}{word}{right})", False
        return left

    made = part(0)
    if tokens:
        raise ValueError(f"{tokens[-1]!r} is not expected there")
    return made
