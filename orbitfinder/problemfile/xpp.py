"""XPPAUT's .ode files as equations in text; what has no meaning here is refused with its line, or left out in words.

Source: B. Ermentrout, Simulating, Analyzing, and Animating Dynamical Systems, SIAM 2002, appendix B; for what a line is
taken for, `parse_a_string`, `search_array`, `subsk` and `compile_em` of XPPAUT's form_ode.c.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from orbitfinder.errors import Hint, InputError, shortened
from orbitfinder.mechanics.equations import RESERVED
from orbitfinder.mechanics.expression import expression
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model, altered, vector_field
from orbitfinder.records.reading import Entries, file_beside, file_bytes

NAME, NUMBER = r"[A-Za-z_]\w*", r"[+-]?(?:\d++\.?\d*+|\.\d++)(?:[eE][+-]?\d++)?"
PAGE, WORD = "docs/how-to/xppaut.md", re.compile(rf"(?<![\w.]){NAME}")
RANGE, INDEX = re.compile(r"\[(-?\d{1,6}) ?\.\.+ ?(-?\d{1,6})\]"), re.compile(r"\[j ?(?:([+*-]) ?(\d{1,6}))?\]", re.I)
COMMANDS, LEFT_OUT = (
    {"d": "end", "gr": "group", "ma": "markov", "so": "algebraic", "au": "aux", "ve": "special", "sp": "special",
     "ex": "export", "on": "only", "v": "volterra", "ta": "table", "p": "parameters", "w": "wiener", "n": "let",
     "o": "options", "se": "set", "b": "bndry", "g": "global", "i": "start"},
    ("aux", "only", "options", "set", "bndry", "read", "unknown"),
)  # fmt: skip
"""What a line without an equation is, by how its first word begins, the first that fits; which of them change no rate:
columns of tables, choices of a window, values to choose from later, conditions at two ends, a value of which XPPAUT
reads the beginning alone, and what begins with a word that XPPAUT does not know either"""
REFUSED, STRANGE = (
    {"markov": "a variable that jumps at random is no differential equation; leave it out",
     "wiener": "noise makes no differential equation; make it a parameter of value 0: par name=0",
     "export": "another program gives these their values; write them as equations, name=...",
     "volterra": "an integral over the past is no differential equation; write it by variables of their own",
     "special": "functions of a whole network are not read; write each term, or sum(0,9)of(...)",
     "group": "groups are not read; write their equations as lines of the file",
     "algebraic": "equations 0=... are not read; solve them for their unknown, name=..., or give it a rate",
     "map": "x(t+1)= makes a map of these lines; only differential equations are read"},
    {**dict.fromkeys(("ran", "normal", "poisson"), "is drawn at random; put a number or a parameter in its place"),
     **dict.fromkeys(("delay", "del_shft"), "is a value of the past; only ordinary differential equations are read"),
     **dict.fromkeys(("besselj", "bessely", "besseli", "hom_bcs"), "is not known here; write it out")},
)  # fmt: skip
"""Lines, and functions of XPPAUT's, that make no ordinary differential equation here, and why"""
LONGEST, MOST_LINES, MOST_ROWS, ROWS, ALONE = 20_000, 5_000, 1000, 50, 20
"""Letters of a line with those that it goes on in; lines with those that arrays stand for; rows of a table, and of each
text that it is written in; formulas of starts that are tried by themselves"""
PRIORITIES, OWN = (
    {**dict.fromkeys(("+", "-", "|", "||"), 4), **dict.fromkeys(("*", "/", "&", "&&"), 6),
     **dict.fromkeys(("^", "**", ">", "<", "==", ">=", "<=", "!="), 7)},
    {"heav": ("heav(u)", "if(u >= 0, 1, 0)"), "ln": ("ln(u)", "log(u)"), "log10": ("log10(u)", "log(u)/log(10)"),
     "not": ("not_(u)", "if(u, 0, 1)"), "flr": ("flr(u)", "floor(u)"), "erfc": ("erfc(u)", "1 - erf(u)")},
)  # fmt: skip
"""How tightly operators bind, all from the left, a minus and a not before something as a product does; XPPAUT's
functions that are written out in ours"""
FORMS = {
    rf"(\d*{NAME}) ?' ?=(.*)": "rates", rf"d(\d*{NAME}) ?/ ?dt ?=(.*)": "rates",
    rf"(\d*{NAME}) ?\( ?0 ?\) ?=(.*)": "start", rf"({NAME}) ?\( ?t ?\+ ?1 ?\) ?=(.*)": "map",
    r"(0) ?=(.*)": "algebraic", rf"({NAME} ?\( ?{NAME}[ \w,]*\)) ?=(.*)": "let",
    rf"!? ?(\d*{NAME}) ?=([^=].*|)": "let",
}  # fmt: skip
"""Lines that define something, the first that fits"""


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

    def fault(self, why: object) -> InputError:
        """An error that names the line."""
        return InputError(f"{self.where}: {why}; see {PAGE}")


