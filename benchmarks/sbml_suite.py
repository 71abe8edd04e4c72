"""The SBML test suite's semantic cases, read and simulated; writes a table of what is read, equal, and refused and why.

A case is read from its newest level. Its course is computed by SciPy's LSODA on the rates as they were read, and
compared with the numbers of the suite by the tolerances of its own settings. Nothing of the suite is kept.

    python benchmarks/sbml_suite.py FOLDER "sbmlteam/sbml-test-suite COMMIT"     FOLDER has 00001/00001-settings.txt
"""

from __future__ import annotations

import argparse
import csv
import re
from collections import Counter
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from orbitfinder.errors import InputError
from orbitfinder.mechanics.kind import build_model
from orbitfinder.problemfile.sbml import translated

LEVELS = ("l3v2", "l3v1", "l2v5", "l2v4", "l2v3", "l2v2", "l2v1")
PAGE = Path(__file__).parents[1] / "results" / "validation" / "sbml.md"
FOREVER = 1e9
"""The period that is given where the time enters the rates"""


def settings(path: Path) -> dict[str, str]:
    """The lines `key: value` of a case's settings."""
    rows = (line.partition(":") for line in path.read_text(encoding="utf-8").splitlines() if ":" in line)
    return {key.strip(): value.strip() for key, _, value in rows}


def course(
    source: Path, names: list[str], concentrations: set[str], amounts: set[str], times: np.ndarray, bar: float
) -> np.ndarray:
    """What the suite asks for at its times, a column each. Raises `InputError`."""
    import libsbml

    made = translated([str(source), str(source), None])  # as in the process of its own that users have
    if "refused" in made:
        raise InputError(made["refused"])
    system, state = made["system"], np.array(made["state"])
    try:
        model = build_model(system)
    except InputError as error:
        if "depends on the time" not in str(error):
            raise
        system |= {"period": FOREVER}
        model = build_model(system)
    constants = model.parameter_values
    done = solve_ivp(
        lambda t, x: model.rates(t, x, constants).full().ravel(), (0.0, float(times[-1])), state, "LSODA", times,
        rtol=1e-10, atol=bar,
    )  # fmt: skip
    if done.y.shape[1] != times.size:
        raise ArithmeticError(done.message)
    spelled = {
        name: f"{name}_1" if f"{name}_1 " in " ".join(system.get("left_out", ())) + " " else name for name in names
    }
    outs = {f"out__{k}": spelled[name] for k, name in enumerate(names)}
    shown = build_model(
        {key: value for key, value in system.items() if key not in ("units", "states")}
        | {"rates": {**dict.fromkeys(model.state_names, "0"), **outs}, "find_invariants": False,
           **({"period": FOREVER} if "period" in system else {})}
    )  # fmt: skip
    rows = np.array([shown.rates(t, [*x, *np.zeros(len(names))], constants).full().ravel()[state.size :]
                     for t, x in zip(times, done.y.T, strict=True)])  # fmt: skip
    original = libsbml.readSBMLFromFile(str(source)).getModel()
    for k, name in enumerate(names):
        species = original.getSpecies(name)
        if species is not None:
            size = system["parameters"].get(species.getCompartment(), 1.0)  # with its initial assignment
            if species.getCompartment() in model.state_names:
                size = done.y[model.state_names.index(species.getCompartment())]
            within = original.getCompartment(species.getCompartment())
            plain = species.getHasOnlySubstanceUnits() or within.getSpatialDimensionsAsDouble() == 0
            if name in amounts and not plain:
                rows[:, k] *= size
            if name in concentrations and plain:
                rows[:, k] /= size
    return rows


def judged(case: Path) -> str:
    """ "equal", "other", "no course", or why it is refused."""
    number = case.name
    source = next(path for level in LEVELS if (path := case / f"{number}-sbml-{level}.xml").exists())
    asked = settings(case / f"{number}-settings.txt")
    with (case / f"{number}-results.csv").open(encoding="utf-8") as stream:
        head, *rows = list(csv.reader(stream))
    wanted = np.array([[float(word) for word in row] for row in rows if row])
    split = {key: [word.strip() for word in asked.get(key, "").split(",") if word.strip()]
             for key in ("variables", "amount", "concentration")}  # fmt: skip
    names = [word.strip() for word in head[1:]]
    try:
        made = course(
            source,
            names,
            set(split["concentration"]),
            set(split["amount"]),
            wanted[:, 0],
            1e-6 * float(asked["absolute"]),
        )
    except InputError as error:
        return "refused: " + re.sub(r"'[^']*'", "...", str(error).partition(".xml: ")[2].partition("; ")[0])[:90]
    except ArithmeticError:
        return "no course"
    bar = float(asked["absolute"]) + float(asked["relative"]) * np.abs(wanted[:, 1:])
    return "equal" if (np.abs(made - wanted[:, 1:]) <= bar).all() else "other"


def main() -> int:
    """Write the page; 1 where a course differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("source")
    parser.add_argument("--list", action="store_true", help="each case that is not equal")
    parser.add_argument("--every", type=int, default=1, help="each so manieth case alone")
    chosen = parser.parse_args()
    counts: Counter[str] = Counter()
    for case in sorted(chosen.folder.glob("[0-9]*"))[:: chosen.every]:
        if (case / f"{case.name}-results.csv").exists():
            said = judged(case)
            counts[said] += 1
            if chosen.list and said != "equal":
                print(case.name, said, flush=True)
    refused = {key: count for key, count in counts.items() if key.startswith("refused")}
    read = sum(counts.values()) - sum(refused.values())
    lines = ["# The SBML test suite", "", __doc__.split("\n\n")[1], "",
             f"Of {sum(counts.values())} semantic cases of {chosen.source}: {read} read, {counts['equal']} of them "
             f"with the suite's course, {counts['other']} with another, {counts['no course']} without one.", "",
             "Why cases are refused:", "", *(f"- {count}: {key.removeprefix('refused: ')}"
             for key, count in sorted(refused.items(), key=lambda each: (-each[1], each[0])))]  # fmt: skip
    PAGE.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))
    return int(counts["other"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
