"""What motions of a system are measured in: the one place for its lengths and its time.

Angles are measured in rad. Other coordinates may be told in anything, so they are measured in lengths of the motion,
each in proportion to what carries the same kinetic energy at the same pace,

    m_i L_i^2 = m_j L_j^2        m the diagonal of the mass matrix, L = 1 for angles,

so that a slider beside a crank, or a charge beside a plate, counts as much as what it moves with. Rates are
measured in lengths over tau = T / 2 pi. Whoever divides by these divides by exactly 1 where a system is of order one:
what is within a factor of 16 counts as equal, and the rest are powers of two, which cost no digits.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from orbitfinder._runtime.sizes import LEAST, nonzero
from orbitfinder.errors import InputError, closest
from orbitfinder.mechanics.model import Model
from orbitfinder.records.reading import Table

ALIKE, COARSE = 16.0, 256.0
"""Lengths that differ by less than the first factor are measured alike, as they are in powers of the second."""

STILL = 1e-12
"""A component of a first-order state that is less than this share of another is its round-off, not of smaller units,
but for one that is `acting`."""

FELT, LOOKED_AT = 1e-8, 8
"""Relative changes that are more than round-off; states at which it is asked whether they are felt"""

LEAST_SHARE = 0.1
"""A component that hardly moves is measured in this share: of what others do, of what it has moved in a family."""

WIDE = 2.0**16
"""Conditions that change by less than 256 with the unknowns, such as energies in J, are rows as they are."""


DIMENSIONLESS = ("henon_heiles", "restricted_three_body", "restricted_three_body_canonical", "planar_oscillator",
                 "van_der_pol", "lorenz", "rossler", "brusselator", "fitzhugh_nagumo", "hodgkin_huxley")  # fmt: skip
"""Systems of orbitfinder.systems and .flows whose equations carry no units, or their own"""
OWN = {"hodgkin_huxley": {"time": "ms", "V": "mV", "current": "uA/cm^2"}}
SI = {"time": "s", "length": "m", "mass": "kg", "angle": "rad", "energy": "J", "action": "J s"}
NEUTRAL = dict.fromkeys(SI, "") | {"angle": "rad"}
WORD = re.compile(r"[\w %/^*.()-]{0,24}")
"""A unit as it may be called"""


def units(system: Table) -> dict[str, str]:
    """The words for units of `SI`'s quantities, and of states and parameters by name: those given, else SI, or none
    where equations carry none, or are rates as text, which state none. Of other than SI's, kg m^2/s^2 and that times s
    are energy and action."""
    bare, told = system.get("function") in DIMENSIONLESS or "rates" in system, system.get("units", {})
    given = {**OWN.get(str(system.get("function")), {}), **(told if isinstance(told, Mapping) else {})}
    given = {name: word for name, word in given.items() if isinstance(word, str) and WORD.fullmatch(word)}
    known = (NEUTRAL if bare else SI) | given
    time, length, mass, _, energy, action = (known[name] for name in SI)
    if "energy" not in given and any(given.get(name, SI[name]) != SI[name] for name in ("time", "length", "mass")):
        energy = f"{mass} {length}^2/{time}^2" if mass and length and time else ""
    if "action" not in given and energy != SI["energy"]:
        action = f"{energy} {time}" if energy and time else ""
    return known | {"energy": energy, "action": action}


def with_units(model: Model, given: Mapping[str, str] | None) -> Model:
    """The Model whose quantities have these units in words, its description included; `InputError` for others.

    Nothing is converted. Of a first-order system only those are known that are given.
    """
    if not given:
        return model
    known = [*SI, *model.state_names, *model.parameter_names]
    for name, word in given.items():
        if name not in known:
            raise InputError(f"units: unknown {name!r}{closest(name, known)}; give words for {', '.join(known[:20])}")
        if not (isinstance(word, str) and WORD.fullmatch(word)):
            raise InputError(f"units.{name}: {str(word)[:30]!r} is no unit; give a word such as 'ms' or 'N/mm'")
    whole = (NEUTRAL if model.rates is not None else {}) | dict(given)
    return replace(model, system={**model.system, "units": whole})


def lasting(time: float, system: Table, digits: int = 12) -> str:
    """A time in words, with its unit where the equations carry one."""
    return measured(time, "time", system, digits)


def measured(value: float, quantity: str, system: Table, digits: int = 9) -> str:
    """A value in words, with the unit of its quantity, or of a parameter by name, where that is told."""
    told = units(system) if quantity in ("time", "energy") else given_units(system)
    return f"{value:.{digits}g} {told.get(quantity, '')}".rstrip()


def unit_along(parameter: str, system: Table) -> str:
    """The unit of what a family is followed in: energy, period or a parameter."""
    return units(system).get({"period": "time"}.get(parameter, parameter), "")


def given_units(system: Table) -> dict[str, str]:
    """The words for units of states and parameters by name."""
    return {name: word for name, word in units(system).items() if name not in SI}


UNIT, QUANTITIES = re.compile(r" \(([^()]*)\)|(?<=\d) (J|s)\b"), {word: name for name, word in SI.items()}
"""Units as texts have them: after a name in brackets, after a number"""


def worded(text: str, system: Table) -> str:
    """A text in SI units with a system's words in their place, and without units where it has none."""
    words = units(system)

    def told(unit: str) -> str | None:
        parts = [part if part == "1" else words.get(QUANTITIES.get(part, "")) for part in unit.split("/")]
        return None if None in parts else "/".join(map(str, parts)) * ("" not in parts)

    def converted(match: re.Match[str]) -> str:
        words = [told(unit) for unit in (match[1] or match[2]).split(" or ")]
        if None in words:
            return match[0]
        kept = " or ".join(dict.fromkeys(filter(None, words)))
        return (f" ({kept})" if match[1] else f" {kept}") if kept else ""

    return text if all(words[name] == SI[name] for name in SI) else UNIT.sub(converted, text)