def from_xpp(path: str | Path, period: str | float | None = None, time: float | None = None) -> Model:
    """The Model of an XPPAUT file, with its initial state as the landmark "init".

    Read are parameters (`par`, `number`), `init`, `x'=`, `dx/dt=`, functions, hidden and derived quantities, arrays
    `[1..10]`, `sum(0,9)of(...)`, tables, if()then()else(), and `global`, whose resets make a hybrid system of it.
    `aux`, `set`, `bndry`, `only`, options and what enters no rate are left out, in words in `system["left_out"]`.
    Names keep the case of their definition. Commands take the file itself in place of a problem file,
    and FILE.ode#time=T0 or FILE.ode#period=T.

    Args:
        path: FILE.ode.
        period: of the explicit dependence on the time, where there is one.
        time: instead, a time at which all rates are taken: a pulse heav(t - t0) has come or not.

    Returns:
        A Model of equations as text.

    Raises:
        InputError: naming the file, the line, its text and the remedy, for `markov`, `wiener`, `export`, delays,
            integrals, maps, a `global` that sets a parameter, and whatever else has no meaning here.

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
    document = xpp_document(Path(path), period, time)
    return altered(build_model(document["system"]), landmarks={"init": tuple(document["simulate"]["state"])})


def xpp_document(path: Path, period: str | float | None = None, time: float | None = None) -> Entries:
    """The problem file that an XPPAUT file stands for: its equations, and where its simulation starts."""
    if period is not None and time is not None:
        raise InputError("time: what is taken at a time has no period; leave period out")
    seen: dict[tuple[str, str], _Entry] = {}
    left_out, resets = list[str](), list[_Entry]()
    for entry in _named([*_entries(path)], left_out):
        key = (entry.table if entry.table in ("start", "total") else "", entry.word)
        if entry.table == "read":
            warnings.warn(
                f"{entry.where}: {entry.name}: XPPAUT reads no more of it; write a number", Hint, stacklevel=4
            )
        if entry.table in LEFT_OUT:
            left_out.append(f"{entry.table} {entry.name}".strip())
        elif entry.table == "global":
            resets.append(entry)
        elif key in seen and entry.table not in ("start", "total"):
            raise InputError(f"{entry.where}: {entry.name} is defined in line {seen[key].number} too; keep one of them")
        else:
            seen[key] = entry
    tables = {key: [entry for entry in seen.values() if entry.table == key]
              for key in ("rates", "let", "parameters", "start", "table")}  # fmt: skip
    if not tables["rates"]:
        raise InputError(f"{path}: no equations x'=... or dx/dt=...; give an XPPAUT file of differential equations")
    reading = _Definitions(tables, path.parent, time)
    system = reading.system(resets)
    left_out += reading.left_out
    left_out += [f"{old} is called {new}" for old, new in reading.renamed]
    system |= {} if period is None else {"period": period}
    try:
        build_model(system)
    except InputError as error:
        named = [seen["", word.lower()] for word in re.findall(r"\w+", error.field)[2:3] if ("", word.lower()) in seen]
        timed = " or, to take it at a time, time = 0 (in commands FILE.ode#time=0)" * (
            "depends on the time" in str(error)
        )
        raise InputError(f"{named[0].where if named else path}: {error}{timed}") from error
    starts, rates = {entry.word: entry for entry in tables["start"]}, {entry.word for entry in tables["rates"]}
    for word in starts.keys() - rates:
        raise starts[word].fault(f"nothing gives the rate of {word}; add {word}'=...")
    state = _started(reading, starts, tables["rates"], left_out)
    system |= {"left_out": left_out} if left_out else {}
    total = {"duration": float(seen["total", "duration"].text)} if ("total", "duration") in seen else {}
    return {"system": system, "simulate": {"state": state, **total}}


def _named(entries: Sequence[_Entry], left_out: list[str]) -> Iterator[_Entry]:
    """The same with names that begin with a letter: XPPAUT takes 5HT, which expressions cannot tell from a number."""
    odd = {entry.word: f"x_{entry.name}" for entry in entries if re.fullmatch(r"\d+[a-z_]\w*", entry.word)}
    left_out += [f"{new.removeprefix('x_')} is called {new}" for new in odd.values()]
    words = re.compile(rf"(?<![\w.])(?:{'|'.join(odd)})\b", re.IGNORECASE)
    for entry in entries:
        name, text = (words.sub(lambda match: odd[match[0].lower()], each) if odd else each
                      for each in (entry.name, entry.text))  # fmt: skip
        yield replace(entry, name=name, text=text)


def _started(
    reading: _Definitions, starts: Mapping[str, _Entry], rates: Sequence[_Entry], left_out: list[str]
) -> list[float]:
    """The state at t = 0; a formula by the parameters and the numbers of other states, 0 where it has no value."""
    number = {word: float(entry.text) for word, entry in starts.items() if re.fullmatch(NUMBER, entry.text)}
    state = [number.get(entry.word, 0.0) for entry in rates]
    formulas = [k for k, entry in enumerate(rates) if entry.word in starts.keys() - number.keys()]
    readable = list[int]()
    for k in formulas:
        with suppress(InputError):
            readable += [k] if reading.text(starts[rates[k].word]) else []
    for tried in (readable, *([k] for k in readable[:ALONE])):  # some by themselves where not all are defined
        with suppress(InputError):
            values = reading.values({rates[k].word: starts[rates[k].word].text for k in tried}, state)
            formulas = [k for k in formulas if k not in tried or not math.isfinite(values[k])]
            state = [values[k] if k in tried and k not in formulas else x for k, x in enumerate(state)]
        if not formulas:
            break
    left_out += [f"start {starts[rates[k].word].name}(0)={starts[rates[k].word].text}" for k in formulas]
    return state


class _Definitions:
    """A file's definitions on their way into our expressions."""

    def __init__(self, tables: Mapping[str, Sequence[_Entry]], folder: Path, time: float | None) -> None:
        self.tables, self.folder, self.time = tables, folder, time
        self.defined = {entry.word: entry for key in ("let", "table") for entry in tables[key]}
        self.renamed, self.spelled, self.left_out = list[tuple[str, str]](), dict[str, str](), list[str]()
        named = [entry for key in ("rates", "parameters", "let", "table") for entry in tables[key]]
        taken = {entry.word for entry in named}
        for entry in named:
            name = entry.name.partition("(")[0].strip()
            if name in RESERVED or (entry.table in ("rates", "parameters") and name in ("energy", "period")):
                new = next(made for k in range(1, 99) if (made := f"{name}_{k}").lower() not in taken)
                self.renamed.append((name, new))
                name = new
            self.spelled[entry.word] = name

    def system(self, resets: Sequence[_Entry]) -> Entries:
        """The table of a problem file: what the rates and the resets use, and no more. Raises `InputError`."""
        made: Entries = {"kind": "equations", "find_invariants": True}
        self._pass(resets)
        made["parameters"] = {self.spelled[entry.word]: float(entry.text) for entry in self.tables["parameters"]}
        events = [event for entry in resets for event in self._events(entry)]
        used = self._used([entry.text for entry in self.tables["rates"]])
        used |= self._used([text for event in events for text in (event["guard"], *event["reset"].values())])
        self.left_out += [f"{entry.name} enters no rate" for word, entry in self.defined.items() if word not in used]
        made["rates"] = {self.spelled[entry.word]: self.text(entry) for entry in self.tables["rates"]}
        made["let"] = dict[str, str]()
        for word, entry in self.defined.items():
            if word in used:
                made["let"] |= self._rows(entry) if entry.table == "table" else {self._head(entry): self.text(entry)}
        made["let"] |= {head: text for word, (head, text) in OWN.items() if word in used and word not in self.spelled}
        return made | ({"events": {f"event_{k}": event for k, event in enumerate(events, 1)}} if events else {})

    def values(self, texts: Mapping[str, str], state: Sequence[float], time: float = 0.0) -> list[float]:
        """What formulas are at a state and a time, each in the place of a variable's rate. Raises `InputError`."""
        rates = [replace(entry, text=texts.get(entry.word, "0")) for entry in self.tables["rates"]]
        model = build_model(_Definitions({**self.tables, "rates": rates}, self.folder, time).system(()))
        return [*map(float, vector_field(model)(0.0, state, [], []).full().ravel())]

    def _used(self, texts: Sequence[str]) -> set[str]:
        """All words of texts, in small letters, and of what defines them."""
        used, waiting = set[str](), list(texts)
        while waiting:
            text = waiting.pop()
            with suppress(ValueError, RecursionError):  # is refused where it is read
                text = self._shifted(_summed(text))
            new = {word.lower() for word in WORD.findall(text)} - used
            used |= new
            waiting += [self.defined[word].text for word in new if word in self.defined]
        return used

    def _pass(self, resets: Sequence[_Entry]) -> None:
        """Give the parameters the values that lines `global` of times before that of the rates leave them.

        Each happens once, where a condition that is linear in the time crosses 0, and takes the parameters as the
        events before it left them. Raises `InputError` where states, or other events, decide when or what.
        """
        passed, first = list[tuple[float, dict[str, str]]](), self.tables["rates"][0].word
        state, states = [0.0] * len(self.tables["rates"]), {entry.word for entry in self.tables["rates"]}
        timed = [] if self.time is None else [(entry, _global(entry)) for entry in resets]
        timed = [(entry, event) for entry, event in timed if "t" in self._used([event[1]])]
        known = {entry.word for entry in self.tables["parameters"]}
        sets = {word for _, (_, _, actions) in timed for word in actions if word in known}
        for entry, (direction, condition, actions) in timed:
            actions = {word: text for word, text in actions.items() if word in known}
            begin, half, end = (self.values({first: condition}, state, k * (self.time or 0.0) / 2)[0] for k in range(3))
            straight = abs(begin - 2 * half + end) <= 1e-9 * max(abs(begin), abs(end))
            if not straight or self._used([condition]) & (states | sets):
                raise entry.fault("is no time at which it happens, such as t-100; leave it out")
            if self._used([*actions.values()]) & states:
                raise entry.fault("gives a parameter a value of the state then; leave it out, or make it a variable")
            self.left_out.append(f"global {entry.text}")
            if (begin < 0 < end and direction >= 0) or (begin > 0 >= end and direction <= 0):
                passed.append((begin / (begin - end) * (self.time or 0.0), actions))
        for time, actions in sorted(passed, key=lambda each: each[0]):
            new = {word: repr(self.values({first: text}, state, time)[0]) for word, text in actions.items()}
            parameters = [replace(each, text=new.get(each.word, each.text)) for each in self.tables["parameters"]]
            self.tables = {**self.tables, "parameters": parameters}

    def _events(self, entry: _Entry) -> Iterator[Entries]:
        """The events of a line `global`; none where it only prints or ends a simulation, or has passed.

        Raises `InputError`.
        """
        direction, condition, actions = _global(entry)
        timed, values = "t" in self._used([condition]), dict[str, str]()
        if timed and self.time is not None:
            return
        tables = {each.word: each.table for key in ("rates", "parameters") for each in self.tables[key]}
        for word, text in actions.items():
            table = tables.get(word, "")
            if table and (timed or "t" in self._used([text])):
                raise entry.fault("happens at a time and not at a state; leave it out, or take the rates at a time, "
                                  "time = 100")  # fmt: skip
            if table == "parameters":
                raise entry.fault(f"{word} is a parameter that it changes; make it a variable, {word}'=0")
            if table == "rates" and text:
                values[self.spelled[word]] = self.text(entry, text)
            elif word not in ("out_put", "arret"):
                raise entry.fault(
                    f"{shortened(f'{word}={text}')} resets no variable; write {{v=c}} of a variable that has a rate"
                )
        if values:
            for way in (direction,) if direction else (-1, 1):
                yield {"guard": self.text(entry, condition), "direction": way, "reset": values}

    def _head(self, entry: _Entry) -> str:
        """Its name as our `let` has it, the arguments of a function with it."""
        inside = [_argument(part) for part in WORD.findall(entry.name)[1:]]
        return self.spelled[entry.word] + (f"({', '.join(inside)})" if inside else "")

    def text(self, entry: _Entry, text: str | None = None) -> str:
        """A right-hand side, that of the line if none is given, as our expressions are written. Raises `InputError`."""
        text = entry.text if text is None else text
        known = {"not": "not_", **({} if self.time is None else {"t": f"({self.time!r})"}), **self.spelled}
        known |= {word.lower(): _argument(word) for word in WORD.findall(entry.name)[1:]}
        try:
            plain = re.sub(r"\) ?(?:then|else) ?\(", ", ", self._shifted(_summed(text)), flags=re.IGNORECASE)
            plain = _bracketed(plain)
        except (ValueError, RecursionError) as error:
            why = "nested too deeply" if isinstance(error, RecursionError) else error
            raise entry.fault(f"{shortened(repr(text))} is no expression ({why}); write it by numbers, names, "
                              "+ - * / ^, comparisons, &, |, brackets and functions") from error  # fmt: skip
        for name in re.findall(rf"(?<![\w.])({NAME})\(", plain):
            if name.lower() in STRANGE and name.lower() not in self.spelled:
                raise entry.fault(f"{name}() {STRANGE[name.lower()]}")
        return WORD.sub(lambda match: known.get(match[0].lower(), match[0].lower()), plain)

    def _shifted(self, text: str) -> str:
        """A text in which shift(x,k) is the variable, or the parameter, k places after x. Raises `ValueError`."""
        while match := re.search(r"\bshift ?\(", text, re.IGNORECASE):
            within, close = _inside(text, match.end())
            name, _, offset = within.partition(",")
            orders = ([entry.word for key in keys for entry in self.tables[key] if "(" not in entry.name]
                      for keys in (("rates", "let"), ("parameters",)))  # fmt: skip
            words = next((each for each in orders if name.strip().lower() in each), [])
            place = float(expression(_bracketed(offset), {}, "shift", {"flr": math.floor}))
            k = words.index(name.strip().lower()) + int(place) if words else -1
            if not 0 <= k < len(words):
                raise ValueError(f"shift({within}) is no variable and no parameter")
            text = f"{text[: match.start()]}{words[k]}{text[close:]}"
        return text

    def _rows(self, entry: _Entry) -> dict[str, str]:
        """A table as functions, straight between its rows and beyond them, as XPPAUT has it. Raises `InputError`."""
        if formula := re.fullmatch(rf"% ?(\d{{1,6}}) ({NUMBER}) ({NUMBER}) (.*)", entry.text):
            count, low, high = int(formula[1]), float(formula[2]), float(formula[3])
            if not (2 <= count <= MOST_ROWS and 0 < high - low < math.inf):
                raise entry.fault(f"has {count} rows from {low} to {high}; give 2 to {MOST_ROWS} of them, rising")
            places, name = np.linspace(low, high, count).tolist(), self.spelled[entry.word]
            made = {f"{name}_at(t_1)": self.text(replace(entry, name=f"{name}(t)"), formula[4])}
            values = [f"{name}_at({place!r})" for place in places]
        else:
            places, values = self._file(entry)
            made, name = dict[str, str](), self.spelled[entry.word]
        step = (places[-1] - places[0]) / (len(places) - 1)
        terms = [f"{values[0]} + ({values[1]} - {values[0]})/{step!r}*(u - ({places[0]!r}))"] + [
            f"({after} - 2*{here} + {before})/{step!r}*max(0, u - ({place!r}))"
            for before, here, after, place in zip(values, values[1:], values[2:], places[1:], strict=False)
        ]
        for k in range(0, len(terms), ROWS):
            made[f"{name}_{k}(u)"] = " + ".join(terms[k : k + ROWS])
        return made | {f"{name}(u)": " + ".join(f"{name}_{k}(u)" for k in range(0, len(terms), ROWS))}

    def _file(self, entry: _Entry) -> tuple[list[float], list[str]]:
        """Places and values of a table's file: how many, from, to, values. Raises `InputError`."""
        name = entry.text.strip().strip('"')
        if not name or name.startswith("@"):
            raise entry.fault("is not understood; write table f values.tab, or table f % 51 0 10 sin(t)")
        path = file_beside(self.folder, name, entry.where)
        words = file_bytes(path, "table", limit=1_000_000).decode("latin-1").split()
        try:
            numbers = np.array([float(word) for word in words])
            count = int(numbers[0])
            if not (2 <= count <= MOST_ROWS and numbers.size >= 3 + count and np.isfinite(numbers).all()):
                raise ValueError(f"{count} rows, {numbers.size - 3} values")
        except (ValueError, IndexError, OverflowError) as error:
            raise entry.fault(f"{name} is no table ({error}); write how many, from, to, and so many values, at most "
                              f"{MOST_ROWS}") from error  # fmt: skip
        return np.linspace(float(numbers[1]), float(numbers[2]), count).tolist(), [
            f"({value!r})" for value in numbers[3 : 3 + count].tolist()
        ]


