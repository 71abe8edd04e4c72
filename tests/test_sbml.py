"""SBML files: every component, formulas of every function, what is refused, and the same bifurcations as the text's."""

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.mechanics.kind import build_model
from orbitfinder.problemfile.sbml import translated

pytestmark = pytest.mark.needs("sbml")
NAMESPACE = "http://www.sbml.org/sbml/level3/version2/core"


def command(*arguments):
    return CliRunner().invoke(cli, [str(each) for each in arguments])


def mathml(text):
    """A formula as the element <math>."""
    import libsbml

    made = libsbml.writeMathMLToString(libsbml.parseL3Formula(text))
    return made.partition("?>")[2]


def attributes(given):
    return "".join(f' {key}="{value}"' for key, value in given.items())


def rule(kind, key, text):
    """A rule "rate" or "assignment" of a symbol."""
    return f'<{kind}Rule variable="{key}">{mathml(text)}</{kind}Rule>'


def volume(key, size, constant="true"):
    return f'<compartment id="{key}" size="{size}" constant="{constant}"/>'


def listed(word, rows):
    return f"<listOf{word}>{''.join(rows)}</listOf{word}>" if rows else ""


def sbml(
    species=(),
    parameters=(),
    reactions=(),
    rules="",
    compartments='<compartment id="cell" size="1" constant="true"/>',
    more="",
):
    """A model of Level 3 Version 2: species with their attributes, parameters, and reactions (left, right, law)."""
    usual = {"compartment": "cell", "hasOnlySubstanceUnits": "false", "boundaryCondition": "false", "constant": "false"}
    kinds = [f"<species{attributes(usual | {'id': key} | given)}/>" for key, given in dict(species).items()]
    values = [f'<parameter id="{key}" value="{value}" constant="true"/>' for key, value in dict(parameters).items()]
    made = []
    for key, (left, right, law) in dict(reactions).items():
        sides = [
            listed(
                word,
                [
                    f'<speciesReference species="{each}" stoichiometry="{n}" constant="true"/>'
                    for each, n in side.items()
                ],
            )
            for word, side in (("Reactants", left), ("Products", right))
        ]
        made.append(
            f'<reaction id="{key}" reversible="false">{"".join(sides)}<kineticLaw>{mathml(law)}</kineticLaw></reaction>'
        )
    inside = (
        more
        + f"<listOfCompartments>{compartments}</listOfCompartments>"
        + listed("Species", kinds)
        + listed("Parameters", values)
    )
    inside += (f"<listOfRules>{rules}</listOfRules>" if rules else "") + listed("Reactions", made)
    return f'<sbml xmlns="{NAMESPACE}" level="3" version="2"><model id="m">{inside}</model></sbml>'


@pytest.fixture
def here(monkeypatch):
    """libSBML in this process, which takes no second to begin."""
    monkeypatch.setattr("orbitfinder.problemfile.sbml.alone", lambda *asked: translated(asked[2]))


@pytest.fixture
def read(tmp_path, here):
    """A model of a text."""

    def reading(text, **options):
        (tmp_path / "a.xml").write_text(text)
        return of.from_sbml(tmp_path / "a.xml", **options)

    return reading


def rates(model, state):
    return model.rates(0.0, np.array(state, float), model.parameter_values).full().ravel()


def start(value):
    return {"initialConcentration": value}