def snapped(values: np.ndarray | float, base: float = COARSE) -> np.ndarray:
    """The powers of a base nearest to positive values, 1 for all others."""
    given = np.asarray(values, float)
    known = np.isfinite(given) & (given > 0)
    powers = np.round(np.log(np.where(known, given, 1.0)) / np.log(base))
    return np.asarray(base**powers)


def unit_names(model: Model) -> list[str]:
    """Unit of each coordinate: its own, that of angles, or of lengths; none is known of other components of a
    first-order system."""
    words, n = units(model.system), model.degrees_of_freedom
    angles = model.angular if model.rates is not None else model.angles or (True,) * n
    other = "" if model.rates is not None else words["length"]
    named = zip(model.state_names[:n], angles, strict=True)
    return [given_units(model.system).get(name, words["angle"] if angle else other) for name, angle in named]


def masses_of(kinetic: Callable[..., Any], state: np.ndarray, model: Model | None = None) -> np.ndarray:
    """Diagonal (n) of the mass matrix at a state (2n): twice the kinetic energy of each unit velocity."""
    n = state.size // 2
    given = [] if model is None else [model.parameter_values]
    return np.array([2.0 * float(kinetic(state[:n], unit, *given)) for unit in np.eye(n)])


def with_scales(model: Model, scales: Mapping[str, float] | None) -> Model:
    """The Model measured in given sizes, its description included (see `Model.scales`); `InputError` for others."""
    if not scales:
        return model
    coordinates = model.state_names[: model.degrees_of_freedom]
    lengths = [name for name, angle in zip(coordinates, model.angular, strict=True) if not angle]
    known = [*(["length"] if lengths else []), *lengths, *model.parameter_names]
    for name, value in scales.items():
        if name not in known:
            why = "; angles are measured in rad" if name in coordinates else closest(name, known)
            raise InputError(f"scales: unknown {name!r}{why}; give sizes of {', '.join(known[:20]) or 'nothing'}")
        if not (isinstance(value, (int, float)) and np.isfinite(value) and value > 0):
            raise InputError(f"scales.{name}: must be positive and finite, got {value}; give a typical size of it")
    given = {name: float(value) for name, value in scales.items()}
    return replace(model, scales=given, system={**model.system, "scales": given})