def _global(entry: _Entry) -> tuple[int, str, dict[str, str]]:
    """The direction, the condition and the actions of a line `global`. Raises `InputError`."""
    read = re.fullmatch(r"([+-]?[01]) ?(?:\{([^{}]*)\}|([^{}]*)) ?\{([^{}]*)\}?", entry.text)
    if read is None:
        raise entry.fault("is not understood; write global 1 {v-30} {v=c;u=u+d}")
    actions = [part.partition("=") for part in read[4].split(";") if part.strip()]
    return int(read[1]), (read[2] or read[3] or "").strip(), {a.strip().lower(): b.strip() for a, _, b in actions}


def _argument(name: str) -> str:
    """What an argument of a function is called here."""
    return f"{name}_1" if name.lower() in RESERVED else name


def _inside(text: str, begin: int) -> tuple[str, int]:
    """What stands in a bracket that has been opened before a place, and where it ends. Raises `ValueError`."""
    depth = 1
    for k in range(begin, len(text)):
        depth += (text[k] == "(") - (text[k] == ")")
        if not depth:
            return text[begin:k], k + 1
    raise ValueError("a bracket is not closed")


def _summed(text: str) -> str:
    """A text with sum(a,b)of(...) written out, in which i' is the index. Raises `ValueError`."""
    if "{" in text or re.search(r"\bint ?\[", text, re.IGNORECASE):
        raise ValueError("an integral int{...} over the past is no part of a differential equation")
    while match := re.search(r"\bsum ?\(", text, re.IGNORECASE):
        limits, end = _inside(text, match.end())
        of, numbers = (
            re.match(r" ?of ?\(", text[end:], re.IGNORECASE),
            re.fullmatch(r" ?(-?\d{1,6}) ?, ?(-?\d{1,6}) ?", limits),
        )
        if of is None or numbers is None:
            raise ValueError("a sum is written sum(0,9)of(...), with numbers as its bounds")
        body, close = _inside(text, end + of.end())
        over = range(int(numbers[1]), int(numbers[2]) + 1)
        if len(text) + len(over) * (len(body) + 3) > LONGEST:
            raise ValueError(f"more than {LONGEST} letters with its sums written out")
        terms = "+".join("(" + re.sub(r"\bi'", str(k), body) + ")" for k in over)
        text = f"{text[: match.start()]}({terms or 0}){text[close:]}"
    return text


