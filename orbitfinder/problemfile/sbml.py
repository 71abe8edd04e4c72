"""SBML files as equations in text: reactions, rules and functions; what has no meaning here is refused by its name.

Source: M. Hucka et al., The Systems Biology Markup Language (SBML): Language Specification for Level 3 Version 2 Core,
J. Integr. Bioinform. 16 (2019) 20190021, sections 4.6 to 4.11, for what a symbol of a species means and how its rate
follows from the reactions.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import cache, reduce
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from orbitfinder._runtime.processes import alone
from orbitfinder.errors import InputError, shortened
from orbitfinder.mechanics.equations import RESERVED
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model, altered, vector_field
from orbitfinder.mechanics.scales import with_units
from orbitfinder.records.reading import Entries, file_bytes

PAGE, LARGEST, DEEPEST, MOST, SECONDS, MEMORY = "docs/how-to/sbml.md", 20_000_000, 200, 5_000, 30.0, 4_000_000_000
"""The page; bytes of a file, how deeply its elements may be nested, its species, parameters and reactions; what libSBML
gets to read it: s, bytes"""
OPERATORS, FUNCTIONS, SYMBOLS, PREFIXES = (
    {"PLUS": ("+", 4, "0"), "TIMES": ("*", 5, "1"), "MINUS": ("-", 4, ""), "DIVIDE": ("/", 5, ""),
     "POWER": ("^", 7, ""), "FUNCTION_POWER": ("^", 7, ""), "LOGICAL_AND": (" and ", 1, "(1 > 0)"),
     "LOGICAL_OR": (" or ", 0, "(1 < 0)"), "RELATIONAL_EQ": (" == ", 3, ""), "RELATIONAL_NEQ": (" != ", 3, ""),
     "RELATIONAL_LT": (" < ", 3, ""), "RELATIONAL_LEQ": (" <= ", 3, ""), "RELATIONAL_GT": (" > ", 3, ""),
     "RELATIONAL_GEQ": (" >= ", 3, "")},
    {**{name.upper(): f"{name}({{0}})" for name in
        ("abs", "sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "floor")},
     "ARCSIN": "asin({0})", "ARCCOS": "acos({0})", "ARCTAN": "atan({0})", "LN": "log({0})",
     "CEILING": "-floor(-({0}))", "LOG": "log({1})/log({0})", "ROOT": "({1})^(1/({0}))", "SEC": "1/cos({0})",
     "CSC": "1/sin({0})", "COT": "1/tan({0})", "SECH": "1/cosh({0})", "CSCH": "1/sinh({0})", "COTH": "1/tanh({0})",
     "ARCSINH": "log({0} + sqrt(({0})^2 + 1))", "ARCCOSH": "log({0} + sqrt(({0})^2 - 1))",
     "ARCTANH": "log((1 + ({0}))/(1 - ({0})))/2"},
    {("second", 60.0): "min", ("second", 3600.0): "h", ("second", 86400.0): "d", ("dimensionless", 1.0): "",
     **{(name, 1.0): word for name, word in (("second", "s"), ("mole", "mol"), ("litre", "L"), ("metre", "m"),
        ("gram", "g"), ("kilogram", "kg"), ("volt", "V"), ("ampere", "A"), ("item", "items"))}},
    {-15: "f", -12: "p", -9: "n", -6: "u", -3: "m", 0: "", 3: "k"},
)  # fmt: skip
"""MathML's operators: the sign, how tightly it binds, and its value of nothing; its functions in ours (the base of a
logarithm and the degree of a root come first); units with their multipliers, and powers of ten, as words"""


def from_sbml(path: str | Path, period: str | float | None = None, time: float | None = None) -> Model:
    """The Model of an SBML file, with its initial state as the landmark "init"; needs the extra [sbml].

    n' = sum_r (s_r v_r), of the amount n of a species in the reactions r with stoichiometries s and rates v; where a
    species is meant by its concentration, its state is n / V. Read are kinetic laws, function definitions, rate and
    assignment rules, initial assignments, compartments of constant size, species at a boundary and conversion factors.
    Symbols keep their ids. Totals are looked for. Commands take FILE.xml in place of a problem file.

    Args:
        path: FILE.xml of Level 2 or 3.
        period: of the explicit dependence on the time, where there is one.
        time: instead, a time at which all rates are taken.

    Returns:
        A Model of equations as text.

    Raises:
        InputError: naming the file and the id, for events, delays, algebraic rules, fast reactions, compartments that
            change, packages that must be understood, values that are missing, and files that libSBML cannot read.

    Examples:
        >>> from pathlib import Path
        >>> _ = Path("decay.xml").write_text('''
        ... <sbml xmlns="http://www.sbml.org/sbml/level2/version4" level="2" version="4"><model id="decay">
        ...   <listOfCompartments><compartment id="cell" size="2"/></listOfCompartments>
        ...   <listOfSpecies><species id="A" compartment="cell" initialAmount="3"/></listOfSpecies>
        ...   <listOfReactions><reaction id="r"><listOfReactants><speciesReference species="A"/></listOfReactants>
        ...     <kineticLaw><math xmlns="http://www.w3.org/1998/Math/MathML"><ci>A</ci></math></kineticLaw>
        ...   </reaction></listOfReactions></model></sbml>
        ... '''.strip())
        >>> model = of.from_sbml("decay.xml")
        >>> model.landmarks["init"], model.system["rates"]
        ((1.5,), {'A': '(-r)/cell'})

    See Also:
        `of.from_xpp` for XPPAUT's files, `of.equations` for what they become.
    """
    document = sbml_document(Path(path), period, time)
    model = with_units(build_model(document["system"]), document.get("units"))
    return altered(model, landmarks={"init": tuple(document["simulate"]["state"])})


def sbml_document(path: Path, period: str | float | None = None, time: float | None = None) -> Entries:
    """The problem file that an SBML file stands for: its equations, and where its simulation starts."""
    if period is not None and time is not None:
        raise InputError("time: what is taken at a time has no period; leave period out")
    if find_spec("libsbml") is None:
        raise InputError("file: SBML files need the extra: pip install 'orbitfinder[sbml]'")
    _check_nesting(path, file_bytes(path, "SBML file", limit=LARGEST))
    made = alone(__name__, "translated", [str(path.resolve()), str(path), time], SECONDS, MEMORY)
    if made is None:
        raise InputError(f"{path}: libSBML ends, or does not read it within {SECONDS:g} s and {MEMORY / 1e9:g} GB; "
                         "correct the file")  # fmt: skip
    if "refused" in made:
        raise InputError(made["refused"])
    system = made["system"] | ({} if period is None else {"period": period})
    try:
        build_model(system)
    except InputError as error:
        at_a_time = " or, to take it at a time, time = 0" if "depends on the time" in str(error) else ""
        raise InputError(f"{path}: {error}{at_a_time}; see {PAGE}") from error
    units = {"units": made["units"]} if made["units"] else {}
    return {"system": system, **units, "simulate": {"state": made["state"]}}


def translated(asked: Sequence[Any]) -> Entries:
    """What a file, [where it lies, its name, a time], says; or why nothing is made of it, `refused`. For `alone`, since
    libSBML ends the process on some damaged files."""
    source, name, time = asked
    try:
        reading = _Components(Path(name), _read(Path(source), Path(name)), time)
        return {"system": reading.system(), "units": reading.units, "state": reading.state}
    except InputError as error:
        return {"refused": str(error)}


def _read(source: Path, path: Path) -> Any:
    """libSBML's model, the parameters of its reactions among the others. Raises `InputError`, which names `path`."""
    import libsbml  # noqa: PLC0415

    document = libsbml.readSBMLFromString(source.read_bytes().decode("utf-8", "replace"))
    for k in range(document.getNumErrors()):
        fault = document.getError(k)
        if fault.getSeverity() >= libsbml.LIBSBML_SEV_ERROR:
            said = shortened(" ".join(fault.getMessage().split()), 200)
            raise InputError(f"{path}: line {fault.getLine()}: {said}; correct the file")
    model = document.getModel()
    if model is None:
        raise InputError(f"{path}: no model in it; give an SBML file of Level 2 or 3")
    for k in range(document.getNumPlugins()):
        package = document.getPlugin(k).getPackageName()
        known = package == "l3v2extendedmath" or document.getLevel() < 3  # there packages are annotations
        if not known and document.getPackageRequired(package):
            raise InputError(f"{path}: the package {package!r} is not read; write the model without it; see {PAGE}")
    sizes = (model.getNumSpecies(), model.getNumParameters(), model.getNumReactions(), model.getNumRules())
    if max(sizes) > MOST:
        raise InputError(
            f"{path}: {max(sizes)} species, parameters, rules or reactions; at most {MOST} of each are read"
        )
    wanted = libsbml.ConversionProperties()
    wanted.addOption("promoteLocalParameters", True)
    document.convert(wanted)
    model.keeping = document  # its memory
    return model