def given_or(model: Model, size: np.ndarray | float) -> np.ndarray:
    """The sizes (n) that the user gives coordinates, else those found; 1 of angles."""
    names, common = model.state_names[: model.degrees_of_freedom], model.scales.get("length", np.nan)
    given = np.array([model.scales.get(name, common) for name in names], float)
    return np.where(model.angular, 1.0, np.where(np.isnan(given), size, given))


def alike(sizes: np.ndarray | float) -> np.ndarray:
    """The powers of 2 nearest to sizes, 1 where they are within a factor of 16 of it."""
    return np.where(snapped(sizes) == 1.0, 1.0, snapped(sizes, 2.0))


def proportions(model: Model, state: np.ndarray, exact: bool = False) -> np.ndarray:
    """L_i (n) of the coordinates, in rad where there are angles, else relative to that of the heaviest coordinate.

    Sizes that the user gives (`model.scales`) replace what the mass matrix says, which is rounded but where `exact`.
    """
    if model.angular.all():
        return np.ones(model.degrees_of_freedom)
    if model.rates is not None:
        return given_or(model, 1.0)
    masses = masses_of(model.kinetic, state, model)
    known = np.isfinite(masses) & (masses > 0)
    turning = model.angular & known
    reference = masses[turning if turning.any() else known].max(initial=0.0)
    ratios = np.sqrt(np.where(known, reference / np.where(known, masses, 1.0), 1.0))
    return given_or(model, ratios if exact else alike(ratios))


def lengths(model: Model, states: np.ndarray) -> np.ndarray:
    """What coordinates (n) are measured in along a motion (k x 2n): its largest extent where there are no angles.

    Those of a first-order system each by itself.
    """
    if model.rates is not None:
        return np.where(model.angular, 1.0, alone(np.ptp(states, axis=0), model.angular, acts=acting_in(model, states)))
    parts, n = proportions(model, states[0]), model.degrees_of_freedom
    if model.angular.any():
        return parts
    return np.asarray(parts * nonzero((np.ptp(states[:, :n], axis=0) / parts).max()))


def surroundings(model: Model, place: np.ndarray) -> tuple[np.ndarray, float]:
    """Lengths (n) and a time (s) in which to look about a configuration q (n), before there is a motion.

    Lengths given, else a power of 256 near |q|; sqrt(length / acceleration), also as such a power.
    """
    reach = given_or(model, snapped(np.abs(place[~model.angular]).max(initial=0.0)))
    there = np.append(place + 0.3 * reach, np.zeros(len(model.state_names) - place.size))
    pace = np.abs(_pushed(model, there, place.size) / reach).max()
    return reach, float(1.0 / snapped(pace if model.rates is not None else np.sqrt(pace)))


def _pushed(model: Model, state: np.ndarray, n: int) -> np.ndarray:
    """The accelerations (n), of a first-order system the rates, at a state (d), 0 where they are not finite."""
    accelerations = model.rate(0.0, state, model.parameter_values).full().ravel()[-n:]
    return np.asarray(np.nan_to_num(accelerations, nan=0.0, posinf=0.0, neginf=0.0))


def unless_one(units: np.ndarray) -> tuple[float, ...]:
    """Units (d) as they are handed to an integrator: () where all are 1."""
    return () if np.all(units == 1.0) else tuple(map(float, units))


def base_of(model: Model) -> float:
    """The base of the powers that the finder's flow is measured in: 2 where a motion shows its sizes, that of a smooth
    mechanical system with lengths or with a forcing; under constraints, where coordinates depend on each other, 256."""
    free = model.rates is None and model.constraint is None
    shown = model.smooth and free and (model.forced or not bool(model.angular.all()))
    return 2.0 if shown else COARSE