FORMULAS = {
    "1/(x*(2-x)) - 3^2^0.5": 1 / (0.5 * 1.5) - 3 ** (2**0.5),
    "-x^2 - -x": 0.25,
    "(x^2)^3": 0.5**6,
    "piecewise(1, x > 0.1, 2, x > 0.4, 3)": 1.0,
    "2 - (1 - x)": 1.5,
    "12/(3/x)/2": 1.0,
    "sqrt(x) + root(3, 8) + log10(1000) + log(2, 8) + ln(exp(x))": math.sqrt(0.5) + 2 + 3 + 3 + 0.5,
    "piecewise(1, x > 1, 2, x > 0.4, 3)": 2.0,
    "piecewise(1, x > 1 && x < 2, 2, !(x > 0.4) || x == 7, 3)": 3.0,
    "piecewise(1, xor(x > 0, x > 1), 2)": 1.0,
    "piecewise(1, lt(0, x, 1), 2) + piecewise(1, geq(1, 2, x), 4)": 5.0,
    "piecewise(1, true, 2) + piecewise(1, false, 2)": 3.0,
    "max(x, 0.1, 0.7) + min(x, 3)": 1.2,
    "abs(-x) + floor(1.7) + ceil(1.2)": 3.5,
    "sin(x) + cos(x) + tan(x) + sec(x) + csc(x) + cot(x)": sum(
        (math.sin(0.5), math.cos(0.5), math.tan(0.5), 1 / math.cos(0.5), 1 / math.sin(0.5), 1 / math.tan(0.5))
    ),
    "sinh(x) + cosh(x) + tanh(x) + sech(x) + csch(x) + coth(x)": sum(
        (math.sinh(0.5), math.cosh(0.5), math.tanh(0.5), 1 / math.cosh(0.5), 1 / math.sinh(0.5), 1 / math.tanh(0.5))
    ),
    "arcsin(x) + arccos(x) + arctan(x)": math.pi / 2 + math.atan(0.5),
    "arcsinh(x) + arccosh(2) + arctanh(x)": math.asinh(0.5) + math.acosh(2) + math.atanh(0.5),
    "pi + exponentiale + 1e-3 + (3/4)": math.pi + math.e + 0.001 + 0.75,
    "avogadro/1e23": 6.02214179,
    "x*1.5e2 + 7": 82.0,
}


@pytest.mark.parametrize("text", FORMULAS)
def test_a_formula_means_what_mathml_does(text, read):
    model = read(
        sbml(parameters={}, rules=f'<rateRule variable="x">{mathml(text)}</rateRule>').replace(
            "<listOfRules>",
            '<listOfParameters><parameter id="x" value="0.5" constant="false"/></listOfParameters><listOfRules>',
        )
    )
    assert rates(model, [0.5])[0] == pytest.approx(FORMULAS[text], rel=1e-14)
    assert build_model(model.system).system == model.system


def test_every_component(read):
    """Amounts and concentrations, two compartments, a boundary, local parameters, functions, rules and assignments."""
    functions = f"<functionDefinition id='hill'>{mathml('lambda(s, k, s^2/(k^2 + s^2))')}</functionDefinition>"
    text = sbml(
        {
            "A": start(2.0),
            "B": {"initialAmount": 6.0, "compartment": "big"},
            "N": {"initialAmount": 5.0, "hasOnlySubstanceUnits": "true"},
            "F": start(3.0) | {"boundaryCondition": "true"},
            "S": start(0.0),
            "Z": start(9.0) | {"constant": "true"},
        },
        {"k": 0.5, "e": 1, "i0": 7},
        {
            "r1": ({"A": 2}, {"B": 1}, "k*A*F"),
            "r2": ({"B": 1}, {"N": 3}, "hill(B, 2)*big"),
            "exp": ({}, {"A": 1}, "0.1*N*r1"),
        },
        rules=rule("assignment", "S", "A + Z") + rule("rate", "i0", "S - i0"),
        compartments=volume("cell", 0.5) + volume("big", 4),
        more=f"<listOfFunctionDefinitions>{functions}</listOfFunctionDefinitions>",
    ).replace('<parameter id="i0" value="7" constant="true"/>', '<parameter id="i0" value="7" constant="false"/>')
    assignment = f'<initialAssignment symbol="k">{mathml("Z/3")}</initialAssignment>'
    assignment = f"<listOfInitialAssignments>{assignment}</listOfInitialAssignments>"
    model = read(text.replace("<listOfRules>", assignment + "<listOfRules>"))
    assert model.state_names == ("A", "B", "N", "i0") and model.landmarks["init"] == (2.0, 1.5, 5.0, 7.0)
    a, b, n, i = state = np.array([1.2, 0.7, 3.0, 2.0])
    r1, r2 = 3.0 * a * 3.0, b**2 / (4 + b**2) * 4
    wanted = [(-2 * r1 + 0.1 * n * r1) / 0.5, (r1 - r2) / 4, 3 * r2, a + 9 - i]
    assert rates(model, state) == pytest.approx(wanted, rel=1e-14)
    assert {"F", "Z", "k", "cell", "big"} <= set(model.parameter_names) and "exp is called exp_1" in model.system[
        "left_out"
    ]
    local = read(
        sbml({"A": start(1.0)}, {}, {"r": ({"A": 1}, {}, "q*A")}).replace(
            "</math></kineticLaw>",
            '</math><listOfLocalParameters><localParameter id="q" value="3"/></listOfLocalParameters></kineticLaw>',
        )
    )
    assert rates(local, [2.0]) == pytest.approx([-6.0]) and local.parameter_values.tolist() == [1.0, 3.0]