def _check_nesting(path: Path, data: bytes) -> None:
    """`InputError` for what is no XML, for entities, and for nesting by which a recursive reader would die."""
    parser, depth = expat.ParserCreate(), 0

    def begin(name: str, _: Mapping[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > DEEPEST:
            raise InputError(f"{path}: elements within elements, deeper than {DEEPEST}; name parts of the formula")
        if depth == 1 and name.rpartition(":")[2] != "sbml":
            raise InputError(f"{path}: its element is <{shortened(name)}>; an SBML file has <sbml>")

    def end(_: str) -> None:
        nonlocal depth
        depth -= 1

    def refused(*_: Any) -> None:
        raise InputError(f"{path}: has a document type of its own; SBML files have none, leave it out")

    parser.StartElementHandler, parser.EndElementHandler, parser.StartDoctypeDeclHandler = begin, end, refused
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise InputError(f"{path}: no XML ({error}); give an SBML file") from error


class _Components:
    """A model's components on their way into our text."""

    def __init__(self, path: Path, model: Any, time: float | None) -> None:
        self.path, self.model, self.time = path, model, time
        self.state, self.spelled, self.units = list[float](), dict[str, str](), dict[str, str]()
        self.species = {each.getId(): each for each in model.getListOfSpecies()}
        self.rules = {each.getVariable(): each for each in model.getListOfRules() if each.getVariable()}
        self.assigned = {each.getSymbol(): each for each in model.getListOfInitialAssignments()}
        self.sizes = {each.getId(): each for each in model.getListOfCompartments()}
        self.ids = {each.getId() for many in (model.getListOfParameters(), model.getListOfReactions()) for each in many}
        self.ruled = {each.getId(): each for reaction in model.getListOfReactions()
                      for many in (reaction.getListOfReactants(), reaction.getListOfProducts())
                      for each in many if each.getId() in {*self.rules, *self.assigned}}  # fmt: skip
        self.ids |= {*self.species, *self.sizes, *self.ruled}

    def fault(self, what: str, why: str) -> InputError:
        """An error that names a component."""
        return InputError(f"{self.path}: {what}: {why}; see {PAGE}")

    def system(self) -> Entries:
        """The table of a problem file. Raises `InputError`."""
        self._check()
        made: Entries = {"kind": "equations", "find_invariants": True, "parameters": {}, "let": {}, "rates": {}}
        for function in self.model.getListOfFunctionDefinitions():
            inside = [self._name(function.getArgument(k).getName()) for k in range(function.getNumArguments())]
            head = self._name(function.getId()) + (f"({', '.join(inside)})" if inside else "")
            made["let"][head] = self.text(function.getBody(), f"function {function.getId()!r}")
        terms = self._reactions(made["let"])
        left = [f"the size of {key}, taken as 1" for key, each in self.sizes.items() if not each.isSetSize()]
        values = self._values({key: each.getSize() if each.isSetSize() else 1.0 for key, each in self.sizes.items()})
        for key in values:
            name, rule, each = self._name(key), self.rules.get(key), self.species.get(key)
            if rule is not None and rule.isAssignment():
                made["let"][name] = self.text(rule.getMath(), f"rule of {key!r}")
            elif rule is not None or (each and not each.getConstant() and not each.getBoundaryCondition()):
                made["rates"][name] = self.text(rule.getMath(), f"rule of {key!r}") if rule else self._rate(each, terms)
            else:
                made["parameters"][name] = values[key]
        if not made["rates"]:
            raise self.fault("model", "nothing has a rate; a model of fluxes alone is not read")
        if self.assigned:
            values = self._assigned(values, made["let"])
        for key, value in values.items():
            name = self._name(key)
            if name not in made["let"] and not math.isfinite(value):
                raise self.fault(repr(key), "has no value; give it")
            if name in made["parameters"]:
                made["parameters"][name] = value
        self.state = [values[key] for name in made["rates"] for key in values if self._name(key) == name]
        left += [f"constraint {k + 1}" for k in range(self.model.getNumConstraints())]
        left += [f"{key} is called {name}" for key, name in self.spelled.items() if key != name]
        known = made["rates"].keys() | made["parameters"].keys()
        self.units = {name: word for key, name in self.spelled.items() if name in known
                 and (word := _word(self.model.getElementBySId(key).getDerivedUnitDefinition()))}  # fmt: skip
        time = self.model.getUnitDefinition(self.model.getTimeUnits() or "time")
        self.units |= {"time": word} if (word := "s" if self.model.getTimeUnits() == "second" else _word(time)) else {}
        return made | ({"left_out": left} if left else {})

    def _values(self, sizes: Mapping[str, float]) -> dict[str, float]:
        """What everything begins with that has a symbol, by its id, in compartments of these sizes."""
        values = {key: self._amount(each, sizes) for key, each in self.species.items()} | dict(sizes)
        values |= {each.getId(): each.getValue() if each.isSetValue() else math.nan
                   for each in self.model.getListOfParameters()}  # fmt: skip
        return values | {key: each.getStoichiometry() for key, each in self.ruled.items()}

    def _assigned(self, values: dict[str, float], let: Mapping[str, str]) -> dict[str, float]:
        """The same with the initial assignments, which may need each other. Raises `InputError`."""
        texts = {f"start_{k}": self.text(each.getMath(), f"initialAssignment {key!r}")
                 for k, (key, each) in enumerate(self.assigned.items())}  # fmt: skip
        timed = any(re.search(r"\bt\b", text) for text in (*texts.values(), *let.values()))
        names = {self._name(key): key for key in values if self._name(key) not in let}
        system = {"kind": "equations", "parameters": dict.fromkeys(names, 1.0), "let": dict(let), "rates": texts}
        model = build_model(system | ({"period": 1.0} if timed else {}))
        for _ in range(len(texts) + 2):
            given = [values[names[name]] for name in model.parameter_names]
            new = dict(zip(self.assigned, vector_field(model, model.parameter_names)(0.0, [0.0] * len(texts), [], given)
                           .full().ravel().tolist(), strict=True))  # fmt: skip
            begun = self._values({key: new.get(key, values[key]) for key in self.sizes}) | new
            if np.array_equal(list(values.values()), [begun[key] for key in values], equal_nan=True):
                return values
            values = begun
        raise self.fault(f"initialAssignment {next(iter(self.assigned))!r}", "needs itself; break the circle")

    def _check(self) -> None:
        """`InputError` for what no equations here stand for."""
        for event in self.model.getListOfEvents():
            name = event.getId() or event.getName()
            raise self.fault(f"event {name!r}", "events are not read; leave it out, or write the equations as text")
        for rule in self.model.getListOfRules():
            if rule.isAlgebraic():
                raise self.fault("algebraicRule", "is not read; solve it for its unknown, as an assignmentRule")
        for key, each in self.sizes.items():
            within = [species for species in self.species.values() if species.getCompartment() == key]
            if key in self.rules and within and not all(map(self._grown, within)):
                raise self.fault(
                    f"compartment {key!r}", "changes its size; give it a rate, and reactions to what is in it"
                )
            if each.isSetSize() and each.getSize() <= 0:
                raise self.fault(f"compartment {key!r}", f"has the size {each.getSize():g}; give a positive size")

    def _name(self, key: str) -> str:
        """What a component is called here: its id, but for what is taken."""
        if key not in self.spelled:
            names = (f"{key}_{k}" if k else key for k in range(99))
            taken = {*RESERVED, "energy", "period", *self.spelled.values(), *(self.ids - {key})}
            self.spelled[key] = next(name for name in names if name not in taken)
        return self.spelled[key]

    def _concentration(self, species: Any) -> bool:
        """Whether its symbol means a concentration."""
        size = self.sizes.get(species.getCompartment())
        flat = size is not None and size.isSetSpatialDimensions() and size.getSpatialDimensionsAsDouble() == 0
        return not species.getHasOnlySubstanceUnits() and not flat

    def _grown(self, species: Any) -> bool:
        """Whether its rate is known where its compartment grows by a rate."""
        by_reactions = not (species.getConstant() or species.getBoundaryCondition() or species.getId() in self.rules)
        return by_reactions and self.rules[species.getCompartment()].isRate()

    def _amount(self, species: Any, sizes: Mapping[str, float]) -> float:
        """The initial value of a species as its symbol means it."""
        size = sizes.get(species.getCompartment(), 1.0)
        if self._concentration(species):
            if species.isSetInitialConcentration():
                return float(species.getInitialConcentration())
            return float(species.getInitialAmount()) / size if species.isSetInitialAmount() else math.nan
        if species.isSetInitialAmount():
            return float(species.getInitialAmount())
        return float(species.getInitialConcentration()) * size if species.isSetInitialConcentration() else math.nan

    def _reactions(self, let: dict[str, str]) -> dict[str, list[str]]:
        """The terms of each species' rate, by the names of the reactions, whose kinetic laws `let` gets."""
        terms: dict[str, list[str]] = {}
        for reaction in self.model.getListOfReactions():
            key, law = reaction.getId(), reaction.getKineticLaw()
            if reaction.isSetFast() and reaction.getFast():
                raise self.fault(f"reaction {key!r}", "is fast; write its equilibrium as a rule")
            if law is None or law.getMath() is None:
                raise self.fault(f"reaction {key!r}", "has no kinetic law; models of fluxes alone are not read")
            let[self._name(key)] = self.text(law.getMath(), f"reaction {key!r}")
            for sign, many in (("-", reaction.getListOfReactants()), ("+", reaction.getListOfProducts())):
                for each in many:
                    terms.setdefault(each.getSpecies(), []).append(f"{sign}{self._times(each, key)}{self._name(key)}")
        return terms

    def _times(self, reference: Any, reaction: str) -> str:
        """How many of a species a reaction takes or makes, as a factor."""
        if reference.getId() in self.ruled:
            return f"{self._name(reference.getId())}*"
        if reference.isSetStoichiometryMath():
            return f"({self.text(reference.getStoichiometryMath().getMath(), f'reaction {reaction!r}')})*"
        count = reference.getStoichiometry() if reference.isSetStoichiometry() else 1.0
        if not math.isfinite(count):
            raise self.fault(f"reaction {reaction!r}", "has no stoichiometry; give the number")
        return "" if count == 1 else f"{count:.17g}*"

    def _rate(self, species: Any, terms: Mapping[str, list[str]]) -> str:
        """The rate of a species by its reactions, 0 without any."""
        text = "".join(terms.get(species.getId(), ["0"])).removeprefix("+")
        factor = species.getConversionFactor() or self.model.getConversionFactor()
        text = f"{self._name(factor)}*({text})" if factor else text
        if not self._concentration(species):
            return text
        where = species.getCompartment()
        if where in self.rules:  # (n / V)' = n' / V - (n / V) V' / V
            growth = self.text(self.rules[where].getMath(), f"rule of {where!r}")
            text += f"-{self._name(species.getId())}*({growth})"
        return f"({text})/{self._name(where)}"

    def text(self, node: Any, where: str) -> str:
        """A formula of MathML as our expressions are written. Raises `InputError`."""
        if node is None:
            raise self.fault(where, "has no formula; write it")
        return self._printed(node, where)[0]

    def _printed(self, node: Any, where: str) -> tuple[str, int]:
        """Its text and how tightly its outermost operator binds."""
        means = _kinds()[node.getType()]
        inside = [node.getChild(k) for k in range(node.getNumChildren())]
        if means in ("INTEGER", "REAL", "REAL_E", "RATIONAL"):
            if means == "RATIONAL":
                return f"{node.getNumerator()}/{node.getDenominator()}", 5
            value = float(node.getInteger() if means == "INTEGER" else node.getReal())
            if not math.isfinite(value):
                raise self.fault(where, f"the number {value}; give a finite number")
            return (f"{value:.17g}", 8) if value >= 0 else (f"{value:.17g}", 4)
        names = {"NAME_TIME": "t" if self.time is None else f"({self.time!r})", "NAME_AVOGADRO": "6.02214179e+23",
                 "CONSTANT_PI": "pi", "CONSTANT_E": "exp(1)", "CONSTANT_TRUE": "(1 > 0)",
                 "CONSTANT_FALSE": "(1 < 0)"}  # fmt: skip
        if means in names or means == "NAME":
            return names.get(means) or self._name(node.getName()), 8
        parts = [self._printed(each, where) for each in inside]
        texts = [text for text, _ in parts]
        if means == "FUNCTION":
            name = self._name(node.getName())
            return f"{name}({', '.join(texts)})" if parts else name, 8
        if means == "FUNCTION_PIECEWISE":
            if len(texts) % 2 == 0:
                raise self.fault(where, "a piecewise without otherwise; say what it is elsewhere")
            pieces = zip(texts[-3::-2], texts[-2::-2], strict=True)
            return reduce(lambda rest, piece: f"if({piece[1]}, {piece[0]}, {rest})", pieces, texts[-1]), 8
        if means == "LOGICAL_NOT" and len(parts) == 1:
            return f"not ({texts[0]})", 2
        if means in ("FUNCTION_MAX", "FUNCTION_MIN") and parts:
            word = means.removeprefix("FUNCTION_").lower()
            return reduce(lambda done, each: f"{word}({done}, {each})", texts), 8
        if means == "LOGICAL_XOR" and parts:
            return reduce(lambda done, each: f"(({done}) != ({each}))", texts), 8
        if means in OPERATORS:
            return self._joined(means, parts, where)
        pattern = FUNCTIONS.get(means.removeprefix("FUNCTION_"), "")
        if pattern and len(parts) == 1 + pattern.count("{1}"):
            return pattern.format(*texts), 8 if pattern[0].isalpha() and "/" not in pattern else 4
        name = node.getName() or means.removeprefix("FUNCTION_").lower()
        raise self.fault(where, f"{shortened(name)!r} with {len(parts)} arguments is not read; write it out")

    def _joined(self, means: str, parts: list[tuple[str, int]], where: str) -> tuple[str, int]:
        """Operands with their sign between them, in brackets where they bind less tightly."""
        sign, level, empty = OPERATORS[means]
        if not parts and empty:
            return empty, 8
        if means == "MINUS" and len(parts) == 1:
            return f"-{_closed(parts[0], 5)}", 4
        if len(parts) == 1 and empty:
            return parts[0]
        if len(parts) < 2 or (not empty and level != 3 and len(parts) > 2):
            raise self.fault(where, f"{sign.strip()!r} of {len(parts)} operands; write two")
        if level == 3:
            pairs = [f"{_closed(a, 4)}{sign}{_closed(b, 4)}" for a, b in pairwise(parts)]
            return " and ".join(pairs), 3 if len(pairs) == 1 else 1
        first, *others = parts
        return sign.join([_closed(first, level + (level == 7)), *(_closed(each, level + 1) for each in others)]), level


@cache
def _kinds() -> dict[int, str]:
    """What libSBML's numbers of nodes mean, such as PLUS."""
    import libsbml  # noqa: PLC0415

    return {getattr(libsbml, name): name.removeprefix("AST_") for name in dir(libsbml)
            if name.startswith("AST_") and isinstance(getattr(libsbml, name), int)}  # fmt: skip


def _word(definition: Any) -> str:
    """A unit in words, such as "umol/L"; "" where it has none."""
    import libsbml  # noqa: PLC0415

    above, below = list[str](), list[str]()
    for unit in definition.getListOfUnits() if definition is not None else ():
        name, times, power = libsbml.UnitKind_toString(unit.getKind()), unit.getMultiplier(), unit.getExponentAsDouble()
        word = SYMBOLS.get((name, times)) if unit.getScale() == 0 else None
        if word is None:
            prefix, plain = PREFIXES.get(unit.getScale()), SYMBOLS.get((name, 1.0))
            word = f"{prefix}{plain}" if prefix is not None and plain and times == 1 else None
        if word is None:
            return ""
        side = above if power > 0 else below
        side += [word if abs(power) == 1 else f"{word}^{abs(power):g}"] if word and power else []
    text = " ".join(above) or ("1" if below else "")
    text += f"/{' '.join(below)}" if len(below) == 1 else f"/({' '.join(below)})" if below else ""
    return text if len(text) <= 24 else ""


def _closed(part: tuple[str, int], least: int) -> str:
    """A part in brackets, unless it binds as tightly."""
    return part[0] if part[1] >= least else f"({part[0]})"