def units_of(model: Model, states: np.ndarray, period: float, base: float = COARSE) -> tuple[float, ...]:
    """What a state (2n) is measured in: powers of 256 near the lengths and the time of a motion (k x 2n); () is 1.

    Lengths are max(|q|, |v| tau), tau = T / 2 pi, the largest over all angles and over all others, or |a| tau^2 where
    that is 0. Another `base` than 256 rounds time and lengths that are no angles' to its own powers. Base 0 rounds
    nothing: time is tau, angles are in rad, and the unit of length is a quarter of the largest.
    """
    clock, n = period / (2 * np.pi), model.degrees_of_freedom
    if model.constraint is not None:  # integrated by IDAS
        return ()
    largest = np.abs(states).max(axis=0)
    if model.rates is not None:
        sizes = np.maximum(largest, clock * np.abs(_pushed(model, states[0], n)))
        return unless_one(snapped(alone(sizes, model.angular, 1.0, acting_in(model, states))))
    parts, turning = proportions(model, states[0], not base), model.angular
    amplitudes = np.maximum(largest[:n], largest[n:] * clock) / parts
    if base == COARSE and turning.all() and 1 / ALIKE < clock < ALIKE and 1 / ALIKE < amplitudes.max() < ALIKE:
        return ()  # as below, in a third of the time
    for group in (turning, ~turning):
        size = amplitudes[group].max(initial=0.0)
        if group.any() and not size > 0:
            size = (np.abs(_pushed(model, states[0], n)) * clock**2 / parts)[group].max()
        amplitudes[group] = size
    if not base:
        amplitudes = np.where(amplitudes > 0, amplitudes, LEAST_SHARE * amplitudes.max(initial=0.0))
        sizes = np.where(turning | ~(amplitudes > 0), 1.0, amplitudes * parts / 4)
        return (*sizes, *(sizes / clock))
    amplitudes *= parts
    sizes = np.where(turning, snapped(amplitudes), snapped(amplitudes, base))
    return unless_one(np.concatenate([sizes, sizes / snapped(clock, base)]))


def extents_of(model: Model, states: np.ndarray, period: float) -> np.ndarray:
    """Extents (d) of a motion of a Model (k x d) over its period."""
    if model.rates is not None:
        return alone(np.ptp(states, axis=0), model.angular, acts=acting_in(model, states))
    return extents(np.ptp(states, axis=0), masses_of(model.kinetic, states[0], model), period, model.angular)


def extents(
    moved: np.ndarray, masses: np.ndarray, period: float, angular: np.ndarray | None = None, acts: Acts | None = None
) -> np.ndarray:
    """Extents (2n) of coordinates and rates from how far they moved, none of them 0; without masses `alone`.

    What moves less than a tenth of the length L_i, m_i L_i^2 / tau = the largest m q v of all, tau = T / 2 pi,
    is measured in that tenth: `masses` are the diagonal of the mass matrix (n).
    """
    if not masses.size:
        return alone(moved, angular, acts=acts)
    far, fast = np.split(moved, 2)
    clock, weights = period / (2 * np.pi), nonzero(masses)
    # what turns steadily has moved, although its rate has not changed
    action = float(np.max(weights * far * np.maximum(fast, far / period)))
    if not (np.isfinite(action) and action > 0.0):
        return np.repeat([1.0, 1.0 / clock], masses.size)
    least = LEAST_SHARE * np.sqrt(action * clock / weights)
    return np.asarray(np.maximum(moved, np.concatenate([least, least / clock])))


def shared(moved: np.ndarray, angular: np.ndarray) -> np.ndarray:
    """What the components of a state (d) move beside each other, none of them 0: all coordinates (n) what the most of
    them does, and so all rates; of a first-order system each `alone`."""
    n = angular.size
    if n == moved.size:
        return alone(moved, angular)
    return np.repeat(nonzero(np.array([moved[:n].max(), moved[n:].max()])), n)