def test_a_compartment_that_grows_dilutes(read):
    """V' = g V: a concentration falls by g beside its reactions; an amount does not."""
    text = sbml(
        {"A": start(1.0), "N": {"initialAmount": 2.0, "hasOnlySubstanceUnits": "true"}}, {"g": 0.1, "k": 3.0},
        {"make": ({}, {"A": 1, "N": 1}, "k*cell")}, rules=f'<rateRule variable="cell">{mathml("g*cell")}</rateRule>',
        compartments='<compartment id="cell" size="2" constant="false"/>',
    )  # fmt: skip
    model = read(text)
    assert model.state_names == ("A", "N", "cell")
    assert rates(model, [0.7, 1.0, 5.0]) == pytest.approx([3.0 - 0.07, 15.0, 0.5])


def test_stoichiometries_and_conversion_factors(read):
    text = sbml({"A": start(1.0)}, {"f": 10.0, "n": 1.0}, {"r": ({"A": 1}, {}, "A")})
    model = read(text.replace('species="A" stoichiometry="1"', 'id="many" species="A" stoichiometry="2.5"').replace(
        'id="A"', 'id="A" conversionFactor="f"'))  # fmt: skip
    assert rates(model, [2.0]) == pytest.approx([-50.0])
    ruled = text.replace('species="A" stoichiometry="1" constant="true"', 'id="many" species="A" constant="false"')
    ruled = ruled.replace(
        "<listOfReactions>",
        f'<listOfRules><assignmentRule variable="many">{mathml("3*n")}</assignmentRule></listOfRules><listOfReactions>',
    )
    assert rates(read(ruled), [2.0]) == pytest.approx([-6.0])


def test_units_are_words(read):
    def unit(key, kind, exponent, scale, times):
        inside = f'<unit kind="{kind}" exponent="{exponent}" scale="{scale}" multiplier="{times}"/>'
        return f'<unitDefinition id="{key}"><listOfUnits>{inside}</listOfUnits></unitDefinition>'

    units = listed("UnitDefinitions", [unit("uM", "mole", 1, -6, 1), unit("perh", "second", -1, 0, 3600)])
    text = sbml(
        {"A": start(1.0) | {"substanceUnits": "uM"}}, {"k": 3.0}, {"r": ({"A": 1}, {}, "k*A")}, more=units,
        compartments='<compartment id="cell" size="1" units="litre" spatialDimensions="3" constant="true"/>',
    )  # fmt: skip
    text = text.replace('<model id="m">', '<model id="m" timeUnits="second">').replace(
        'value="3.0"', 'value="3.0" units="perh"'
    )
    model = read(text)
    assert model.system["units"] | {"A": "umol/L", "k": "1/h", "time": "s", "cell": "L"} == model.system["units"]


def model_with(**given):
    return sbml({"A": start(1.0)}, {"k": 3.0}, {"r": ({"A": 1}, {}, "k*A")}, **given)


