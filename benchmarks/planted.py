"""A thousand planted errors in thirty certified orbits; writes results/validation/planted.md in some five minutes.

Every plant changes one thing of a true record and then recomputes what follows from it, so that only the physics
(or the one wrong entry) can betray it: periods, multiples, states, systems, forcings, and every recorded number.
True records told otherwise (from another instant, with the multipliers in another order) must pass.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from closure_rule import Case, shipped, unstable, upright

import orbitfinder as of
from orbitfinder.loops.symmetry import recognise
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.certify import certify, gather
from orbitfinder.orbits.evidence import Evidence

ROOT = Path(__file__).parents[1]
LEFT_OUT = ("five-bar-fast-mode", "six-bar-middle-mode", "four-bar-drag-link", "cart-chain-three", "fermi-pasta-ulam",
            "coupled-oscillators", "double-well-inside", "forced-duffing-lower", "henon-heiles-straight",
            "henon-heiles-recurrence", "pendulum-on-cart", "spring-pendulum-bounce", "triple-pendulum-middle-mode",
            "quadruple-pendulum-slow-mode", "van-der-pol", "unequal-double-pendulum", "six-bar-slow-mode")  # fmt: skip
"""Shipped orbits much like one that is in."""
MULTIPLES = (2, 3, 5, 7, 13, 29, 31)
OFF = (1e-3, 1e-6, 1e-8)


@dataclass(frozen=True)
class Plant:
    """A record with something wrong, in words, or with nothing wrong."""

    kind: str
    orbit: of.Orbit
    model: Model


def refreshed(orbit: of.Orbit, model: Model) -> of.Orbit:
    """The record with all that follows from its state and period recomputed: consistent, whatever it is of."""
    found: Evidence = gather(model, orbit.state, orbit.period, np.asarray(orbit.winding))
    return replace(
        orbit, energy=found.energy, action=found.action, closure=found.closure, pair_defect=found.floquet.pair_defect,
        floquet_multipliers=found.floquet.multipliers, stability=found.floquet.stability,
        symmetry=recognise(found.times, found.states, model), nodes=orbit.state[None],
        times=np.zeros(0), samples=np.zeros((0, orbit.state.size)), expected={}, record=None, certificate=None,
    )  # fmt: skip


def recorded(case: Case) -> of.Orbit:
    """A consistent record of a true case."""
    bare = of.Orbit(
        name=case.name, system=case.model.system, state=case.state, period=case.period, energy=0.0, action=0.0,
        closure=0.0, symmetry="none", winding=tuple(int(k) for k in case.turns), floquet_multipliers=np.zeros(0),
        pair_defect=0.0, stability="", unfolding=(0.0,), nodes=case.state[None], times=np.zeros(0),
        samples=np.zeros((0, case.state.size)), tolerance=1e-12,
    )  # fmt: skip
    return refreshed(bare, case.model)


def bases() -> list[Case]:
    """Thirty true orbits: conservative, dissipative, forced, linkages, running, very unstable, near a separatrix."""
    cases = [case for case in shipped() if case.name not in LEFT_OUT]
    near = [case for case in upright() if case.name.endswith(("1e-2 below upright, from the top",
                                                              "1e-3 below upright, from the bottom"))]  # fmt: skip
    return [*cases, *near, *list(unstable(2))]


def physical(orbit: of.Orbit, model: Model, units: np.ndarray, random: np.random.Generator) -> Iterator[Plant]:
    """What is no orbit, in records that are consistent with it."""
    for off in OFF:
        for sign in (1, -1):
            wrong = replace(orbit, period=orbit.period * (1 + sign * off))
            yield Plant(f"period {sign * off:+.0e}", refreshed(wrong, model), model)
        for _ in range(3):
            state = orbit.state + off * units * random.choice([-1.0, 1.0], units.size)
            yield Plant(f"state {off:.0e}", refreshed(replace(orbit, state=state), model), model)
    for k in MULTIPLES:
        turns = tuple(k * one for one in orbit.winding)
        many = replace(orbit, period=k * orbit.period, winding=turns, action=k * orbit.action,
                       floquet_multipliers=orbit.floquet_multipliers**k)  # fmt: skip
        yield Plant(f"{k} times round", many, model)
    loose = replace(orbit, state=orbit.state + 1e-8 * units, tolerance=0.9)
    yield Plant("state 1e-8, tolerance 0.9", refreshed(loose, model), model)
    for name, place in list(zip(model.parameter_names, range(len(model.parameter_values)), strict=True))[:3]:
        values = model.parameter_values.copy()
        values[place] = values[place] * (1 + 1e-6) if values[place] else 1e-6
        other = replace(model, parameter_values=values)
        if not np.allclose(recorded_field(other, orbit), recorded_field(model, orbit), rtol=1e-9, atol=0):
            yield Plant(f"{name} 1e-6", refreshed(orbit, other), other)
    if model.forcing_period is not None:
        import casadi as ca

        p = ca.MX.sym("p", len(model.parameter_values))
        for share in (0.5, 2 / 3, 1 / 3):
            clock = ca.Function("clock", [p], [share * model.forcing_period(p)])
            yield Plant(f"forcing period {share:.3g}", orbit, replace(model, forcing_period=clock))


def recorded_field(model: Model, orbit: of.Orbit) -> np.ndarray:
    n = model.degrees_of_freedom
    q, v = np.split(orbit.state + 0.1, 2)
    return model.acceleration(0.1, q, v, model.parameter_values).full().ravel()[:n]


def written(orbit: of.Orbit, model: Model, units: np.ndarray, random: np.random.Generator) -> Iterator[Plant]:
    """One wrong entry in a record of a true orbit."""
    n = model.degrees_of_freedom
    turned = [list(orbit.winding) for _ in range(n)]
    for k in range(n):
        turned[k][k] += 1
    entries = {
        "energy": orbit.energy + 1e-6 * max(abs(orbit.action) / orbit.period, 1e-9 * abs(orbit.energy)),
        "action": orbit.action * (1 + 1e-6) + 1e-6 * (orbit.action == 0),
        "closure": orbit.closure + 1e-3 * units.max(), "unfolding": (1e-3 / orbit.period,), "pair_defect": 1.0,
        "floquet_multipliers": orbit.floquet_multipliers + 1e-4 if orbit.floquet_multipliers.size else np.ones(2),
        "stability": "elliptic" if orbit.stability != "elliptic" else "unstable",
        "symmetry": "none" if orbit.symmetry != "none" else "brake",
        "nodes": np.vstack([orbit.state, orbit.state + 1e-2 * units]),
        "winding": tuple(turned[int(random.integers(n))]),
    }  # fmt: skip
    for name, value in entries.items():
        yield Plant(f"recorded {name}", replace(orbit, **{name: value}), model)
    picture = {"times": np.linspace(0, orbit.period, 65), "samples": random.normal(size=(65, 2 * n)) * units}
    yield Plant("recorded samples", replace(orbit, **picture), model)


def true(orbit: of.Orbit, model: Model, found: Evidence) -> Iterator[Plant]:
    """The same orbit told otherwise."""
    yield Plant("as it is", orbit, model)
    turned = replace(orbit, floquet_multipliers=orbit.floquet_multipliers[::-1])
    yield Plant("multipliers in another order", turned, model)
    if not model.forced and found.growth < 1e3 and model.constraint is None:
        later = replace(orbit, state=found.states[170])
        yield Plant("from a third of the period on", refreshed(later, model), model)


def kind_of(plant: str) -> str:
    """A heading for the table."""
    first = plant.split(" ")[0]
    if first.isdigit():
        return "a multiple of the period"
    named = {
        "period": "period off by 1e-8 to 1e-3", "state": "state off by 1e-8 to 1e-3",
        "forcing": "a forcing period that is none", "recorded": plant,
    }  # fmt: skip
    return named.get(first, "a parameter of the system off by 1e-6")


def main() -> None:
    """Plant, certify, count, write the page."""
    random, cases = np.random.default_rng(0), bases()
    table: Counter[tuple[str, bool, bool]] = Counter()
    odd: list[str] = []
    for case in cases:
        orbit, found = recorded(case), gather(case.model, case.state, case.period, case.turns)
        known = (orbit, case.model, found.extents, random)
        plants = [(plant, False) for make in (physical, written) for plant in make(*known)]
        for plant, right in [*plants, *((plant, True) for plant in true(orbit, case.model, found))]:
            certificate = certify(plant.orbit, plant.model)
            kind = plant.kind if right else kind_of(plant.kind)
            table[kind, right, certificate.passed] += 1
            if certificate.passed != right:
                values = {check.name: check.value for check in certificate.checks}
                failed = ", ".join(certificate.failures) or "none"
                odd.append(
                    f"| {case.name} | {plant.kind} | {values.get('closure', np.nan):.1e} | {certificate.scale:.2g} | "
                    f"{values.get('distance', np.nan):.1e} | {failed} |"
                )
        print(case.name, flush=True)
    target = ROOT / "results" / "validation" / "planted.md"
    target.write_text(page(len(cases), table, odd))
    print(target.relative_to(ROOT), sum(n for key, n in table.items() if not key[1]), "false,",
          sum(n for key, n in table.items() if not key[1] and key[2]), "of them accepted")  # fmt: skip


def page(cases: int, table: Counter[tuple[str, bool, bool]], odd: list[str]) -> str:
    """The table of kinds, and what was not judged as planted."""
    lines = [
        "# Planted errors\n",
        f"Written by `python benchmarks/planted.py`: {cases} certified orbits of all kinds, one error at a time, "
        "everything else in the record made consistent with it.\n",
        "| what | planted | accepted | rejected |", "|---|---|---|---|",
    ]  # fmt: skip
    for right, heading in ((False, "wrong"), (True, "right")):
        for kind in sorted({key[0] for key in table if key[1] == right}):
            yes, no = table[kind, right, True], table[kind, right, False]
            lines.append(f"| {heading}: {kind} | {yes + no} | {yes} | {no} |")
    for right, heading in ((False, "all that is wrong"), (True, "all that is right")):
        yes, no = (sum(n for key, n in table.items() if key[1:] == (right, passed)) for passed in (True, False))
        lines.append(f"| **{heading}** | {yes + no} | {yes} | {no} |")
    head = "| orbit | plant | gap | A | distance to a true orbit | failed checks |"
    lines += ["", "Not judged as planted:", "", head, "|---|---|---|---|---|---|", *odd] if odd else [
        "", "Every one was judged as planted."
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