def _logical(path: Path) -> Iterator[tuple[int, str]]:
    """Lines that say something, with their numbers: without comments, continued after a backslash."""
    data = file_bytes(path, "XPPAUT file", limit=1_000_000)
    try:
        rows = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        rows = data.decode("latin-1").splitlines()
    if b"\x00" in data:
        raise InputError(f"{path}: not text (a byte 0 in it); save it as plain text")
    begun, first = "", 1
    for number, row in enumerate(rows, start=1):
        first = first if begun else number
        where, row = f"{path}: line {number}: {shortened(repr(row))}", row.lstrip()
        if row.lower().startswith("#include"):
            raise InputError(f"{where}: is not followed; write what is in that file in its place")
        row, continued, _ = ("" if row.startswith('"') else row.partition("#")[0].strip()).partition("\\")
        begun += row
        if len(begun) > LONGEST:
            raise InputError(f"{where}: a line of {len(begun)} letters, at most {LONGEST} are read; write several")
        if begun and not (continued and number < len(rows)):
            yield first, " ".join(begun.split())
            begun = ""


def _lines(path: Path) -> Iterator[tuple[int, str, str]]:
    """(number, line, the line as it stands with its file) of lines, each that an array stands for by itself."""
    block, over = list[tuple[int, str, str]](), None
    for number, line in _logical(path):
        here = number, line, f"{path}: line {number}: {shortened(repr(line))}"
        ranged = RANGE.search(line) is not None
        if line.startswith("%") and over is not None:  # the end of lines that are repeated
            yield from ((k, _indexed(each, j, where), where) for j in over for k, each, where in block)
            block, over = [], None
        elif line.startswith("%"):
            over = _range(line, here[2]) if ranged else None  # else a comment
        elif over is not None:
            block.append(here)
        else:
            yield from (
                (number, _indexed(line, j, here[2]), here[2]) for j in (_range(line, here[2]) if ranged else (None,))
            )
    if over is not None:
        raise InputError(f"{path}: lines that %[..] repeats are not ended; write % in a line of its own after them")