EVENT = '<event id="hit" useValuesFromTriggerTime="true"><trigger initialValue="true" persistent="true"/></event>'
COMP = 'xmlns:comp="http://www.sbml.org/sbml/level3/version1/comp/version1" comp:required="true"'


def assigned_to_itself():
    return listed("InitialAssignments", [f'<initialAssignment symbol="k">{mathml("k + 1")}</initialAssignment>'])


def with_law(law):
    return sbml({"A": start(1.0)}, {}, {"r": ({}, {"A": 1}, law)})


def replaced(*parts, **given):
    """A sound model with parts of its text replaced."""
    text = model_with(**given)
    for old, new in zip(parts[::2], parts[1::2], strict=True):
        assert old in text
        text = text.replace(old, new)
    return text


REFUSED = {
    "event": (lambda: replaced("</model>", f"{listed('Events', [EVENT])}</model>"), "event 'hit': events are not read"),
    "delay": (lambda: with_law("delay(A, 1)"), "reaction 'r': 'delay' with 2 arguments is not read"),
    "algebraic": (lambda: model_with(rules=f"<algebraicRule>{mathml('A - k')}</algebraicRule>"), "algebraicRule: is"),
    "fluxes": (lambda: replaced("<kineticLaw>", "<!--", "</kineticLaw>", "-->"), "reaction 'r': has no kinetic law"),
    "value": (lambda: replaced(' value="3.0"', ""), "'k': has no value"),
    "still": (lambda: sbml(parameters={"k": 1.0}), "nothing has a rate"),
    "size": (lambda: replaced('size="1"', 'size="0"'), "compartment 'cell': has the size 0"),
    "growing": (
        lambda: model_with(rules=rule("assignment", "cell", "k"), compartments=volume("cell", 1, "false")),
        "compartment 'cell': changes its size",
    ),
    "time": (lambda: with_law("sin(time)"), "depends on the time t; give the period of that"),
    "piece": (lambda: with_law("piecewise(1, A > 2)"), "a piecewise without otherwise"),
    "unknown": (lambda: replaced("<ci> k </ci>", "<ci> kk </ci>"), "unknown name 'kk'"),
    "function": (lambda: with_law("factorial(A)"), "'factorial' with 1 arguments is not read"),
    "infinite": (lambda: replaced("<ci> k </ci>", "<infinity/>"), "the number inf"),
    "package": (lambda: replaced("<sbml ", f"<sbml {COMP} "), "the package 'comp' is not read"),
    "element": (lambda: "<mujoco/>", "its element is <mujoco>"),
    "nothing": (lambda: "x' = 1", "no XML"),
    "bomb": (lambda: '<!DOCTYPE a [<!ENTITY b "cc">]><sbml>&b;</sbml>', "a document type of its own"),
    "deep": (
        lambda: replaced("<ci> k </ci>", "<apply><minus/>" * 100_000 + "<ci> k </ci>" + "</apply>" * 100_000),
        "deeper than 200",
    ),
    "empty": (lambda: f'<sbml xmlns="{NAMESPACE}" level="3" version="2"/>', "no model in it"),
    "law": (lambda: replaced("</math>", "</maths>"), "no XML (mismatched tag"),
    "many": (lambda: sbml(parameters=dict.fromkeys((f"k{n}" for n in range(5001)), 1.0)), "at most 5000 of each"),
    "dies": (lambda: replaced(f'xmlns="{NAMESPACE}" level="3"', f'xmlns="{NAMESPACE}" level="9999999999"'), "a.xml: "),
    "code": (lambda: '<?xml version="1.0" encoding="true"?>' + model_with(), "no XML (unknown encoding"),
    "itself": (lambda: replaced("<listOfReactions>", assigned_to_itself() + "<listOfReactions>"), "'k': needs itself"),
    "circle": (lambda: model_with(rules=rule("assignment", "k", "k + 1")), "is defined by itself"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused_is_named(name, tmp_path, request):
    make, why = REFUSED[name]
    if name not in ("dies", "package"):
        request.getfixturevalue("here")
    (tmp_path / "a.xml").write_text(make())
    made = command("simulate", tmp_path / "a.xml")
    assert made.exit_code == 2 and why in made.stderr.replace("\n", "") and "a.xml" in made.stderr, made.stderr


def test_at_a_time_or_with_a_period(read):
    text = sbml({"A": start(1.0)}, {"w": 2.0}, {"r": ({}, {"A": 1}, "sin(w*time)")})
    assert rates(read(text, time=1.5), [0.0]) == pytest.approx([math.sin(3.0)])
    assert read(text, period="2*pi/w").forced
    with pytest.raises(InputError, match="has no period; leave period out"):
        read(text, time=1.0, period=1.0)


def test_level_two(read):
    """BioModels' usual form: rates of change, local parameters in the law, amounts; its packages are annotations."""
    text = f"""<sbml xmlns="http://www.sbml.org/sbml/level2/version4" level="2" version="4"><model id="m">
      <listOfCompartments><compartment id="c" size="2"/></listOfCompartments>
      <listOfSpecies><species id="A" compartment="c" initialAmount="3"/></listOfSpecies>
      <listOfReactions><reaction id="r" reversible="false"><listOfReactants><speciesReference species="A"/>
      </listOfReactants><kineticLaw>{mathml("c*k*A")}<listOfParameters><parameter id="k" value="0.5"/>
      </listOfParameters>
      </kineticLaw></reaction></listOfReactions></model></sbml>"""
    model = read(text)
    assert model.landmarks["init"] == (1.5,) and rates(model, [1.2]) == pytest.approx([-0.6])


def test_without_libsbml(tmp_path, monkeypatch):
    monkeypatch.setattr("orbitfinder.problemfile.sbml.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'orbitfinder\[sbml\]'"):
        of.from_sbml(tmp_path / "a.xml")


CELL = {
    "mitosis": (
        {"C": 0.3, "M": 0.3, "MI": 0.7, "X": 0.3, "XI": 0.7},
        {"vi": 0.005, "vd": 0.25, "Kd": 0.02, "kd": 0.01, "V1": 3.0, "V2": 1.5, "V3": 1.0, "V4": 0.5, "K": 0.05,
         "Kc": 0.5},
        {"make": ({}, {"C": 1}, "vi"), "decay": ({"C": 1}, {}, "kd*C + vd*X*C/(Kd + C)"),
         "on": ({"MI": 1}, {"M": 1}, "V1*C/(Kc + C)*MI/(K + MI)"), "off": ({"M": 1}, {"MI": 1}, "V2*M/(K + M)"),
         "up": ({"XI": 1}, {"X": 1}, "V3*M*XI/(K + XI)"), "down": ({"X": 1}, {"XI": 1}, "V4*X/(K + X)")},
        {"C": "vi - kd*C - vd*X*C/(Kd + C)", "M": "V1*C/(Kc + C)*(1 - M)/(K + 1 - M) - V2*M/(K + M)",
         "X": "V3*M*(1 - X)/(K + 1 - X) - V4*X/(K + X)"},
        "vi", 0.2, 2,
    ),
    "cascade": (
        {"A": 90.0, "AP": 10.0, "B": 280.0, "BP": 10.0, "BPP": 10.0, "E": 280.0, "EP": 10.0, "EPP": 10.0},
        {"V1": 0.1, "Ki": 9.0, "K1": 10.0, "V2": 0.25, "K2": 8.0, "k": 0.025, "K": 15.0, "V5": 0.75, "V9": 0.5},
        {"v1": ({"A": 1}, {"AP": 1}, "V1*A/((1 + EPP/Ki)*(K1 + A))"), "v2": ({"AP": 1}, {"A": 1}, "V2*AP/(K2 + AP)"),
         "v3": ({"B": 1}, {"BP": 1}, "k*AP*B/(K + B)"), "v4": ({"BP": 1}, {"BPP": 1}, "k*AP*BP/(K + BP)"),
         "v5": ({"BPP": 1}, {"BP": 1}, "V5*BPP/(K + BPP)"), "v6": ({"BP": 1}, {"B": 1}, "V5*BP/(K + BP)"),
         "v7": ({"E": 1}, {"EP": 1}, "k*BPP*E/(K + E)"), "v8": ({"EP": 1}, {"EPP": 1}, "k*BPP*EP/(K + EP)"),
         "v9": ({"EPP": 1}, {"EP": 1}, "V9*EPP/(K + EPP)"), "v10": ({"EP": 1}, {"E": 1}, "V9*EP/(K + EP)")},
        {"AP": "V1*(100 - AP)/((1 + EPP/Ki)*(K1 + 100 - AP)) - V2*AP/(K2 + AP)",
         "B": "V5*(300 - B - BPP)/(K + 300 - B - BPP) - k*AP*B/(K + B)",
         "BPP": "k*AP*(300 - B - BPP)/(K + 300 - B - BPP) - V5*BPP/(K + BPP)",
         "E": "V9*(300 - E - EPP)/(K + 300 - E - EPP) - k*BPP*E/(K + E)",
         "EPP": "k*BPP*(300 - E - EPP)/(K + 300 - E - EPP) - V9*EPP/(K + EPP)"},
        "V1", 3.0, 1,
    ),
    "glycolysis": (
        {"F": 1.0, "ATP": 1.0, "ADP": 1.0}, {"v": 0.02, "k": 1.0, "r": 0.02, "u": 1.0},
        {"feed": ({}, {"F": 1}, "v"), "pfk": ({"F": 1, "ATP": 1}, {"ADP": 1}, "k*F*ATP*(r + ADP^2)"),
         "use": ({"ADP": 1}, {"ATP": 1}, "u*ADP")},
        {"F": "v - k*F*(2 - ADP)*(r + ADP^2)", "ADP": "k*F*(2 - ADP)*(r + ADP^2) - u*ADP"},
        "v", 1.0, 2,
    ),
    "clock": (
        {"R": 0.1, "P": 0.1, "Q": 0.1, "N": 0.1, "G": 0.9, "GN": 0.1},
        {"vs": 0.3, "km": 0.5, "Km": 0.1, "ks": 1.0, "V1": 1.0, "K1": 0.1, "k1": 0.5, "kd": 0.5, "Kd": 0.1, "a": 5.0,
         "b": 1.0},
        {"write": ({}, {"R": 1}, "vs*G"), "lose": ({"R": 1}, {}, "km*R/(Km + R)"), "read": ({}, {"P": 1}, "ks*R"),
         "mark": ({"P": 1}, {"Q": 1}, "V1*P/(K1 + P)"), "enter": ({"Q": 1}, {"N": 1}, "k1*Q"),
         "decay": ({"N": 1}, {}, "kd*N/(Kd + N)"), "bind": ({"G": 1}, {"GN": 1}, "a*G*N^4"),
         "free": ({"GN": 1}, {"G": 1}, "b*GN")},
        {"R": "vs*G - km*R/(Km + R)", "P": "ks*R - V1*P/(K1 + P)", "Q": "V1*P/(K1 + P) - k1*Q",
         "N": "k1*Q - kd*N/(Kd + N)", "G": "b*(1 - G) - a*G*N^4"},
        "vs", 1.0, 1,
    ),
    "feedback": (
        {"X": 0.1, "Y": 0.1, "Z": 0.1, "K": 0.5, "KP": 0.5}, {"a": 0.001, "b": 0.1, "k": 0.2},
        {"make": ({}, {"X": 1}, "a/(1 + Z^8)"), "x": ({"X": 1}, {}, "b*X"), "on": ({"K": 1}, {"KP": 1}, "k*X*K"),
         "off": ({"KP": 1}, {"K": 1}, "k*KP"), "y": ({}, {"Y": 1}, "KP"), "yd": ({"Y": 1}, {}, "b*Y"),
         "z": ({}, {"Z": 1}, "Y"), "zd": ({"Z": 1}, {}, "b*Z")},
        {"X": "a/(1 + Z^8) - b*X", "KP": "k*X*(1 - KP) - k*KP", "Y": "KP - b*Y", "Z": "Y - b*Z"},
        "a", 1.0, 1,
    ),
}  # fmt: skip
"""Clocks of cells written for this test: species, parameters, reactions, the same with their totals put in as text, the
parameter that is followed, until where, and how many Hopf points there are"""


def of_cell(name):
    species, parameters, reactions, *_ = CELL[name]
    return sbml({key: start(value) for key, value in species.items()}, parameters, reactions)


@pytest.mark.parametrize("name", CELL)
def test_totals_are_found_and_hopf_points_are_those_of_the_text(name, read):
    species, parameters, _, text, parameter, until, count = CELL[name]
    model, other = read(of_cell(name)), of.equations(text, parameters, find_invariants=False)
    assert len(model.invariants) == len(species) - len(text)
    found = of.follow_equilibria(model, model.landmarks["init"], parameter, until=until)
    wanted = of.follow_equilibria(other, [species[key] for key in text], parameter, until=until)
    here, there = (
        [(event.parameter, event.period) for event in each.events if event.kind == "hopf"] for each in (found, wanted)
    )
    assert len(here) == count and np.array(here) == pytest.approx(np.array(there), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", CELL)
def test_a_diagram_of_a_file_in_one_command(name, tmp_path):
    """Equilibria, Hopf points and the cycles that are born there, each verified; the text's have the same."""
    *_, parameter, until, count = CELL[name]
    (tmp_path / f"{name}.xml").write_text(of_cell(name))
    made = command("diagram", tmp_path / f"{name}.xml", "--parameter", parameter, "--until", until, "-o", tmp_path)
    assert made.exit_code == 0, made.output
    curve = of.load_equilibria(tmp_path / name / "equilibria" / "equilibria.json")
    assert len([event for event in curve.events if event.kind == "hopf"]) == count
    families = sorted(tmp_path.glob(f"{name}/**/family.json"))
    assert families
    for file in families:
        assert command("verify", file).exit_code == 0


def test_by_the_commands_and_in_a_problem_file(tmp_path):
    (tmp_path / "glycolysis.xml").write_text(of_cell("glycolysis"))
    made = command("show", tmp_path / "glycolysis.xml")
    assert made.exit_code == 0 and "pfk" in made.output, made.output
    (tmp_path / "b.toml").write_text(
        '[system]\nkind = "sbml"\nfile = "glycolysis.xml"\nparameters = { v = 0.3 }\n'
        "[guess]\nstate = [1.2, 1.7, 0.3]\nperiod = 10.0\n"
    )
    made = command("equilibria", tmp_path / "b.toml", "--parameter", "v", "--until", 1.0, "-o", tmp_path)
    assert made.exit_code == 0 and "hopf at v = 0.56" in made.output, made.output
    record = json.loads((tmp_path / "b" / "equilibria.json").read_text())
    assert record["system"]["kind"] == "equations" and record["system"]["parameters"]["v"] == 0.3
    for wrong, why in (("v = 0.3", "q = 1.0"), ("glycolysis.xml", "../glycolysis.xml"), ("glycolysis", "nowhere")):
        text = (tmp_path / "b.toml").read_text().replace(wrong, why)
        (tmp_path / "c.toml").write_text(text)
        assert command("show", tmp_path / "c.toml").exit_code == 2


def test_an_equilibrium_with_totals_from_a_state_that_is_large(read):
    """The sizes grow with a start, of which the pushes along the totals are no part."""
    model = read(of_cell("cascade"))
    rest = of.follow_equilibria(model, 3 * np.array(model.landmarks["init"]), "V1", until=0.2)
    assert rest.points[-1].value == 0.2 and rest.points[0].state[:2].sum() == pytest.approx(300.0)