Acts = Callable[[np.ndarray], np.ndarray]
"""Which of some components (a mask d) are no round-off, however small they are"""


def alone(
    moved: np.ndarray, angular: np.ndarray | None = None, share: float = LEAST_SHARE, acts: Acts | None = None
) -> np.ndarray:
    """Extents (d) of a first-order motion from how far its components moved, none of them 0.

    Each may have a unit of its own; what hardly moves at all is measured in a share of what the others do, `angular`
    ones by themselves: a clock of 2 pi says nothing of what a nanometre is.
    """
    turning = np.zeros(moved.size, bool) if angular is None else angular
    largest = np.where(turning, moved[turning].max(initial=0.0), moved[~turning].max(initial=0.0))
    moves = moved > STILL * largest
    if acts is not None and (small := ~moves & (moved > LEAST)).any():
        moves |= acts(small)
    shares = np.where(moves, moved, share * largest)
    return np.where(np.isfinite(largest) & (largest > 0.0), shares, 1.0)


def acting_in(model: Model, states: np.ndarray) -> Acts:
    """`acting` in a motion (k x d) of a first-order Model."""
    rate, given = model.rate, model.parameter_values
    return acting(lambda rows: np.array([rate(0.0, row, given).full().ravel() for row in rows]), states)


def acting(rates: Callable[[np.ndarray], np.ndarray], states: np.ndarray) -> Acts:
    """Which small components of a motion (k x d) act, by the rates (k x d) of states: in whatever units they are told.

    Half of it is felt by the rate of another that moves, or it is driven by those: its rate is not in proportion to it.
    The round-off of what stays at 0, such as in a plane that is invariant or on a section, is neither.
    """

    def acts(small: np.ndarray) -> np.ndarray:
        few = states[:: max(1, len(states) // LOOKED_AT)]
        least = FELT * np.abs(few).max(axis=0) if len(few) > 1 else 0.0
        asked, idle = small & ~(np.ptp(few, axis=0) < least), small.copy()
        now = rates(few)
        jolted = few * (1.0 + FELT * (-1.0) ** np.arange(small.size))
        most = FELT * np.abs(now).max(axis=0)
        if len(few) > 1:  # what stays though its rate would move it, as on a section, is held at 0
            paces = np.abs(now).max(axis=0) / nonzero(np.ptp(few, axis=0))
            asked &= paces <= paces[~small].max(initial=0.0) / STILL
        while True:
            more = np.zeros(small.size, bool)  # whose halves change the rates of those that are moving
            for k in np.flatnonzero(asked & idle):
                half = few * np.where(np.arange(small.size) == k, 0.5, 1.0)
                more[k] = bool(((np.abs(rates(half) - now).max(axis=0) > most) & ~idle).any())
            if not more.any():  # who is felt is no constant of the others
                offset = 2 * rates(np.where(idle, few / 2, few)) - now
                noise = 2 * rates(np.where(idle, jolted / 2, jolted)) - rates(jolted) - offset
                driven = np.abs(offset).max(axis=0) > np.maximum(np.abs(noise).max(axis=0), most)
                more = asked & idle & driven
            if not more.any():
                return np.asarray(asked & ~idle)
            idle &= ~more

    return acts


def parameter_sizes(model: Model, names: Sequence[str], values: np.ndarray, least: float = 1e-3) -> np.ndarray:
    """What physical parameters of these names are measured in: the sizes given, else their values.

    Values that are less than `least` may be zeros that were not met exactly, unless the model's own are as small.
    """
    own = [abs(float(model.parameter_values[model.parameter_index(name)])) for name in names]
    floors = [min(least, value) or least for value in own]
    measured = np.maximum(np.abs(values), floors)
    return np.array([model.scales.get(name, size) for name, size in zip(names, measured, strict=True)], float)