def _range(line: str, where: str) -> Sequence[int]:
    """The indices of a line, those of the last range in it."""
    low, high = (int(end) for end in RANGE.findall(line)[-1])
    if abs(high - low) > MOST_LINES:
        raise InputError(f"{where}: stands for {abs(high - low) + 1} lines, at most {MOST_LINES} are read")
    return range(low, high + 1) if high >= low else range(low, high - 1, -1)


def _indexed(line: str, j: int | None, where: str) -> str:
    """A line with its indices [j], [j+1], [j*2], [3] as numbers."""
    if j is None and INDEX.search(line):
        raise InputError(f"{where}: [j] belongs to a line with a range, x[1..10]'=x[j+1]; write the number")

    def number(match: re.Match[str]) -> str:
        by = int(match[2] or 0)
        return str((j or 0) * by if match[1] == "*" else (j or 0) + (-by if match[1] == "-" else by))

    return re.sub(r"(?<!int)\[ ?([+-]?\d+) ?\]", r"\1", INDEX.sub(number, RANGE.sub("[j]", line)))


def _entries(path: Path) -> Iterator[_Entry]:
    """What the lines define, in their order. Raises `InputError` for a line that is not understood."""
    for count, (number, line, where) in enumerate(_lines(path)):
        if count > MOST_LINES:
            raise InputError(f"{where}: more than {MOST_LINES} lines with those of arrays; give shorter ones")
        if line.startswith("@"):
            if method := re.search(r"\bmeth\w* ?= ?([dv]\w*)", line, re.IGNORECASE):
                raise InputError(f"{where}: {method[1]} makes a map or an integral equation of these lines; only "
                                 f"differential equations are read; see {PAGE}")  # fmt: skip
            total = re.search(rf"\btotal ?= ?({NUMBER})", line, re.IGNORECASE)
            if total and float(total[1]) > 0:
                yield _Entry("total", "duration", total[1], number, where)
            continue
        match = next(((table, m) for form, table in FORMS.items() if (m := re.fullmatch(form, line, re.I))), None)
        command, means = re.fullmatch(r"([A-Za-z]\w*)(?: (?!=)(.*))?", line), ""
        name, text, rest = "", "", command[2] or "" if command else ""
        if match:
            means, name, text = match[0], match[1][1], match[1][2].strip()
            means = "volterra" if re.search(r"\( ?t ?\)$", name) and re.search(r"int ?[{[]", text, re.I) else means
        elif command:
            means = next((each for begin, each in COMMANDS.items() if command[1].lower().startswith(begin)), "unknown")
        if means == "end":
            return
        if means in REFUSED:
            raise InputError(f"{where}: {REFUSED[means]}; see {PAGE}")
        if match and text:
            yield _Entry(means, name, text, number, where)
        elif command and means in LEFT_OUT:
            name = rest.partition("=")[0].strip() if means == "aux" else rest if means != "unknown" else shortened(line)
            yield _Entry(means, name, rest, number, where)
        elif command and means == "global":
            yield _Entry(means, "", rest, number, where)
        elif command and means == "table" and (table := re.fullmatch(rf"({NAME}) (.+)", rest)):
            yield _Entry(means, table[1], table[2], number, where)
        elif command and means in ("parameters", "let", "start") and rest:
            for name, value in _values(rest, where):
                begun = read[0] if (read := re.match(NUMBER, value)) else "0"
                if value not in ("", begun):
                    yield _Entry("read", f"{name}={shortened(value)} as {begun}", begun, number, where)
                yield _Entry(means, name, begun, number, where)
        else:
            if count == 0 and re.match(r"\d", line):
                raise InputError(f"{where}: is of XPPAUT's old form; convert the file by xppaut -convert; see {PAGE}")
            raise InputError(f"{where}: is not understood; read are par a=1, number a=1, init x=1, x(0)=1, x'=, "
                             f"dx/dt=, f(x)=, a=, !a=, table, global, aux, @; see {PAGE}")  # fmt: skip


def _values(text: str, where: str) -> Iterator[tuple[str, str]]:
    """(name, value) of `a=1, b=2 c`, each without blanks. Raises `InputError`."""
    for part in filter(None, re.split(r" ?, ?| ", re.sub(r" ?= ?", "=", text))):
        name, _, value = part.partition("=")
        if not re.fullmatch(rf"\d*{NAME}", name):
            raise InputError(f"{where}: {shortened(repr(part))} is no name=number; write a=1, b=2; see {PAGE}")
        yield name, value


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
