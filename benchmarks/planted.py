"""Four thousand planted errors in certified orbits of all kinds; writes results/validation/planted.md in some minutes.

Every plant changes one thing of a true record and then recomputes what follows from it, so that only the physics
(or the one wrong entry) can betray it: periods, multiples, states, systems, forcings, and every recorded number; and
systems that are what their description says but for something narrow, late, slow or in another turn. A feature that is
narrower than the width down to which its certificate says to have looked is counted by itself. Slow states have rates
from 1e-2 to 1e-12 beside a cycle of period 6.66. True records told
otherwise (from another instant, with the multipliers in another order) must pass. `python benchmarks/planted.py FILE`
writes the page there.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import casadi as ca
import numpy as np
from closure_rule import Case, shipped, unstable, upright

import orbitfinder as of
from orbitfinder.errors import OrbitfinderError
from orbitfinder.loops.symmetry import recognise
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.mechanics.model import Model, altered, energy
from orbitfinder.orbits.certify import certify
from orbitfinder.orbits.evidence import Evidence, gather
from orbitfinder.orbits.hybrid import gather_hybrid
from orbitfinder.records.certificate import Check

ROOT = Path(__file__).parents[1]
LEFT_OUT = ("five-bar-fast-mode", "six-bar-middle-mode", "four-bar-drag-link", "cart-chain-three", "fermi-pasta-ulam",
            "coupled-oscillators", "double-well-inside", "forced-duffing-lower", "henon-heiles-straight",
            "henon-heiles-recurrence", "pendulum-on-cart", "spring-pendulum-bounce", "triple-pendulum-middle-mode",
            "quadruple-pendulum-slow-mode", "van-der-pol", "unequal-double-pendulum", "six-bar-slow-mode")  # fmt: skip
"""Shipped orbits much like one that is in."""
MULTIPLES, MORE = (2, 3, 5, 7, 13), (31, 103)
"""Times round; of orbits in one coordinate also so many"""
OFF = (1e-3, 1e-6, 1e-8)


@dataclass(frozen=True)
class Plant:
    """A record with something wrong, in words, or with nothing wrong, and how wide that is as a share of the motion."""

    kind: str
    orbit: of.Orbit
    model: Model
    wide: float = np.inf


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
    relative = {orbit.name for kind, orbit, _ in others() if kind == "relative"}
    cases = [case for case in shipped() if case.name not in {*LEFT_OUT, *relative} and case.model.rates is None]
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
    for k in (*MULTIPLES, *MORE) if len(orbit.winding) == 1 else MULTIPLES:
        turns = tuple(k * one for one in orbit.winding)
        many = replace(orbit, period=k * orbit.period, winding=turns, action=k * orbit.action,
                       floquet_multipliers=orbit.floquet_multipliers**k)  # fmt: skip
        yield Plant(f"{k} times round", many, model)
    loose = replace(orbit, state=orbit.state + 1e-8 * units, tolerance=0.9)
    yield Plant("state 1e-8, tolerance 0.9", refreshed(loose, model), model)
    for name, place in list(zip(model.parameter_names, range(len(model.parameter_values)), strict=True))[:3]:
        values = model.parameter_values.copy()
        values[place] = values[place] * (1 + 1e-6) if values[place] else 1e-6
        other = altered(model, parameter_values=values)
        if not np.allclose(recorded_field(other, orbit), recorded_field(model, orbit), rtol=1e-9, atol=0):
            yield Plant(f"{name} 1e-6", refreshed(orbit, other), other)
    if model.forcing_period is not None:
        p = ca.MX.sym("p", len(model.parameter_values))
        for share in (0.5, 2 / 3, 1 / 3):
            clock = ca.Function("clock", [p], [share * model.forcing_period(p)])
            yield Plant(f"forcing period {share:.3g}", orbit, altered(model, forcing_period=clock))


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


def others() -> list[tuple[str, of.Orbit, Model]]:
    """Shipped records that are no mechanical orbits of one mode: hybrid, controlled, relative, of first order."""
    files = [*sorted((ROOT / "docs" / "gallery" / "orbits").glob("hybrid-*.json")),
             *sorted((ROOT / "docs" / "gallery" / "orbits").glob("control-*.json")),
             *sorted((ROOT / "results" / "gallery").glob("*/orbit.json"))]  # fmt: skip
    found = []
    for file in files:
        orbit = of.load_orbit(file)
        model = build_model(orbit.system)
        kind = "controlled" if orbit.control else "hybrid" if model.hybrid else "relative" if orbit.shift else ""
        kind = kind or ("first-order" if model.rates is not None else "")
        if kind:
            found.append((kind, replace(orbit, record=None, expected={}), model))
    return found


def elsewhere(kind: str, orbit: of.Orbit, model: Model, random: np.random.Generator) -> Iterator[Plant]:
    """Periods, states and entries of the other kinds of records: what they are off by is a share of the motion (of a
    canonical one's action, of p dq along it), and no symmetry is planted that the samples have."""
    if model.hybrid is not None and not orbit.control:
        units = gather_hybrid(model, orbit.state, orbit.period, np.asarray(orbit.winding)).extents
    else:
        units = np.maximum(np.ptp(orbit.samples, axis=0) if len(orbit.samples) else np.abs(orbit.state), 1e-3)
    half, places = orbit.state.size // 2, np.arange(len(orbit.samples)) + (len(orbit.samples) - 1) // 2
    turned = orbit.samples + orbit.samples[places % max(len(orbit.samples) - 1, 1)]
    reflected = len(turned) % 2 == 1 and bool(np.all(np.ptp(turned, axis=0) < 1e-6 * units))
    gone = abs(orbit.action)
    if model.hamiltonian and len(orbit.samples):
        gone = max(gone, float(np.abs(orbit.samples).max(axis=0)[half:] @ units[:half]))
    bare = replace(orbit, times=np.zeros(0), samples=np.zeros((0, orbit.state.size)))
    for off in OFF:
        for sign in (1, -1):
            yield Plant(f"{kind}: period", replace(bare, period=orbit.period * (1 + sign * off)), model)
        for _ in range(2):
            state = orbit.state + off * units * random.choice([-1.0, 1.0], units.size)
            moved = replace(bare, state=state, nodes=bare.nodes if orbit.control else state[None])
            if model.hybrid is not None and not orbit.control:
                try:
                    found = gather_hybrid(model, state, orbit.period, np.asarray(orbit.winding))
                except OrbitfinderError:
                    continue
                moved = replace(moved, period=found.period, closure=found.closure, action=found.action,
                                floquet_multipliers=found.floquet.multipliers, stability=found.floquet.stability,
                                energy=energy(model, state))  # fmt: skip
            yield Plant(f"{kind}: state", moved, model)
    wrong = {
        "action": orbit.action + 1e-6 * (gone or 1.0), "closure": orbit.closure + 1e-3 * units.max(),
        "floquet_multipliers": orbit.floquet_multipliers + 1e-4 if orbit.floquet_multipliers.size else np.ones(2),
        "stability": "elliptic" if orbit.stability != "elliptic" else "unstable",
        "symmetry": "brake" if orbit.symmetry == "reflection" or reflected else "reflection",
        "unfolding": (1e-3 / orbit.period,),
    }  # fmt: skip
    for name, value in wrong.items():
        yield Plant(f"{kind}: recorded {name}", replace(orbit, **{name: value}), model)
    if len(orbit.samples):
        samples = orbit.samples.copy()
        samples[len(samples) // 2] += 1e-2 * units
        yield Plant(f"{kind}: recorded samples", replace(orbit, samples=samples), model)
    if orbit.control:
        for name, value in {"cost": orbit.control["cost"] * (1 + 1e-6) + 1e-6}.items():
            yield Plant(f"{kind}: recorded {name}", replace(orbit, control={**orbit.control, name: value}), model)


Q, V, CLOCK = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("t")


def told(model: Model, state: list[float], period: float, turns: tuple[int, ...] | None = None) -> of.Orbit:
    """A consistent record of a state and a period."""
    still = np.zeros(model.degrees_of_freedom, int) if turns is None else np.asarray(turns)
    return recorded(Case("planted", model, np.asarray(state, float), period, still))


def oscillator(force: ca.SX, damping: float, stiffness: float, cycle: float) -> Model:
    symbols = Symbols(Q, V, time=CLOCK, forcing_period=cycle)
    return lagrange(V**2 / 2, stiffness * Q**2 / 2, symbols, forces=force - damping * V)


def holes(random: np.random.Generator) -> Iterator[tuple[Plant, bool]]:
    """The classes of errors that 0.2.0 certified, with the true orbits beside them."""
    for damping, stiffness in ((0.2, 2.0), (0.05, 0.3), (0.6, 5.0), (0.1, 1.7)):
        answer = 1 / (stiffness - 1 + 1j * damping)
        start, cycle = [answer.real, -answer.imag], 2 * np.pi
        for k in (1, 2, 3, 4, 7, 9, 13, 29, 103):
            model = oscillator(ca.cos(CLOCK), damping, stiffness, k * cycle)
            yield Plant("forcing declared a multiple", told(model, start, k * cycle), model), k == 1
        for late in (1, 2, 3, 5, 8, 13, 20, 31):
            for wide in (0.3, 0.1, 0.05):
                pulse = 0.5 * ca.exp(-(((CLOCK - (late + random.uniform(0.1, 0.9)) * cycle) / wide) ** 2))
                model = oscillator(ca.cos(CLOCK) + pulse, damping, stiffness, cycle)
                yield Plant("pulse in a later period", told(model, start, cycle), model), False
        for wide in (1e-3, 3e-4, 1e-4, 3e-5, 1e-5):
            for _ in range(4):
                phase = CLOCK - cycle * ca.floor(CLOCK / cycle)
                pulse = 1e-2 / wide * ca.exp(-(((phase - random.uniform(0.3, 6.0)) / (wide * cycle)) ** 2))
                model = oscillator(ca.cos(CLOCK) + pulse, damping, stiffness, cycle)
                yield Plant("narrow pulse of the forcing", told(model, start, cycle), model, wide), False
    for wide in (1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6):
        for place in random.uniform(-0.9, 0.9, 16):
            size = 2 * wide
            model = lagrange(V**2 / 2, Q**2 / 2, Symbols(Q, V),
                             forces=4e-3 / size * ca.exp(-(((Q - place) / size) ** 2)) * V)  # fmt: skip
            yield Plant("narrow Gaussian force", told(model, [1.0, 0.0], 2 * np.pi), model, wide), False
            model = lagrange(V**2 / 2, Q**2 / 2, Symbols(Q, V),
                             forces=ca.if_else(ca.fabs(Q - place) < size / 2, 4e-3 / size, 0.0) * V)  # fmt: skip
            yield Plant("narrow rectangular force", told(model, [1.0, 0.0], 2 * np.pi), model, wide), False
    yield from turning(random)
    yield from parts()
    yield from slow(random)
    yield from needles(random)


def turning(random: np.random.Generator) -> Iterator[tuple[Plant, bool]]:
    """Rotors whose potential differs in a later turn."""
    from scipy.integrate import quad

    for level in (1.2, 1.5, 3.0):
        period = 2 * quad(lambda angle, level=level: 1 / np.sqrt(2 * (level + np.cos(angle))), 0, np.pi)[0]
        for turn in (0, 1, 2, 3, 5, 7, -1):
            for wide in (0.3, 0.1, 0.05):
                place = random.uniform(1.0, 5.0) + 2 * np.pi * turn
                bump = 0.3 * ca.exp(-(((Q - place) / wide) ** 2)) if turn else 0.0
                model = lagrange(V**2 / 2, -ca.cos(Q) + bump, Symbols(Q, V), angles=[True])
                orbit = told(model, [0.0, float(np.sqrt(2 * (level + 1)))], period, (1,))
                yield Plant("another potential in a later turn", orbit, model), turn == 0


def parts() -> Iterator[tuple[Plant, bool]]:
    """A free oscillator that is damped, beside or driving what errors grow in."""
    for grown in (10.0, 1e3, 1e5, 9e5):
        steep = float(np.log(grown)) / (2 * np.pi)
        for driven in (0, 1):
            for damping in (0.0, 1e-11, 1e-10, 1e-9, 6e-9, 1.2e-8, 1e-7):
                model = of.ode(lambda t, x, p, d=damping, s=steep, k=driven: [
                    x.v, -x.x - 2 * d * x.v, x.d, s**2 * x.c + k * x.x], ("x", "v", "c", "d"))  # fmt: skip
                orbit = told(model, [1.0, 0.0, -driven / (1 + steep**2), 0.0], 2 * np.pi)
                yield Plant("damped beside what is steep", orbit, model), damping == 0.0


CYCLE, PERIOD = [2.008619860874844, 0.0], 6.663286859323132
"""Of van der Pol's oscillator at mu = 1, as certified"""
SLOW: dict[str, tuple[Callable[[float], dict[str, str]], list[float]]] = {
    "a slow state": (lambda k: {"z": f"-({k})*(z-1)"}, [1.0]),
    "a slow state that feels the cycle": (lambda k: {"z": f"({k})*(1-z)*(1+x^2)"}, [1.0]),
    "a slow state in another unit": (lambda k: {"z": f"-({k})*(z-1e6)"}, [1e6]),
    "a slow state at 0": (lambda k: {"z": f"-({k})*z"}, [0.0]),
    "a slow cubic": (lambda k: {"z": f"({k})*(1-z^3)"}, [1.0]),
    "a pair that cancels": (lambda k: {"a": f"-({k})*(a-1)", "b": f"({k})*(b-1)"}, [1.0, 1.0]),
    "a pair whose gaps cancel": (lambda k: {"a": f"({k})*(b-a-(a-1)/5)", "b": f"({k})*(a-b-(b-1)/5)"}, [1.0, 1.0]),
    "a slow rotation": (lambda k: {"a": f"({k})*(b-1)", "b": f"({k})*(1-a)"}, [1.0, 1.0]),
    "a sum that leaks": (lambda k: {"a": "b-a", "b": f"a-b-({k})*(a+b-2)"}, [1.0, 1.0]),
    "a quick state and a slow": (lambda k: {"y": "20*(x-y)", "z": f"-({k})*(z-1)"}, [np.nan, 1.0]),
}
"""Rates of other states beside van der Pol's oscillator by k, and where they close; nan for one that follows"""
RATES = (*(f"{digit}e-{power}" for power in range(2, 12) for digit in (1, 5)), "1e-12")


def slow(
    random: np.random.Generator, kinds: Iterable[str] = SLOW, rates: Iterable[str] = RATES, count: int = 8
) -> Iterator[tuple[Plant, bool]]:
    """Multipliers near 1, of which nothing frees one: states that are off by 1e-8 to 1e-2 of their size."""
    for kind, k in product(kinds, rates):
        others, states = SLOW[kind]
        model = of.equations(rates={"x": "v", "v": "(1-x^2)*v-x", **others(float(k))})
        begin = np.append(CYCLE, states)
        if np.isnan(begin).any():
            settled = of.simulate(model, np.nan_to_num(begin), 3 * PERIOD).states[-1]
            begin = np.where(np.isnan(begin), settled, begin)
        yield Plant(f"near 1: {kind}", told(model, list(begin), PERIOD), model), True
        for _ in range(count):
            off = 10 ** random.uniform(-8, -2) * random.choice([-1.0, 1.0], len(states))
            moved = np.where(np.isnan(states), 0.0, off * np.where(np.nan_to_num(states), states, 1.0))
            state = list(begin + np.append([0.0, 0.0], moved))
            yield Plant(f"near 1: {kind}", told(model, state, PERIOD), model), False
    for mu in ("1e-3", "1e-5", "1e-7", "1e-9", "1e-11"):
        model = of.equations(rates={"x": "v", "v": f"{mu}*(1-x^2)*v-x"})
        for _ in range(4):
            state = [2.0 * (1 + 10 ** random.uniform(-5, -1)), 0.0]
            period = 2 * np.pi * (1 + float(mu) ** 2 / 16)
            yield Plant("near 1: an amplitude", told(model, state, period), model), False


def needles(random: np.random.Generator) -> Iterator[tuple[Plant, bool]]:
    """An oscillator against a wall, and a needle on the wall that it should meet before."""
    bob = lagrange(V**2 / 2, Q**2 / 2, Symbols(Q, V))

    def against(needle: float, place: float, wide: float) -> Model:
        wall = of.impact(bob, lambda x, p: 0.5 - x.q1 - needle * ca.exp(-(((x.q1 - place) / wide) ** 2)), 1.0)
        hit = of.Transition("hit", "fly", "fly", wall.gap, wall.after, impulse=wall.impulse)
        return of.hybrid({"fly": bob}, [hit], ["hit"], conserved=["energy"])

    plain = against(0.0, 0.0, 1.0)
    orbit = of.find_orbit(of.Problem(plain, guess=of.Guess([0.5, -1.0], 4.2), pin=of.pin(energy=0.625)))
    yield Plant("needle on a guard", orbit, plain), True
    for wide in (1e-3, 3e-4, 1e-4, 3e-5, 1e-5):
        for place in random.uniform(-1.0, 0.35, 12):
            yield Plant("needle on a guard", orbit, against(2.0, place, wide * 1.6), wide), False


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


def looked(certificate: of.Certificate) -> float:
    """The width down to which a certificate says to have looked; infinite where it does not say."""
    notes = [check.note for check in certificate.checks if check.name == "resolution"]
    said = re.search(r"([0-9.e+-]+) of (the motion|an arc) or less", notes[0]) if notes else None
    return float(said[1]) if said else np.inf


def planted() -> Iterator[tuple[str, Plant, bool]]:
    """(what it is of, the plant, whether it is right) of everything."""
    random = np.random.default_rng(0)
    for case in bases():
        orbit, found = recorded(case), gather(case.model, case.state, case.period, case.turns)
        for make in (physical, written):
            for plant in make(orbit, case.model, found.extents, random):
                yield case.name, replace(plant, kind=kind_of(plant.kind)), False
        for plant in true(orbit, case.model, found):
            yield case.name, plant, True
    for kind, orbit, model in others():
        yield orbit.name, Plant(f"{kind}: as it is", orbit, model), True
        for plant in elsewhere(kind, orbit, model, random):
            yield orbit.name, plant, False
    for plant, right in holes(random):
        yield "planted", plant, right


def main() -> None:
    """Plant, certify, count, write the page."""
    table: Counter[tuple[str, bool, bool, bool]] = Counter()
    odd: list[str] = []
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, nargs="?", default=ROOT / "results" / "validation" / "planted.md")
    parser.add_argument("--slow", action="store_true", help="multipliers near 1 alone")
    last, chosen = "", parser.parse_args()
    target, seeded = chosen.file, slow(np.random.default_rng(0))
    for name, plant, right in (("slow", *each) for each in seeded) if chosen.slow else planted():
        try:
            certificate = certify(plant.orbit, plant.model)
        except OrbitfinderError:  # a record that contradicts itself is refused before anything is recomputed
            certificate = of.Certificate((Check("record", 1.0, 0.0, False),))
        below = certificate.passed and not right and plant.wide < looked(certificate)
        table[plant.kind, right, certificate.passed, below] += 1
        if certificate.passed != right and not below:
            values = {check.name: check.value for check in certificate.checks}
            failed = ", ".join(certificate.failures) or "none"
            odd.append(
                f"| {name} | {plant.kind} | {values.get('closure', np.nan):.1e} | {certificate.scale:.2g} | "
                f"{values.get('distance', np.nan):.1e} | {failed} |"
            )
        if name != last:
            print(name, flush=True)
            target.write_text(page(table, odd))  # what has been judged so far
        last = name
    target.write_text(page(table, odd))
    wrong = Counter({key: n for key, n in table.items() if not key[1]})
    print(target.name, wrong.total(), "false,", sum(n for key, n in wrong.items() if key[2] and not key[3]),
          "of them certified,", sum(n for key, n in wrong.items() if key[3]), "below the stated width")  # fmt: skip


def page(table: Counter[tuple[str, bool, bool, bool]], odd: list[str]) -> str:
    """The table of kinds, and what was not judged as planted."""
    lines = [
        "# Planted errors\n",
        "Written by `python benchmarks/planted.py`: certified orbits of all kinds, one error at a time, "
        "everything else in the record made consistent with it. Below the width: features narrower than what the "
        "certificate says to have looked for.\n",
        "| what | planted | rejected | certified | below the stated width |", "|---|---|---|---|---|",
    ]  # fmt: skip

    def row(heading: str, chosen: Counter[tuple[str, bool, bool, bool]]) -> str:
        no, below = (sum(n for key, n in chosen.items() if key[2:] == one) for one in ((False, False), (True, True)))
        return f"| {heading} | {chosen.total()} | {no} | {chosen.total() - no - below} | {below} |"

    for right, heading in ((False, "wrong"), (True, "right")):
        for kind in sorted({key[0] for key in table if key[1] == right}):
            chosen = Counter({key: n for key, n in table.items() if key[:2] == (kind, right)})
            lines.append(row(f"{heading}: {kind}", chosen))
    for right, heading in ((False, "**all that is wrong**"), (True, "**all that is right**")):
        lines.append(row(heading, Counter({key: n for key, n in table.items() if key[1] == right})))
    head = "| orbit | plant | gap | A | distance to a true orbit | failed checks |"
    lines += ["", "Not judged as planted:", "", head, "|---|---|---|---|---|---|", *odd] if odd else [
        "", "Every one was judged as planted."
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
